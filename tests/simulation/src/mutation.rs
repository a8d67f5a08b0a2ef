//! Deliberate bugs: each has to be found by an invariant.
//!
//! They are in the hosts of the simulation and in the wrappers around production types, never in
//! production code.

use crate::violation::Invariant;

macro_rules! mutations {
    ($($(#[$meta:meta])* $name:ident: $($invariant:ident)|+,)*) => {
        /// A deliberate bug.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Mutation {
            $($(#[$meta])* $name,)*
        }

        impl Mutation {
            /// All deliberate bugs.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The invariants that can find it.
            pub fn found_by(self) -> &'static [Invariant] {
                match self {
                    $(Self::$name => &[$(Invariant::$invariant,)+],)*
                }
            }
        }
    };
}

mutations! {
    /// The array forgets its stops when it restarts.
    StopForgottenAtRestart: StoppedArray,
    /// The array leaves its record as it is where a stop cannot be written.
    StaleRecordAfterFullDisk: StoppedArray,
    /// The device gets a command that arrives after a stop.
    SetAfterStop: StoppedArray,
    /// The device does not get the stop.
    DeviceNotStopped: StoppedArray,
    /// A re-arm releases a stop that it does not name.
    OtherStopReleased: StoppedArray,
    /// The operator is told "stopped" at the first report of a stop.
    ToldAtFirstReport: ToldStopped,
    /// The operator is told "stopped" although the device has not stopped.
    ToldWithoutDevice: ToldStopped,
    /// No process repeats a stop to an array that has not reported it.
    StopNotRepeated: Recovery,
    /// A controller skips a sequence number.
    SequenceSkipped: Numbering,
    /// Two controllers choose the same epoch.
    SameEpoch: Numbering,
    /// A standby takes over with an epoch below the one that the array follows.
    LowerEpochAtTakeover: Numbering | Gap,
    /// The array follows commands with a sequence below the last one.
    OldSequenceFollowed: Numbering,
    /// The array executes a command that arrives twice twice.
    DuplicateExecuted: Numbering,
    /// The array follows commands of a lower epoch.
    LowerEpochFollowed: Numbering,
    /// A controller sends an angle that is not a number.
    NotANumber: Payload,
    /// A controller sends an angle outside the range.
    OutOfRange: Payload,
    /// A controller moves the mirrors faster than the slew limit.
    SlewExceeded: Payload,
    /// The array follows commands after their validity.
    ExpiredFollowed: Validity,
    /// An array without commands does not park.
    NotParked: Validity,
    /// A position report that is too old is answered.
    StaleAnswered: Answer,
    /// A position report is dropped without a count.
    ReportNotCounted: Answer,
    /// A standby never takes over.
    NoTakeover: Gap | Recovery,
    /// A controller that was superseded never leads again.
    NeverResumes: Recovery | Gap,
    /// The array accepts no command after a release.
    ReleasedArrayStuck: Recovery,
    /// A calibration answers no position report.
    GuestSilent: Guest,
    /// A calibration goes on after its end.
    LeadKept: Guest,
    /// The replay lacks an input of the controller.
    InputNotRecorded: Replay,
    /// The state of a controller is that before its last input.
    StateOutdated: Replay,
}
