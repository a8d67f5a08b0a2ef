//! The bus subscriptions of one room: reports, liveliness, announcements and orders.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_core::room_core::{Handled, Input, InputKey, Repeater};
use heliostat_service::clock::utc_ns;

use super::{
    decision_loop::{DecisionLoop, PayloadHandler},
    locks::lock,
};

/// How long the controller waits for the announcements of an array that is already there.
const ANNOUNCED_WITHIN: Duration = Duration::from_millis(300);

/// The entry of announcements and orders. None of them is in the decision path.
#[derive(Clone)]
struct AnnouncementHandler {
    decision_loop: Arc<Mutex<DecisionLoop>>,
    repeater: Arc<Mutex<Repeater>>,
}

impl AnnouncementHandler {
    fn handle(&self, key: InputKey, payload: &[u8]) {
        if key == InputKey::Stop {
            // The decision loop can be locked by a policy that does not return.
            lock(&self.repeater).note_order(utc_ns(), payload);
        }
        let handled = lock(&self.decision_loop).handle(Input::Payload { key, bytes: payload });
        if let Handled::Examination(examination) = handled {
            // It takes long, so it does not hold the lock.
            let examined = examination.run();
            lock(&self.decision_loop).handle(examined);
        }
    }
}

/// Subscribes to the inputs of a room. The announcements of the arrays come first: an array that is
/// already there announces itself before the first command.
///
/// # Errors
/// If the session is closed.
pub fn subscribe(
    bus: &Bus,
    handler: &PayloadHandler,
    repeater: &Arc<Mutex<Repeater>>,
) -> anyhow::Result<Vec<Subscription>> {
    let room = bus.room();
    let arrays = lock(&handler.decision_loop).room.controller().arrays();
    let announcements =
        AnnouncementHandler { decision_loop: Arc::clone(&handler.decision_loop), repeater: Arc::clone(repeater) };
    let mut subscriptions = Vec::new();
    for key in InputKey::announcements(arrays) {
        let (handler, name) = (announcements.clone(), key.in_room(room));
        let receive = move |payload: &[u8]| handler.handle(key, payload);
        if key.is_queried() {
            bus.fetch(&name, ANNOUNCED_WITHIN)?.iter().for_each(|payload| receive(payload));
        }
        subscriptions.push(bus.subscribe(&name, receive)?);
    }
    subscriptions.push(bus.watch(&room.all_alive(), move |token, presence| {
        let is_alive = presence == Presence::Alive;
        lock(&announcements.decision_loop).handle(Input::Presence { token, is_alive });
    })?);
    for channel in InputKey::reports(arrays) {
        let handler = handler.clone();
        let receive = move |payload: &[u8]| handler.handle(channel, payload, Instant::now());
        subscriptions.push(bus.subscribe(&InputKey::Report(channel).in_room(room), receive)?);
    }
    Ok(subscriptions)
}
