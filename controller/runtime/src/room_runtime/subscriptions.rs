//! The bus subscriptions of one room: reports, liveliness, announcements and orders.

use std::time::{Duration, Instant};

use heliostat_bus::{Bus, Presence, Subscription};
use heliostat_core::room_core::InputKey;
use heliostat_service::locks::lock;

use super::decision_loop::PayloadHandler;

/// How long the controller waits for the announcements of an array that is already there.
const ANNOUNCED_WITHIN: Duration = Duration::from_millis(300);

/// Subscribes to the inputs of a room. The announcements of the arrays come first: an array that is
/// already there announces itself before the first command.
///
/// # Errors
/// If the session is closed.
pub fn subscribe(bus: &Bus, handler: &PayloadHandler) -> anyhow::Result<Vec<Subscription>> {
    let room = bus.room();
    let arrays = lock(&handler.decision_loop).room.controller().arrays();
    let mut subscriptions = Vec::new();
    for key in InputKey::announcements(arrays) {
        let (announcements, name) = (handler.announcements.clone(), key.in_room(room));
        let receive = move |payload: &[u8]| announcements.handle(key, payload);
        if key.is_queried() {
            bus.fetch(&name, ANNOUNCED_WITHIN)?.iter().for_each(|payload| receive(payload));
        }
        subscriptions.push(bus.subscribe(&name, receive)?);
    }
    let announcements = handler.announcements.clone();
    subscriptions.push(bus.watch(&room.all_alive(), move |token, presence| {
        announcements.handle_presence(token, presence == Presence::Alive);
    })?);
    for channel in InputKey::reports(arrays) {
        let handler = handler.clone();
        let receive = move |payload: &[u8]| handler.handle(channel, payload, Instant::now());
        subscriptions.push(bus.subscribe(&InputKey::Report(channel).in_room(room), receive)?);
    }
    Ok(subscriptions)
}
