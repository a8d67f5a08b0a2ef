//! A look into a room through one of its processes, where this process joins as a client.

use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use heliostat_proto::NodeKind;
use heliostat_proto::keys::{parse_alive, parse_alive_room};

use crate::config::{BusConfig, Reach, Role};
use crate::session::{Bus, if_answered};

/// A process that is there accepts a connection within this time.
pub const ACCEPTS_WITHIN: Duration = Duration::from_millis(1200);

/// Longest wait for the processes that another one reaches.
const ALIVE_WITHIN: Duration = Duration::from_millis(500);

/// A client of the process in `connect` that reaches the most processes, and the endpoints at which no process answers
/// within the limit. The client's process passes on the messages of those to which it is connected, where peers pass
/// nothing on. Nothing for a configuration that [is not joined through](is_joined_through) a process.
pub fn join_through(config: &BusConfig, limit: Duration) -> (Option<Bus>, Vec<String>) {
    let (sessions, unanswered) = join_all_through(config, limit);
    (sessions.into_iter().next(), unanswered)
}

/// As [`join_through`], with a further client of each process that reaches others than those before.
pub fn join_all_through(config: &BusConfig, limit: Duration) -> (Vec<Bus>, Vec<String>) {
    let (mut sessions, mut unanswered) = (Vec::new(), Vec::new());
    let opened = is_joined_through(config).then(|| join_each(config, limit));
    for (index, bus) in opened.into_iter().flatten() {
        match bus {
            Some(bus) => {
                let alive = reached(&bus);
                sessions.push((index, bus, alive));
            }
            None => unanswered.push(index),
        }
    }
    // Of those that reach as many, the first one.
    sessions.sort_by_key(|(index, _, alive)| (Reverse(alive.len()), *index));
    let mut known = BTreeSet::new();
    let mut is_first = true;
    sessions.retain(|(_, _, alive)| {
        let is_kept = is_first || !alive.is_subset(&known);
        (is_first, _) = (false, known.extend(alive.iter().cloned()));
        is_kept
    });
    unanswered.sort_unstable();
    let unanswered = unanswered.into_iter().map(|index| config.connect[index].clone()).collect();
    (sessions.into_iter().map(|(_, bus, _)| bus).collect(), unanswered)
}

/// The tokens of the processes that a session reaches. Those that it watches have come before.
pub fn reached(bus: &Bus) -> BTreeSet<String> {
    bus.alive(&bus.room().all_alive(), ALIVE_WITHIN).unwrap_or_default().into_iter().collect()
}

/// The names of the rooms of which a session reaches a process, viewers aside; with a certificate at most its own.
pub fn reached_rooms(bus: &Bus) -> BTreeSet<String> {
    let tokens = bus.alive(&bus.visible_alive(), ALIVE_WITHIN).unwrap_or_default();
    let is_viewer = |key: &str| parse_alive(key).is_none_or(|(node, _)| node == NodeKind::Viewer);
    let rooms = tokens.iter().filter(|key| !is_viewer(key)).filter_map(|key| parse_alive_room(key));
    rooms.map(|room| room.name().to_owned()).collect()
}

/// Opens a client of each process in `connect`, all at the same time. Each comes with the index of its endpoint as soon
/// as it is open, and without a session where no process answers within the limit: none delays another one.
pub fn join_each(config: &BusConfig, limit: Duration) -> Receiver<(usize, Option<Bus>)> {
    let (sender, opened) = mpsc::channel();
    for (index, endpoint) in config.connect.iter().enumerate() {
        let client = BusConfig { role: Role::Client, connect: vec![endpoint.clone()], ..config.clone() };
        let (client, sender) = (client.reaching(Reach::Within(limit)), sender.clone());
        thread::spawn(move || {
            // The receiver may have ended.
            let _ = sender.send((index, if_answered(&client, Bus::open)));
        });
    }
    opened
}

/// Whether a room can be joined through one of its processes. Neither a client of a router, nor a process that
/// listens, nor one with a certificate, whose rights end at the first process: all of these join as they are.
pub fn is_joined_through(config: &BusConfig) -> bool {
    config.role != Role::Client && config.identity.is_none() && config.listen.is_empty()
}
