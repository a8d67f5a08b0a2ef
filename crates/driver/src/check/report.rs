//! The findings of the conformance check.

use std::fmt;

use heliostat_service::counted::counted;
use serde::Serialize;

/// What an operator has to know of an array that was stopped before the check.
pub(super) const STOPPED_AGAIN: &str = "the array is stopped again, as before the check: heliostat rearm releases it";

/// What an operator has to know of an array that does not stop again.
pub(super) const NOT_STOPPED_AGAIN: &str = "the array was stopped before the check, and does not report the stop at its \
     end: expected the state stopped; end the driver before a controller starts";

/// The result for one rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The driver keeps it.
    Kept,
    /// The driver breaks it.
    Broken,
    /// It could not be judged.
    NotJudged,
}

/// One rule and its result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Short name, the same in every version.
    pub rule: &'static str,
    /// The requirement of the contract.
    pub requirement: &'static str,
    /// Kept, broken, or not judged.
    pub verdict: Verdict,
    /// The observation, or why the rule could not be judged.
    pub evidence: String,
}

/// The findings for one driver.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The room.
    pub room: String,
    /// Hardware, as announced.
    pub hardware: String,
    /// Driver, as announced.
    pub driver: String,
    /// Mirrors, as announced.
    pub mirrors: usize,
    /// Why the device or the driver failed during the check, and what to do; rules that it prevents are
    /// not judged.
    pub problem: Option<String>,
    /// Whether an array that was stopped before the check reports the stop at its end; `None` for any other array.
    pub is_stopped: Option<bool>,
    /// Every rule, in the order of the check.
    pub findings: Vec<Finding>,
}

impl Report {
    /// The rules that are broken.
    pub fn broken(&self) -> impl Iterator<Item = &Finding> {
        self.of(Verdict::Broken)
    }

    /// Why the check fails; `None` where it finds nothing wrong.
    pub fn failure(&self) -> Option<String> {
        if let Some(problem) = &self.problem {
            return Some(format!("room \"{}\": {problem}", self.room));
        }
        let broken = self.broken().count();
        if broken > 0 {
            let rules = counted(broken, "rule");
            return Some(format!("the driver of room \"{}\" breaks {rules} of the contract", self.room));
        }
        (self.is_stopped == Some(false)).then(|| NOT_STOPPED_AGAIN.to_owned())
    }

    /// The line of verdicts: the names of the rules that are broken, and of those that could not be judged.
    pub fn conclusion(&self) -> String {
        let named = |verdict, words: &str| {
            let rules: Vec<&str> = self.of(verdict).map(|finding| finding.rule).collect();
            (!rules.is_empty()).then(|| format!("{} {words}: {}", rules.len(), rules.join(", ")))
        };
        let broken = named(Verdict::Broken, "broken");
        let by_hand = format!("{} to try by hand: {}", BY_HAND.len(), BY_HAND.map(|(rule, ..)| rule).join(", "));
        match (broken, named(Verdict::NotJudged, "not judged")) {
            (None, None) => format!("every judged rule is kept; {by_hand}"),
            (None, Some(not_judged)) => format!("every rule that could be judged is kept; {not_judged}; {by_hand}"),
            (Some(broken), not_judged) => {
                [Some(broken), not_judged].into_iter().flatten().collect::<Vec<_>>().join("; ")
            }
        }
    }

    fn of(&self, verdict: Verdict) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(move |finding| finding.verdict == verdict)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "room {}: {}, driver {}, {}",
            self.room,
            self.hardware,
            self.driver,
            counted(self.mirrors, "mirror")
        )?;
        if let Some(problem) = &self.problem {
            writeln!(f, "{problem}")?;
        }
        for Finding { rule, requirement, verdict, evidence } in &self.findings {
            let word = match verdict {
                Verdict::Kept => "kept",
                Verdict::Broken => "BROKEN",
                Verdict::NotJudged => "-",
            };
            write_rule(f, word, (*rule, *requirement, evidence.as_str()))?;
        }
        for rule in BY_HAND {
            write_rule(f, "by hand", rule)?;
        }
        writeln!(f, "{}", self.conclusion())?;
        match self.is_stopped {
            None => Ok(()),
            Some(true) => writeln!(f, "{STOPPED_AGAIN}"),
            Some(false) => writeln!(f, "{NOT_STOPPED_AGAIN}"),
        }
    }
}

/// Writes the two lines of a rule: name and requirement, then what was observed or how to try it.
fn write_rule(f: &mut fmt::Formatter<'_>, word: &str, (rule, requirement, below): (&str, &str, &str)) -> fmt::Result {
    writeln!(f, "{word:<7} {rule:<18} {requirement}")?;
    writeln!(f, "{:27}{below}", "")
}

/// Rules that need a restart of the driver or a second one, and how an engineer tries them.
const BY_HAND: [(&str, &str, &str); 2] = [
    (
        "restart",
        "a stop is in force after the next start of the driver",
        "stop the array, end the driver and start it: heliostat status names the stop",
    ),
    (
        "one-driver",
        "a driver that finds another one of its array ends, and names it",
        "start the driver a second time, with the same room and array",
    ),
];

/// How a driver failed during the check, with the rule at which this was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    /// It has left the room.
    Ended(&'static str),
    /// It is in the room and sends no telemetry.
    Silent(&'static str),
}

impl Failure {
    /// Why a rule is not judged.
    pub(super) fn obstacle(self) -> &'static str {
        match self {
            Self::Ended(_) => "the driver had ended",
            Self::Silent(_) => "the driver sends no telemetry",
        }
    }
}

/// Why the check failed, by the failure of the driver, and what it reported about a device that did not answer.
pub(super) fn describe_failure(failure: Option<Failure>, device: Option<&str>) -> Option<String> {
    match (failure, device) {
        (None, None) => None,
        (None, Some(device)) => {
            Some(format!("the device did not answer during the check: {device}; repair it, then check again"))
        }
        (Some(Failure::Silent(rule)), device) => {
            let reported = device.map(|device| format!(" ({device})")).unwrap_or_default();
            Some(format!(
                "since the rule {rule} the driver is in the room and sends no telemetry{reported}: a call of its device \
                 may not return, or the driver breaks the rule telemetry; end the driver, repair this, then check again"
            ))
        }
        (Some(Failure::Ended(rule)), None) => {
            Some(format!("the driver ended during the check, at the rule {rule}: its output names the reason"))
        }
        (Some(Failure::Ended(rule)), Some(device)) => Some(format!(
            "the driver ended during the check, at the rule {rule}, after its device did not answer: {device}"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_at_which_the_driver_ended_is_named() {
        for device in [None, Some("turn raised")] {
            let problem = describe_failure(Some(Failure::Ended("undecodable")), device).expect("a problem");
            assert!(problem.starts_with("the driver ended during the check, at the rule undecodable"), "{problem}");
        }
        assert_eq!(describe_failure(None, None), None);
    }

    #[test]
    fn the_problem_precedes_the_rules_that_it_prevents() {
        let finding = |rule, verdict| Finding { rule, requirement: "", verdict, evidence: String::new() };
        let report = Report {
            room: "lab".into(),
            hardware: "mirrors".into(),
            driver: "test".into(),
            mirrors: 2,
            problem: Some("the device did not answer during the check: turn raised".into()),
            is_stopped: None,
            findings: vec![finding("follow", Verdict::NotJudged), finding("stop", Verdict::Kept)],
        };
        let text = report.to_string();
        for (rule, ..) in BY_HAND {
            assert!(text.contains(&format!("by hand {rule}")), "{text}");
        }
        let second = text.lines().nth(1);
        assert_eq!(second, report.problem.as_deref(), "{text}");
        assert!(!text.contains("BROKEN"), "{text}");
    }

    #[test]
    fn the_last_line_names_the_rules_that_are_broken_and_those_that_could_not_be_judged() {
        let finding =
            |(rule, verdict)| Finding { rule, requirement: "", verdict, evidence: "the driver had ended".into() };
        let report = |findings: &[(&'static str, Verdict)]| Report {
            room: "lab".into(),
            hardware: "mirrors".into(),
            driver: "test".into(),
            mirrors: 2,
            problem: None,
            is_stopped: None,
            findings: findings.iter().copied().map(finding).collect(),
        };
        let (kept, broken, not_judged) = (("park", Verdict::Kept), ("stop", Verdict::Broken), Verdict::NotJudged);
        for (findings, last) in [
            (&[kept][..], "every judged rule is kept; 2 to try by hand: restart, one-driver"),
            (
                &[("follow", not_judged), kept, ("expired", not_judged)],
                "every rule that could be judged is kept; 2 not judged: follow, expired; 2 to try by hand: restart, one-driver",
            ),
            (&[broken, ("follow", not_judged)], "1 broken: stop; 1 not judged: follow"),
            (&[broken, kept], "1 broken: stop"),
        ] {
            let text = report(findings).to_string();
            assert_eq!(text.lines().last(), Some(last), "{text}");
        }
        for (is_stopped, words) in
            [(true, "is stopped again, as before the check"), (false, "does not report the stop")]
        {
            let report = Report { is_stopped: Some(is_stopped), ..report(&[kept]) };
            assert_eq!(report.failure().is_none(), is_stopped, "an array that moves again is a failure");
            let text = report.to_string();
            assert!(text.lines().last().is_some_and(|last| last.contains(words)), "{text}");
        }
        let json = serde_json::to_value(report(&[("follow", not_judged)])).expect("texts and numbers");
        assert_eq!(json["findings"][0]["verdict"], "not-judged");
    }
}
