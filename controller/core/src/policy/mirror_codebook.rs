//! A codebook for each mirror: angles from a finite set, chosen by the channel model.
//!
//! Codebooks with beam training are the usual way to steer an intelligent reflecting surface
//! without knowledge of each reflected path: You, Zheng and Zhang, "Fast beam training for
//! IRS-assisted multiuser communications", IEEE Wireless Communications Letters 9(11), 2020. There
//! the complete surface, or a part of it, takes a codeword that users report as best. Here every
//! mirror has a codebook of its own, and the model replaces the training.
//!
//! # A decision
//! 1. For each user and mirror the entry with the largest gain is found among the entries for the
//!    four grid points around the user, in the paper's modes among all entries.
//! 2. The solver of `greedy` assigns each mirror to one user, by these gains.
//! 3. Each mirror takes the entry of its user.
//!
//! Light that an entry gives to other users is not counted.

use heliostat_channel::{
    ChannelError, ChannelModel, Vec3,
    mirrors::MirrorAngles,
    solver::{MinimumRates, Problem, QOS_PENALTY, Solver},
};
use heliostat_proto::MAX_USERS;
use heliostat_scenario::{ChannelMode, Scenario};

use super::codewords::codewords;
use super::model_based::GREEDY_PASSES;
use super::proposal::{Policy, PolicyError};
use crate::observe::observation::Observation;

/// Points of the grid along each side of the room in `specular`: 0.2 m apart in a room of 5 m, less
/// than the width of a spot.
const GRID: usize = 24;

/// The entry with the largest gain for each pair of user and mirror. Shape: K * M.
struct BestEntries {
    gains: Vec<f64>,
    entries: Vec<u32>,
    /// The gains of one codeword.
    of_codeword: Vec<f64>,
}

/// Every mirror takes the entry of its codebook that serves the user whom the solver assigns.
pub struct MirrorCodebook {
    /// Entry c of mirror m is element m of codeword c.
    codewords: Vec<MirrorAngles>,
    /// Extent of the room along x and y in m, where codewords are points of a grid.
    grid_m: Option<[f64; 2]>,
    best: BestEntries,
    solver: Solver,
}

impl MirrorCodebook {
    /// The codebooks of a scenario's mirrors.
    ///
    /// # Errors
    /// [`ChannelError`] where the scenario describes no channel.
    pub fn new(scenario: &Scenario) -> Result<Self, ChannelError> {
        let model = scenario.channel_model()?;
        let (users, mirrors) = (scenario.users.count, model.mirrors.len());
        let is_grid = scenario.channel.mode == ChannelMode::Specular;
        let pairs = MAX_USERS * mirrors;
        Ok(Self {
            codewords: codewords(scenario, &model, GRID),
            grid_m: is_grid.then_some([scenario.room.length_x_m, scenario.room.length_y_m]),
            best: BestEntries {
                gains: Vec::with_capacity(pairs),
                entries: Vec::with_capacity(pairs),
                of_codeword: Vec::with_capacity(pairs),
            },
            solver: Solver::with_capacity(users, MAX_USERS, mirrors),
        })
    }

    /// The codebook of a mirror: roll and yaw of each entry in rad.
    pub fn entries(&self, mirror: usize) -> impl Iterator<Item = [f64; 2]> {
        self.codewords.iter().map(move |codeword| [codeword.roll[mirror], codeword.yaw[mirror]])
    }
}

impl BestEntries {
    fn clear(&mut self, pairs: usize) {
        self.gains.clear();
        self.gains.resize(pairs, 0.0);
        self.entries.clear();
        self.entries.resize(pairs, 0);
        self.of_codeword.clear();
        self.of_codeword.resize(pairs, 0.0);
    }

    /// Takes an entry of all mirrors.
    fn offer(&mut self, model: &ChannelModel, seen: &Observation, (entry, angles): (usize, &MirrorAngles)) {
        seen.scene.irs_gain_each(model, angles, &mut self.of_codeword);
        // The steering gain knows mirrors that do not follow, and obstacles that are believed.
        let gains = self.of_codeword.iter().zip(seen.scene.steering_gain());
        for ((best, taken), (gain, steering)) in self.gains.iter_mut().zip(&mut self.entries).zip(gains) {
            let gain = gain.min(*steering);
            if gain > *best {
                (*best, *taken) = (gain, entry as u32);
            }
        }
    }
}

/// The four points of the grid around a place, as indices of codewords.
fn around(place: &Vec3, extents_m: [f64; 2]) -> [usize; 4] {
    let lower = |value_m: f64, extent_m: f64| {
        let steps = (value_m / extent_m + 0.5) * GRID as f64 - 0.5;
        (steps.floor().max(0.0) as usize).min(GRID - 2)
    };
    let (x, y) = (lower(place.x, extents_m[0]), lower(place.y, extents_m[1]));
    [y * GRID + x, y * GRID + x + 1, (y + 1) * GRID + x, (y + 1) * GRID + x + 1]
}

impl Policy for MirrorCodebook {
    fn name(&self) -> &str {
        "mirror-codebook"
    }

    fn act(&mut self, model: &ChannelModel, seen: &Observation, out: &mut MirrorAngles) -> Result<(), PolicyError> {
        let Self { codewords, grid_m, best, solver } = self;
        let (users, mirrors) = (seen.users(), seen.mirrors());
        best.clear(users * mirrors);
        match grid_m {
            Some(extents_m) => {
                for index in seen.positions.iter().flat_map(|place| around(place, *extents_m)) {
                    best.offer(model, seen, (index, &codewords[index]));
                }
            }
            None => codewords.iter().enumerate().for_each(|codeword| best.offer(model, seen, codeword)),
        }
        // Each decision starts without a state, so the policy has no memory.
        solver.change_users(&[None; MAX_USERS][..users]);
        let minimum_rates = MinimumRates { min_rate_bps: &seen.min_rate_bps, qos_penalty: QOS_PENALTY };
        let problem = Problem::of_scene(model, &seen.scene, &minimum_rates);
        solver.greedy(&Problem { steering_gain: &best.gains, directions: None, ..problem }, GREEDY_PASSES);
        for (mirror, user) in solver.served().iter().enumerate() {
            let entry = best.entries[user * mirrors + mirror] as usize;
            out.roll[mirror] = codewords[entry].roll[mirror];
            out.yaw[mirror] = codewords[entry].yaw[mirror];
        }
        Ok(())
    }

    fn warm_cache(&mut self, model: &ChannelModel, seen: &Observation, out: &mut MirrorAngles) {
        // The policy has no memory, and the next decision reports a failure.
        let _ = self.act(model, seen, out);
    }
}
