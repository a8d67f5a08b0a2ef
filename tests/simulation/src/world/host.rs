//! A host: its clock, and its process while that runs.

use std::collections::VecDeque;

use crate::clock::{Clock, TrueNs};
use crate::hosts::Incoming;
use crate::hosts::array::ArrayNode;
use crate::hosts::attacker::Attacker;
use crate::hosts::calibration::Calibration;
use crate::hosts::controller::ControllerNode;
use crate::hosts::operator::Operator;
use crate::hosts::tracker::Tracker;
use crate::plan::Role;

/// A process of one of the roles.
pub(super) enum Process {
    Tracker(Box<Tracker>),
    Array(Box<ArrayNode>),
    Controller(Box<ControllerNode>),
    Operator(Box<Operator>),
    Attacker(Box<Attacker>),
    Calibration(Box<Calibration>),
}

/// A host with its clock; the process may be down.
pub(super) struct Host {
    pub role: Role,
    pub clock: Clock,
    pub process: Option<Process>,
    /// Counts the starts: a message to an earlier process is lost.
    pub generation: u64,
    pub source: u64,
    /// Faults in force that keep it down, or frozen.
    pub down: u32,
    pub frozen: u32,
    /// Until when a process that was asked to end goes on; its token has ended.
    pub ends_by: Option<TrueNs>,
    pub busy_until: TrueNs,
    /// What arrived while it was frozen or busy.
    pub waiting: VecDeque<Incoming>,
    pub wake_at: Option<TrueNs>,
    /// Durations of its decisions by the faults in force.
    pub slow_ms: Vec<u64>,
    /// The token of each host that it has seen.
    pub sees: Vec<Option<u64>>,
    /// Since when it does not reach each host.
    pub lost_since: Vec<Option<TrueNs>>,
}

impl Host {
    /// Whether its liveliness token is announced.
    pub fn has_token(&self) -> bool {
        self.ends_by.is_none()
            && match &self.process {
                Some(Process::Calibration(node)) => node.has_token(),
                process => process.is_some(),
            }
    }
}
