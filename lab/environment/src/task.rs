//! A task: a room with a form of action and observation and a reward, in steps of a learner.
//!
//! The calling order is [`Task::new`], then [`Task::reset`], then [`Task::step`] again and again.
//! After each of the latter two, [`Task::write_observation`] writes the observation.
//!
//! - **Static**: the learner observes the true state, the mirrors turn at once, and the action is
//!   evaluated in the state in which it was chosen. The users then walk on for `step_s`.
//! - **Closed loop**: a step is the time between two position reports. The learner observes what
//!   the decision core derives from reports, and its action becomes a command to the simulated
//!   array. The action is evaluated at the end of the step, with the true users and the true
//!   angles.
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
use heliostat_core::angle_state::AngleState;
use heliostat_core::core::Controller;
use heliostat_core::observation::{Observation, ObservationEncoder, USERS_CAPACITY};
use heliostat_core::policy::Fixed;
use heliostat_core::safety::Limits;
use heliostat_core::selection::Selection;
use heliostat_room::World;
use heliostat_room::episode::Episode;
use heliostat_scenario::Scenario;

use crate::action::{ActionDecoder, Seen};
use crate::believed;
use crate::closed_loop::ClosedLoop;
use crate::episodes::HeldOutEpisode;
use crate::error::EnvironmentError;
use crate::held_out::{SETTLE_S, best_angles, met};
use crate::room::{Environment, Outcome};
use crate::sampling::Sampling;
pub use crate::task_settings::{Dynamics, ObservationForm, TaskSettings};

/// The result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// sum_k [R_k - penalty] over the bandwidth, in bit/s/Hz.
    pub reward: f64,
    /// sum_k R_k in Mbit/s.
    pub sum_rate_mbps: f64,
    /// Share of users whose minimum rate is met; 1 without users.
    pub met: f64,
    /// Sum rate of the oracle with minimum rates in Mbit/s, in the same state with mirrors that
    /// turn at once.
    pub oracle_mbps: Option<f64>,
}

enum Room {
    Static { environment: Box<Environment>, step_s: f64 },
    Closed { inner: Box<ClosedLoop>, now_ns: u64 },
}

impl Room {
    fn new(settings: &TaskSettings, seed: u64, settle_s: f64) -> Result<Self, EnvironmentError> {
        let (scenario, trace) = (&settings.scenario, settings.trace.as_deref());
        match settings.dynamics {
            Dynamics::Static { step_s } => {
                let mut environment = Box::new(Environment::new(scenario, trace, seed)?);
                environment.step(settle_s)?;
                Ok(Self::Static { environment, step_s })
            }
            Dynamics::ClosedLoop => {
                let start_ns = (settle_s * 1e9) as u64;
                let mut inner = begun(settings, Episode::new(scenario, trace, seed, start_ns)?)?;
                let now_ns = inner.next_decision(start_ns)?.room_ns;
                Ok(Self::Closed { inner, now_ns })
            }
        }
    }

    fn duplicate(&self, scenario: &Scenario) -> Self {
        match self {
            Self::Static { environment, step_s } => Self::Static { environment: environment.clone(), step_s: *step_s },
            Self::Closed { inner, now_ns } => {
                let inner = Box::new(inner.duplicate(scenario, idle_policy(scenario)));
                Self::Closed { inner, now_ns: *now_ns }
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

/// The policy of a controller in whose place the learner decides.
fn idle_policy(scenario: &Scenario) -> Box<Fixed> {
    Box::new(Fixed::flat(scenario.mirror_count()))
}

/// An episode with a controller in whose place the learner decides.
fn begun(settings: &TaskSettings, episode: Episode) -> Result<Box<ClosedLoop>, EnvironmentError> {
    let scenario = &settings.scenario;
    let controller = Controller::new(scenario, scenario.channel_model()?, idle_policy(scenario), 1);
    Ok(Box::new(ClosedLoop::new(episode, controller)))
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
    /// The observation as a vector in closed loop; a room with its true state has its own.
    vector: Vec<f32>,
    decoder: ActionDecoder,
    limits: Limits,
    angles: MirrorAngles,
    rates_bps: Vec<f64>,
    solver: Option<Solver>,
    /// In an episode of a comparison.
    sampling: Option<Sampling>,
}

/// A copy continues as the original: the same actions give the same observations and rewards.
impl Clone for Task {
    fn clone(&self) -> Self {
        let Self { settings, room, model, encoder, angle_state, selection, vector, .. } = self;
        let Self { decoder, limits, angles, rates_bps, solver, sampling, .. } = self;
        Self {
            room: room.duplicate(&settings.scenario),
            model: model.clone(),
            encoder: *encoder,
            angle_state: *angle_state,
            selection: selection.clone(),
            vector: vector.clone(),
            decoder: decoder.clone(),
            limits: *limits,
            angles: angles.clone(),
            rates_bps: rates_bps.clone(),
            // Each solution starts from the state alone.
            solver: solver.as_ref().map(|_| new_solver(&settings.scenario)),
            sampling: sampling.clone(),
            settings: Arc::clone(settings),
        }
    }
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
        let is_static = matches!(settings.dynamics, Dynamics::Static { .. });
        if is_static && scenario.users.count > USERS_CAPACITY {
            return Err(EnvironmentError::Setting {
                name: "users.count",
                value: scenario.users.count.to_string(),
                expected: "at most 10 in a static room; choose dynamics=\"closed-loop\"",
            });
        }
        let slots = USERS_CAPACITY.max(match settings.dynamics {
            Dynamics::Static { .. } => 0,
            Dynamics::ClosedLoop => scenario.users.count,
        });
        let encoder = ObservationEncoder::new(slots, scenario.mirror_count());
        let limits = Limits::new(&scenario.control);
        let solver = settings.oracle.then(|| new_solver(scenario));
        let mut task = Self {
            room: Room::new(&settings, seed, settings.settle_s)?,
            model: scenario.channel_model()?,
            encoder,
            angle_state: AngleState::of(scenario, true),
            selection: Selection::new(slots),
            vector: vec![0.0; encoder.len()],
            decoder: ActionDecoder::new(settings.action, encoder, limits.range_rad()),
            limits,
            angles: MirrorAngles::flat(scenario.mirror_count()),
            rates_bps: Vec::new(),
            solver,
            sampling: None,
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
        self.restart(seed, self.settings.settle_s)
    }

    fn restart(&mut self, seed: u64, settle_s: f64) -> Result<(), EnvironmentError> {
        match &mut self.room {
            Room::Static { environment, .. } if self.settings.trace.is_none() => {
                environment.restart(seed)?;
                environment.step(settle_s)?;
            }
            room => *room = Room::new(&self.settings, seed, settle_s)?,
        }
        self.sampling = None;
        self.restarted()
    }

    /// Restarts in an episode of a comparison, which [`Task::sampling`] then samples; its last step
    /// ends at the last sampling time. Needs a closed loop.
    ///
    /// # Errors
    /// As [`Task::new`], and for other dynamics.
    pub fn begin_episode(&mut self, episode: &HeldOutEpisode) -> Result<(), EnvironmentError> {
        let settings = &self.settings;
        if settings.dynamics != Dynamics::ClosedLoop {
            let expected = "\"closed-loop\" for an episode of a comparison";
            return Err(EnvironmentError::Setting { name: "dynamics", value: "\"static\"".into(), expected });
        }
        let mut inner = begun(settings, episode.begun(&settings.scenario, settings.trace.as_deref())?)?;
        let mut sampling = Sampling::new(episode);
        let now_ns = sampling.advance(&mut inner, 0)?;
        self.room = Room::Closed { inner, now_ns };
        self.sampling = Some(sampling);
        self.restarted()
    }

    /// Restarts in the state of a static comparison whose room has this seed, as
    /// [`held_out_world`](crate::held_out::held_out_world); [`Task::sampling`] then has the sample of the next action.
    /// Needs exact states.
    ///
    /// # Errors
    /// As [`Task::new`], and for other dynamics.
    pub fn begin_state(&mut self, seed: u64) -> Result<(), EnvironmentError> {
        if self.settings.dynamics == Dynamics::ClosedLoop {
            let expected = "\"static\" for a state of a comparison";
            return Err(EnvironmentError::Setting { name: "dynamics", value: "\"closed-loop\"".into(), expected });
        }
        self.restart(seed, SETTLE_S)?;
        self.sampling = Some(Sampling::of_state());
        Ok(())
    }

    /// The samples of the episode or state of a comparison; `None` in other rooms.
    pub fn sampling(&self) -> Option<&Sampling> {
        self.sampling.as_ref()
    }

    /// Forgets the former room.
    fn restarted(&mut self) -> Result<(), EnvironmentError> {
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
        let seen = Seen { observation, chosen: self.selection.chosen(), encoder: self.encoder, vector };
        self.decoder.decode(&self.model, seen, action, &mut self.angles)?;
        let step = match &mut self.room {
            Room::Static { environment, step_s } => {
                // The mirrors turn at once.
                self.limits.bound(&environment.observation().angles, f64::INFINITY, &mut self.angles);
                let outcome = environment.act(&self.angles, self.settings.reward, &mut []);
                self.rates_bps.clear();
                self.rates_bps.extend_from_slice(environment.last_rates_bps());
                let step = evaluated(outcome, &self.rates_bps, environment.world());
                if let Some(sampling) = &mut self.sampling {
                    sampling.sample_state(environment.world(), &self.angles);
                }
                let oracle_mbps = self.solver.as_mut().map(|solver| oracle_mbps(solver, environment.world()));
                environment.step(*step_s)?;
                Step { oracle_mbps, ..step }
            }
            Room::Closed { inner, now_ns } => {
                inner.decide(&self.angles)?;
                *now_ns = match &mut self.sampling {
                    Some(sampling) => sampling.advance(inner, *now_ns)?,
                    None => inner.next_decision(*now_ns)?.room_ns,
                };
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
            ObservationForm::AngleState => self.angle_state.write(self.vector(), out),
            ObservationForm::Belief => {
                assert_eq!(out.len(), self.observation_len(), "the buffer has another length");
                let controller = match &self.room {
                    Room::Static { .. } => None,
                    Room::Closed { inner, now_ns } => Some((inner.controller(), *now_ns)),
                };
                believed::write((&self.model, self.room.observation()), controller, self.selection.chosen(), out);
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
        let chosen = self.selection.choose(observation).iter().copied();
        if self.room.vector().is_some() {
            return Ok(());
        }
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

fn new_solver(scenario: &Scenario) -> Solver {
    Solver::new(scenario.users.count.max(1), scenario.mirror_count())
}

/// Sum rate of the oracle in the present state of a world.
fn oracle_mbps(solver: &mut Solver, world: &World) -> f64 {
    let (model, scene) = (world.model(), world.scene());
    let angles = best_angles(solver, model, scene, world.min_rate_bps());
    let mut rates_bps = vec![0.0; scene.users()];
    scene.rates_bps(model, &angles, &mut rates_bps);
    1e-6 * rates_bps.iter().sum::<f64>()
}
