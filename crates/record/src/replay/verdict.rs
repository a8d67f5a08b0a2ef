//! The result of a replay, and the difference of two commands.

use std::fmt;
use std::path::PathBuf;

use heliostat_proto::MirrorCommand;
use serde::Serialize;

use super::plan::Clock;
use crate::account::Account;

/// The result of a replay.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// The recording.
    pub file: PathBuf,
    /// Name of the room.
    pub room: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The policies, one for each epoch.
    pub policies: Vec<String>,
    /// The clock of the room.
    pub clock: Clock,
    /// Whether the recorder closed the file.
    pub complete: bool,
    /// Counts of the messages in the file, and of missing ones.
    pub account: Account,
    /// Position reports.
    pub reports: u64,
    /// Position reports without a recorded command.
    pub unanswered: u64,
    /// Commands that were recorded and decided again.
    pub compared: u64,
    /// Commands among them that do not count, since earlier inputs are not in the recording.
    pub not_counted: u64,
    /// Decisions at the start of an epoch that do not count, the most of all epochs.
    pub settle: u64,
    /// Commands that count and are equal bit for bit.
    pub same: u64,
    /// Commands that count and differ.
    pub different: u64,
    /// Reports that have a command in the recording and none in the replay.
    pub held: u64,
    /// Recorded commands that were not decided again: the recording lacks their report, or another
    /// controller's answer to it was replayed.
    pub without_report: u64,
    /// Largest difference of an angle in rad, among the commands that count.
    pub largest_difference_rad: f64,
    /// The first difference.
    pub first_difference: Option<String>,
    /// Why a recorded state of a controller was not restored.
    pub unrestored: Option<String>,
    /// The controllers whose commands were not decided again.
    pub left_out: Vec<LeftOut>,
}

/// A controller that used another scenario than the recording holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Its source id.
    pub controller: String,
    /// The hash of its scenario.
    pub scenario: String,
    /// Its decisions in the recording.
    pub commands: u64,
}

impl Verdict {
    /// Whether no command counts, and no report lacks one.
    pub fn is_empty(&self) -> bool {
        self.same == 0 && self.different == 0 && self.held == 0
    }

    /// Whether at least one command counts, and all that count are equal.
    pub fn is_good(&self) -> bool {
        self.same > 0 && self.different == 0 && self.held == 0
    }
}

/// The first difference of two commands. In live operation epoch and sequence are ignored: the tenure is
/// not part of a controller's recorded state.
pub(crate) fn difference(ours: &MirrorCommand, theirs: &MirrorCommand, clock: Clock) -> Option<String> {
    let numbers = [
        ("epoch", ours.epoch, theirs.epoch),
        ("validity in ms", u64::from(ours.validity_ms), u64::from(theirs.validity_ms)),
        ("time in ns", ours.time_ns, theirs.time_ns),
        ("sequence", ours.sequence, theirs.sequence),
    ];
    let compared = if clock == Clock::Lockstep { &numbers[..] } else { &numbers[1..3] };
    if let Some((name, ours, theirs)) = compared.iter().find(|(_, ours, theirs)| ours != theirs) {
        return Some(format!("{name}: recorded {theirs}, decided {ours}"));
    }
    for (axis, ours, theirs) in [("roll", &ours.roll, &theirs.roll), ("yaw", &ours.yaw, &theirs.yaw)] {
        if ours.len() != theirs.len() {
            return Some(format!(
                "{axis} of another number of mirrors: recorded {}, decided {}",
                theirs.len(),
                ours.len()
            ));
        }
        let differs = |(_, (ours, theirs)): &(usize, (&f32, &f32))| ours.to_bits() != theirs.to_bits();
        if let Some((mirror, (ours, theirs))) = ours.iter().zip(theirs).enumerate().find(differs) {
            return Some(format!("{axis} of mirror {mirror}: recorded {theirs} rad, decided {ours} rad"));
        }
    }
    None
}

impl fmt::Display for Verdict {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clock = match self.clock {
            Clock::Live => "live",
            Clock::Lockstep => "lockstep",
        };
        writeln!(
            formatter,
            "room {}, scenario {}, {clock}, policy {}",
            self.room,
            self.scenario,
            self.policies.join(", ")
        )?;
        writeln!(formatter, "{}", self.account)?;
        if !self.complete {
            writeln!(
                formatter,
                "the recording was cut: it is complete up to here, and the recorder's counts are missing"
            )?;
        }
        writeln!(formatter, "reports {}, without a recorded command {}", self.reports, self.unanswered)?;
        writeln!(
            formatter,
            "commands compared {}: equal {}, different {}, not counted {}; recorded and missing in the replay {}",
            self.compared, self.same, self.different, self.not_counted, self.held
        )?;
        if self.without_report > 0 {
            writeln!(
                formatter,
                "recorded commands not decided again: {}; the recording lacks their report, or another controller answered it first",
                self.without_report
            )?;
        }
        if let Some(problem) = &self.unrestored {
            writeln!(formatter, "a recorded state of the controller was not restored: {problem}")?;
        }
        for LeftOut { controller, scenario, commands } in &self.left_out {
            writeln!(
                formatter,
                "left out: {commands} commands of controller {controller}, which used another scenario: {scenario}"
            )?;
        }
        match &self.first_difference {
            Some(found) => {
                writeln!(formatter, "first difference: {found}")?;
                write!(formatter, "largest difference of an angle: {:e} rad", self.largest_difference_rad)
            }
            None if self.same > 0 => {
                write!(formatter, "every command that counts equals the recorded one bit for bit")
            }
            None => write!(formatter, "no command counts"),
        }
    }
}
