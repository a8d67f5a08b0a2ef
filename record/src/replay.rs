//! From a recording into the deciding core of a controller: does it decide as it did?
//!
//! The core is a function of `(now, message)`. A recording holds the messages; where `now` comes from depends on the run:
//!
//! - **lockstep**: from the messages themselves. Every command must come out the same, bit for bit.
//! - **live**: of an answered position report `now` is the time in the command that answers it, exactly. Of all other messages it is the
//!   time at which the recorder got them, which decides only whether a message on the edge of being too old is taken. A report that nothing
//!   answered is left out, since the controller may not have got it, or may have shed it for a newer one. An answer that repeats the command
//!   before it is replayed as one for which there was no time, if the controller counted such.
//!
//! What a recording cannot hold is what a controller knew before the recording began, or heard in the instant before the recorder knew of it.
//! So the first [`SETTLE`] decisions of an epoch are replayed but not judged, unless it is one of lockstep whose first command is there.

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
use heliostat_decide::refusal::{Refusal, Stream};
use heliostat_engine::ActorSource;
use heliostat_proto::{
    Capabilities, ChannelReport, MirrorCommand, MirrorTelemetry, Nanos, NodeKind, ObstacleReport, UserReport, decode,
};
use heliostat_scenario::Answer as WhenLate;
use thiserror::Error;

pub(crate) use plan::Beginning;
pub use plan::Clock;
pub use verdict::Verdict;
pub(crate) use verdict::difference;

use crate::file::{Entry, PRESENCE_TOPIC, Presence, Reading};
use plan::{Answer, Plan};

/// Decisions that are not judged where it is not known what the controller knew before; a second of reports and more.
pub const SETTLE: u64 = 200;

/// An answer later than this after its report is one to another report with the same number.
const ANSWER_MAX_NS: u64 = 10_000_000_000;

/// What to replay, and how.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The recording.
    pub file: PathBuf,
    /// The policy, in place of the recorded one.
    pub policy: Option<PolicyKind>,
    /// The actor's file, in place of the built-in one.
    pub model: Option<PathBuf>,
    /// How many decisions of each epoch are not judged, in place of none or [`SETTLE`].
    pub settle: Option<u64>,
}

/// A file that cannot be replayed, which is not the same as one that comes out otherwise.
#[derive(Debug, Error)]
#[error("{} cannot be replayed", .0.display())]
pub struct Unusable(
    /// The file.
    pub PathBuf,
);

/// Opens a recording.
pub(crate) fn open(file: &Path) -> Result<Reading<BufReader<File>>> {
    Ok(Reading::open(BufReader::new(File::open(file)?))?)
}

/// Replays a recording into a controller of this process.
///
/// # Errors
/// [`Unusable`] where the recording cannot be read, or says too little to decide by; a policy that cannot be built.
pub fn run(settings: &Settings) -> Result<Verdict> {
    let plan = Plan::read(&settings.file).with_context(|| Unusable(settings.file.clone()))?;
    let mut reading = open(&settings.file)?;
    let mut player = Player::new(settings, plan)?;
    while let Some(entry) = reading.entry()? {
        player.take(&entry)?;
    }
    Ok(player.finish(&settings.file, &reading))
}

/// A controller as it was in one epoch.
struct Reign {
    controller: Controller,
    newest_ns: Nanos,
    /// Number of the last command.
    sequence: u64,
    /// Decisions so far.
    decided: u64,
    /// Decisions that are not judged.
    settle: u64,
}

/// Plays messages into controllers, and compares.
struct Player<'a> {
    settings: &'a Settings,
    plan: Plan,
    examiner: Examiner,
    /// What the array said last that it can do.
    array: Option<Capabilities>,
    reign: Option<Reign>,
    /// A controller that came into the room and has not answered yet.
    next: Option<Reign>,
    ours: BTreeMap<u64, (MirrorCommand, bool)>,
    theirs: BTreeMap<u64, MirrorCommand>,
    policies: BTreeMap<u64, String>,
    verdict: Tally,
}

#[derive(Default)]
struct Tally {
    reports: u64,
    unanswered: u64,
    compared: u64,
    not_judged: u64,
    same: u64,
    held: u64,
    largest_difference_rad: f64,
    first_difference: Option<String>,
}

impl<'a> Player<'a> {
    fn new(settings: &'a Settings, plan: Plan) -> Result<Self> {
        // Commands stand in the recording, so whatever the array lacks was accepted.
        let force = Force { small_range: true, paper_angles: true };
        let mut player = Self {
            settings,
            examiner: Examiner::new(&plan.scenario, &plan.scenario.channel_model()?, force),
            array: None,
            plan,
            reign: None,
            next: None,
            ours: BTreeMap::new(),
            theirs: BTreeMap::new(),
            policies: BTreeMap::new(),
            verdict: Tally::default(),
        };
        player.reign = player.begin_from(0)?;
        Ok(player)
    }

    /// The controller of the first epoch from this one on.
    fn begin_from(&mut self, epoch: u64) -> Result<Option<Reign>> {
        let Some((&epoch, &first)) = self.plan.epochs.range(epoch..).next() else { return Ok(None) };
        let kind = match self.settings.policy {
            Some(kind) => kind,
            None => self.plan.policy_of(epoch).with_context(|| Unusable(self.settings.file.clone()))?,
        };
        let scenario = &self.plan.scenario;
        let source = self.settings.model.clone().map_or(ActorSource::Shipped, ActorSource::Path);
        let policy = heliostat_engine::build(kind, scenario, &source)?;
        let mut controller = Controller::new(scenario, scenario.channel_model()?, policy, epoch);
        controller.warm_up(0..WARM_UP_RUNS);
        if let Some(array) = &self.array {
            controller.handle_capabilities(array, self.examiner.examine(array));
        }
        self.policies.insert(epoch, controller.policy_name().to_owned());
        let known_from_the_start = first == 1 && self.plan.clock == Clock::Lockstep;
        let settle = self.settings.settle.unwrap_or(if known_from_the_start { 0 } else { SETTLE });
        Ok(Some(Reign { controller, newest_ns: 0, sequence: 0, decided: 0, settle }))
    }

    fn take(&mut self, entry: &Entry) -> Result<()> {
        if entry.topic == PRESENCE_TOPIC {
            return self.presence(&entry.data);
        }
        let (room, topic) = (&self.plan.room, &entry.topic);
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
                self.reigns().for_each(|reign| reign.controller.handle_stop_order(&order));
            }
            return Ok(());
        }
        let stream = match topic {
            topic if *topic == room.channel() => Stream::Channel,
            topic if *topic == room.obstacles() => Stream::Obstacles,
            topic if *topic == room.telemetry() => Stream::Telemetry,
            _ => return Ok(()),
        };
        let clock = self.plan.clock;
        self.reigns().for_each(|reign| reign.hear(stream, &entry.data, clock, entry.arrived_ns));
        Ok(())
    }

    /// The controllers that hear the room.
    fn reigns(&mut self) -> impl Iterator<Item = &mut Reign> {
        self.reign.iter_mut().chain(&mut self.next)
    }

    /// What the array can do; it says so again and again.
    fn meet_array(&mut self, array: Capabilities) {
        let known = self.array.as_ref();
        if known.is_some_and(|known| *known == Capabilities { stamp: known.stamp, ..array.clone() }) {
            return;
        }
        let verdict = self.examiner.examine(&array);
        self.reigns().for_each(|reign| reign.controller.handle_capabilities(&array, verdict.clone()));
        self.array = Some(array);
    }

    fn command(&mut self, theirs: MirrorCommand) {
        if theirs.answers == 0 {
            self.unprompted(&theirs);
            return;
        }
        match self.ours.remove(&theirs.answers) {
            Some((ours, judged)) => self.compare(&ours, &theirs, judged),
            None => drop(self.theirs.insert(theirs.answers, theirs)),
        }
    }

    /// A command that answers no report: it answers silence, or a report that was too old.
    fn unprompted(&mut self, theirs: &MirrorCommand) {
        let Some(reign) = self.reign.as_mut().filter(|reign| reign.controller.epoch() == theirs.epoch) else { return };
        let judged = reign.decided >= reign.settle;
        let decision = match reign.controller.poll_timeout_command(theirs.time_ns) {
            Some(decision) => decision,
            None => reign.controller.poll_stale_command(theirs.time_ns),
        };
        match decision {
            Decision::Move { command, .. } => {
                reign.sequence += 1;
                let ours = MirrorCommand { sequence: reign.sequence, ..command.clone() };
                self.compare(&ours, theirs, judged);
            }
            Decision::Hold(_) => self.verdict.held += 1,
        }
    }

    fn presence(&mut self, data: &[u8]) -> Result<()> {
        let presence: Presence = serde_json::from_slice(data).context("an entry about presence is damaged")?;
        if presence.node == NodeKind::Controller && presence.alive {
            // In lockstep the room waits for its controller: whatever was recorded, it heard.
            if self.plan.clock == Clock::Live {
                let current = self.reign.as_ref().map_or((0, 0), |reign| (reign.controller.epoch(), reign.decided));
                match current {
                    (epoch, 0) => self.reign = self.begin_from(epoch)?,
                    (epoch, _) => self.next = self.begin_from(epoch + 1)?,
                }
            }
        } else if !presence.alive {
            self.reigns().for_each(|reign| reign.controller.handle_source_lost(presence.source));
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
            && self.reign.as_ref().is_some_and(|reign| reign.controller.epoch() < answer.epoch)
        {
            let epoch = self.reign.as_ref().map_or(0, |reign| reign.controller.epoch());
            self.reign = match self.next.take() {
                Some(next) => Some(next),
                None => self.begin_from(epoch + 1)?,
            };
        }
        let Some(reign) = &mut self.reign else { return Ok(()) };
        let now = match (self.plan.clock, answer) {
            (Clock::Lockstep, _) => reign.at(report.stamp.time_ns),
            (Clock::Live, Some(answer)) => answer.time_ns,
            (Clock::Live, None) => return Ok(()),
        };
        let tick = report.tick;
        let repeats = self.plan.scenario.control.when_late == WhenLate::LastGood;
        let late = answer.is_some_and(|answer| answer.is_repeat && self.plan.was_late(answer.epoch));
        let timing = if late && repeats { Timing::Late } else { Timing::InTime };
        let decided = match reign.controller.handle_message(now, Message::Users(&mut report)) {
            Due::Command => Some(reign.controller.poll_command(now, timing, &mut |_| {})),
            Due::StaleCommand => Some(reign.controller.poll_stale_command(now)),
            Due::Nothing => None,
        };
        let Some(Decision::Move { command, .. }) = decided else {
            self.verdict.held += u64::from(answer.is_some());
            return Ok(());
        };
        reign.sequence += 1;
        let command = MirrorCommand { sequence: reign.sequence, ..command.clone() };
        let judged = reign.decided >= reign.settle;
        reign.decided += 1;
        match self.theirs.remove(&tick) {
            Some(theirs) => self.compare(&command, &theirs, judged),
            None => drop(self.ours.insert(tick, (command, judged))),
        }
        Ok(())
    }

    /// The recorded answer to a report. Numbers of ticks begin anew with each source of reports, so the time tells which answer is meant.
    fn answer_to(&mut self, report: &UserReport) -> Option<Answer> {
        let answers = self.plan.answers.get_mut(&report.tick)?;
        let time_ns = report.stamp.time_ns;
        let meant = answers.iter().position(|answer| answer.time_ns.abs_diff(time_ns) < ANSWER_MAX_NS)?;
        answers.drain(..=meant).next_back()
    }

    fn compare(&mut self, ours: &MirrorCommand, theirs: &MirrorCommand, judged: bool) {
        let verdict = &mut self.verdict;
        verdict.compared += 1;
        if !judged {
            verdict.not_judged += 1;
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
            not_judged: tally.not_judged,
            same: tally.same,
            different: tally.compared - tally.not_judged - tally.same,
            held: tally.held,
            without_report: self.theirs.len() as u64,
            largest_difference_rad: tally.largest_difference_rad,
            first_difference: tally.first_difference,
        }
    }
}

impl Reign {
    /// Room time in lockstep: that of the newest message.
    fn at(&mut self, time_ns: Nanos) -> Nanos {
        self.newest_ns = self.newest_ns.max(time_ns);
        self.newest_ns
    }

    fn hear(&mut self, stream: Stream, data: &[u8], clock: Clock, arrived_ns: Nanos) {
        let now =
            |reign: &mut Self, time_ns: Nanos| if clock == Clock::Lockstep { reign.at(time_ns) } else { arrived_ns };
        let read = match stream {
            Stream::Channel => decode::<ChannelReport>(data).map(|mut report| {
                let now = now(self, report.stamp.time_ns);
                self.controller.handle_and_poll(now, Message::Channel(&mut report), &mut |_| {});
            }),
            Stream::Obstacles => decode::<ObstacleReport>(data).map(|mut report| {
                let now = now(self, report.stamp.time_ns);
                self.controller.handle_and_poll(now, Message::Obstacles(&mut report), &mut |_| {});
            }),
            Stream::Telemetry => decode::<MirrorTelemetry>(data).map(|mut telemetry| {
                let now = now(self, telemetry.stamp.time_ns);
                self.controller.handle_and_poll(now, Message::Telemetry(&mut telemetry), &mut |_| {});
            }),
            Stream::Users => return,
        };
        if let Err(error) = read {
            self.controller.handle_malformed(stream, Refusal::from(&error));
        }
    }
}
