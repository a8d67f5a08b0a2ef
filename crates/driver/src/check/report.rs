//! The findings of the conformance check.

use std::fmt;

use heliostat_service::counted::counted;
use serde::Serialize;

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
    /// Every rule, in the order of the check.
    pub findings: Vec<Finding>,
    /// Why the device did not answer during the check; rules can be broken for this reason alone.
    pub device_problem: Option<String>,
}

impl Report {
    /// The rules that are broken.
    pub fn broken(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|finding| finding.verdict == Verdict::Broken)
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
        for Finding { rule, requirement, verdict, evidence } in &self.findings {
            let word = match verdict {
                Verdict::Kept => "kept",
                Verdict::Broken => "BROKEN",
                Verdict::NotJudged => "-",
            };
            writeln!(f, "{word:<7} {rule:<18} {requirement}")?;
            writeln!(f, "{:27}{evidence}", "")?;
        }
        if let Some(problem) = &self.device_problem {
            writeln!(f, "the device did not answer during the check: {problem}; repair it, then check again")?;
        }
        let broken: Vec<&str> = self.broken().map(|finding| finding.rule).collect();
        match broken.len() {
            0 => writeln!(f, "every rule that could be judged is kept"),
            count => writeln!(f, "{count} broken: {}", broken.join(", ")),
        }
    }
}
