//! Replays a recording into the controller core of this process, and compares every command.
//!
//! The core is a function of `(now, message)`. A recording holds the messages; the source of `now`
//! depends on the run:
//!
//! - **lockstep**: the stamps of the messages. Every command must be equal bit for bit.
//! - **live**: for an answered position report, the time in the command that answers it, which is
//!   exact. For any other message, the time at which the recorder received it; this only matters
//!   for a message close to its maximum age. A report without a command is skipped: the controller
//!   may not have received it, or may have dropped it for a newer one. A command that repeats the
//!   one before it is replayed as a late decision, if the controller counted any.
//!
//! A recording cannot hold messages that the controller received before the recording started. The
//! first [`SETTLE`] decisions of an epoch are therefore replayed but not compared, except in a
//! lockstep epoch recorded from its first command.

mod epoch;
mod plan;
mod verdict;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use heliostat_decide::capabilities::{Examiner, Force};
use heliostat_decide::core::{Controller, Decision, Due, Timing, WARM_UP_RUNS};
use heliostat_decide::inbox::Message;
use heliostat_decide::policy::PolicyKind;
use heliostat_decide::refusal::Stream;
use heliostat_engine::ActorSource;
use heliostat_proto::{Capabilities, MirrorCommand, NodeKind, SafetyReport, UserReport, decode};
use heliostat_scenario::DegradedAction;
use heliostat_service::exit::UnusableInput;

pub(crate) use plan::Beginning;
pub use plan::Clock;
pub use verdict::Verdict;
pub(crate) use verdict::difference;

use crate::file::{Entry, PRESENCE_TOPIC, Presence, Reading, open};
use epoch::EpochReplay;
use plan::{Plan, RecordedCommand};

/// Decisions that are not compared when earlier inputs of the controller are unknown: two seconds
/// of reports at 100 Hz.
pub const SETTLE: u64 = 200;

/// A command later than this after a report answers another report with the same number.
const ANSWER_MAX_NS: u64 = 10_000_000_000;

/// What to replay, and how to replay it.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The recording.
    pub file: PathBuf,
    /// The policy, instead of the recorded one.
    pub policy: Option<PolicyKind>,
    /// The actor's file, instead of the built-in one.
    pub model: Option<PathBuf>,
    /// Decisions at the start of each epoch that are not compared, instead of none or [`SETTLE`].
    pub settle: Option<u64>,
}

/// The context of an error that the recording itself causes; a replay that differs is another error.
pub(crate) fn unusable(file: &Path) -> UnusableInput {
    UnusableInput::new(format!("{} cannot be replayed", file.display()))
}

/// Replays a recording into a controller of this process.
///
/// # Errors
/// [`UnusableInput`] if the recording cannot be read or lacks a required stream; a policy that cannot
/// be built.
pub fn run(settings: &Settings) -> Result<Verdict> {
    let plan = Plan::read(&settings.file).with_context(|| unusable(&settings.file))?;
    let mut reading = open(&settings.file)?;
    let mut player = Player::new(settings, plan)?;
    while let Some(entry) = reading.entry()? {
        player.take(&entry)?;
    }
    Ok(player.finish(&settings.file, &reading))
}

/// Passes messages to controllers, and compares their commands.
struct Player<'a> {
    settings: &'a Settings,
    plan: Plan,
    examiner: Examiner,
    /// The latest capabilities of the array.
    array: Option<Capabilities>,
    /// The latest safety report of the array.
    safety: Option<SafetyReport>,
    current: Option<EpochReplay>,
    /// A controller that joined the room and has not published a command yet.
    next: Option<EpochReplay>,
    /// Commands of this process by tick, each with whether it counts.
    ours: BTreeMap<u64, (MirrorCommand, bool)>,
    /// Recorded commands by tick that still wait for ours.
    theirs: BTreeMap<u64, MirrorCommand>,
    policies: BTreeMap<u64, String>,
    verdict: Tally,
}

#[derive(Default)]
struct Tally {
    reports: u64,
    unanswered: u64,
    compared: u64,
    not_counted: u64,
    same: u64,
    held: u64,
    largest_difference_rad: f64,
    first_difference: Option<String>,
}

impl<'a> Player<'a> {
    fn new(settings: &'a Settings, plan: Plan) -> Result<Self> {
        // The recording holds commands, so the controller had accepted the array.
        let force = Force { small_range: true, paper_angles: true };
        let mut player = Self {
            settings,
            examiner: Examiner::new(&plan.scenario, &plan.scenario.channel_model()?, force),
            array: None,
            safety: None,
            plan,
            current: None,
            next: None,
            ours: BTreeMap::new(),
            theirs: BTreeMap::new(),
            policies: BTreeMap::new(),
            verdict: Tally::default(),
        };
        player.current = player.start_from(0)?;
        Ok(player)
    }

    /// The controller of the first epoch not before this one.
    fn start_from(&mut self, epoch: u64) -> Result<Option<EpochReplay>> {
        let Some((&epoch, &first)) = self.plan.epochs.range(epoch..).next() else { return Ok(None) };
        let kind = match self.settings.policy {
            Some(kind) => kind,
            None => self.plan.policy_of(epoch).with_context(|| unusable(&self.settings.file))?,
        };
        let scenario = &self.plan.scenario;
        let source = self.settings.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
        let policy = heliostat_engine::build(kind, scenario, &source)?;
        let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, epoch);
        controller.warm_up(0..WARM_UP_RUNS);
        if let Some(array) = &self.array {
            controller.handle_capabilities(array, self.examiner.examine(array));
        }
        if let Some(report) = &self.safety {
            controller.handle_safety(report);
        }
        self.policies.insert(epoch, controller.policy_name().to_owned());
        let recorded_from_start = first == 1 && self.plan.clock == Clock::Lockstep;
        let settle = self.settings.settle.unwrap_or(if recorded_from_start { 0 } else { SETTLE });
        Ok(Some(EpochReplay { controller, newest_ns: 0, sequence: 0, decided: 0, settle }))
    }

    fn take(&mut self, entry: &Entry) -> Result<()> {
        if entry.topic == PRESENCE_TOPIC {
            return self.presence(&entry.data);
        }
        let (room, topic, clock) = (&self.plan.room, &entry.topic, self.plan.clock);
        if *topic == room.users() {
            return self.users(entry);
        }
        if *topic == room.command() {
            if let Ok(command) = decode(&entry.data) {
                self.command(command);
            }
            return Ok(());
        }
        if *topic == room.capabilities() {
            if let Ok(array) = decode(&entry.data) {
                self.meet_array(array);
            }
            return Ok(());
        }
        if *topic == room.stop() {
            if let Ok(order) = decode(&entry.data) {
                let arrived = |epoch_replay: &EpochReplay| match clock {
                    Clock::Lockstep => epoch_replay.newest_ns,
                    Clock::Live => entry.arrived_ns,
                };
                self.epochs_running()
                    .for_each(|epoch_replay| epoch_replay.controller.handle_stop_order(arrived(epoch_replay), &order));
            }
            return Ok(());
        }
        if *topic == room.rearm() {
            if let Ok(rearm) = decode(&entry.data) {
                self.epochs_running().for_each(|epoch_replay| epoch_replay.controller.handle_rearm(&rearm));
            }
            return Ok(());
        }
        if *topic == room.safety() {
            if let Ok(report) = decode(&entry.data) {
                self.epochs_running().for_each(|epoch_replay| {
                    epoch_replay.controller.handle_safety(&report);
                });
                self.safety = Some(report);
            }
            return Ok(());
        }
        let stream = match topic {
            topic if *topic == room.channel() => Stream::Channel,
            topic if *topic == room.obstacles() => Stream::Obstacles,
            topic if *topic == room.telemetry() => Stream::Telemetry,
            _ => return Ok(()),
        };
        self.epochs_running()
            .for_each(|epoch_replay| epoch_replay.receive(stream, &entry.data, clock, entry.arrived_ns));
        Ok(())
    }

    /// The controllers that receive messages.
    fn epochs_running(&mut self) -> impl Iterator<Item = &mut EpochReplay> {
        self.current.iter_mut().chain(&mut self.next)
    }

    /// Applies capabilities of the array; repetitions are ignored.
    fn meet_array(&mut self, array: Capabilities) {
        let known = self.array.as_ref();
        if known.is_some_and(|known| *known == Capabilities { stamp: known.stamp, ..array.clone() }) {
            return;
        }
        let verdict = self.examiner.examine(&array);
        let mut is_followed = self.current.is_none();
        for epoch_replay in self.epochs_running() {
            is_followed |= epoch_replay.controller.handle_capabilities(&array, verdict.clone());
        }
        if is_followed {
            self.array = Some(array);
        }
    }

    fn command(&mut self, theirs: MirrorCommand) {
        if theirs.answers == 0 {
            self.unprompted(&theirs);
            return;
        }
        match self.ours.remove(&theirs.answers) {
            Some((ours, counts)) => self.compare(&ours, &theirs, counts),
            None => drop(self.theirs.insert(theirs.answers, theirs)),
        }
    }

    /// A command that answers no report: it follows silence, or a report that was too old.
    fn unprompted(&mut self, theirs: &MirrorCommand) {
        let Some(epoch_replay) =
            self.current.as_mut().filter(|epoch_replay| epoch_replay.controller.epoch() == theirs.epoch)
        else {
            return;
        };
        let counts = epoch_replay.decided >= epoch_replay.settle;
        let decision = match epoch_replay.controller.poll_timeout_command(theirs.time_ns) {
            Some(decision) => decision,
            None => epoch_replay.controller.poll_stale_command(theirs.time_ns),
        };
        match decision {
            Decision::Move { command, .. } => {
                epoch_replay.sequence += 1;
                let ours = MirrorCommand { sequence: epoch_replay.sequence, ..command.clone() };
                self.compare(&ours, theirs, counts);
            }
            Decision::Hold(_) => self.verdict.held += 1,
        }
    }

    fn presence(&mut self, data: &[u8]) -> Result<()> {
        let presence: Presence = serde_json::from_slice(data).context("a presence entry is damaged")?;
        if presence.node == NodeKind::Controller && presence.alive {
            // In lockstep the room waits for its controller: the controller received every recorded
            // message.
            if self.plan.clock == Clock::Live {
                let current = self
                    .current
                    .as_ref()
                    .map_or((0, 0), |epoch_replay| (epoch_replay.controller.epoch(), epoch_replay.decided));
                match current {
                    (epoch, 0) => self.current = self.start_from(epoch)?,
                    (epoch, _) => self.next = self.start_from(epoch + 1)?,
                }
            }
        } else if !presence.alive {
            self.epochs_running()
                .for_each(|epoch_replay| epoch_replay.controller.handle_source_lost(presence.node, presence.source));
        }
        Ok(())
    }

    fn users(&mut self, entry: &Entry) -> Result<()> {
        self.verdict.reports += 1;
        let Ok(mut report) = decode::<UserReport>(&entry.data) else {
            return Ok(());
        };
        let answer = self.answer_to(&report);
        if answer.is_none() {
            self.verdict.unanswered += 1;
        }
        if let Some(answer) = answer
            && self.current.as_ref().is_some_and(|epoch_replay| epoch_replay.controller.epoch() < answer.epoch)
        {
            let epoch = self.current.as_ref().map_or(0, |epoch_replay| epoch_replay.controller.epoch());
            self.current = match self.next.take() {
                Some(next) => Some(next),
                None => self.start_from(epoch + 1)?,
            };
        }
        let Some(epoch_replay) = &mut self.current else { return Ok(()) };
        let now = match (self.plan.clock, answer) {
            (Clock::Lockstep, _) => epoch_replay.at(report.stamp.time_ns),
            (Clock::Live, Some(answer)) => answer.time_ns,
            (Clock::Live, None) => return Ok(()),
        };
        let tick = report.tick;
        let repeats = self.plan.scenario.control.when_late == DegradedAction::LastGood;
        let late = answer.is_some_and(|answer| answer.is_repeat && self.plan.was_late(answer.epoch));
        let timing = if late && repeats { Timing::Late } else { Timing::InTime };
        let decided = match epoch_replay.controller.handle_message(now, Message::Users(&mut report)) {
            Due::Command => Some(epoch_replay.controller.poll_command(now, timing, &mut |_| {})),
            Due::StaleCommand => Some(epoch_replay.controller.poll_stale_command(now)),
            Due::Nothing => None,
        };
        let Some(Decision::Move { command, .. }) = decided else {
            self.verdict.held += u64::from(answer.is_some());
            return Ok(());
        };
        epoch_replay.sequence += 1;
        let command = MirrorCommand { sequence: epoch_replay.sequence, ..command.clone() };
        let counts = epoch_replay.decided >= epoch_replay.settle;
        epoch_replay.decided += 1;
        match self.theirs.remove(&tick) {
            Some(theirs) => self.compare(&command, &theirs, counts),
            None => drop(self.ours.insert(tick, (command, counts))),
        }
        Ok(())
    }

    /// The recorded answer to a report. Tick numbers restart with each source, so the time selects
    /// the answer.
    fn answer_to(&mut self, report: &UserReport) -> Option<RecordedCommand> {
        let answers = self.plan.answers.get_mut(&report.tick)?;
        let time_ns = report.stamp.time_ns;
        let index = answers.iter().position(|answer| answer.time_ns.abs_diff(time_ns) < ANSWER_MAX_NS)?;
        answers.drain(..=index).next_back()
    }

    fn compare(&mut self, ours: &MirrorCommand, theirs: &MirrorCommand, counts: bool) {
        let verdict = &mut self.verdict;
        verdict.compared += 1;
        if !counts {
            verdict.not_counted += 1;
            return;
        }
        match difference(ours, theirs, self.plan.clock) {
            None => verdict.same += 1,
            Some(found) => {
                verdict.first_difference.get_or_insert_with(|| format!("tick {}: {found}", theirs.answers));
                let angles = |command: &MirrorCommand| [command.roll.clone(), command.yaw.clone()].concat();
                let apart = angles(ours).into_iter().zip(angles(theirs)).map(|(a, b)| f64::from((a - b).abs()));
                verdict.largest_difference_rad = apart.fold(verdict.largest_difference_rad, f64::max);
            }
        }
    }

    fn finish(self, file: &Path, reading: &Reading<BufReader<File>>) -> Verdict {
        let tally = self.verdict;
        let header = reading.header();
        Verdict {
            file: file.to_owned(),
            room: header.room.clone(),
            scenario: header.scenario_name.clone(),
            policies: self.policies.into_values().collect(),
            clock: self.plan.clock,
            complete: reading.account().is_some(),
            account: self.plan.account,
            reports: tally.reports,
            unanswered: tally.unanswered,
            compared: tally.compared,
            not_counted: tally.not_counted,
            same: tally.same,
            different: tally.compared - tally.not_counted - tally.same,
            held: tally.held,
            without_report: self.theirs.len() as u64,
            largest_difference_rad: tally.largest_difference_rad,
            first_difference: tally.first_difference,
        }
    }
}
