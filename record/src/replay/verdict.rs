//! What a replay came to, and where two commands differ.

use std::fmt;
use std::path::PathBuf;

use heliostat_proto::MirrorCommand;
use serde::Serialize;

use super::plan::Clock;
use crate::account::Account;

/// What a replay came to.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// The recording.
    pub file: PathBuf,
    /// Name of the room.
    pub room: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The policies that decided, one an epoch.
    pub policies: Vec<String>,
    /// In which time the room ran.
    pub clock: Clock,
    /// Whether the recorder ended in good order.
    pub complete: bool,
    /// What is in the file, and what is missing.
    pub account: Account,
    /// Position reports.
    pub reports: u64,
    /// Position reports that no recorded command answers.
    pub unanswered: u64,
    /// Commands that were recorded and decided anew.
    pub compared: u64,
    /// Of those: not judged, since what the controller knew before is not in the recording.
    pub not_judged: u64,
    /// Of those judged: the same, bit for bit.
    pub same: u64,
    /// Of those judged: different.
    pub different: u64,
    /// Reports that were answered in the recording and are not now.
    pub held: u64,
    /// Recorded commands whose report is not in the recording.
    pub without_report: u64,
    /// Largest difference of an angle in rad, among those judged.
    pub largest_difference_rad: f64,
    /// The first difference.
    pub first_difference: Option<String>,
}

impl Verdict {
    /// Whether everything that could be judged came out as recorded, and there was something to judge.
    pub fn is_good(&self) -> bool {
        self.same > 0 && self.different == 0 && self.held == 0
    }
}

/// Where two commands differ. In live time the sequence is left out: it counts commands that the recording may not hold.
pub(crate) fn difference(ours: &MirrorCommand, theirs: &MirrorCommand, clock: Clock) -> Option<String> {
    let numbers = [
        ("epoch", ours.epoch, theirs.epoch),
        ("validity in ms", u64::from(ours.validity_ms), u64::from(theirs.validity_ms)),
        ("time in ns", ours.time_ns, theirs.time_ns),
        ("sequence", ours.sequence, theirs.sequence),
    ];
    let told = if clock == Clock::Lockstep { &numbers[..] } else { &numbers[..3] };
    if let Some((name, ours, theirs)) = told.iter().find(|(_, ours, theirs)| ours != theirs) {
        return Some(format!("{name}: recorded {theirs}, decided {ours}"));
    }
    for (axis, ours, theirs) in [("roll", &ours.roll, &theirs.roll), ("yaw", &ours.yaw, &theirs.yaw)] {
        if ours.len() != theirs.len() {
            return Some(format!("{axis}: recorded {} mirrors, decided {}", theirs.len(), ours.len()));
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
                "the recording was cut: it is whole up to here, and its recorder's account is missing"
            )?;
        }
        writeln!(formatter, "reports {}, of them without a recorded answer {}", self.reports, self.unanswered)?;
        writeln!(
            formatter,
            "commands compared {}: same {}, different {}, not judged {}; held where one was recorded {}",
            self.compared, self.same, self.different, self.not_judged, self.held
        )?;
        if self.without_report > 0 {
            writeln!(formatter, "recorded commands without their report: {}", self.without_report)?;
        }
        match &self.first_difference {
            Some(found) => {
                writeln!(formatter, "first difference: {found}")?;
                write!(formatter, "largest difference of an angle: {:e} rad", self.largest_difference_rad)
            }
            None if self.same > 0 => {
                write!(formatter, "every command that was judged came out bit for bit as recorded")
            }
            None => write!(formatter, "no command was judged"),
        }
    }
}
