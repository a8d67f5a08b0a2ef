//! The deciding core: (now, message) in, decision out. No socket, no clock, no log, no waiting, no allocation of our own.
//!
//! Duties, in this order, each time a position report completes a tick:
//!
//! 1. **Inbox**: take the report or refuse it.
//! 2. **Observe**: bring the latest of each stream into one observation, without mirrors that do not follow or whose range does not reach somebody.
//! 3. **Infer**: let the policy propose angles; where it fails, let the fallback.
//! 4. **Make safe**: bring the proposal within range and reach.
//!
//! Every situation in which the plain way is left has one defined answer, and is counted:
//!
//! | situation | answer: a key of the scenario's `control` table | unless set otherwise | counter |
//! | --- | --- | --- | --- |
//! | the decision would be late, as its caller says | `when_late` | the last command again | `late` |
//! | the position report is too old | `when_stale` | no command: the array holds, then parks | `stale-report` |
//! | no channel report of acceptable age | `when_channel_missing` | the policy acts on modelled direct gains | `channel-missing` |
//! | no position report for as long | `when_silent` | no command | `silence` |
//! | the policy gives no answer for 0.1 s, as its caller sees | `when_unanswered` | no command | `unanswered` |
//! | the policy fails, or gives a value that is not finite | `fallback` | the fixed point | `policy-failed` |
//! | nothing can act: the fallback fails too or is `hold`, or there is no last command | no command | | `held` |
//! | the array is stopped, or does not fit | no command | | `withheld` |
//!
//! Glossary: a *tick* is one sampling of the room; a command *answers* the tick of the position report that it responds to;
//! an *epoch* is one life of a controller, and a later one deposes an earlier one; the array is *parked* when every mirror faces
//! straight into the room because no command is valid any more.

use heliostat_channel::{ChannelModel, Vec3, mirrors::MirrorAngles};
use heliostat_proto::{Capabilities, MirrorCommand, Nanos};
use heliostat_scenario::{Answer, Scenario};

pub use crate::outcome::{Accepted, Counters, Decision, Departure, Haste, Stage};
use crate::{
    capabilities::{Guard, Unfit},
    inbox::{Inbox, Message},
    observation::{Observation, RoomState},
    observer::{LosSource, Observer},
    policy::{Policy, PolicyError, build_fallback},
    refusal::{Refusal, Stream},
    safety::{self, Limits},
};

/// Decisions on an invented room before a controller announces itself. A policy remembers them, so a replay makes as many.
pub const WARM_UP_RUNS: usize = 200;

/// The scenario's answers, and when silence begins.
#[derive(Clone, Copy, Debug)]
struct Answers {
    late: Answer,
    stale: Answer,
    channel_missing: Answer,
    silent: Answer,
    silent_after_ns: Nanos,
}

impl Answers {
    fn new(scenario: &Scenario) -> Self {
        let control = &scenario.control;
        Self {
            late: control.when_late,
            stale: control.when_stale,
            channel_missing: control.when_channel_missing,
            silent: control.when_silent,
            silent_after_ns: (control.report_age_max_ms * 1e6) as Nanos,
        }
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
    answers: Answers,
    limits: Limits,
    guard: Guard,
    validity_ns: Nanos,
    /// When the last position report was accepted, and whether its absence since was answered.
    heard: Option<(Nanos, bool)>,
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
            answers: Answers::new(scenario),
            limits: Limits::new(&scenario.control),
            guard: Guard::default(),
            heard: None,
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

    /// Takes a message that arrived at `now`, and answers at once where it completes a tick. `mark` is called as each stage ends.
    pub fn receive(&mut self, now: Nanos, message: Message<'_>, mark: &mut dyn FnMut(Stage)) -> Option<Decision<'_>> {
        match self.accept(now, message) {
            Accepted::Tick => Some(self.decide(now, Haste::InTime, mark)),
            Accepted::TooOld => Some(self.answer_stale(now)),
            Accepted::Other => None,
        }
    }

    /// Takes a message that arrived at `now`, and says what is to be answered.
    pub fn accept(&mut self, now: Nanos, message: Message<'_>) -> Accepted {
        let stream = message.stream();
        let sources = self.inbox.sources();
        let accepted = self.inbox.accept(now, message);
        if self.inbox.sources() != sources {
            self.observer.forget();
        }
        match accepted {
            Ok(()) if stream == Stream::Users => {
                self.heard = Some((now, false));
                Accepted::Tick
            }
            Err(Refusal::Stale) if stream == Stream::Users => Accepted::TooOld,
            _ => Accepted::Other,
        }
    }

    /// Answers the tick that was accepted last. `mark` is called as each stage ends.
    pub fn decide(&mut self, now: Nanos, haste: Haste, mark: &mut dyn FnMut(Stage)) -> Decision<'_> {
        let mut answer = (Answer::Policy, Departure::Held);
        if haste == Haste::Late {
            self.counters.depart(Departure::Late);
            answer = (self.answers.late, Departure::Late);
        }
        if matches!(answer.0, Answer::Policy | Answer::Fallback) {
            match self.observer.observe(&self.model, &self.inbox, now, &mut self.observation) {
                Some(LosSource::Measured) => {}
                Some(LosSource::Modelled) => {
                    self.counters.depart(Departure::ChannelMissing);
                    if answer.0 == Answer::Policy {
                        answer = (self.answers.channel_missing, Departure::ChannelMissing);
                    }
                }
                None => {
                    self.counters.depart(Departure::Held);
                    answer = (Answer::Hold, Departure::Held);
                }
            }
            if let Some(telemetry) = self.inbox.telemetry() {
                self.observation.scene.exclude_mirrors(&telemetry.unusable);
            }
            if let Some([roll, yaw]) = self.limits.narrow_axes_rad() {
                self.observation.scene.restrict_to_range(&self.model, &roll, &yaw);
            }
            mark(Stage::Observed);
        }
        self.counters.decisions += 1;
        let tick = self.inbox.users().map_or(0, |report| report.tick);
        self.give(answer, tick, now, mark)
    }

    /// Answers a position report that was too old.
    pub fn answer_stale(&mut self, now: Nanos) -> Decision<'_> {
        self.counters.decisions += 1;
        self.counters.depart(Departure::StaleReport);
        self.give((self.answers.stale, Departure::StaleReport), 0, now, &mut |_| {})
    }

    /// Lets time pass without a position report; a decision where their absence is to be answered, to be published like any other.
    ///
    /// Counted once a silence. `last-good` is repeated at each call, so call it more often than commands lose their validity.
    pub fn elapse(&mut self, now: Nanos) -> Option<Decision<'_>> {
        let (heard_ns, answered) = self.heard?;
        if now.saturating_sub(heard_ns) <= self.answers.silent_after_ns {
            return None;
        }
        self.heard = Some((heard_ns, true));
        if !answered {
            self.counters.depart(Departure::Silence);
        } else if self.answers.silent != Answer::LastGood {
            return None;
        }
        Some(self.give((self.answers.silent, Departure::Silence), 0, now, &mut |_| {}))
    }

    /// Goes through observation and inference again as at the last decision, and leaves nothing behind on which a later answer
    /// depends: it keeps code and data in the caches while reports are sparse. Does nothing before the first decision.
    pub fn rehearse(&mut self) {
        if self.command.answers == 0 {
            return;
        }
        let seen = self.observer.observe(&self.model, &self.inbox, self.command.time_ns, &mut self.observation);
        if seen.is_some() {
            // What it proposes is overwritten by the next decision before anything looks at it.
            self.policy.rehearse(&self.model, &self.observation, &mut self.proposed);
        }
    }

    /// A source is known to be gone: another may take the room at once.
    pub fn source_gone(&mut self, source: u64) {
        self.inbox.release(source);
    }

    /// A source is known to be there, perhaps again.
    pub fn source_there(&mut self, source: u64) {
        self.inbox.welcome(source);
    }

    /// Counts a payload that is no message.
    pub fn count_malformed(&mut self, stream: Stream, refusal: Refusal) {
        self.inbox.count_malformed(stream, refusal);
    }

    /// Lets policy and fallback decide for an invented room, once for each item of `runs`, so that the first real decision finds buffers
    /// sized and caches warm. Only what a policy remembers is left behind.
    pub fn warm_up(&mut self, runs: impl Iterator) {
        let mut policies: Vec<&mut dyn Policy> = vec![self.policy.as_mut()];
        if let Some(fallback) = self.fallback.as_mut() {
            policies.push(fallback.as_mut());
        }
        warm_up(&mut policies, &self.model, self.observation.users(), runs);
    }

    /// Numbers the next command beyond those that were given in this controller's stead.
    pub fn skip_to(&mut self, sequence: u64) {
        self.command.sequence = self.command.sequence.max(sequence);
    }

    /// Lets another policy decide from now on, and gives back the one that did. The new one should be warm.
    pub fn replace_policy(&mut self, policy: Box<dyn Policy>) -> Box<dyn Policy> {
        std::mem::replace(&mut self.policy, policy)
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

    /// Whether and how the array may be commanded.
    pub fn guard(&self) -> &Guard {
        &self.guard
    }

    /// For announcements of the array and orders of an operator.
    pub fn guard_mut(&mut self) -> &mut Guard {
        &mut self.guard
    }

    /// Takes over what the array can do, where it was found to fit; where not, it is not commanded.
    pub fn meet_array(&mut self, capabilities: &Capabilities, verdict: Result<(), Unfit>) {
        if verdict.is_ok() {
            self.limits.narrow(&capabilities.roll, &capabilities.yaw);
            self.observer.set_settling(f64::from(capabilities.roll.settling_s.max(capabilities.yaw.settling_s)));
        }
        self.guard.set_verdict(verdict);
    }

    /// Why the policy failed last.
    pub fn last_failure(&self) -> Option<&PolicyError> {
        self.last_failure.as_ref()
    }

    /// What the policy saw last, and the angles commanded last.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// Proposes angles in the way that the answer says, makes them safe and completes the command.
    fn give(
        &mut self,
        (answer, cause): (Answer, Departure),
        tick: u64,
        now: Nanos,
        mark: &mut dyn FnMut(Stage),
    ) -> Decision<'_> {
        if !self.guard.may_command(self.inbox.telemetry()) {
            self.counters.depart(Departure::Withheld);
            return Decision::Hold(Departure::Withheld);
        }
        let elapsed_s = self.settle_angles(now);
        let proposed = match answer {
            Answer::Policy => self.propose(),
            Answer::Fallback => self.fall_back(),
            Answer::LastGood => self.repeat(),
            Answer::Park => {
                self.proposed.roll.fill(0.0);
                self.proposed.yaw.fill(0.0);
                true
            }
            Answer::Hold => return Decision::Hold(cause),
        };
        if !proposed {
            self.counters.depart(Departure::Held);
            return Decision::Hold(Departure::Held);
        }
        mark(Stage::Inferred);
        let clipped = self.limits.bound(&self.observation.angles, elapsed_s, &mut self.proposed);
        self.counters.clipped.range += clipped.range;
        self.counters.clipped.slew += clipped.slew;
        self.complete_command(tick, now);
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
        let acted = self.fall_back();
        if acted {
            self.counters.depart(Departure::PolicyFailed);
        }
        acted
    }

    /// Lets the fallback propose; false where there is none, or it fails too.
    fn fall_back(&mut self) -> bool {
        let Some(fallback) = self.fallback.as_mut() else { return false };
        attempt(fallback.as_mut(), &self.model, &self.observation, &mut self.proposed).is_ok()
    }

    /// Proposes the last command; false where there is none.
    fn repeat(&mut self) -> bool {
        copy_widened(&self.command.roll, &mut self.proposed.roll);
        copy_widened(&self.command.yaw, &mut self.proposed.yaw);
        self.command.sequence > 0
    }

    fn complete_command(&mut self, tick: u64, now: Nanos) {
        self.counters.commands += 1;
        self.command.sequence += 1;
        self.command.answers = tick;
        self.command.time_ns = now;
        copy_narrowed(&self.proposed.roll, &mut self.command.roll);
        copy_narrowed(&self.proposed.yaw, &mut self.command.yaw);
        self.observation.set_angles(&self.proposed);
    }
}

/// Lets policies decide for an invented room of so many users, once for each item of `runs`.
pub fn warm_up(policies: &mut [&mut dyn Policy], model: &ChannelModel, users: usize, runs: impl Iterator) {
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
    let mut observation = Observation::new(model, users);
    let mut proposed = observation.angles.clone();
    for _ in runs {
        observation.set_state(model, &state);
        for policy in policies.iter_mut() {
            // A failure shows, and is counted, when it matters.
            let _ = policy.act(model, &observation, &mut proposed);
        }
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
