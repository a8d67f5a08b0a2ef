//! The result of a replay, and the difference of two commands.

use std::fmt;
use std::path::PathBuf;

use heliostat_proto::MirrorCommand;
use serde::Serialize;

use super::plan::Clock;
use crate::account::Account;

/// The result of a replay.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verdict {
    /// The recording.
    pub file: PathBuf,
    /// Name of the room.
    pub room: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The policies, one for each epoch.
    pub policies: Vec<String>,
    /// What decided in place of the recorded policies, where the caller chose another policy or actor file.
    pub replaced: Vec<String>,
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
    /// Commands that were not decided again, since no status in the recording names their policy.
    pub without_policy: u64,
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

    /// What may explain the differences that were found: another policy than the recorded one, or else messages
    /// that the recording lacks.
    pub fn cause(&self) -> Option<String> {
        if self.different == 0 && self.held == 0 {
            return None;
        }
        if !self.replaced.is_empty() {
            return Some(format!("decided by {}: this is the cause", self.replaced.join("; ")));
        }
        let missing = self.account.missing();
        (missing > 0).then(|| format!("the recording lacks {missing} messages, see the table: this may be the cause"))
    }

    /// The policies, each once, in the order of the epochs.
    fn distinct_policies(&self) -> Vec<&str> {
        let mut distinct = Vec::new();
        for policy in self.policies.iter().map(String::as_str) {
            if !distinct.contains(&policy) {
                distinct.push(policy);
            }
        }
        distinct
    }

    /// Whether the commands that count are equal, how many differ, and why.
    fn write_result(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (same, different) = (self.same, self.different);
        match (self.is_empty(), self.is_good()) {
            (true, _) => write!(formatter, "no command counts")?,
            (false, true) => {
                write!(formatter, "equal: every command that counts ({same}) equals the recorded one bit for bit")?;
            }
            (false, false) => write!(
                formatter,
                "different: {different} of {} commands that count; recorded and missing in the replay {}",
                same + different,
                self.held
            )?,
        }
        if let Some(cause) = self.cause() {
            write!(formatter, "\n{cause}")?;
        }
        if let Some(found) = &self.first_difference {
            write!(formatter, "\nfirst difference: {found}")?;
            write!(formatter, "\nlargest difference of an angle: {:e} rad", self.largest_difference_rad)?;
        }
        Ok(())
    }

    /// The reports, and why some have no command in the recording.
    fn write_reports(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "\nreports {}, without a recorded command {}", self.reports, self.unanswered)?;
        if self.unanswered > 0 {
            write!(
                formatter,
                "\n  possible causes: no controller led, as before a takeover; a stop; a newer report came first; the recording lacks the command, or it is left out"
            )?;
        }
        Ok(())
    }

    /// The compared commands, and why some do not count.
    fn write_commands(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "\ncommands compared {}, not counted {}", self.compared, self.not_counted)?;
        if self.not_counted > 0 {
            let first = match self.settle {
                0 => String::new(),
                settle => format!("the first {settle} decisions of a controller; "),
            };
            write!(
                formatter,
                "\n  not counted: {first}commands before the first recorded state of a controller, also at a takeover; after a stop, a standby or a missing message, those before the next state; with the belief filter, those after the last state"
            )?;
        }
        if self.without_report > 0 {
            write!(
                formatter,
                "\nrecorded commands not decided again: {}; the recording lacks their report, or another controller answered it first",
                self.without_report
            )?;
        }
        Ok(())
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
    /// The result and the counts of reports and commands, then the table of the recording's streams.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clock = match self.clock {
            Clock::Live => "live",
            Clock::Lockstep => "lockstep",
        };
        self.write_result(formatter)?;
        write!(
            formatter,
            "\nroom {}, scenario {}, {clock}, policy {}",
            self.room,
            self.scenario,
            self.distinct_policies().join(", ")
        )?;
        self.write_reports(formatter)?;
        self.write_commands(formatter)?;
        if let Some(problem) = &self.unrestored {
            write!(formatter, "\na recorded state of the controller was not restored: {problem}")?;
        }
        self.left_out.iter().try_for_each(|LeftOut { controller, scenario, commands }| {
            write!(
                formatter,
                "\nleft out: {commands} commands of controller {controller}, which used another scenario: {scenario}"
            )
        })?;
        if self.without_policy > 0 {
            write!(
                formatter,
                "\nnot counted: {} commands of a controller whose policy the recording does not name, as where it ends just after a takeover; --policy NAME compares them",
                self.without_policy
            )?;
        }
        write!(formatter, "\n{}", self.account)?;
        if !self.complete {
            write!(
                formatter,
                "\nthe recording was cut: it is complete up to here, and the recorder's counts are missing"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliostat_proto::Stamp;

    /// A verdict on a recording that lacks two messages.
    fn verdict() -> Verdict {
        let mut account = Account::default();
        for sequence in [1, 4] {
            account.count("users", 10, Some(Stamp { source: 1, sequence, time_ns: 0 }));
        }
        Verdict { account, same: 5, ..Verdict::default() }
    }

    #[test]
    fn the_result_comes_first_and_its_cause_and_first_difference_before_the_counts() {
        let first = |verdict: &Verdict| verdict.to_string().lines().next().unwrap_or_default().to_owned();
        assert_eq!(first(&Verdict::default()), "no command counts");
        assert_eq!(first(&verdict()), "equal: every command that counts (5) equals the recorded one bit for bit");
        let different = Verdict { different: 2, held: 1, first_difference: Some("tick 7".into()), ..verdict() };
        assert_eq!(first(&different), "different: 2 of 7 commands that count; recorded and missing in the replay 1");
        let text = different.to_string();
        let at = |part: &str| text.find(part).expect("a line of the result");
        assert!(at("lacks 2 messages") < at("first difference: tick 7") && at("tick 7") < at("room "), "{text}");
        assert!(at("reports ") < at("commands compared ") && at("commands compared ") < at("stream "), "{text}");
    }

    #[test]
    fn missing_messages_are_named_where_a_command_differs() {
        let cause = "lacks 2 messages";
        assert!(!verdict().to_string().contains(cause));
        for (different, held) in [(1, 0), (0, 1)] {
            let text = Verdict { different, held, ..verdict() }.to_string();
            assert!(text.contains(cause), "{text}");
        }
    }

    #[test]
    fn another_policy_than_the_recorded_one_is_the_cause_and_no_missing_message() {
        let replaced = vec!["greedy in place of fixed-point".to_owned()];
        let text = Verdict { different: 4, replaced: replaced.clone(), ..verdict() }.to_string();
        assert!(text.contains("decided by greedy in place of fixed-point: this is the cause\n"), "{text}");
        assert!(!text.contains("lacks 2 messages"), "{text}");
        assert_eq!(Verdict { replaced, ..verdict() }.cause(), None, "nothing differs");
    }

    #[test]
    fn a_policy_of_several_epochs_is_named_once() {
        let policies = ["greedy", "analytic", "greedy"].map(String::from).to_vec();
        let text = Verdict { policies, ..verdict() }.to_string();
        assert!(text.contains("policy greedy, analytic\n"), "{text}");
    }

    #[test]
    fn reports_without_a_command_and_uncounted_commands_have_their_causes() {
        let text = verdict().to_string();
        assert!(!text.contains("possible causes") && !text.contains("not counted:"), "{text}");
        let text = Verdict { unanswered: 3, not_counted: 2, ..verdict() }.to_string();
        assert!(text.contains("no controller led") && text.contains("not counted: commands before"), "{text}");
        let text = Verdict { not_counted: 2, settle: 200, ..verdict() }.to_string();
        assert!(text.contains("not counted: the first 200 decisions"), "{text}");
    }
}
