//! The deciding core: (now, message) in, decision out. No socket, no clock, no log, no waiting, no allocation of our own.
//!
//! Duties, in this order, each time a position report completes a tick:
//!
//! 1. **Inbox**: take the report or refuse it.
//! 2. **Observe**: bring the latest of each stream into one observation.
//! 3. **Infer**: let the policy propose angles; where it fails, let the fallback.
//! 4. **Make safe**: bring the proposal within range and reach.
//!
//! Every situation in which the plain way is left has one defined answer, and is counted:
//!
//! | situation | answer | counter |
//! | --- | --- | --- |
//! | the position report is too old | no command: the array holds, then parks | `stale-report` |
//! | no channel report of acceptable age | the policy acts on modelled direct gains | `channel-missing` |
//! | the policy fails, or gives a value that is not finite | `control.fallback` acts | `policy-failed` |
//! | the fallback fails too, or is `hold` | no command: the array holds, then parks | `held` |
//!
//! Glossary: a *tick* is one sampling of the room; a command *answers* the tick of the position report that it responds to;
//! an *epoch* is one life of a controller, and a later one deposes an earlier one; the array is *parked* when every mirror faces
//! straight into the room because no command is valid any more.

use heliostat_channel::{ChannelModel, Vec3, mirrors::MirrorAngles};
use heliostat_proto::{MirrorCommand, Nanos};
use heliostat_scenario::Scenario;

use crate::{
    inbox::{Inbox, Message},
    observation::{Observation, RoomState},
    observer::{LosSource, Observer},
    policy::{Policy, PolicyError, build_fallback},
    refused::{Refusal, Stream},
    safety::{self, Clipped, Limits},
};

/// What was just finished, for a ledger at the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The payload became a message.
    Decoded,
    /// The observation is complete.
    Observed,
    /// The policy, or its fallback, proposed angles.
    Inferred,
    /// The proposal is within its limits, and the command complete.
    MadeSafe,
    /// The command was handed to the transport.
    Published,
}

impl Stage {
    /// All stages in the order in which they pass.
    pub const ALL: [Self; 5] = [Self::Decoded, Self::Observed, Self::Inferred, Self::MadeSafe, Self::Published];

    /// The name in summaries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Decoded => "decode",
            Self::Observed => "observe",
            Self::Inferred => "infer",
            Self::MadeSafe => "safe",
            Self::Published => "publish",
        }
    }
}

/// The answer to a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision<'a> {
    /// The mirrors are to turn.
    Move {
        /// What to send.
        command: &'a MirrorCommand,
        /// Age of the positions acted on, in ns.
        age_ns: Nanos,
    },
    /// No command: the array holds the last one, and parks when its validity ends.
    Hold(Departure),
}

/// How a tick left the plain way; the table of the module has the answer to each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Departure {
    /// The position report was too old.
    StaleReport,
    /// The gains of the direct paths are modelled, not measured.
    ChannelMissing,
    /// The policy failed and the fallback acted.
    PolicyFailed,
    /// Nothing could act.
    Held,
}

impl Departure {
    /// All departures, in the order of their counters.
    pub const ALL: [Self; 4] = [Self::StaleReport, Self::ChannelMissing, Self::PolicyFailed, Self::Held];

    /// The name in counters.
    pub fn name(self) -> &'static str {
        match self {
            Self::StaleReport => "stale-report",
            Self::ChannelMissing => "channel-missing",
            Self::PolicyFailed => "policy-failed",
            Self::Held => "held",
        }
    }
}

/// What a controller did so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Position reports that got an answer, be it to hold.
    pub decisions: u64,
    /// Commands among the answers.
    pub commands: u64,
    /// Axis values that the limits changed.
    pub clipped: Clipped,
    departures: [u64; Departure::ALL.len()],
}

impl Counters {
    /// How often a tick left the plain way like this.
    pub fn departures(&self, departure: Departure) -> u64 {
        self.departures[departure as usize]
    }

    fn depart(&mut self, departure: Departure) {
        self.departures[departure as usize] += 1;
    }
}

/// The controller of one room.
pub struct Controller {
    model: ChannelModel,
    inbox: Inbox,
    observer: Observer,
    /// Its angles are the last commanded ones.
    observation: Observation,
    policy: Box<dyn Policy>,
    fallback: Option<Box<dyn Policy>>,
    limits: Limits,
    validity_ns: Nanos,
    /// Nominal time between position reports in s.
    interval_s: f64,
    proposed: MirrorAngles,
    command: MirrorCommand,
    counters: Counters,
    last_failure: Option<PolicyError>,
}

impl Controller {
    /// A controller of a scenario's room that lets `policy` decide; `epoch` must exceed that of every controller before it.
    pub fn new(scenario: &Scenario, model: ChannelModel, policy: Box<dyn Policy>, epoch: u64) -> Self {
        let observation = Observation::new(&model, scenario.users.count);
        let mirrors = model.mirrors.len();
        let validity_ms = scenario.control.validity_ms.round() as u32;
        Self {
            inbox: Inbox::new(scenario),
            observer: Observer::new(scenario),
            proposed: observation.angles.clone(),
            observation,
            policy,
            fallback: build_fallback(scenario.control.fallback, scenario),
            limits: Limits::new(&scenario.control),
            validity_ns: Nanos::from(validity_ms) * 1_000_000,
            interval_s: 1.0 / scenario.streams.positions.rate_hz,
            command: MirrorCommand {
                epoch,
                sequence: 0,
                answers: 0,
                time_ns: 0,
                validity_ms,
                roll: vec![0.0; mirrors],
                yaw: vec![0.0; mirrors],
            },
            counters: Counters::default(),
            last_failure: None,
            model,
        }
    }

    /// Takes a message that arrived at `now`, and answers where it completes a tick. `mark` is called as each stage ends.
    pub fn receive(&mut self, now: Nanos, message: Message<'_>, mark: &mut dyn FnMut(Stage)) -> Option<Decision<'_>> {
        let stream = message.stream();
        let sources = self.inbox.sources();
        let accepted = self.inbox.accept(now, message);
        if self.inbox.sources() != sources {
            self.observer.forget();
        }
        match accepted {
            Ok(()) if stream == Stream::Users => Some(self.decide(now, mark)),
            Err(Refusal::Stale) if stream == Stream::Users => Some(self.hold(Departure::StaleReport)),
            _ => None,
        }
    }

    /// A source is known to be gone: another may take the room at once.
    pub fn source_gone(&mut self, source: u64) {
        self.inbox.release(source);
    }

    /// Counts a payload that is no message.
    pub fn count_malformed(&mut self, stream: Stream, refusal: Refusal) {
        self.inbox.count_malformed(stream, refusal);
    }

    /// Lets policy and fallback decide for an invented room, `runs` times, so that the first real decision finds buffers sized
    /// and caches warm. Only what a policy remembers is left behind.
    pub fn warm_up(&mut self, runs: usize) {
        let users = self.observation.users();
        let positions: Vec<Vec3> = (0..users).map(|user| invented_position(user, users)).collect();
        let state = RoomState {
            tick: 0,
            positions: &positions,
            velocities: &vec![Vec3::zeros(); users],
            min_rate_bps: &vec![1e6; users],
            blockers: &[],
            forced: &vec![false; users],
            measured_los_gain: None,
        };
        for _ in 0..runs {
            self.observation.set_state(&self.model, &state);
            let policies = [Some(&mut self.policy), self.fallback.as_mut()];
            for policy in policies.into_iter().flatten() {
                // A failure shows, and is counted, when it matters.
                let _ = policy.act(&self.model, &self.observation, &mut self.proposed);
            }
        }
        self.observation = Observation::new(&self.model, users);
    }

    /// The reports and what was refused.
    pub fn inbox(&self) -> &Inbox {
        &self.inbox
    }

    /// What was done so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Name of the policy.
    pub fn policy_name(&self) -> &str {
        self.policy.name()
    }

    /// This controller's epoch.
    pub fn epoch(&self) -> u64 {
        self.command.epoch
    }

    /// The higher epoch that the array obeys, where this controller was deposed.
    pub fn deposed_by(&self) -> Option<u64> {
        self.inbox.telemetry().map(|telemetry| telemetry.epoch).filter(|epoch| *epoch > self.command.epoch)
    }

    /// Why the policy failed last.
    pub fn last_failure(&self) -> Option<&PolicyError> {
        self.last_failure.as_ref()
    }

    /// What the policy saw last, and the angles commanded last.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    fn decide(&mut self, now: Nanos, mark: &mut dyn FnMut(Stage)) -> Decision<'_> {
        let elapsed_s = self.settle_angles(now);
        match self.observer.observe(&self.model, &self.inbox, now, &mut self.observation) {
            Some(LosSource::Measured) => {}
            Some(LosSource::Modelled) => self.counters.depart(Departure::ChannelMissing),
            None => return self.hold(Departure::Held),
        }
        mark(Stage::Observed);
        if !self.propose() {
            return self.hold(Departure::Held);
        }
        mark(Stage::Inferred);
        let clipped = self.limits.bound(&self.observation.angles, elapsed_s, &mut self.proposed);
        self.counters.clipped.range += clipped.range;
        self.counters.clipped.slew += clipped.slew;
        self.complete_command(now);
        mark(Stage::MadeSafe);
        let sampled_ns = self.inbox.users().map_or(now, |report| report.stamp.time_ns);
        Decision::Move { command: &self.command, age_ns: now.saturating_sub(sampled_ns) }
    }

    /// Sees to it that the observation's angles are where the mirrors are, and gives the time in s that they had to turn.
    ///
    /// While our last command is valid, that is what it says; otherwise what the array last reported, or parked.
    fn settle_angles(&mut self, now: Nanos) -> f64 {
        let since_command_ns = now.saturating_sub(self.command.time_ns);
        if self.command.sequence > 0 && since_command_ns <= self.validity_ns {
            return since_command_ns as f64 * 1e-9;
        }
        let angles = &mut self.observation.angles;
        match self.inbox.telemetry() {
            Some(telemetry) => {
                copy_widened(&telemetry.roll_commanded, &mut angles.roll);
                copy_widened(&telemetry.yaw_commanded, &mut angles.yaw);
            }
            None => {
                angles.roll.fill(0.0);
                angles.yaw.fill(0.0);
            }
        }
        self.interval_s
    }

    /// Lets the policy propose, or else the fallback; false where neither could.
    fn propose(&mut self) -> bool {
        let Err(failure) = attempt(self.policy.as_mut(), &self.model, &self.observation, &mut self.proposed) else {
            return true;
        };
        self.last_failure = Some(failure);
        let Some(fallback) = self.fallback.as_mut() else { return false };
        match attempt(fallback.as_mut(), &self.model, &self.observation, &mut self.proposed) {
            Ok(()) => {
                self.counters.depart(Departure::PolicyFailed);
                true
            }
            Err(_) => false,
        }
    }

    fn complete_command(&mut self, now: Nanos) {
        self.counters.decisions += 1;
        self.counters.commands += 1;
        self.command.sequence += 1;
        self.command.answers = self.observation.tick;
        self.command.time_ns = now;
        copy_narrowed(&self.proposed.roll, &mut self.command.roll);
        copy_narrowed(&self.proposed.yaw, &mut self.command.yaw);
        self.observation.set_angles(&self.proposed);
    }

    fn hold(&mut self, departure: Departure) -> Decision<'_> {
        self.counters.decisions += 1;
        self.counters.depart(departure);
        Decision::Hold(departure)
    }
}

/// One proposal, with its values checked.
fn attempt(
    policy: &mut dyn Policy,
    model: &ChannelModel,
    observation: &Observation,
    out: &mut MirrorAngles,
) -> Result<(), PolicyError> {
    policy.act(model, observation, out)?;
    Ok(safety::check_finite(out)?)
}

/// A place on a circle around the centre, at the height of a held device.
fn invented_position(user: usize, users: usize) -> Vec3 {
    let angle = std::f64::consts::TAU * user as f64 / users as f64;
    Vec3::new(1.5 * angle.cos(), 1.5 * angle.sin(), 0.85)
}

fn copy_widened(from: &[f32], to: &mut [f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = f64::from(*from);
    }
}

fn copy_narrowed(from: &[f64], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from as f32;
    }
}
