//! A task: a room with a form of action and observation and a reward, in steps of a learner.
//!
//! The calling order is [`Task::new`], then [`Task::reset`], then [`Task::step`] again and again.
//! After each of the latter two, [`Task::write_observation`] writes the observation.
//!
//! - **Static**: the learner observes the true state, the mirrors turn at once, and the action is
//!   evaluated in the state in which it was chosen. The users then walk on for `step_s`.
//! - **Closed loop**: a step is the time between two position reports. The learner observes what the
//!   decision core derives from reports, and its action becomes a command to the simulated array.
//!   The action is evaluated at the end of the step, with the true users and the true angles.
//!
//! ```
//! use heliostat_environment::task::{Task, TaskSettings};
//! use heliostat_scenario::Scenario;
//!
//! let mut task = Task::new(TaskSettings::closed_loop(Scenario::builtin("hall")?), 1)?;
//! let flat = vec![0.0; task.action_len()];
//! let first = task.step(&flat)?;
//! task.step(&flat)?;
//! task.reset(1)?;
//! assert_eq!(task.step(&flat)?, first);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::sync::Arc;

use heliostat_channel::solver::Solver;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_decide::core::Controller;
use heliostat_decide::observation::{Observation, ObservationEncoder, USERS_CAPACITY};
use heliostat_decide::policy::Fixed;
use heliostat_decide::safety::Limits;
use heliostat_decide::selection::Selection;
use heliostat_scenario::Scenario;
use heliostat_sim::World;
use heliostat_sim::episode::Episode;

use crate::action::{ActionDecoder, ActionForm, Seen};
use crate::angle_state::AngleState;
use crate::believed;
use crate::closed_loop::ClosedLoop;
use crate::error::EnvironmentError;
use crate::held_out::{SETTLE_S, best_angles, met};
use crate::room::{Environment, Outcome, Reward, RewardForm};

/// How the room answers an action.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dynamics {
    /// True state, instant mirrors; `step_s` seconds between two actions.
    Static {
        /// Time between two actions in s.
        step_s: f64,
    },
    /// Reports, belief and mirrors as in a running room.
    ClosedLoop,
}

/// What the learner observes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObservationForm {
    /// The vector of [`heliostat_decide::observation`], which an exported actor reads.
    Vector,
    /// The paper's state: presence, positions, gains, minimum rates and angles ([`AngleState`]).
    AngleState,
    /// One row for each slot: [`believed`].
    Belief,
}

/// The settings of a task.
#[derive(Clone, Debug)]
pub struct TaskSettings {
    /// The room.
    pub scenario: Scenario,
    /// The text of the file `users.trace`.
    pub trace: Option<String>,
    /// How the room answers an action.
    pub dynamics: Dynamics,
    /// What an action means.
    pub action: ActionForm,
    /// What the learner observes.
    pub observation: ObservationForm,
    /// The reward.
    pub reward: Reward,
    /// Seconds that users walk before the first observation.
    pub settle_s: f64,
    /// Whether each step also evaluates the oracle, which takes far longer than the step.
    pub oracle: bool,
}

impl TaskSettings {
    /// A room with its true state, one second between two actions.
    pub fn of_true_state(scenario: Scenario) -> Self {
        Self {
            scenario,
            trace: None,
            dynamics: Dynamics::Static { step_s: 1.0 },
            action: ActionForm::Angles,
            observation: ObservationForm::Vector,
            reward: Reward { form: RewardForm::Shortfall, lambda: 1.0, margin: 1.0 },
            settle_s: SETTLE_S,
            oracle: false,
        }
    }

    /// A room in closed loop.
    pub fn closed_loop(scenario: Scenario) -> Self {
        Self { dynamics: Dynamics::ClosedLoop, ..Self::of_true_state(scenario) }
    }

    fn check(&self) -> Result<(), EnvironmentError> {
        let refuse =
            |name, value: f64, expected| Err(EnvironmentError::Setting { name, value: value.to_string(), expected });
        if let Dynamics::Static { step_s } = self.dynamics
            && !(step_s.is_finite() && step_s > 0.0)
        {
            return refuse("step_s", step_s, "a positive number of seconds");
        }
        if !(0.0..=86_400.0).contains(&self.settle_s) {
            return refuse("settle_s", self.settle_s, "0 to 86400 seconds");
        }
        let Reward { lambda, margin, .. } = self.reward;
        if !(lambda.is_finite() && lambda >= 0.0) {
            return refuse("penalty", lambda, "a number from 0");
        }
        if !(margin.is_finite() && margin >= 0.0) {
            return refuse("margin", margin, "a number from 0");
        }
        Ok(())
    }
}

/// The result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// sum_k [R_k - penalty] over the bandwidth, in bit/s/Hz.
    pub reward: f64,
    /// sum_k R_k in Mbit/s.
    pub sum_rate_mbps: f64,
    /// Share of users whose minimum rate is met; 1 without users.
    pub met: f64,
    /// Sum rate of the oracle with minimum rates in Mbit/s, in the same state with mirrors that turn
    /// at once.
    pub oracle_mbps: Option<f64>,
}

enum Room {
    Static { environment: Box<Environment>, step_s: f64 },
    Closed { inner: Box<ClosedLoop>, now_ns: u64 },
}

impl Room {
    fn new(settings: &TaskSettings, seed: u64) -> Result<Self, EnvironmentError> {
        let (scenario, trace) = (&settings.scenario, settings.trace.as_deref());
        match settings.dynamics {
            Dynamics::Static { step_s } => {
                let mut environment = Box::new(Environment::new(scenario, trace, seed)?);
                environment.step(settings.settle_s)?;
                Ok(Self::Static { environment, step_s })
            }
            Dynamics::ClosedLoop => {
                let start_ns = (settings.settle_s * 1e9) as u64;
                let policy = Box::new(Fixed::flat(scenario.mirror_count()));
                let controller = Controller::new(scenario, scenario.channel_model()?, policy, 1);
                let mut inner = Box::new(ClosedLoop::new(Episode::new(scenario, trace, seed, start_ns)?, controller));
                let now_ns = inner.next_decision(start_ns)?.room_ns;
                Ok(Self::Closed { inner, now_ns })
            }
        }
    }

    fn world(&self) -> &World {
        match self {
            Self::Static { environment, .. } => environment.world(),
            Self::Closed { inner, .. } => inner.room().world(),
        }
    }

    /// The vector of a room that encodes its own observation.
    fn vector(&self) -> Option<&[f32]> {
        match self {
            Self::Static { environment, .. } => Some(environment.vector()),
            Self::Closed { .. } => None,
        }
    }

    fn observation(&self) -> &Observation {
        match self {
            Self::Static { environment, .. } => environment.observation(),
            Self::Closed { inner, .. } => inner.observation(),
        }
    }
}

/// A room in steps of a learner.
pub struct Task {
    settings: Arc<TaskSettings>,
    room: Room,
    /// The channel that the controller assumes.
    model: ChannelModel,
    encoder: ObservationEncoder,
    angle_state: AngleState,
    selection: Selection,
    /// Index in the observation of each slot's user.
    chosen: Vec<usize>,
    /// The observation as a vector in closed loop; a room with its true state has its own.
    vector: Vec<f32>,
    decoder: ActionDecoder,
    limits: Limits,
    angles: MirrorAngles,
    rates_bps: Vec<f64>,
    solver: Option<Solver>,
}

impl Task {
    /// A task in the room of a seed.
    ///
    /// # Errors
    /// [`EnvironmentError`] for settings that describe no room or no task.
    pub fn new(settings: impl Into<Arc<TaskSettings>>, seed: u64) -> Result<Self, EnvironmentError> {
        let settings = settings.into();
        settings.check()?;
        let scenario = &settings.scenario;
        let slots = USERS_CAPACITY.max(match settings.dynamics {
            Dynamics::Static { .. } => 0,
            Dynamics::ClosedLoop => scenario.users.count,
        });
        let encoder = ObservationEncoder::new(slots, scenario.mirror_count());
        let limits = Limits::new(&scenario.control);
        let solver = settings.oracle.then(|| Solver::new(scenario.users.count.max(1), scenario.mirror_count()));
        let mut task = Self {
            room: Room::new(&settings, seed)?,
            model: scenario.channel_model()?,
            encoder,
            angle_state: AngleState::of(scenario, true),
            selection: Selection::new(slots),
            chosen: Vec::with_capacity(slots),
            vector: vec![0.0; encoder.len()],
            decoder: ActionDecoder::new(settings.action, encoder, limits.range_rad()),
            limits,
            angles: MirrorAngles::flat(scenario.mirror_count()),
            rates_bps: Vec::new(),
            solver,
            settings,
        };
        if task.settings.observation == ObservationForm::AngleState && slots != USERS_CAPACITY {
            return Err(EnvironmentError::Setting {
                name: "users.count",
                value: slots.to_string(),
                expected: "at most 10 for the observation \"paper\"; choose \"flat\" or \"belief\"",
            });
        }
        task.observe()?;
        Ok(task)
    }

    /// Restarts in the room of another seed. A task after `reset(seed)` equals a new one of that
    /// seed.
    ///
    /// # Errors
    /// As [`Task::new`].
    pub fn reset(&mut self, seed: u64) -> Result<(), EnvironmentError> {
        match &mut self.room {
            Room::Static { environment, .. } if self.settings.trace.is_none() => {
                environment.restart(seed)?;
                environment.step(self.settings.settle_s)?;
            }
            room => *room = Room::new(&self.settings, seed)?,
        }
        self.selection.set_slots(&[]);
        self.rates_bps.clear();
        self.angles.roll.fill(0.0);
        self.angles.yaw.fill(0.0);
        self.observe()
    }

    /// Performs an action of [`Task::action_len`] components in [-1, 1].
    ///
    /// # Errors
    /// [`EnvironmentError`] for an action of another length or with a component that is not finite;
    /// the room is then unchanged.
    pub fn step(&mut self, action: &[f32]) -> Result<Step, EnvironmentError> {
        let observation = self.room.observation();
        let vector = self.room.vector().unwrap_or(&self.vector);
        let seen = Seen { model: &self.model, observation, chosen: &self.chosen, vector };
        self.decoder.decode(seen, action, &mut self.angles)?;
        let step = match &mut self.room {
            Room::Static { environment, step_s } => {
                // The mirrors turn at once.
                self.limits.bound(&environment.observation().angles, f64::INFINITY, &mut self.angles);
                let outcome = environment.act(&self.angles, self.settings.reward, &mut []);
                self.rates_bps.clear();
                self.rates_bps.extend_from_slice(environment.last_rates_bps());
                let step = evaluated(outcome, &self.rates_bps, environment.world());
                let oracle_mbps = self.solver.as_mut().map(|solver| oracle_mbps(solver, environment.world()));
                environment.step(*step_s)?;
                Step { oracle_mbps, ..step }
            }
            Room::Closed { inner, now_ns } => {
                inner.decide(&self.angles)?;
                *now_ns = inner.next_decision(*now_ns)?.room_ns;
                let (world, angles) = (inner.room().world(), inner.room().angles());
                self.rates_bps.resize(world.ids().len(), 0.0);
                world.scene().rates_bps(world.model(), angles, &mut self.rates_bps);
                let outcome = self.settings.reward.outcome(&self.rates_bps, world.min_rate_bps(), |_| {});
                let oracle_mbps = self.solver.as_mut().map(|solver| oracle_mbps(solver, world));
                Step { oracle_mbps, ..evaluated(outcome, &self.rates_bps, world) }
            }
        };
        self.observe()?;
        Ok(step)
    }

    /// Checks an action without performing it.
    ///
    /// # Errors
    /// As [`Task::step`] for an action that is not valid.
    pub fn check_action(&self, action: &[f32]) -> Result<(), EnvironmentError> {
        self.decoder.check(action)
    }

    /// The users' rates after the last step in bit/s, in the order of the world's users; empty
    /// before it.
    pub fn rates_bps(&self) -> &[f64] {
        &self.rates_bps
    }

    /// Number of components of an action.
    pub fn action_len(&self) -> usize {
        self.decoder.len()
    }

    /// Number of components of an observation.
    pub fn observation_len(&self) -> usize {
        match self.settings.observation {
            ObservationForm::Vector => self.encoder.len(),
            ObservationForm::AngleState => self.angle_state.inputs(),
            ObservationForm::Belief => self.encoder.users_max() * believed::COLUMNS.len(),
        }
    }

    /// Writes the present observation into a buffer of [`Task::observation_len`].
    ///
    /// # Panics
    /// When the buffer has another length.
    pub fn write_observation(&self, out: &mut [f32]) {
        match self.settings.observation {
            ObservationForm::Vector => out.copy_from_slice(self.vector()),
            ObservationForm::AngleState => out.copy_from_slice(&self.angle_state.state(self.vector())),
            ObservationForm::Belief => {
                assert_eq!(out.len(), self.observation_len(), "the buffer has another length");
                let controller = match &self.room {
                    Room::Static { .. } => None,
                    Room::Closed { inner, now_ns } => Some((inner.controller(), *now_ns)),
                };
                believed::write((&self.model, self.room.observation()), controller, &self.chosen, out);
            }
        }
    }

    /// The observation as the vector that an exported actor reads.
    pub fn vector(&self) -> &[f32] {
        self.room.vector().unwrap_or(&self.vector)
    }

    /// The layout of that vector.
    pub fn encoder(&self) -> ObservationEncoder {
        self.encoder
    }

    /// The settings.
    pub fn settings(&self) -> &TaskSettings {
        &self.settings
    }

    /// The true users, obstacles and channel.
    pub fn world(&self) -> &World {
        self.room.world()
    }

    /// Where the mirrors point.
    pub fn angles(&self) -> &MirrorAngles {
        match &self.room {
            Room::Static { environment, .. } => &environment.observation().angles,
            Room::Closed { inner, .. } => inner.room().angles(),
        }
    }

    /// Fills the vector from the observation.
    fn observe(&mut self) -> Result<(), EnvironmentError> {
        let observation = self.room.observation();
        self.chosen.clear();
        self.chosen.extend_from_slice(self.selection.choose(observation));
        if self.room.vector().is_some() {
            return Ok(());
        }
        let chosen = self.chosen.iter().copied();
        Ok(self.encoder.encode_users(&self.model, observation, chosen, &mut self.vector)?)
    }
}

fn evaluated(outcome: Outcome, rates_bps: &[f64], world: &World) -> Step {
    Step {
        reward: 1e6 * outcome.reward_mbps / world.model().budget.bandwidth_hz,
        sum_rate_mbps: outcome.sum_rate_mbps,
        met: if rates_bps.is_empty() { 1.0 } else { met(rates_bps, world.min_rate_bps()) },
        oracle_mbps: None,
    }
}

/// Sum rate of the oracle in the present state of a world.
fn oracle_mbps(solver: &mut Solver, world: &World) -> f64 {
    let (model, scene) = (world.model(), world.scene());
    let angles = best_angles(solver, model, scene, world.min_rate_bps());
    let mut rates_bps = vec![0.0; scene.users()];
    scene.rates_bps(model, &angles, &mut rates_bps);
    1e-6 * rates_bps.iter().sum::<f64>()
}
