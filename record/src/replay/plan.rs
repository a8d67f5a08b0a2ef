//! What must be known of a recording before it can be replayed: who answered what, when, and by which policy.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use heliostat_decide::policy::PolicyKind;
use heliostat_proto::{MirrorCommand, Nanos, NodeKind, NodeStatus, Room};
use heliostat_scenario::Scenario;
use serde::Serialize;

use super::open;
use crate::account::Account;
use crate::heard::Heard;

const NO_REPORT: &str =
    "it holds no position report: the recorder did not hear the room's process, or was cut before it wrote";

/// Reports whose time is further than this from their arrival are in simulated time.
const LIVE_CLOCK_NS: u64 = 3_600_000_000_000;

/// In which time a room ran.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// UTC.
    #[default]
    Live,
    /// Simulated time.
    Lockstep,
}

/// What comes before the first position report of a recording.
pub(crate) struct Beginning {
    /// The room's name.
    pub room: Room,
    /// In which time the room ran: the first report tells.
    pub clock: Clock,
    /// What the array had said that it can do.
    pub capabilities: Option<Vec<u8>>,
}

impl Beginning {
    /// Reads a recording up to its first position report.
    ///
    /// # Errors
    /// Where it cannot be read, or holds no such report.
    pub fn read(file: &Path) -> Result<Self> {
        let mut reading = open(file)?;
        let room = Room::new(&reading.header().room)?;
        let mut capabilities = None;
        while let Some(entry) = reading.entry()? {
            if entry.topic == room.capabilities() {
                capabilities = Some(entry.data);
            } else if entry.topic == room.users()
                && let Ok(Heard::Users(report)) = Heard::read(&entry.data)
            {
                return Ok(Self { clock: clock_of(report.stamp.time_ns, entry.arrived_ns), room, capabilities });
            }
        }
        bail!("{NO_REPORT}")
    }
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
    /// What the controllers said of themselves, by epoch.
    controllers: BTreeMap<u64, Told>,
    pub account: Account,
}

/// What a controller said of itself.
#[derive(Default)]
struct Told {
    policies: BTreeSet<String>,
    /// Decisions for which it had no time.
    late: u64,
}

impl Plan {
    /// Reads a recording from its beginning to its end.
    ///
    /// # Errors
    /// Where it cannot be read, or cannot be replayed whatever decides.
    pub fn read(file: &Path) -> Result<Self> {
        let mut reading = open(file)?;
        let header = reading.header().clone();
        let hash = Scenario::hash_of(&header.scenario);
        ensure!(
            hash == header.scenario_hash,
            "its scenario has the hash {hash}, and it says {}: it was changed after it was made",
            header.scenario_hash
        );
        let mut plan = Self {
            scenario: Scenario::from_recorded_toml(&header.scenario).context("its scenario")?,
            room: Room::new(&header.room)?,
            clock: Clock::Live,
            answers: HashMap::new(),
            epochs: BTreeMap::new(),
            controllers: BTreeMap::new(),
            account: Account::default(),
        };
        let mut clock = None;
        let mut last = None;
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
                Some(Heard::Command(command)) => last = Some(plan.expect(command, last.as_ref())),
                Some(Heard::Status(status)) if status.node == NodeKind::Controller => {
                    ensure!(
                        status.scenario.is_empty() || status.scenario == hash,
                        "its controller decided by the scenario {}, and it holds {hash}: the recorder was not given the room's --scenario, --set and --seed",
                        status.scenario
                    );
                    plan.learn(status);
                }
                _ => {}
            }
        }
        plan.clock = clock.with_context(|| NO_REPORT)?;
        ensure!(
            !plan.epochs.is_empty(),
            "it holds no command: nothing was decided in that room, or the recorder did not hear the controller"
        );
        Ok(plan)
    }

    /// Takes a command; `last` is the one before it.
    fn expect(&mut self, command: MirrorCommand, last: Option<&MirrorCommand>) -> MirrorCommand {
        self.epochs.entry(command.epoch).or_insert(command.sequence);
        let is_repeat = last
            .is_some_and(|last| (last.epoch, &last.roll, &last.yaw) == (command.epoch, &command.roll, &command.yaw));
        let answer = Answer { epoch: command.epoch, time_ns: command.time_ns, is_repeat };
        self.answers.entry(command.answers).or_default().push_back(answer);
        command
    }

    /// Takes what a controller says of itself.
    fn learn(&mut self, status: NodeStatus) {
        let counter =
            |name: &str| status.counters.iter().find(|(known, _)| known == name).map_or(0, |(_, count)| *count);
        let told = self.controllers.entry(counter("epoch")).or_default();
        told.late = told.late.max(counter("fallback:late"));
        told.policies.insert(status.policy);
    }

    /// Whether the controller of an epoch had no time for some of its decisions.
    pub fn was_late(&self, epoch: u64) -> bool {
        self.controllers.get(&epoch).is_some_and(|told| told.late > 0)
    }

    /// The policy that decided in an epoch.
    ///
    /// # Errors
    /// Where it is not known, not one, or not here.
    pub fn policy_of(&self, epoch: u64) -> Result<PolicyKind> {
        let Some(Told { policies, .. }) = self.controllers.get(&epoch) else {
            bail!("it does not say which policy decided in epoch {epoch}: name it with --policy");
        };
        ensure!(
            policies.len() == 1,
            "the policy was switched within epoch {epoch} ({}), and the recording does not say at which decision: replay a recording of one policy, or name one with --policy",
            policies.iter().cloned().collect::<Vec<_>>().join(", ")
        );
        let name = policies.first().map_or("", String::as_str);
        PolicyKind::from_str(name, false).map_err(|_| {
            anyhow!("policy \"{name}\" decided, which this program does not have: name another with --policy")
        })
    }
}

fn clock_of(report_ns: Nanos, arrived_ns: Nanos) -> Clock {
    if report_ns.abs_diff(arrived_ns) > LIVE_CLOCK_NS { Clock::Lockstep } else { Clock::Live }
}
