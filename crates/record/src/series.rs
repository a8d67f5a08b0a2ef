//! Time series for Foxglove's plots, as JSON with a schema.
//!
//! | topic | one message for each | content |
//! | --- | --- | --- |
//! | `/rates` | truth of a simulated room | sum rates, rate and minimum rate of each user |
//! | `/answers` | answered report | time from the arrival of the report to that of the command, both at the recorder; negative if the command arrived first |
//! | `/status/NODE` | status | times by quantile, counts, gauges |

use std::collections::BTreeMap;

use heliostat_proto::{Nanos, NodeStatus, RoomTruth};
use serde::Serialize;
use serde_json::{Value, json};

use crate::file::Topic;
use crate::received::Received;

/// Most ticks of which only the report or only the command has arrived; older ones are discarded.
const WAITING_MAX: usize = 1024;

/// Derives time series from the messages of a room.
#[derive(Debug)]
pub struct Series {
    schemas: Schemas,
    /// Arrival of the report of a tick or of its command, whichever was first.
    first: BTreeMap<u64, Nanos>,
}

#[derive(Debug)]
struct Schemas {
    rates: Vec<u8>,
    answers: Vec<u8>,
    status: Vec<u8>,
}

impl Default for Series {
    fn default() -> Self {
        Self { schemas: Schemas::new(), first: BTreeMap::new() }
    }
}

impl Series {
    /// Applies a message, and passes topic and derived message to `put` if there is one.
    ///
    /// # Errors
    /// The error of `put`.
    pub fn update<E>(
        &mut self,
        received: &Received,
        arrived_ns: Nanos,
        put: impl FnOnce(&Topic<'_>, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        match received {
            Received::Truth(truth) => {
                put(&topic("/rates", "heliostat.Rates", &self.schemas.rates), &bytes(&rates(truth)))
            }
            Received::Status(status) => {
                let name = format!("/status/{}", status.node);
                put(&topic(&name, "heliostat.Status", &self.schemas.status), &bytes(&status_of(status)))
            }
            Received::Users(report) => match self.pair(report.tick, arrived_ns) {
                Some(apart_us) => self.answer(report.tick, -apart_us, put),
                None => Ok(()),
            },
            Received::Command(command) if command.answers > 0 => match self.pair(command.answers, arrived_ns) {
                Some(apart_us) => self.answer(command.answers, apart_us, put),
                None => Ok(()),
            },
            _ => Ok(()),
        }
    }

    /// The time in us since the other message of a tick arrived; `None` if it has not arrived yet.
    fn pair(&mut self, tick: u64, arrived_ns: Nanos) -> Option<f64> {
        let Some(first_ns) = self.first.remove(&tick) else {
            self.first.insert(tick, arrived_ns);
            if self.first.len() > WAITING_MAX {
                self.first.pop_first();
            }
            return None;
        };
        Some(arrived_ns.saturating_sub(first_ns) as f64 * 1e-3)
    }

    fn answer<E>(
        &self,
        tick: u64,
        answer_us: f64,
        put: impl FnOnce(&Topic<'_>, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let message = json!({ "tick": tick, "answer_us": answer_us });
        put(&topic("/answers", "heliostat.Answer", &self.schemas.answers), &bytes(&message))
    }
}

fn topic<'a>(name: &'a str, schema: &'a str, schema_data: &'a [u8]) -> Topic<'a> {
    Topic { name, encoding: "json", schema, schema_encoding: "jsonschema", schema_data }
}

fn bytes(message: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(message).expect("numbers and text serialise to JSON")
}

fn rates(truth: &RoomTruth) -> Value {
    let users = truth.users.iter().map(|user| {
        json!({
            "user": user.user,
            "rate_mbps": user.rate_bps * 1e-6,
            "min_rate_mbps": user.min_rate_bps * 1e-6,
            "sinr": user.sinr,
            "los_blocked": user.los_blocked,
        })
    });
    let met = truth.users.iter().filter(|user| user.rate_bps >= user.min_rate_bps).count();
    json!({
        "tick": truth.tick,
        "policy_mbps": truth.sum_rate_bps.policy * 1e-6,
        "no_irs_mbps": truth.sum_rate_bps.no_irs * 1e-6,
        "flat_mbps": truth.sum_rate_bps.flat * 1e-6,
        "oracle_mbps": truth.sum_rate_bps.oracle * 1e-6,
        "min_rates_met": met,
        "users_blocked": truth.users.iter().filter(|user| user.los_blocked).count(),
        "users": users.collect::<Vec<_>>(),
    })
}

fn status_of(status: &NodeStatus) -> Value {
    let timings = status.timings.iter().map(|(name, times)| {
        json!({
            "name": name, "count": times.count,
            "p50_us": times.p50, "p90_us": times.p90, "p99_us": times.p99, "p999_us": times.p999, "max_us": times.max,
        })
    });
    let counters = status.counters.iter().map(|(name, value)| json!({ "name": name, "value": value }));
    let gauges = status.gauges.iter().map(|(name, value)| json!({ "name": name, "value": value }));
    json!({
        "state": status.state,
        "policy": status.policy,
        "last_problem": status.last_problem,
        "timings": timings.collect::<Vec<_>>(),
        "counters": counters.collect::<Vec<_>>(),
        "gauges": gauges.collect::<Vec<_>>(),
    })
}

impl Schemas {
    fn new() -> Self {
        let numbers = |names: &[&str]| fields(names, "number");
        let mut user = numbers(&["user", "rate_mbps", "min_rate_mbps", "sinr"]);
        user.extend(fields(&["los_blocked"], "boolean"));
        let mut rates = numbers(&[
            "tick",
            "policy_mbps",
            "no_irs_mbps",
            "flat_mbps",
            "oracle_mbps",
            "min_rates_met",
            "users_blocked",
        ]);
        rates.insert("users".into(), list(user));
        let named = |numbers: serde_json::Map<String, Value>| {
            let mut entry = fields(&["name"], "string");
            entry.extend(numbers);
            list(entry)
        };
        let mut status = fields(&["state", "policy", "last_problem"], "string");
        status.insert("timings".into(), named(numbers(&["count", "p50_us", "p90_us", "p99_us", "p999_us", "max_us"])));
        status.insert("counters".into(), named(numbers(&["value"])));
        status.insert("gauges".into(), named(numbers(&["value"])));
        Self { rates: schema(rates), answers: schema(numbers(&["tick", "answer_us"])), status: schema(status) }
    }
}

fn fields(names: &[&str], kind: &str) -> serde_json::Map<String, Value> {
    names.iter().map(|name| ((*name).to_owned(), json!({ "type": kind }))).collect()
}

fn list(entry: serde_json::Map<String, Value>) -> Value {
    json!({ "type": "array", "items": { "type": "object", "properties": entry } })
}

fn schema(fields: serde_json::Map<String, Value>) -> Vec<u8> {
    bytes(&json!({ "type": "object", "properties": fields }))
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{MirrorCommand, UserReport};

    use super::*;

    #[test]
    fn a_tick_is_timed_whether_report_or_command_arrives_first() {
        let report = |tick| Received::Users(UserReport { tick, ..UserReport::default() });
        let command = |answers| Received::Command(MirrorCommand { answers, ..MirrorCommand::default() });
        let mut series = Series::default();
        let mut messages = Vec::new();
        // The second tick's command arrives first; the third has none, and a command without a tick
        // answers no report.
        let inputs = [report(1), command(1), command(2), report(2), report(3), command(0), command(0)];
        for (index, received) in inputs.iter().enumerate() {
            let put = |_: &Topic<'_>, message: &[u8]| {
                messages.push(serde_json::from_slice::<Value>(message).expect("JSON"));
                Ok::<(), ()>(())
            };
            series.update(received, 1000 * index as Nanos, put).expect("it is taken");
        }
        assert_eq!(messages, [json!({ "tick": 1, "answer_us": 1.0 }), json!({ "tick": 2, "answer_us": -1.0 })]);
    }
}
