//! The bus subscriptions of one room: reports, liveliness, and what concerns the array.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_decide::{capabilities::Examiner, refusal::Stream};
use heliostat_proto::{Capabilities, EmergencyStop, decode, keys::parse_alive};

use super::{
    decision_loop::{DecisionLoop, PayloadHandler},
    locks::lock,
    watchdog::Watchdog,
};

/// How long the controller waits for the capabilities of an array that is already there.
const CAPABILITIES_WITHIN: Duration = Duration::from_millis(300);

/// Subscribes to the reports of a room and to the liveliness of its sources.
///
/// # Errors
/// If the session is closed.
pub fn subscribe_to_reports(bus: &Bus, handler: &PayloadHandler) -> anyhow::Result<Vec<Subscription>> {
    let room = bus.room();
    // Positions come last, so that the other reports are there when the first decision is due.
    let keys = [
        (Stream::Telemetry, room.telemetry()),
        (Stream::Obstacles, room.obstacles()),
        (Stream::Channel, room.channel()),
        (Stream::Users, room.users()),
    ];
    let mut subscriptions = Vec::with_capacity(keys.len() + 1);
    for (stream, key) in keys {
        let handler = handler.clone();
        let callback = move |payload: &[u8]| handler.handle(stream, payload, Instant::now());
        subscriptions.push(bus.subscribe(&key, callback)?);
    }
    let decision_loop = Arc::clone(&handler.decision_loop);
    subscriptions.push(bus.watch(&room.all_alive(), move |key, presence| {
        let Some((_, source)) = parse_alive(key) else { return };
        let controller = &mut lock(&decision_loop).controller;
        match presence {
            Presence::Gone => controller.handle_source_lost(source),
            Presence::Alive => controller.handle_source_found(source),
        }
    })?);
    Ok(subscriptions)
}

/// Subscribes to the capabilities of the array, to stop orders, and to the kind of node that drives
/// the mirrors.
///
/// None of this is in the decision path.
///
/// # Errors
/// If the session is closed.
pub fn subscribe_to_array(
    bus: &Bus,
    decision_loop: &Arc<Mutex<DecisionLoop>>,
    watchdog: &Arc<Watchdog>,
    examiner: Examiner,
) -> anyhow::Result<[Subscription; 3]> {
    let room = bus.room();
    let examiner = Arc::new(examiner);
    let (of_array, on_capabilities) = (Arc::clone(&examiner), Arc::clone(decision_loop));
    let mut known = Capabilities::default();
    let mut examine = move |payload: &[u8]| {
        let Ok(new) = decode::<Capabilities>(payload) else { return };
        if known == (Capabilities { stamp: known.stamp, ..new.clone() }) {
            return;
        }
        let verdict = of_array.examine(&new);
        lock(&on_capabilities).controller.handle_capabilities(&new, verdict);
        known = new;
    };
    // An array that is already there answers the request before the first command.
    bus.fetch(&room.capabilities(), CAPABILITIES_WITHIN)?.iter().for_each(|payload| examine(payload));
    let capabilities = bus.subscribe(&room.capabilities(), examine)?;
    let (on_stop, watchdog) = (Arc::clone(decision_loop), Arc::clone(watchdog));
    let stops = bus.subscribe(&room.stop(), move |payload| {
        if let Ok(order) = decode::<EmergencyStop>(payload) {
            watchdog.handle_stop_order(&order);
            lock(&on_stop).controller.handle_stop_order(&order);
        }
    })?;
    let on_node = Arc::clone(decision_loop);
    let nodes = bus.watch(&room.all_alive(), move |key, presence| {
        let Some((node, _)) = parse_alive(key).filter(|_| presence == Presence::Alive) else { return };
        if let Err(unfit) = examiner.examine_node(node) {
            lock(&on_node).controller.handle_unfit(unfit);
        }
    })?;
    Ok([capabilities, stops, nodes])
}
