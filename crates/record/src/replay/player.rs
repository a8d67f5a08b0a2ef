//! Passes the messages of a recording to controllers, and compares their commands.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use heliostat_core::capabilities::{Examiner, Force};
use heliostat_core::core::{Controller, Timing, WARM_UP_RUNS};
use heliostat_core::policy::Policy;
use heliostat_models::{ActorSource, build};
use heliostat_proto::{
    Capabilities, ControllerInput, InputKind, MirrorCommand, NodeKind, SafetyReport, UserReport, decode,
};
use heliostat_scenario::{Belief, DegradedAction};
use heliostat_service::exit;

use super::comparison::Comparison;
use super::epoch::EpochReplay;
use super::inputs::{Input, cloned};
use super::plan::{Clock, Plan, RecordedCommand};
use super::schedule::EntryIndex;
use super::scheduled::{Decided, Offered, Place, Progress, Tail};
use super::settings::{SETTLE, Settings, unusable};
use super::verdict::Verdict;
use crate::file::{Entry, PRESENCE_TOPIC, Presence, Reading};
use crate::received::Received;

/// A command later than this after a report answers another report with the same number.
const ANSWER_MAX_NS: u64 = 10_000_000_000;

/// Passes messages to controllers, and compares their commands.
pub(super) struct Player<'a> {
    settings: &'a Settings,
    plan: Plan,
    examiner: Examiner,
    /// The latest capabilities of each array.
    arrays: BTreeMap<usize, Capabilities>,
    /// The latest safety report of each array.
    safety: BTreeMap<usize, SafetyReport>,
    current: Option<EpochReplay>,
    /// A controller that joined the room and has not published a command yet.
    next: Option<EpochReplay>,
    /// Number of the entry that is being read.
    read: EntryIndex,
    /// Messages after the last step of the current controller's schedule.
    tail: Vec<Tail>,
    policies: BTreeMap<u64, String>,
    /// What decides in place of the recorded policies, by epoch.
    replaced: BTreeMap<u64, String>,
    verdict: Comparison,
    /// Why a recorded state was not restored.
    unrestored: Option<String>,
    /// The most decisions at the start of an epoch that do not count.
    settle: u64,
}

impl<'a> Player<'a> {
    /// Begins at the first epoch of the plan.
    ///
    /// # Errors
    /// A policy that cannot be built.
    pub fn new(settings: &'a Settings, plan: Plan) -> Result<Self> {
        // The recording holds commands, so the controller had accepted the array.
        let force = Force { small_range: true, paper_angles: true };
        let mut player = Self {
            settings,
            verdict: Comparison::of(plan.clock),
            examiner: Examiner::new(&plan.scenario, &plan.scenario.channel_model()?, force),
            arrays: BTreeMap::new(),
            safety: BTreeMap::new(),
            plan,
            current: None,
            next: None,
            read: 0,
            tail: Vec::new(),
            policies: BTreeMap::new(),
            replaced: BTreeMap::new(),
            unrestored: None,
            settle: 0,
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
        let source = ActorSource::from(self.settings.model.clone());
        let policy = build(kind, scenario, &source).map_err(exit::unusable)?;
        self.check_actor(epoch, policy.as_ref())?;
        let replaced = self.replaced(epoch, policy.as_ref());
        let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, epoch);
        controller.warm_up(0..WARM_UP_RUNS);
        for (array, capabilities) in &self.arrays {
            controller.handle_capabilities(*array, capabilities, self.examiner.examine(*array, capabilities));
        }
        for (array, report) in &self.safety {
            controller.handle_safety(*array, report);
        }
        self.policies.insert(epoch, controller.policy().name().to_owned());
        self.replaced.extend(replaced.map(|replaced| (epoch, replaced)));
        let recorded_from_start = first == 1 && self.plan.clock == Clock::Lockstep;
        let schedule = self.plan.schedules.get(&epoch).filter(|_| !recorded_from_start);
        let progress = schedule.map(|schedule| Progress::new(schedule.clone()));
        let is_known = recorded_from_start || progress.is_some();
        let settle = self.settings.settle.unwrap_or(if is_known { 0 } else { SETTLE });
        self.settle = self.settle.max(settle);
        Ok(Some(EpochReplay { controller, newest_ns: 0, decided: 0, settle, progress }))
    }

    /// Refuses to compare with another file of a learned policy than the recorded one, where the
    /// caller chose neither.
    ///
    /// # Errors
    /// The files differ.
    fn check_actor(&self, epoch: u64, policy: &dyn Policy) -> Result<()> {
        let is_chosen = self.settings.policy.is_some() || self.settings.model.is_some();
        let (Some(recorded), Some(found)) = (self.plan.actor_of(epoch), policy.file_hash()) else { return Ok(()) };
        ensure!(
            is_chosen || recorded == found,
            "{} was recorded with another actor file, whose SHA-256 begins with {recorded} (the built-in one: {found}): give it with --model",
            self.settings.file.display()
        );
        Ok(())
    }

    /// What decides in place of the recorded policy of an epoch; `None` where the recording names no other one.
    fn replaced(&self, epoch: u64, policy: &dyn Policy) -> Option<String> {
        let recorded = self.plan.policies_of(epoch);
        if recorded.iter().any(|recorded| *recorded != policy.name()) {
            return Some(format!("{} in place of {}", policy.name(), recorded.join(", ")));
        }
        let (recorded, found) = (self.plan.actor_of(epoch)?, policy.file_hash()?);
        (recorded != found).then(|| format!("the actor file {found} in place of {recorded}"))
    }

    /// Takes the next entry of the recording.
    ///
    /// # Errors
    /// A damaged presence entry; a policy that cannot be built.
    pub fn take(&mut self, entry: &Entry) -> Result<()> {
        self.pass(entry)?;
        self.advance();
        self.read += 1;
        Ok(())
    }

    fn pass(&mut self, entry: &Entry) -> Result<()> {
        if entry.topic == PRESENCE_TOPIC {
            return self.presence(&entry.data);
        }
        let (room, clock) = (&self.plan.room, self.plan.clock);
        let (array, topic) = &room.first_array_key(&entry.topic);
        let array = *array;
        if array >= self.plan.scenario.mirrors.arrays().len() {
            return Ok(());
        }
        if *topic == room.users() {
            return self.users(entry);
        }
        if *topic == room.command() {
            if let Ok(command) = decode(&entry.data) {
                self.command(array, command);
            }
            return Ok(());
        }
        if *topic == room.capabilities() {
            if let Ok(capabilities) = decode(&entry.data) {
                self.meet_array(array, capabilities);
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
        if *topic == room.stops() {
            if let Ok(report) = decode(&entry.data) {
                self.epochs_running().for_each(|epoch_replay| {
                    epoch_replay.controller.handle_stops(array, &report);
                });
            }
            return Ok(());
        }
        if *topic == room.safety() {
            if let Ok(report) = decode(&entry.data) {
                self.epochs_running().for_each(|epoch_replay| {
                    epoch_replay.controller.handle_safety(array, &report);
                });
                self.safety.insert(array, report);
            }
            return Ok(());
        }
        let input = match topic {
            topic if *topic == room.channel() => InputKind::Channel,
            topic if *topic == room.obstacles() => InputKind::Obstacles,
            topic if *topic == room.orientation() => InputKind::Orientation,
            topic if *topic == room.leds() => InputKind::Leds,
            topic if *topic == room.telemetry() => InputKind::Telemetry,
            topic if *topic == room.controller_memory() => {
                self.keep_memory(&entry.data);
                return Ok(());
            }
            _ => return Ok(()),
        };
        self.offer((input, array), entry, None);
        Ok(())
    }

    /// Keeps a recorded state for the schedules.
    fn keep_memory(&mut self, data: &[u8]) {
        let read = self.read;
        self.epochs_running()
            .filter_map(|epoch_replay| epoch_replay.progress.as_mut())
            .for_each(|progress| progress.keep_memory(read, data));
    }

    /// Passes a report or telemetry to the controllers: by their schedules, or at once.
    fn offer(&mut self, input: Input, entry: &Entry, answer: Option<RecordedCommand>) {
        let (read, clock) = (self.read, self.plan.clock);
        let received = Received::read(&self.plan.room, &entry.topic, &entry.data);
        let origin = received.map(|received| received.origin()).unwrap_or_default();
        let sequence = ControllerInput::sequence_of(input.1, origin.sequence);
        let offered = Offered { entry: read, input, source: origin.source, sequence, data: entry.data.clone() };
        if let Some(next) = &mut self.next {
            match &mut next.progress {
                Some(progress) => drop(progress.place(&offered)),
                None if input.0 != InputKind::Users => next.receive(input, &entry.data, clock, entry.arrived_ns),
                None => {}
            }
        }
        let place = match self.current.as_mut().map(|current| current.progress.as_mut()) {
            None | Some(None) => Place::Tail,
            Some(Some(progress)) => progress.place(&offered),
        };
        if place == Place::Tail {
            self.tail.push(Tail { input, data: offered.data, arrived_ns: entry.arrived_ns, answer });
        }
    }

    /// Takes the steps of the schedules that can be taken, and then the messages after them.
    fn advance(&mut self) {
        let read = self.read;
        if let Some(EpochReplay { controller, progress: Some(progress), .. }) = &mut self.next {
            // Its commands are compared when it is the current one.
            progress.advance(controller, read);
        }
        let Some(current) = &mut self.current else { return };
        if let Some(progress) = &mut current.progress {
            for Decided { commands, counts } in progress.advance(&mut current.controller, read) {
                let counts = counts && current.decided >= current.settle;
                self.verdict.held += u64::from(counts && commands.is_empty());
                for (array, command) in commands {
                    // The recording does not show which number the command had before the replay.
                    self.verdict.add_ours(array, command, counts, Clock::Live);
                }
                current.decided += 1;
            }
            if !progress.is_complete() {
                return;
            }
            // A filter depends on messages that it handled without an answer.
            progress.is_known &= self.plan.scenario.control.belief != Belief::Filter;
        }
        for message in std::mem::take(&mut self.tail) {
            self.take_tail(message);
        }
    }

    /// Passes a message to the current controller outside a schedule.
    fn take_tail(&mut self, Tail { input, data, arrived_ns, answer }: Tail) {
        let clock = self.plan.clock;
        let Some(current) = &mut self.current else { return };
        if input.0 != InputKind::Users {
            current.receive(input, &data, clock, arrived_ns);
            return;
        }
        let Ok(report) = decode::<UserReport>(&data) else { return };
        let now = match (clock, answer) {
            (Clock::Lockstep, _) => current.at(report.stamp.time_ns),
            (Clock::Live, Some(answer)) => answer.time_ns,
            (Clock::Live, None) => return,
        };
        let repeats = self.plan.scenario.control.when_late == DegradedAction::LastGood;
        let late = answer.is_some_and(|answer| answer.is_repeat && self.plan.was_late(answer.epoch));
        let timing = if late && repeats { Timing::Late } else { Timing::InTime };
        let commands = current.answer(report, now, timing);
        if commands.is_empty() {
            self.verdict.held += u64::from(answer.is_some());
            return;
        }
        let counts = current.counts();
        current.decided += 1;
        let clock = if current.progress.is_some() { Clock::Live } else { clock };
        for (array, command) in commands {
            self.verdict.add_ours(array, command, counts, clock);
        }
    }

    /// The controllers that receive messages.
    fn epochs_running(&mut self) -> impl Iterator<Item = &mut EpochReplay> {
        self.current.iter_mut().chain(&mut self.next)
    }

    /// Applies capabilities of an array; repetitions are ignored.
    fn meet_array(&mut self, array: usize, capabilities: Capabilities) {
        let known = self.arrays.get(&array);
        if known.is_some_and(|known| *known == Capabilities { stamp: known.stamp, ..capabilities.clone() }) {
            return;
        }
        let verdict = self.examiner.examine(array, &capabilities);
        let mut is_followed = self.current.is_none();
        for epoch_replay in self.epochs_running() {
            is_followed |= epoch_replay.controller.handle_capabilities(array, &capabilities, verdict.clone());
        }
        if is_followed {
            self.arrays.insert(array, capabilities);
        }
    }

    fn command(&mut self, array: usize, theirs: MirrorCommand) {
        if self.plan.leaves_out(theirs.epoch) {
            return;
        }
        let progress = self.current.as_ref().and_then(|current| current.progress.as_ref());
        let clock = if progress.is_some() { Clock::Live } else { self.plan.clock };
        if theirs.answers == 0 && array == 0 && progress.is_none_or(Progress::is_complete) {
            self.unprompted(&theirs);
        } else {
            self.verdict.add_theirs(array, theirs, clock);
        }
    }

    /// A command that answers no report: it follows silence, or a report that was too old.
    fn unprompted(&mut self, theirs: &MirrorCommand) {
        let Some(current) = self.current.as_mut().filter(|current| current.controller.epoch() == theirs.epoch) else {
            return;
        };
        let counts = current.counts();
        let decision = match current.controller.poll_timeout_command(theirs.time_ns) {
            Some(decision) => decision,
            None => current.controller.poll_stale_command(theirs.time_ns),
        };
        let commands = cloned(decision);
        if commands.is_empty() {
            self.verdict.held += 1;
            return;
        }
        for (array, ours) in commands {
            match array {
                0 => self.verdict.compare(&ours, theirs, counts, self.plan.clock),
                _ => self.verdict.add_ours(array, ours, counts, self.plan.clock),
            }
        }
    }

    fn presence(&mut self, data: &[u8]) -> Result<()> {
        let presence: Presence = serde_json::from_slice(data).context("a presence entry is damaged")?;
        let Presence { node, source, alive } = presence;
        self.epochs_running().for_each(|EpochReplay { controller, .. }| match alive {
            true => controller.handle_source_found(node, source),
            false => controller.handle_source_lost(node, source),
        });
        if node == NodeKind::Controller && alive {
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
        }
        Ok(())
    }

    fn users(&mut self, entry: &Entry) -> Result<()> {
        self.verdict.reports += 1;
        let Ok(report) = decode::<UserReport>(&entry.data) else { return Ok(()) };
        let answer = self.answer_to(&report);
        if answer.is_none() {
            self.verdict.unanswered += 1;
        }
        let epoch = self.current.as_ref().map_or(0, |current| current.controller.epoch());
        if answer.is_some_and(|answer| self.current.is_some() && epoch < answer.epoch) {
            self.keep_problem();
            self.tail.clear();
            self.current = match self.next.take() {
                Some(next) => Some(next),
                None => self.start_from(epoch + 1)?,
            };
        }
        self.offer((InputKind::Users, 0), entry, answer);
        Ok(())
    }

    /// Keeps the reason for which the current controller did not restore a state.
    fn keep_problem(&mut self) {
        let progress = self.current.as_ref().and_then(|current| current.progress.as_ref());
        if let Some(problem) = progress.and_then(|progress| progress.problem.as_ref()) {
            self.unrestored.get_or_insert_with(|| problem.clone());
        }
    }

    /// The recorded answer to a report. Tick numbers restart with each source, so the time selects
    /// the answer.
    fn answer_to(&mut self, report: &UserReport) -> Option<RecordedCommand> {
        let answers = self.plan.answers.get_mut(&report.tick)?;
        let time_ns = report.stamp.time_ns;
        let index = answers.iter().position(|answer| answer.time_ns.abs_diff(time_ns) < ANSWER_MAX_NS)?;
        answers.drain(..=index).next_back()
    }

    /// The result, after the last entry.
    pub fn finish(mut self, file: &Path, reading: &Reading<BufReader<File>>) -> Verdict {
        self.keep_problem();
        let verdict = self.verdict;
        let header = reading.header();
        let mut replaced = Vec::new();
        for one in self.replaced.into_values() {
            if !replaced.contains(&one) {
                replaced.push(one);
            }
        }
        Verdict {
            file: file.to_owned(),
            room: header.room.clone(),
            scenario: header.scenario_name.clone(),
            policies: self.policies.into_values().collect(),
            replaced,
            clock: self.plan.clock,
            complete: reading.account().is_some(),
            account: self.plan.account,
            reports: verdict.reports,
            unanswered: verdict.unanswered,
            compared: verdict.compared,
            not_counted: verdict.not_counted,
            settle: self.settle,
            same: verdict.same,
            different: verdict.compared - verdict.not_counted - verdict.same,
            held: verdict.held,
            without_report: verdict.without_report(),
            largest_difference_rad: verdict.largest_difference_rad,
            first_difference: verdict.first_difference,
            unrestored: self.unrestored,
            left_out: self.plan.left_out.into_values().collect(),
            without_policy: self.plan.unnamed.into_values().sum(),
        }
    }
}
