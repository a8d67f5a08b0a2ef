//! The bus subscriptions of one room: reports, liveliness, and what concerns the arrays.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_core::{capabilities::Examiner, refusal::Stream};
use heliostat_proto::{Capabilities, EmergencyStop, SafetyReport, StopReport, keys::parse_alive};

use super::{
    decision_loop::{DecisionLoop, PayloadHandler},
    input_channel::InputChannel,
    locks::lock,
    stop_repeater::HeldStops,
    undecodable::Decoder,
};

/// How long the controller waits for the announcements of an array that is already there.
const ANNOUNCED_WITHIN: Duration = Duration::from_millis(300);

/// What the callbacks about arrays share.
#[derive(Clone)]
pub struct Arrays {
    /// The loop that decides for all of them.
    pub decision_loop: Arc<Mutex<DecisionLoop>>,
    /// Their stops, which are repeated also while the loop is locked.
    pub stops: Arc<HeldStops>,
    /// Counts the payloads that do not decode.
    pub decoder: Decoder,
}

/// Subscribes to the reports of a room and to the liveliness of its sources.
///
/// # Errors
/// If the session is closed.
pub fn subscribe_to_reports(bus: &Bus, handler: &PayloadHandler) -> anyhow::Result<Vec<Subscription>> {
    let room = bus.room();
    // Positions come last, so that the other reports are there when the first decision is due.
    let arrays = 0..lock(&handler.decision_loop).controller.arrays();
    let telemetry =
        arrays.map(|array| (InputChannel { stream: Stream::Telemetry, array }, room.array(array).telemetry()));
    let reports = [
        (Stream::Obstacles.into(), room.obstacles()),
        (Stream::Orientation.into(), room.orientation()),
        (Stream::Leds.into(), room.leds()),
        (Stream::Channel.into(), room.channel()),
        (Stream::Users.into(), room.users()),
    ];
    let mut subscriptions = Vec::new();
    for (channel, key) in telemetry.chain(reports) {
        let handler = handler.clone();
        let callback = move |payload: &[u8]| handler.handle(channel, payload, Instant::now());
        subscriptions.push(bus.subscribe(&key, callback)?);
    }
    let decision_loop = Arc::clone(&handler.decision_loop);
    subscriptions.push(bus.watch(&room.all_alive(), move |key, presence| {
        let Some((node, source)) = parse_alive(key) else { return };
        let controller = &mut lock(&decision_loop).controller;
        match presence {
            Presence::Gone => controller.handle_source_lost(node, source),
            Presence::Alive => controller.handle_source_found(node, source),
        }
    })?);
    Ok(subscriptions)
}

/// Subscribes to the announcements of each array, to orders about the emergency stop, and to the
/// kind of node that drives the mirrors.
///
/// None of this is in the decision path.
///
/// # Errors
/// If the session is closed.
pub fn subscribe_to_arrays(bus: &Bus, arrays: &Arrays, examiner: &Examiner) -> anyhow::Result<Vec<Subscription>> {
    let mut subscriptions = Vec::new();
    let indices = 0..lock(&arrays.decision_loop).controller.arrays();
    for array in indices.clone() {
        subscriptions.push(subscribe_to_capabilities(bus, array, arrays, examiner.clone())?);
    }
    subscriptions.push(watch_nodes(bus, &arrays.decision_loop, examiner.clone())?);
    subscriptions.push(subscribe_to_stops(bus, arrays)?);
    for array in indices {
        subscriptions.push(subscribe_to_stop_reports(bus, array, arrays)?);
        subscriptions.push(subscribe_to_safety(bus, array, arrays)?);
    }
    Ok(subscriptions)
}

fn subscribe_to_capabilities(
    bus: &Bus,
    array: usize,
    arrays: &Arrays,
    examiner: Examiner,
) -> anyhow::Result<Subscription> {
    let key = bus.room().array(array).capabilities();
    let Arrays { decision_loop, decoder, .. } = arrays.clone();
    let mut known = Capabilities::default();
    let mut examine = move |payload: &[u8]| {
        let Some(new) = decoder.decode::<Capabilities>("capabilities", Some(array), payload) else { return };
        let is_admitted = lock(&decision_loop).controller.admits_array(array, new.stamp.source);
        if is_admitted && known == (Capabilities { stamp: known.stamp, ..new.clone() }) {
            return;
        }
        // The examination takes long, so it does not hold the lock.
        let verdict = if is_admitted { examiner.examine(array, &new) } else { Ok(()) };
        if lock(&decision_loop).controller.handle_capabilities(array, &new, verdict) {
            known = new;
        }
    };
    // An array that is already there answers the request before the first command.
    bus.fetch(&key, ANNOUNCED_WITHIN)?.iter().for_each(|payload| examine(payload));
    Ok(bus.subscribe(&key, examine)?)
}

/// The decision loop can be locked when an order arrives, so the order is held for repetition first.
fn subscribe_to_stops(bus: &Bus, arrays: &Arrays) -> anyhow::Result<Subscription> {
    let Arrays { decision_loop, stops, decoder } = arrays.clone();
    Ok(bus.subscribe(&bus.room().stop(), move |payload| {
        let Some(order) = decoder.decode::<EmergencyStop>("stop", None, payload) else { return };
        stops.handle_order(&order);
        let decision_loop = &mut lock(&decision_loop);
        let now = decision_loop.room_time_ns();
        decision_loop.controller.handle_stop_order(now, &order);
    })?)
}

fn subscribe_to_stop_reports(bus: &Bus, array: usize, arrays: &Arrays) -> anyhow::Result<Subscription> {
    let key = bus.room().array(array).stops();
    let Arrays { decision_loop, stops, decoder } = arrays.clone();
    let report = move |payload: &[u8]| {
        let Some(report) = decoder.decode::<StopReport>("stops", Some(array), payload) else { return };
        if lock(&decision_loop).controller.handle_stops(array, &report) {
            stops.handle_stops(array, &report);
        }
    };
    bus.fetch(&key, ANNOUNCED_WITHIN)?.iter().for_each(|payload| report(payload));
    Ok(bus.subscribe(&key, report)?)
}

fn subscribe_to_safety(bus: &Bus, array: usize, arrays: &Arrays) -> anyhow::Result<Subscription> {
    let key = bus.room().array(array).safety();
    let Arrays { decision_loop, stops, decoder } = arrays.clone();
    let report = move |payload: &[u8]| {
        let Some(report) = decoder.decode::<SafetyReport>("safety", Some(array), payload) else { return };
        if lock(&decision_loop).controller.handle_safety(array, &report) {
            stops.handle_safety(array, &report);
        }
    };
    // The first epoch must be above the one that the array follows.
    bus.fetch(&key, ANNOUNCED_WITHIN)?.iter().for_each(|payload| report(payload));
    Ok(bus.subscribe(&key, report)?)
}

/// Withholds commands while a node that does not fit the scenario is in the room.
fn watch_nodes(
    bus: &Bus,
    decision_loop: &Arc<Mutex<DecisionLoop>>,
    examiner: Examiner,
) -> anyhow::Result<Subscription> {
    let decision_loop = Arc::clone(decision_loop);
    let mut unfit_nodes = Vec::new();
    Ok(bus.watch(&bus.room().all_alive(), move |key, presence| {
        let Some((node, source)) = parse_alive(key) else { return };
        let Err(unfit) = examiner.examine_node(node) else { return };
        unfit_nodes.retain(|known| *known != source);
        if presence == Presence::Alive {
            unfit_nodes.push(source);
        }
        lock(&decision_loop).controller.handle_unfit_node((!unfit_nodes.is_empty()).then_some(unfit));
    })?)
}
