//! Rooms that a controller knows by reports only, in closed loop: the examples from which a network
//! learns to correct the belief.
//!
//! Each decision of the controller shows the row that the actor reads for each user, and the truth
//! in the middle of the command's time in force: [`Future`]. The actor of the run decides, so that
//! its own commands shape what it observes.

use anyhow::Context;
use heliostat_core::core::Controller;
use heliostat_core::evidence::{Evidence, FEATURES, NORMAL};
use heliostat_core::policy::Policy;
use heliostat_environment::closed_loop::ClosedLoop;
use heliostat_room::World;
use heliostat_room::episode::Episode;
use heliostat_scenario::{MismatchKind, Scenario};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Users have walked for this time when the reports begin, in ns.
const START_NS: u64 = 5_000_000_000;

/// The first decisions give no examples, since the belief has just begun; in ns.
const FIRST_NS: u64 = 500_000_000;

/// A row with the truth about its user, in the frame of the row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Example {
    /// The row that the actor reads.
    pub row: [f32; FEATURES],
    /// Horizontal components of the true normal of the receiver less those of the believed one.
    pub tilt: [f32; 2],
}

/// The mobility models from which rooms are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Walks {
    /// Random waypoint.
    RandomWaypoint,
    /// Random waypoint with pauses.
    Pauses,
    /// Random direction.
    RandomDirection,
    /// Gauss-Markov.
    GaussMarkov,
    /// Smooth random mobility.
    SmoothRandom,
    /// Social force.
    SocialForce,
    /// Seated users.
    Seated,
}

impl Walks {
    /// All mobility models.
    pub const ALL: [Self; 7] = [
        Self::RandomWaypoint,
        Self::Pauses,
        Self::RandomDirection,
        Self::GaussMarkov,
        Self::SmoothRandom,
        Self::SocialForce,
        Self::Seated,
    ];

    fn overrides(self) -> &'static [&'static str] {
        match self {
            Self::RandomWaypoint => &[],
            Self::Pauses => &["users.pause_mean_s=3"],
            Self::RandomDirection => &["users.mobility=random-direction"],
            Self::GaussMarkov => &["users.mobility=gauss-markov"],
            Self::SmoothRandom => &["users.mobility=smooth-random"],
            Self::SocialForce => &["users.mobility=social-force", "users.pause_mean_s=2"],
            Self::Seated => &["users.mobility=seated"],
        }
    }
}

/// The rooms of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoomChoice {
    /// The mobility models.
    pub walks: Vec<Walks>,
    /// The parts of the room that may differ from the known one.
    pub mismatch: Vec<MismatchKind>,
    /// Share of offices: seated users among users who walk, with tilted receivers.
    #[serde(default)]
    pub offices: f64,
    /// Whether each room is the scenario itself, for an actor that serves this room only.
    #[serde(default)]
    pub scenario_only: bool,
}

impl RoomChoice {
    /// The largest number of users in a room.
    pub const USERS_MAX: u32 = 7;

    /// Draws a room around a scenario: walks, how receivers are held, the difference from the known
    /// room, number of users, rates, latencies and noises of the reports, size of the room.
    ///
    /// # Errors
    /// A scenario in which no such room is valid.
    pub fn draw(&self, scenario: &Scenario, rng: &mut impl Rng) -> anyhow::Result<Scenario> {
        let mut last = None;
        for _ in 0..20 {
            match scenario.with_overrides(&self.overrides(rng)) {
                Ok(room) => return Ok(room),
                Err(error) => last = Some(error),
            }
        }
        Err(anyhow::anyhow!(last.map_or("no room was drawn".into(), |error| error.to_string())))
            .context("no room around the scenario is valid: choose the scenario hall, or other walks")
    }

    /// Draws this many rooms around a scenario and runs something in each, on all threads; the
    /// results are in the order of the rooms, whatever the number of threads.
    ///
    /// # Errors
    /// As [`RoomChoice::draw`], and errors of `run`, which gets a room and its seed.
    pub fn in_rooms<T: Send>(
        &self,
        (scenario, count): (&Scenario, usize),
        rng: &mut impl Rng,
        run: impl Fn(&Scenario, u64) -> anyhow::Result<T> + Sync,
    ) -> anyhow::Result<Vec<T>> {
        anyhow::ensure!(
            !self.walks.is_empty(),
            "walks = []: expected at least one way of walking, for example [\"seated\"]"
        );
        let draw = |_| Ok((self.draw(scenario, rng)?, rng.random()));
        let rooms: Vec<(Scenario, u64)> = (0..count).map(draw).collect::<anyhow::Result<_>>()?;
        let pool = rayon::ThreadPoolBuilder::new().build()?;
        pool.install(|| rooms.par_iter().map(|(room, seed)| run(room, *seed)).collect())
    }

    fn overrides(&self, rng: &mut impl Rng) -> Vec<String> {
        if self.scenario_only {
            return Vec::new();
        }
        // Without offices, no number of the generator is used for them.
        let office = self.offices > 0.0 && rng.random_bool(self.offices.min(1.0));
        let mut all: Vec<String> = if office {
            office_overrides(rng)
        } else {
            let walks = self.walks[rng.random_range(0..self.walks.len())];
            walks.overrides().iter().map(|text| (*text).to_owned()).collect()
        };
        let mut set = |key: &str, value: f64| all.push(format!("{key}={value}"));
        set("users.count", f64::from(rng.random_range(2..=Self::USERS_MAX)));
        let factor = |rng: &mut dyn FnMut() -> f64, low: f64, high: f64| low * (high / low).powf(rng());
        let mut uniform = || rng.random::<f64>();
        set("streams.positions.rate_hz", factor(&mut uniform, 7.0, 25.0).round());
        set("streams.positions.latency_ms", factor(&mut uniform, 30.0, 150.0).round());
        set("streams.positions.noise_m", factor(&mut uniform, 0.02, 0.1));
        set("streams.positions.velocity_noise_m_s", factor(&mut uniform, 0.05, 0.2));
        set("streams.channel.noise_relative", factor(&mut uniform, 0.02, 0.1));
        set("blockage.obstacles_per_m2", 0.1 * uniform());
        let (length_x_m, length_y_m, height_m) = (4.5 + 2.5 * uniform(), 4.5 + uniform(), 2.8 + 0.4 * uniform());
        set("room.length_x_m", length_x_m);
        set("room.length_y_m", length_y_m);
        set("room.height_m", height_m);
        let led_m = [0.4 * length_x_m * (uniform() - 0.5), 0.4 * length_y_m * (uniform() - 0.5), height_m];
        // One LED, or two that are opposite to each other.
        let two = uniform() < if office { 0.7 } else { 0.3 };
        let opposite_m = [-led_m[0], -led_m[1], height_m];
        all.push(if two {
            format!("led.positions_m=[{led_m:?}, {opposite_m:?}]")
        } else {
            format!("led.positions_m=[{led_m:?}]")
        });
        if office || rng.random_bool(0.6) {
            all.push("users.orientation={}".into());
        }
        if rng.random_bool(if office { 0.5 } else { 0.25 }) {
            all.push("control.tilt={}".into());
        }
        let level = ["none", "typical", "rough"][rng.random_range(0..3)];
        if level != "none" && !self.mismatch.is_empty() {
            all.push(format!("mismatch.level={level}"));
            let kinds = serde_json::to_string(&self.mismatch).unwrap_or_default();
            all.push(format!("mismatch.kinds={kinds}"));
        }
        all
    }
}

/// Walks, pauses and furniture of an office, without reports of orientations: with them no
/// correction counts.
fn office_overrides(rng: &mut impl Rng) -> Vec<String> {
    let (seated, walking) = [(0.4, 0.6), (0.6, 0.4), (0.8, 0.2)][rng.random_range(0..3)];
    let models = [("seated", seated), ("social-force", walking)];
    let models = models.map(|(model, share)| format!("{{mobility=\"{model}\",share={share}}}"));
    vec![
        "users.mobility=mixture".to_owned(),
        format!("users.mixture=[{}]", models.join(",")),
        format!("users.pause_mean_s={}", 2.0 + 6.0 * rng.random::<f64>()),
        "users.heading_lag_s=0.3".into(),
        "blockage.obstacle_radius_m=0.3".into(),
    ]
}

/// Lets a policy decide in a room for `seconds`, and calls `see` after each decision but the first.
///
/// # Errors
/// The scenario describes no room, or the array refuses a command.
pub fn decisions(
    scenario: &Scenario,
    seed: u64,
    (policy, seconds): (Box<dyn Policy>, f64),
    see: &mut dyn FnMut(&ClosedLoop),
) -> anyhow::Result<()> {
    let episode = Episode::new(scenario, None, seed, START_NS)?;
    let controller = Controller::new(scenario, scenario.channel_model()?, policy, 1);
    let mut room = ClosedLoop::new(episode, controller);
    let end_ns = START_NS + (seconds * 1e9) as u64;
    while let Some((now, event)) = room.poll_event(end_ns) {
        if room.deliver(now, event, &mut |_| {})? && now.room_ns > START_NS + FIRST_NS {
            see(&room);
        }
    }
    Ok(())
}

/// The examples of a room in which a policy decides for `seconds`.
///
/// # Errors
/// As [`decisions`].
pub fn examples(scenario: &Scenario, seed: u64, policy: Box<dyn Policy>, seconds: f64) -> anyhow::Result<Vec<Example>> {
    let mut all = Vec::new();
    decisions(scenario, seed, (policy, seconds), &mut |room| {
        let Some(future) = Future::of(room) else { return };
        all.extend(future.users().map(|(row, tilt)| Example { row, tilt }));
    })?;
    Ok(all)
}

/// The users in the middle of the time in which the last command of a controller is in force, and
/// the index among them of each observed user; `None` where one has left.
pub fn later(room: &ClosedLoop) -> Option<(World, Vec<usize>)> {
    let mut world = room.room().world().clone();
    world.step(room.controller().observer().lead_s());
    let index = |user| world.ids().iter().position(|id| id == user);
    let indices = room.observation().ids.iter().map(index).collect::<Option<_>>()?;
    Some((world, indices))
}

/// The room in the middle of the time in which the last command of a controller is in force, and
/// the evidence on which this command was based.
pub struct Future<'a> {
    /// Controller and present room.
    pub room: &'a ClosedLoop,
    /// The evidence.
    pub evidence: &'a Evidence,
    /// Users, obstacles and the true channel.
    pub world: World,
    /// Index in the world of each observed user, in the order of the rows.
    pub indices: Vec<usize>,
}

impl<'a> Future<'a> {
    /// After a decision; `None` where the policy reads no evidence or a user has left.
    pub fn of(room: &'a ClosedLoop) -> Option<Self> {
        let evidence = room.controller().observer().evidence()?;
        let (world, indices) = later(room)?;
        Some(Self { room, evidence, indices, world })
    }

    /// The row of each user, and the horizontal components of the true normal less those of the
    /// believed one, in the frame of the row.
    pub fn users(&self) -> impl Iterator<Item = ([f32; FEATURES], [f32; 2])> {
        let rows = self.evidence.rows().iter().zip(self.evidence.frames());
        rows.zip(&self.indices).map(|((row, frame), index)| {
            let normal = frame.of_room(&self.world.orientations()[*index].normal());
            let tilt = [normal[0] - f64::from(row[NORMAL]), normal[1] - f64::from(row[NORMAL + 1])];
            (*row, tilt.map(|value| value as f32))
        })
    }
}
