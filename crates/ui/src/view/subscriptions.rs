//! The subscriptions of a view: each decodes a message and stores it.

use std::sync::{Arc, Mutex};

use heliostat_bus::{Bus, Subscription};
use heliostat_proto::{ArrayKeys, Capabilities, Message, NodeKind, NodeStatus, Room, RoomGeometry, codec};
use heliostat_service::locks::lock;

use super::received::{Received, keep_text};
use crate::UiError;

/// Subscribes to every topic of the room.
pub(super) fn subscribe(bus: &Bus, received: &Arc<Mutex<Received>>) -> Result<Vec<Subscription>, UiError> {
    let room: &Room = bus.room();
    let on_alive = Arc::clone(received);
    let alive = bus.watch(&bus.visible_alive(), move |key, presence| lock(&on_alive).take_token(key, presence))?;
    Ok(vec![
        store(bus, &room.truth(), received, Received::take_truth)?,
        store(bus, &room.users(), received, Received::take_users)?,
        store(bus, &room.channel(), received, Received::take_channel)?,
        store(bus, &room.obstacles(), received, Received::take_obstacles)?,
        store(bus, &room.telemetry(), received, |received, telemetry| received.take_telemetry(0, telemetry))?,
        later_arrays(bus, received)?,
        capabilities(bus, received, &room.array(0))?,
        capabilities(bus, received, &room.later_arrays())?,
        store(bus, &room.belief(), received, Received::take_belief)?,
        statuses(bus, received)?,
        store(bus, &room.geometry(NodeKind::SimNode), received, |received, geometry: RoomGeometry| {
            keep_text(&mut received.room_geometry, geometry.scenario)
        })?,
        store(bus, &room.geometry(NodeKind::Controller), received, Received::take_controller_geometry)?,
        alive,
    ])
}

/// Keeps the status of each process.
fn statuses(bus: &Bus, received: &Arc<Mutex<Received>>) -> Result<Subscription, UiError> {
    let (room, received) = (bus.room().clone(), Arc::clone(received));
    Ok(bus.subscribe_keyed(&bus.room().all_status(), move |key, payload| {
        let status = codec::decode::<NodeStatus>(payload).ok();
        match status.and_then(|status| Some((room.status_array(key, &status)?, status))) {
            Some((array, status)) => lock(&received).take_status(array, status),
            None => lock(&received).unreadable += 1,
        }
    })?)
}

/// Keeps the telemetry of the arrays after the first.
fn later_arrays(bus: &Bus, received: &Arc<Mutex<Received>>) -> Result<Subscription, UiError> {
    let (room, received) = (bus.room().clone(), Arc::clone(received));
    Ok(bus.subscribe_keyed(&bus.room().later_arrays().telemetry(), move |key, payload| {
        match (room.array_of(key, &room.telemetry()), codec::decode(payload)) {
            (Some(array), Ok(telemetry)) => lock(&received).take_telemetry(array, telemetry),
            _ => lock(&received).unreadable += 1,
        }
    })?)
}

/// Keeps which drivers have a synchronised clock.
fn capabilities(bus: &Bus, received: &Arc<Mutex<Received>>, keys: &ArrayKeys) -> Result<Subscription, UiError> {
    let (room, received) = (bus.room().clone(), Arc::clone(received));
    let first = room.array(0).capabilities();
    Ok(bus.subscribe_keyed(&keys.capabilities(), move |key, payload| {
        if let Some(array) = room.array_of(key, &first)
            && let Ok(capabilities) = codec::decode::<Capabilities>(payload)
        {
            lock(&received).telemetry_ages.handle_capabilities(array, &capabilities);
        }
    })?)
}

fn store<M: Message + 'static>(
    bus: &Bus,
    key: &str,
    received: &Arc<Mutex<Received>>,
    take: fn(&mut Received, M),
) -> Result<Subscription, UiError> {
    let received = Arc::clone(received);
    Ok(bus.subscribe(key, move |payload| {
        let decoded = codec::decode::<M>(payload);
        let mut received = lock(&received);
        match decoded {
            Ok(message) => take(&mut received, message),
            Err(_) => received.unreadable += 1,
        }
    })?)
}
