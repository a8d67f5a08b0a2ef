//! Whether a room is in use: the check begins beside no controller, and beside no other sender of commands.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use anyhow::{Result, bail};
use heliostat_bus::arriving::arriving;
use heliostat_bus::{Bus, BusError};
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{ArrayState, MirrorTelemetry, NodeKind, NodeStatus, STATUS_WITHIN};
use heliostat_service::counted::counted;
use heliostat_service::printable::printable;

use super::PRESENCE_LIMIT;

/// Refuses a room with a controller: the check would take its array, and the controller would interfere with the check.
///
/// # Errors
/// A controller in the room, or a transport that fails.
pub fn expect_no_controller(bus: &Bus) -> Result<()> {
    let room = bus.room();
    let tokens = bus.alive(&room.alive_of(NodeKind::Controller), PRESENCE_LIMIT)?;
    let sources: BTreeSet<u64> =
        tokens.iter().filter_map(|token| parse_alive(token)).map(|(_, source)| source).collect();
    if sources.is_empty() {
        return Ok(());
    }
    let hosts = hosts(bus, &sources)?;
    let name = |source: &u64| match hosts.get(source).filter(|host| !host.is_empty()) {
        Some(host) => format!("{source:016x} on {host}"),
        None => format!("{source:016x}"),
    };
    let names: Vec<String> = sources.iter().map(name).collect();
    bail!(
        "{} in room \"{room}\": end {} first, because the check takes the array, and a controller would interfere with \
         it. Nothing was sent",
        counted(sources.len(), "controller"),
        names.join(" and ")
    )
}

/// The hosts of these controllers, as far as their statuses name them.
fn hosts(bus: &Bus, sources: &BTreeSet<u64>) -> Result<BTreeMap<u64, String>, BusError> {
    let (statuses, _subscription) = arriving::<NodeStatus>(bus, &bus.room().status(NodeKind::Controller))?;
    let until = Instant::now() + STATUS_WITHIN;
    let mut hosts = BTreeMap::new();
    while !sources.iter().all(|source| hosts.contains_key(source)) {
        let left = until.saturating_duration_since(Instant::now());
        let Ok(status) = statuses.recv_timeout(left) else { break };
        hosts.insert(status.stamp.source, printable(status.host().unwrap_or_default()).into_owned());
    }
    Ok(hosts)
}

/// Whether another sender commands the array; `None` while its telemetry does not show it.
///
/// An array follows the last command of a process that has ended, too, until its validity is over. A sender of few
/// commands, and one whose token does not reach this process, is seen by the next command.
pub fn is_commanded(telemetry: &[MirrorTelemetry]) -> Option<bool> {
    let (first, last) = telemetry.first().zip(telemetry.last())?;
    let is_commanded = last.counters.accepted != first.counters.accepted;
    (is_commanded || last.state != ArrayState::Following).then_some(is_commanded)
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Counters;

    use super::*;

    #[test]
    fn an_array_that_follows_is_commanded_if_a_further_command_arrives_before_it_holds() {
        let shown = |state, accepted| {
            let counters = Counters { accepted, ..Counters::default() };
            MirrorTelemetry { state, counters, ..MirrorTelemetry::default() }
        };
        let following = |accepted| shown(ArrayState::Following, accepted);
        assert_eq!(is_commanded(&[]), None);
        assert_eq!(is_commanded(&[shown(ArrayState::Parked, 3)]), Some(false));
        let pause: Vec<MirrorTelemetry> = (0..20).map(|_| following(3)).collect();
        assert_eq!(is_commanded(&pause), None, "the next command may come");
        assert_eq!(is_commanded(&[pause, vec![following(4)]].concat()), Some(true));
        assert_eq!(is_commanded(&[following(3), shown(ArrayState::Holding, 3)]), Some(false), "its sender has ended");
    }
}
