//! A look into a room through one of its processes, where this process joins as a client.

use std::thread;
use std::time::Duration;

use crate::config::{BusConfig, Reach, Role};
use crate::session::Bus;

/// A process that is there accepts a connection within this time.
pub const ACCEPTS_WITHIN: Duration = Duration::from_millis(1200);

/// Longest wait for the processes that another one reaches.
const ALIVE_WITHIN: Duration = Duration::from_millis(500);

/// A client of the process in `connect` that reaches the most processes, and the endpoints at which no process answers
/// within the limit. The client's process passes on the messages of those to which it is connected, where peers pass
/// nothing on. Nothing for a configuration that [is not joined through](is_joined_through) a process.
pub fn join_through(config: &BusConfig, limit: Duration) -> (Option<Bus>, Vec<String>) {
    if is_joined_through(config) { widest(config, limit) } else { (None, Vec::new()) }
}

/// Whether a room can be joined through one of its processes. Neither a client of a router, nor a process that
/// listens, nor one with a certificate, whose rights end at the first process: all of these join as they are.
pub fn is_joined_through(config: &BusConfig) -> bool {
    config.role != Role::Client && config.identity.is_none() && config.listen.is_empty()
}

/// Tries all endpoints at the same time: one that does not answer delays no other one.
fn widest(config: &BusConfig, limit: Duration) -> (Option<Bus>, Vec<String>) {
    let reached = |endpoint: &String| -> Option<(usize, Bus)> {
        let client = BusConfig { role: Role::Client, connect: vec![endpoint.clone()], ..config.clone() };
        let client = client.reaching(Reach::Within(limit));
        let bus = Bus::has_listener(&client).then(|| Bus::open(&client).ok()).flatten()?;
        let reached = bus.alive(&bus.room().all_alive(), ALIVE_WITHIN).map_or(0, |alive| alive.len());
        Some((reached, bus))
    };
    let tried: Vec<Option<(usize, Bus)>> = thread::scope(|scope| {
        let tries: Vec<_> = config.connect.iter().map(|endpoint| scope.spawn(move || reached(endpoint))).collect();
        tries.into_iter().map(|tried| tried.join().unwrap_or_default()).collect()
    });
    let unanswered = config.connect.iter().zip(&tried).filter(|(_, tried)| tried.is_none());
    let unanswered = unanswered.map(|(endpoint, _)| endpoint.clone()).collect();
    // Of those that reach as many, the first one.
    let widest = tried.into_iter().flatten().reduce(|best, one| if one.0 > best.0 { one } else { best });
    (widest.map(|(_, bus)| bus), unanswered)
}
