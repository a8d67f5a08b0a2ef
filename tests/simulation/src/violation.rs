//! The invariants, and a violation of one.

use std::fmt;

use crate::clock::{MS, TrueNs};

/// What holds after each event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Invariant {
    /// An array that latched a stop does not move until a valid re-arm, over restarts too.
    StoppedArray,
    /// No operator is told "stopped" before every device has stopped.
    ToldStopped,
    /// One controller for each epoch, epochs never fall, sequences rise by one.
    Numbering,
    /// Payloads decode; angles are finite, in range and within the slew limit; queues are bounded.
    Payload,
    /// No expired command is followed, and a silent array holds and parks in time.
    Validity,
    /// Each position report gives a command or a counted reason.
    Answer,
    /// Arrays that are not stopped follow again within 5 s after the last fault. A stop is confirmed.
    Recovery,
    /// Beside a standby of rank 1, the end of the leader alone leaves a gap of at most two report intervals. A
    /// leader that hangs or reaches no array is shown by telemetry: one interval and two messages more.
    Gap,
    /// A calibration that leads alone is not disturbed: the array follows no other sender, and the lead returns.
    Guest,
    /// The inputs of a controller give the same outputs again, bit for bit.
    Replay,
}

/// An invariant that does not hold.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Which.
    pub invariant: Invariant,
    /// True time in ns since the start of the run.
    pub at_ns: TrueNs,
    /// What was found, and what was expected.
    pub text: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?} at {:.3} ms: {}", self.invariant, self.at_ns as f64 / MS as f64, self.text)
    }
}
