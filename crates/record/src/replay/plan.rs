//! The first pass over a recording: scenario, clock, answers by tick, and the policy of each epoch.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::path::Path;
use std::rc::Rc;

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use heliostat_core::policy::PolicyKind;
use heliostat_proto::{ControllerInput, EPOCH_SLOTS, InputKind, MirrorCommand, Nanos, NodeKind, NodeStatus, Room};
use heliostat_scenario::Scenario;
use serde::Serialize;

use crate::account::Account;
use crate::file::open;
use crate::received::{Received, Unreadable};

use super::schedule::{Schedule, ScheduleBuilder};
use super::verdict::LeftOut;

/// The policy in the status of `heliostat.run`.
const FUNCTION: &str = "python";

/// A report whose time differs by more than this from its arrival is in simulated time.
const LIVE_CLOCK_NS: u64 = 3_600_000_000_000;

/// The clock of a room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// UTC.
    #[default]
    Live,
    /// Simulated time.
    Lockstep,
}

/// The part of a recording before its first position report.
pub(crate) struct Beginning {
    /// The room's name.
    pub room: Room,
    /// The clock of the room, derived from the first report.
    pub clock: Clock,
    /// The payload of the capabilities of each array that announced some.
    pub capabilities: BTreeMap<usize, Vec<u8>>,
    /// Number of mirrors of each array in the scenario.
    pub mirrors: Vec<usize>,
}

impl Beginning {
    /// Reads a recording up to its first position report.
    ///
    /// # Errors
    /// A recording that cannot be read, or holds no such report.
    pub fn read(file: &Path) -> Result<Self> {
        let mut reading = open(file)?;
        let room = Room::new(&reading.header().room)?;
        let scenario = Scenario::from_recorded_toml(&reading.header().scenario).context("its scenario")?;
        let mirrors = scenario.mirrors.arrays().iter().map(|array| array.rows * array.columns).collect();
        let (mut capabilities, mut unreadable) = (BTreeMap::new(), Unreadable::default());
        while let Some(entry) = reading.entry()? {
            let (array, topic) = room.first_array_key(&entry.topic);
            if topic == room.capabilities() {
                capabilities.insert(array, entry.data);
            } else if entry.topic == room.users()
                && let Some(Received::Users(report)) = unreadable.read(&room, &entry.topic, &entry.data)
            {
                let clock = clock_of(report.stamp.time_ns, entry.arrived_ns);
                return Ok(Self { clock, room, capabilities, mirrors });
            }
        }
        Err(no_report(&unreadable, reading.account().is_none()))
    }
}

/// A recorded command without its angles.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordedCommand {
    pub epoch: u64,
    pub time_ns: Nanos,
    /// Its angles equal those of the command before it, as after a late decision.
    pub is_repeat: bool,
}

/// What a replay needs to know in advance.
pub(super) struct Plan {
    pub scenario: Scenario,
    pub room: Room,
    pub clock: Clock,
    /// Commands by the tick that they answer, in the order of arrival.
    pub answers: HashMap<u64, VecDeque<RecordedCommand>>,
    /// Each epoch with the sequence of its first recorded command.
    pub epochs: BTreeMap<u64, u64>,
    /// The inputs of the controllers that published them, by epoch.
    pub schedules: BTreeMap<u64, Rc<Schedule>>,
    /// The statuses of the controllers, by epoch.
    controllers: BTreeMap<u64, ControllerHistory>,
    /// The scenarios of the controllers that used another one than the recording holds, by source.
    other_scenarios: BTreeMap<u64, String>,
    /// The commands that are not replayed, by the source of their controller.
    pub left_out: BTreeMap<u64, LeftOut>,
    /// The commands that are not replayed since no status names their policy, by epoch.
    pub unnamed: BTreeMap<u64, u64>,
    pub account: Account,
}

/// The statuses of one controller.
#[derive(Default)]
struct ControllerHistory {
    policies: BTreeSet<String>,
    /// The hashes of the files of learned policies.
    actors: BTreeSet<String>,
    /// Decisions whose predicted latency exceeded the deadline.
    late: u64,
    /// The source of a controller that used another scenario than the recording holds.
    with_other_scenario: Option<u64>,
}

impl Plan {
    /// Reads a recording from its beginning to its end, for a replay by the recorded policies, or by a given one.
    ///
    /// # Errors
    /// A recording that cannot be read, or cannot be replayed under any policy.
    pub fn read(file: &Path, is_policy_given: bool) -> Result<Self> {
        let mut reading = open(file)?;
        let header = reading.header().clone();
        let hash = Scenario::hash_of(&header.scenario);
        ensure!(
            hash == header.scenario_hash,
            "its scenario has the hash {hash}, its header names {}: it was changed after it was made",
            header.scenario_hash
        );
        let scenario = Scenario::from_recorded_toml(&header.scenario).context("its scenario")?;
        let mut plan = Self::new(scenario, Room::new(&header.room)?);
        let (mut clock, mut unreadable) = (None, Unreadable::default());
        let mut last = None;
        let mut schedules = ScheduleBuilder::default();
        for index in 0.. {
            let Some(entry) = reading.entry()? else { break };
            if !entry.topic.starts_with("heliostat/") {
                continue;
            }
            let received = unreadable.read(&plan.room, &entry.topic, &entry.data);
            let (array, _) = plan.room.first_array_key(&entry.topic);
            plan.account.count(&entry.topic, entry.data.len(), received.as_ref().map(Received::origin));
            if let Some((input, received)) =
                received.as_ref().and_then(|received| Some((input_of(received)?, received)))
            {
                let origin = received.origin();
                let sequence = ControllerInput::sequence_of(array, origin.sequence);
                schedules.add_message(index, input, origin.source, sequence);
            }
            match received {
                Some(Received::Memory(memory)) => schedules.add_memory(index, memory),
                Some(Received::Users(report)) => {
                    clock.get_or_insert_with(|| clock_of(report.stamp.time_ns, entry.arrived_ns));
                }
                // Each decision has a command to the first array, unless that array gets none.
                Some(Received::Command(command)) if array == 0 => last = Some(plan.add_command(command, last.as_ref())),
                Some(Received::Status(status)) if status.node == NodeKind::Controller => {
                    plan.add_status(status, &hash);
                }
                _ => {}
            }
        }
        plan.schedules = schedules.build();
        plan.clock = clock.ok_or_else(|| no_report(&unreadable, reading.account().is_none()))?;
        plan.leave_out_other_scenarios(&hash)?;
        if !is_policy_given {
            plan.leave_out_unnamed();
        }
        ensure!(
            !plan.epochs.is_empty(),
            "it holds no command: no controller was in the room, or the recorder was not connected to it"
        );
        Ok(plan)
    }

    fn new(scenario: Scenario, room: Room) -> Self {
        Self {
            scenario,
            room,
            clock: Clock::Live,
            answers: HashMap::new(),
            epochs: BTreeMap::new(),
            schedules: BTreeMap::new(),
            controllers: BTreeMap::new(),
            other_scenarios: BTreeMap::new(),
            left_out: BTreeMap::new(),
            unnamed: BTreeMap::new(),
            account: Account::default(),
        }
    }

    /// Adds a command; `last` is the one before it.
    fn add_command(&mut self, command: MirrorCommand, last: Option<&MirrorCommand>) -> MirrorCommand {
        self.epochs.entry(command.epoch).or_insert(command.sequence);
        let is_repeat = last
            .is_some_and(|last| (last.epoch, &last.roll, &last.yaw) == (command.epoch, &command.roll, &command.yaw));
        let answer = RecordedCommand { epoch: command.epoch, time_ns: command.time_ns, is_repeat };
        self.answers.entry(command.answers).or_default().push_back(answer);
        command
    }

    /// Leaves out the epochs of the controllers that used another scenario than the recorded one.
    ///
    /// # Errors
    /// No other epoch has commands.
    fn leave_out_other_scenarios(&mut self, hash: &str) -> Result<()> {
        let others = self.epochs.keys().filter_map(|&epoch| Some((epoch, self.with_other_scenario(epoch)?)));
        for (epoch, source) in others.collect::<Vec<_>>() {
            let commands = self.commands_of(epoch);
            let scenario = self.other_scenarios.get(&source).cloned().unwrap_or_default();
            let left_out = LeftOut { controller: format!("{source:016x}"), scenario, commands: 0 };
            self.left_out.entry(source).or_insert(left_out).commands += commands;
            self.epochs.remove(&epoch);
        }
        if self.epochs.is_empty() && !self.other_scenarios.is_empty() {
            let used = self.other_scenarios.iter();
            let used = used.map(|(source, scenario)| format!("controller {source:016x} used scenario {scenario}"));
            bail!(
                "{}, it holds {hash}: either the recorder or the controller did not have the --scenario, --set and --seed of the room",
                used.collect::<Vec<_>>().join(", ")
            );
        }
        self.keep_answers_of_epochs();
        Ok(())
    }

    /// Leaves out the epochs whose policy no status names, as at the end of a file just after a takeover. Where
    /// this would leave no epoch, all stay, and [`Plan::policy_of`] has the error.
    fn leave_out_unnamed(&mut self) {
        let (named, unnamed): (Vec<u64>, Vec<u64>) =
            self.epochs.keys().partition(|&epoch| self.controllers.contains_key(epoch));
        if named.is_empty() {
            return;
        }
        for epoch in unnamed {
            self.unnamed.insert(epoch, self.commands_of(epoch));
            self.epochs.remove(&epoch);
        }
        self.keep_answers_of_epochs();
    }

    /// Number of the recorded decisions of an epoch.
    fn commands_of(&self, epoch: u64) -> u64 {
        self.answers.values().flatten().filter(|answer| answer.epoch == epoch).count() as u64
    }

    fn keep_answers_of_epochs(&mut self) {
        for answers in self.answers.values_mut() {
            answers.retain(|answer| self.epochs.contains_key(&answer.epoch));
        }
    }

    /// The source of the controller of an epoch, if it used another scenario than the recorded one.
    fn with_other_scenario(&self, epoch: u64) -> Option<u64> {
        let is_of = |source: &u64| source % EPOCH_SLOTS == epoch % EPOCH_SLOTS;
        match (self.controllers.get(&epoch), self.clock) {
            (Some(history), _) => history.with_other_scenario,
            // A status shows an epoch of the first array, and not each that was in use since the last one.
            (None, Clock::Live) => self.other_scenarios.keys().copied().find(is_of),
            (None, Clock::Lockstep) => None,
        }
    }

    /// Whether the commands of an epoch are not replayed.
    pub fn leaves_out(&self, epoch: u64) -> bool {
        self.with_other_scenario(epoch).is_some() || self.unnamed.contains_key(&epoch)
    }

    /// Adds the status of a controller; `hash` is that of the recorded scenario.
    fn add_status(&mut self, status: NodeStatus, hash: &str) {
        let counter = |name: &str| status.counter(name).unwrap_or(0);
        let actor = status.actor().map(String::from);
        let history = self.controllers.entry(counter(NodeStatus::EPOCH)).or_default();
        history.late = history.late.max(counter("fallback:late"));
        if !status.scenario.is_empty() && status.scenario != hash {
            history.with_other_scenario = Some(status.stamp.source);
            self.other_scenarios.insert(status.stamp.source, status.scenario);
        }
        history.actors.extend(actor);
        history.policies.insert(status.policy);
    }

    /// Whether the controller of an epoch counted late decisions.
    pub fn was_late(&self, epoch: u64) -> bool {
        self.controllers.get(&epoch).is_some_and(|history| history.late > 0)
    }

    /// The hash of the file of the learned policy that decided in an epoch; `None` if its status does
    /// not name it.
    pub fn actor_of(&self, epoch: u64) -> Option<&str> {
        let actors = &self.controllers.get(&epoch)?.actors;
        actors.first().filter(|_| actors.len() == 1).map(String::as_str)
    }

    /// The policies that decided in an epoch, by the statuses of its controller.
    pub fn policies_of(&self, epoch: u64) -> Vec<&str> {
        let history = self.controllers.get(&epoch).into_iter();
        history.flat_map(|history| &history.policies).map(String::as_str).collect()
    }

    /// The policy that decided in an epoch.
    ///
    /// # Errors
    /// A policy that is unknown, more than one policy, or one that this program does not have.
    pub fn policy_of(&self, epoch: u64) -> Result<PolicyKind> {
        let Some(ControllerHistory { policies, .. }) = self.controllers.get(&epoch) else {
            bail!("it does not name the policy of epoch {epoch}; give it with --policy");
        };
        ensure!(
            policies.len() == 1,
            "the policy changed within epoch {epoch} ({}), and the recording does not show at which decision; replay a recording of one policy, or give one with --policy",
            policies.iter().cloned().collect::<Vec<_>>().join(", ")
        );
        let name = policies.first().map_or("", String::as_str);
        PolicyKind::from_str(name, false).map_err(|_| not_replayable(name))
    }
}

/// Why no position report was found.
fn no_report(unreadable: &Unreadable, was_cut: bool) -> Error {
    if unreadable.count > 0 {
        return anyhow!("it holds no position report that can be read; {unreadable}");
    }
    let why = if was_cut {
        "the recording was cut, and nothing complete precedes the cut: copy the file again, or record again"
    } else {
        "the recorder was not connected to the tracker or the simulator: record again with a direct link to it, by --listen or --connect"
    };
    anyhow!("it holds no position report: {why}")
}

/// Why this program cannot decide by a recorded policy.
fn not_replayable(policy: &str) -> Error {
    if policy == FUNCTION {
        return anyhow!(
            "a function in Python decided (heliostat.run), which no replay can call; give a built-in policy to compare with in --policy"
        );
    }
    anyhow!("the recorded policy \"{policy}\" is unknown to this program; give another with --policy")
}

/// The kind of input that a message is to a controller.
fn input_of(received: &Received) -> Option<InputKind> {
    match received {
        Received::Users(_) => Some(InputKind::Users),
        Received::Channel(_) => Some(InputKind::Channel),
        Received::Obstacles(_) => Some(InputKind::Obstacles),
        Received::Orientation(_) => Some(InputKind::Orientation),
        Received::Leds(_) => Some(InputKind::Leds),
        Received::Telemetry(_) => Some(InputKind::Telemetry),
        _ => None,
    }
}

fn clock_of(report_ns: Nanos, arrived_ns: Nanos) -> Clock {
    if report_ns.abs_diff(arrived_ns) > LIVE_CLOCK_NS { Clock::Lockstep } else { Clock::Live }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Stamp;

    use super::*;

    const OWN: u64 = 3 * EPOCH_SLOTS + 7;
    const VISITOR: u64 = 5 * EPOCH_SLOTS + 9;

    /// A plan after a command of each epoch, and the statuses of a controller and of one with another scenario.
    fn plan(clock: Clock, epochs: &[u64]) -> Plan {
        let scenario = Scenario::builtin("hall").expect("a built-in scenario");
        let mut plan = Plan { clock, ..Plan::new(scenario, Room::new("lab").expect("a valid name")) };
        for &epoch in epochs {
            plan.add_command(MirrorCommand { epoch, ..MirrorCommand::default() }, None);
        }
        for (source, epoch, scenario) in [(OWN, OWN, "recorded"), (VISITOR, VISITOR, "other")] {
            let status = NodeStatus {
                stamp: Stamp { source, ..Stamp::default() },
                scenario: scenario.into(),
                counters: vec![("epoch".into(), epoch)],
                ..NodeStatus::default()
            };
            plan.add_status(status, "recorded");
        }
        plan
    }

    #[test]
    fn an_epoch_of_another_scenario_that_no_status_shows_is_left_out_too() {
        let unseen = VISITOR + EPOCH_SLOTS;
        let mut live = plan(Clock::Live, &[OWN, VISITOR, unseen]);
        live.leave_out_other_scenarios("recorded").expect("the own epoch remains");
        assert_eq!(live.epochs.keys().collect::<Vec<_>>(), [&OWN]);
        assert_eq!(live.left_out.values().map(|one| one.commands).collect::<Vec<_>>(), [2]);
        assert_eq!(live.answers.values().map(VecDeque::len).sum::<usize>(), 1);
        let of_second_array = VISITOR + 2 * EPOCH_SLOTS;
        assert!(live.leaves_out(of_second_array) && !live.leaves_out(OWN + EPOCH_SLOTS));
    }

    #[test]
    fn an_epoch_whose_policy_no_status_names_is_left_out_unless_it_is_the_only_one() {
        let unnamed = OWN + 1;
        let mut live = plan(Clock::Live, &[OWN, unnamed]);
        live.leave_out_unnamed();
        assert_eq!(live.epochs.keys().collect::<Vec<_>>(), [&OWN]);
        assert_eq!(live.unnamed, BTreeMap::from([(unnamed, 1)]));
        assert_eq!(live.answers.values().map(VecDeque::len).sum::<usize>(), 1);
        assert!(live.leaves_out(unnamed) && !live.leaves_out(OWN));
        let mut only = plan(Clock::Live, &[unnamed]);
        only.leave_out_unnamed();
        assert!(only.unnamed.is_empty() && only.epochs.contains_key(&unnamed));
        assert!(only.policy_of(unnamed).is_err());
    }

    #[test]
    fn a_remainder_names_no_controller_in_lockstep_or_where_a_status_names_another_one() {
        let unseen = VISITOR + EPOCH_SLOTS;
        assert!(!plan(Clock::Lockstep, &[]).leaves_out(unseen));
        let mut live = plan(Clock::Live, &[]);
        let counters = vec![("epoch".into(), unseen)];
        live.add_status(NodeStatus { scenario: "recorded".into(), counters, ..NodeStatus::default() }, "recorded");
        assert!(!live.leaves_out(unseen));
    }

    #[test]
    fn the_policies_of_an_epoch_are_those_of_its_statuses() {
        let mut live = plan(Clock::Live, &[]);
        for policy in ["greedy", "flat", "greedy"] {
            let counters = vec![("epoch".into(), OWN + EPOCH_SLOTS)];
            let status = NodeStatus { policy: policy.into(), counters, ..NodeStatus::default() };
            live.add_status(status, "recorded");
        }
        assert_eq!(live.policies_of(OWN + EPOCH_SLOTS), ["flat", "greedy"]);
        assert!(live.policies_of(OWN + 2 * EPOCH_SLOTS).is_empty());
    }

    #[test]
    fn reports_that_cannot_be_read_are_no_absent_reports() {
        let (room, mut unreadable) = (Room::new("a").unwrap(), Unreadable::default());
        assert!(no_report(&unreadable, false).to_string().contains("the recorder was not connected"));
        assert!(no_report(&unreadable, true).to_string().contains("the recording was cut"));
        for payload in [&[2, 1, 0][..], &[]] {
            assert!(unreadable.read(&room, &room.users(), payload).is_none());
        }
        let error = no_report(&unreadable, true).to_string();
        assert!(
            error.contains("messages that cannot be read: 2, the first one: payload of contract version 2"),
            "{error}"
        );
    }

    #[test]
    fn a_function_in_python_is_no_policy_that_a_flag_can_name() {
        let function = not_replayable(FUNCTION).to_string();
        assert!(function.starts_with("a function in Python decided (heliostat.run)"), "{function}");
        let unknown = not_replayable("own").to_string();
        assert!(unknown.starts_with("the recorded policy \"own\" is unknown"), "{unknown}");
    }
}
