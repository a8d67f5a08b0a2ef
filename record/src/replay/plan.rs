//! What must be known of a recording before it can be replayed: who answered what, when, and by which policy.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use heliostat_controller::policy::PolicyKind;
use heliostat_proto::{MirrorCommand, Nanos, NodeKind, Room};
use heliostat_scenario::Scenario;
use serde::Serialize;

use super::open;
use crate::account::Account;
use crate::heard::Heard;

/// Reports whose time is further than this from their arrival are in simulated time.
const LIVE_CLOCK_NS: u64 = 3_600_000_000_000;

/// In which time a room ran.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// UTC.
    Live,
    /// Simulated time.
    Lockstep,
}

/// In which time the room of a recording ran: told by the first position report.
///
/// # Errors
/// Where it cannot be read or is none.
pub fn clock(file: &Path) -> Result<Clock> {
    let mut reading = open(file)?;
    while let Some(entry) = reading.entry()? {
        if let Ok(Heard::Users(report)) = Heard::read(&entry.data) {
            return Ok(clock_of(report.stamp.time_ns, entry.arrived_ns));
        }
    }
    Ok(Clock::Live)
}

/// A recorded command, but for its angles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub epoch: u64,
    pub time_ns: Nanos,
    /// It says what the command before it said: so a controller answers that has no time to decide.
    pub is_repeat: bool,
}

/// What must be known of a recording before it can be replayed.
pub(super) struct Plan {
    pub scenario: Scenario,
    pub room: Room,
    pub clock: Clock,
    /// By the tick that they answer, in the order of arrival.
    pub answers: HashMap<u64, VecDeque<Answer>>,
    /// Each epoch with the sequence of its first recorded command.
    pub epochs: BTreeMap<u64, u64>,
    /// The policies that the controller of an epoch named.
    policies: BTreeMap<u64, BTreeSet<String>>,
    pub account: Account,
}

impl Plan {
    pub fn read(file: &Path) -> Result<Self> {
        let mut reading = open(file)?;
        let header = reading.header();
        let mut plan = Self {
            scenario: Scenario::from_toml(&header.scenario).context("the recording's scenario cannot be used")?,
            room: Room::new(&header.room)?,
            clock: Clock::Live,
            answers: HashMap::new(),
            epochs: BTreeMap::new(),
            policies: BTreeMap::new(),
            account: Account::default(),
        };
        let mut clock = None;
        let mut last: Option<MirrorCommand> = None;
        while let Some(entry) = reading.entry()? {
            if !entry.topic.starts_with("heliostat/") {
                continue;
            }
            let heard = Heard::read(&entry.data).ok();
            plan.account.count(&entry.topic, entry.data.len(), heard.as_ref().map(Heard::origin));
            match heard {
                Some(Heard::Users(report)) => {
                    clock.get_or_insert_with(|| clock_of(report.stamp.time_ns, entry.arrived_ns));
                }
                Some(Heard::Command(command)) => {
                    plan.epochs.entry(command.epoch).or_insert(command.sequence);
                    let is_repeat = last.as_ref().is_some_and(|last| {
                        (last.epoch, &last.roll, &last.yaw) == (command.epoch, &command.roll, &command.yaw)
                    });
                    let answer = Answer { epoch: command.epoch, time_ns: command.time_ns, is_repeat };
                    plan.answers.entry(command.answers).or_default().push_back(answer);
                    last = Some(command);
                }
                Some(Heard::Status(status)) if status.node == NodeKind::Controller => {
                    let epoch = status.counters.iter().find(|(name, _)| name == "epoch").map_or(0, |(_, epoch)| *epoch);
                    plan.policies.entry(epoch).or_default().insert(status.policy);
                }
                _ => {}
            }
        }
        plan.clock = clock.unwrap_or(Clock::Live);
        Ok(plan)
    }

    pub fn policy_of(&self, epoch: u64) -> Result<PolicyKind> {
        let Some(names) = self.policies.get(&epoch) else {
            bail!("the recording does not say which policy decided in epoch {epoch}: name it with --policy");
        };
        ensure!(
            names.len() == 1,
            "the policy was switched within epoch {epoch} ({}): what it decided cannot be replayed from outside; choose a recording of one policy, or name one with --policy",
            names.iter().cloned().collect::<Vec<_>>().join(", ")
        );
        let name = names.first().map_or("", String::as_str);
        PolicyKind::from_str(name, false).map_err(|_| {
            anyhow::anyhow!("the recording was decided by policy \"{name}\", which this program does not have: name another with --policy")
        })
    }
}

fn clock_of(report_ns: Nanos, arrived_ns: Nanos) -> Clock {
    if report_ns.abs_diff(arrived_ns) > LIVE_CLOCK_NS { Clock::Lockstep } else { Clock::Live }
}
