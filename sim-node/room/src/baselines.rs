//! The users' rates with the present mirror angles, and three references: no array, flat mirrors,
//! and the oracle.
//!
//! All four are computed for the same instants with the same users and obstacles, so that their
//! ratios are comparable. The oracle respects the minimum rates with a penalty of [`QOS_PENALTY`]
//! bit/s for each missing bit/s.

use heliostat_channel::solver::{Method, MinimumRates, QOS_PENALTY, Solver};
use heliostat_channel::{ChannelModel, Cylinder, LinkBudget, MirrorAngles, Orientation, Scene, Vec3};
use heliostat_proto::SumRates;

use crate::world::World;
use crate::world::walker::Walker;

/// All inputs of the rates at one instant.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// The latest tick.
    pub tick: u64,
    /// Room time in ns.
    pub time_ns: u64,
    /// Whether the array has accepted a command yet; earlier instants are not counted.
    pub commanded: bool,
    /// Numbers of the users.
    pub ids: Vec<u32>,
    /// Positions of the receivers in m.
    pub positions: Vec<Vec3>,
    /// How the users hold their receivers.
    pub orientations: Vec<Orientation>,
    /// Heading of each user, in radians from +x towards +y.
    pub headings: Vec<f64>,
    /// Obstacles, then bodies.
    pub blockers: Vec<Cylinder>,
    /// Number of obstacles among them.
    pub obstacles: usize,
    /// For each user, whether the direct path is off.
    pub forced: Vec<bool>,
    /// Minimum rates in bit/s.
    pub min_rate_bps: Vec<f64>,
    /// Power, noise and bandwidth.
    pub budget: LinkBudget,
    /// Where the mirrors point.
    pub angles: MirrorAngles,
}

impl Snapshot {
    /// The world as it is now, with the mirrors at `angles`.
    pub fn new(world: &World, angles: &MirrorAngles) -> Self {
        Self {
            tick: 0,
            time_ns: 0,
            commanded: true,
            ids: world.ids().to_vec(),
            positions: world.positions().to_vec(),
            orientations: world.orientations().to_vec(),
            headings: world.users().iter().map(Walker::heading).collect(),
            blockers: world.blockers().to_vec(),
            obstacles: world.obstacles().len(),
            forced: world.forced().to_vec(),
            min_rate_bps: world.min_rate_bps().to_vec(),
            budget: world.model().budget.clone(),
            angles: angles.clone(),
        }
    }
}

/// The rates and gains at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Sums of all users' rates in bit/s.
    pub sum_rates_bps: SumRates,
    /// Each user's rate in bit/s, with the present angles.
    pub rates_bps: Vec<f64>,
    /// Each user's SINR (linear), with the present angles.
    pub sinr: Vec<f64>,
    /// Each user's gain over the direct path (dimensionless).
    pub los_gain: Vec<f64>,
    /// Each user's gain over the mirrors, with the present angles (dimensionless).
    pub irs_gain: Vec<f64>,
    /// For each user, whether the direct path is off.
    pub los_blocked: Vec<bool>,
    /// Each user's rate in bit/s, with the angles of the oracle.
    pub oracle_rates_bps: Vec<f64>,
    /// Users whose minimum rate is met.
    pub met: usize,
    /// Users whose minimum rate the oracle would meet.
    pub met_oracle: usize,
}

/// Computes the rates of instants; owns a model, scene and solver, so that it can run on another
/// thread. The number of users may differ from instant to instant.
#[derive(Debug)]
pub struct Baselines {
    model: ChannelModel,
    scene: Scene,
    solver: Solver,
    flat: MirrorAngles,
    best: MirrorAngles,
    rates: Vec<f64>,
    measured: Measured,
}

impl Baselines {
    /// Baselines for the room of this world.
    pub fn new(world: &World) -> Self {
        let model = world.model().clone();
        let (users, mirrors) = (world.users().len().max(1), model.mirrors.len());
        Self {
            scene: Scene::new(&model, users),
            solver: Solver::new(users, mirrors),
            flat: MirrorAngles::flat(mirrors),
            best: MirrorAngles::flat(mirrors),
            rates: Vec::new(),
            measured: Measured::default(),
            model,
        }
    }

    /// Sizes the buffers for this number of users.
    fn resize(&mut self, users: usize) {
        let measured = &mut self.measured;
        for list in [
            &mut self.rates,
            &mut measured.rates_bps,
            &mut measured.sinr,
            &mut measured.los_gain,
            &mut measured.irs_gain,
            &mut measured.oracle_rates_bps,
        ] {
            list.resize(users, 0.0);
        }
        measured.los_blocked.resize(users, false);
        self.scene.resize(users);
        if users > 0 {
            self.solver.set_users(users);
        }
    }

    /// Computes one instant.
    pub fn measure(&mut self, at: &Snapshot) -> &Measured {
        self.resize(at.positions.len());
        let Self { model, scene, solver, flat, best, rates, measured, .. } = self;
        model.budget.clone_from(&at.budget);
        scene.update_turned(model, &at.positions, &at.orientations, &at.blockers, &at.forced);
        measured.los_blocked.copy_from_slice(scene.los_blocked());
        let met =
            |rates: &[f64]| rates.iter().zip(&at.min_rate_bps).filter(|(rate, required)| rate >= required).count();

        measured.los_gain.copy_from_slice(scene.los_gain());
        scene.irs_gain(model, &at.angles, &mut measured.irs_gain);
        scene.sinr(model, &at.angles, &mut measured.sinr);
        scene.rates_bps(model, &at.angles, &mut measured.rates_bps);
        measured.sum_rates_bps.policy = measured.rates_bps.iter().sum();
        measured.met = met(&measured.rates_bps);

        let direct = |gain: &f64| model.budget.rate_bps(model.budget.sinr(*gain), at.positions.len());
        measured.sum_rates_bps.no_irs = scene.los_gain().iter().map(direct).sum();

        scene.rates_bps(model, flat, rates);
        measured.sum_rates_bps.flat = rates.iter().sum();

        let minimum_rates = MinimumRates { min_rate_bps: &at.min_rate_bps, qos_penalty: QOS_PENALTY };
        if scene.users() > 0 {
            solver.solve(model, scene, &minimum_rates, Method::Oracle, best);
        }
        scene.rates_bps(model, best, &mut measured.oracle_rates_bps);
        measured.sum_rates_bps.oracle = measured.oracle_rates_bps.iter().sum();
        measured.met_oracle = met(&measured.oracle_rates_bps);
        measured
    }
}

/// Sums over instants.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RateCounters {
    /// Instants.
    pub samples: u64,
    users: u64,
    sums: SumRates,
    met: u64,
    met_oracle: u64,
    blocked: u64,
}

impl RateCounters {
    /// Adds one instant to the sums.
    pub fn add(&mut self, measured: &Measured) {
        self.samples += 1;
        self.users += measured.rates_bps.len() as u64;
        self.sums.policy += measured.sum_rates_bps.policy;
        self.sums.no_irs += measured.sum_rates_bps.no_irs;
        self.sums.flat += measured.sum_rates_bps.flat;
        self.sums.oracle += measured.sum_rates_bps.oracle;
        self.met += measured.met as u64;
        self.met_oracle += measured.met_oracle as u64;
        self.blocked += measured.los_blocked.iter().filter(|blocked| **blocked).count() as u64;
    }

    /// Mean over the instants of the sum rates of the users present, in bit/s; zero before the
    /// first instant. An instant without users has a sum rate of 0.
    pub fn mean_sum_rates_bps(&self) -> SumRates {
        let mean = |sum: f64| sum / self.samples.max(1) as f64;
        SumRates {
            policy: mean(self.sums.policy),
            no_irs: mean(self.sums.no_irs),
            flat: mean(self.sums.flat),
            oracle: mean(self.sums.oracle),
        }
    }

    /// Share of users and instants with the minimum rate met: with the present angles, and by the
    /// oracle.
    pub fn qos_met(&self) -> (f64, f64) {
        let share = |count: u64| count as f64 / self.users.max(1) as f64;
        (share(self.met), share(self.met_oracle))
    }

    /// Mean number of users whose direct path is off.
    pub fn blocked_users_mean(&self) -> f64 {
        self.blocked as f64 / self.samples.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::Scenario;

    use super::*;

    #[test]
    fn instants_may_have_other_users_and_none() {
        let overrides = [
            "users.count=12",
            "users.arrivals.rate_per_min=0",
            "users.arrivals.mean_stay_s=2",
            "users.arrivals.max_users=12",
        ];
        let scenario = Scenario::builtin("specular").unwrap().with_overrides(&overrides).unwrap();
        let mut world = World::new(&scenario, None, 1).unwrap();
        let flat = MirrorAngles::flat(100);
        let (mut baselines, mut counters, mut sizes) = (Baselines::new(&world), RateCounters::default(), Vec::new());
        loop {
            let at = Snapshot::new(&world, &flat);
            let measured = baselines.measure(&at).clone();
            counters.add(&measured);
            sizes.push(measured.rates_bps.len());
            if sizes.last() == Some(&0) {
                assert_eq!(measured.sum_rates_bps, SumRates::default());
                break;
            }
            assert_eq!(measured, *Baselines::new(&world).measure(&at), "{sizes:?}");
            world.step(1.0);
        }
        assert!(sizes.len() > 3 && sizes[0] == 12, "{sizes:?}");
        assert!(counters.mean_sum_rates_bps().oracle > 0.0 && counters.qos_met().1 <= 1.0);
    }
}
