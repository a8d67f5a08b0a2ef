//! Verdicts on the statements of the paper.

use serde::{Deserialize, Serialize};

/// The verdict on a statement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Reproduced without calibration to it.
    Reproduced,
    /// Agrees, but a parameter was chosen or calibrated for this statement.
    ConsistentWith,
    /// Holds in part.
    InPart,
    /// Does not hold.
    NotReproduced,
}

impl Verdict {
    /// The verdict as text.
    pub fn words(self) -> &'static str {
        match self {
            Self::Reproduced => "reproduced",
            Self::ConsistentWith => "consistent with",
            Self::InPart => "reproduced in part",
            Self::NotReproduced => "not reproduced",
        }
    }
}

/// One statement of the paper and the findings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Claim {
    /// The figure to which it belongs.
    pub figure: String,
    /// The statement.
    pub statement: String,
    /// The paper's value.
    pub paper: String,
    /// The findings for each room.
    pub findings: Vec<Finding>,
}

/// The finding for one room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The room.
    pub room: String,
    /// The value here with its 95 % interval.
    pub ours: String,
    /// The verdict.
    pub verdict: Verdict,
    /// The reason.
    pub why: String,
    /// The calibrated parameters.
    pub calibrated: String,
}
