//! The last events of a run, in words; nothing is formatted where nobody reads it.

use std::collections::VecDeque;

use heliostat_proto::{
    EmergencyStop, MirrorCommand, MirrorTelemetry, Rearm, SafetyReport, StopRepetition, StopReport, UserReport, decode,
};

use crate::clock::{MS, TrueNs};
use crate::hosts::Incoming;
use crate::plan::Role;
use crate::topic::Topic;

/// Events that are kept.
const KEPT: usize = 120;

/// The log of a run.
pub(crate) struct Trace {
    lines: Option<VecDeque<String>>,
}

impl Trace {
    pub fn new(is_on: bool) -> Self {
        Self { lines: is_on.then(VecDeque::new) }
    }

    pub fn note(&mut self, now: TrueNs, line: impl FnOnce() -> String) {
        let Some(lines) = &mut self.lines else { return };
        lines.push_back(format!("{:>10.3} ms  {}", now as f64 / MS as f64, line()));
        if lines.len() > KEPT {
            lines.pop_front();
        }
    }

    /// A host handles a message.
    pub fn incoming(&mut self, now: TrueNs, (to, from): (Role, Option<Role>), incoming: &Incoming) {
        self.note(now, || match incoming {
            Incoming::Presence { node, source, is_alive } => {
                format!("{to:?}: {node} {source:x} {}", if *is_alive { "is alive" } else { "has left" })
            }
            Incoming::Payload { topic, payload, .. } => {
                let from = from.map(|role| format!("{role:?}")).unwrap_or_default();
                format!("{from} -> {to:?}: {}", describe(*topic, payload))
            }
        });
    }

    pub fn lines(self) -> Vec<String> {
        self.lines.map(Vec::from).unwrap_or_default()
    }
}

fn describe(topic: Topic, payload: &[u8]) -> String {
    described(topic, payload).unwrap_or_else(|| format!("{topic:?}, {} bytes", payload.len()))
}

/// The numbers of a message by which it is judged.
fn described(topic: Topic, payload: &[u8]) -> Option<String> {
    let names = |report: &StopReport| report.stops.iter().map(|stop| stop.name().to_string()).collect::<Vec<_>>();
    Some(match topic {
        Topic::Users => {
            let report: UserReport = decode(payload).ok()?;
            format!("users, tick {}, {} users", report.tick, report.users.len())
        }
        Topic::Command(array) => {
            let MirrorCommand { epoch, sequence, answers, .. } = decode(payload).ok()?;
            format!("command to array {array}, epoch {epoch}, sequence {sequence}, answers {answers}")
        }
        Topic::Telemetry(_) => {
            let MirrorTelemetry { state, epoch, applied_sequence, counters, .. } = decode(payload).ok()?;
            format!(
                "telemetry, {state:?}, epoch {epoch}, sequence {applied_sequence}, accepted {}, refused {}",
                counters.accepted,
                counters.refused()
            )
        }
        Topic::Stops(_) => {
            let report: StopReport = decode(payload).ok()?;
            format!("stops {:?}, device stopped: {}", names(&report), report.device_stopped)
        }
        Topic::Safety(_) => {
            let report: SafetyReport = decode(payload).ok()?;
            format!("safety, stopped: {}, epoch {}", report.stopped, report.epoch)
        }
        Topic::Stop => {
            let order: EmergencyStop = decode(payload).ok()?;
            format!("{:?} {}", order.action, order.name())
        }
        Topic::Rearm => format!("re-arm of {}", decode::<Rearm>(payload).ok()?.name()),
        Topic::Repetition(_) => format!("repetition of {}", decode::<StopRepetition>(payload).ok()?.name()),
        _ => return None,
    })
}
