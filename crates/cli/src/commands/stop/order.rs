//! An order of `heliostat stop` or `heliostat rearm` on its way: its sessions, and what is known of it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex, Weak};
use std::thread;
use std::time::Duration;

use anyhow::{Result, anyhow};
use heliostat_bus::{
    ACCEPTS_WITHIN, Bus, BusConfig, BusError, is_joined_through, join_all_through, join_each, reached,
};
use heliostat_proto::{Nanos, Room};
use heliostat_service::locks::lock;
use heliostat_service::signals::{end_on_request, stop_on_signals};
use heliostat_service::{Stop, output};
use heliostat_ui::{StopSwitch, find_absent_room};

use super::meanwhile::Meanwhile;
use crate::commands::join::{
    Unconnected, accepting_in_words, find_problem, join, unanswered_in_words, why_unconnected,
};

/// An operator knows within this time whether the order has a connection. The help of `--timeout` names it.
const JOINED_WITHIN: Duration = Duration::from_secs(2);
/// Time between two attempts to join through an endpoint that has not answered.
const AGAIN_EVERY: Duration = Duration::from_secs(1);

/// What an order does.
#[derive(Clone, Copy, Debug)]
pub(super) enum Purpose {
    Stop,
    Rearm,
}

impl Purpose {
    fn program(self) -> &'static str {
        match self {
            Self::Stop => "heliostat stop",
            Self::Rearm => "heliostat rearm",
        }
    }

    /// What an operator has to know where no process answers.
    pub fn unsent(self, reason: &Unconnected) -> anyhow::Error {
        let known = "Nothing was sent, and nothing is known about the arrays";
        let advised =
            format!("{known}: give --connect the endpoint of the controller, of the driver or of their router");
        let consequence = match self {
            Self::Stop => "To stop the mirrors now, cut their power",
            Self::Rearm => "Each stop that is in force stays so",
        };
        anyhow!("{}. {consequence}", reason.with_either(known, &advised))
    }
}

/// The name of an operator, which others see.
pub(super) fn operator_name(text: &str) -> Result<String, String> {
    let is_visible = |character: char| !character.is_whitespace() && !character.is_control();
    match text.contains(is_visible) {
        true => Ok(text.to_owned()),
        false => Err("expected a name with at least one visible character, for example anna".to_owned()),
    }
}

/// The name of an operator who gives none, from that of the user.
fn user_name(user: Option<String>) -> String {
    user.and_then(|user| operator_name(&user).ok()).unwrap_or_else(|| "operator".to_owned())
}

/// An order on its way: its switch, and the sessions through which it goes out.
pub(super) struct Order {
    pub switch: Arc<StopSwitch>,
    purpose: Purpose,
    sessions: Arc<Mutex<Vec<Bus>>>,
    /// Longest wait for a process that accepts connections.
    limit: Duration,
    /// Whether anything was sent.
    is_sent: Arc<AtomicBool>,
    /// Whether the stop is only held from now on.
    is_held: Arc<AtomicBool>,
}

/// Where sessions join, as long as the order lasts.
struct Place {
    switch: Weak<StopSwitch>,
    sessions: Weak<Mutex<Vec<Bus>>>,
}

impl Place {
    /// Joins the room through each endpoint, and calls `joined` after each session; returns the endpoints that have not
    /// answered. Nothing after the end of the order.
    fn join_each(&self, config: &BusConfig, joined: impl Fn()) -> Option<Vec<String>> {
        let mut unanswered = Vec::new();
        for (index, bus) in join_each(config, ACCEPTS_WITHIN) {
            let (switch, sessions) = (self.switch.upgrade()?, self.sessions.upgrade()?);
            match bus.filter(|bus| switch.join(bus).is_ok()) {
                Some(bus) => {
                    lock(&sessions).push(bus);
                    joined();
                }
                None => unanswered.push(config.connect[index].clone()),
            }
        }
        Some(unanswered)
    }

    /// Ends the first attempt: no stop is confirmed before the drivers that each session reaches are known.
    fn finish(&self) {
        let Some(sessions) = self.sessions.upgrade() else { return };
        let enter = |bus: &Bus| bus.enter(bus.room().clone());
        // Without the lock: a further session joins meanwhile.
        let entered: Vec<Bus> = lock(&sessions).iter().map(enter).collect();
        entered.iter().map(reached).for_each(drop);
    }

    /// Joins through these endpoints as soon as they answer.
    fn join_later(&self, config: &BusConfig, mut connect: Vec<String>) {
        while !connect.is_empty() {
            thread::sleep(AGAIN_EVERY);
            let Some(unanswered) = self.join_each(&BusConfig { connect, ..config.clone() }, || {}) else { return };
            connect = unanswered;
        }
    }
}

impl Order {
    /// An order of this operator, or of the user. `timeout` bounds the wait for a connection too.
    pub fn new(purpose: Purpose, operator: Option<&str>, timeout: Duration) -> Self {
        let operator = operator.map_or_else(|| user_name(std::env::var("USER").ok()), str::to_owned);
        Self {
            switch: Arc::new(StopSwitch::new(&operator)),
            purpose,
            sessions: Arc::default(),
            limit: JOINED_WITHIN.min(timeout),
            is_sent: Arc::default(),
            is_held: Arc::default(),
        }
    }

    /// Ends at a signal with what is known of the order: what `sent` returns, or that nothing was sent.
    pub fn end_with_a_word(&self, sent: impl Fn(&StopSwitch) -> String + Send + 'static) {
        // Nothing keeps an order from being sent.
        if let Ok(end) = stop_on_signals() {
            self.end_at(end, sent);
        }
    }

    /// The same at a request, until the stop is only held: that has an end of its own.
    pub fn end_at(&self, end: Stop, sent: impl Fn(&StopSwitch) -> String + Send + 'static) {
        let (is_sent, is_held) = (Arc::clone(&self.is_sent), Arc::clone(&self.is_held));
        let switch = Arc::downgrade(&self.switch);
        end_on_request(end, self.purpose.program(), move || {
            // Without its switch the order is over, and its result is printed.
            let said = match is_sent.load(Ordering::SeqCst) {
                true => {
                    let switch = switch.upgrade()?;
                    format!("{}; look at `heliostat status`", sent(&switch))
                }
                false => "nothing was sent".to_owned(),
            };
            (!is_held.load(Ordering::SeqCst)).then_some(said)
        });
    }

    /// From now on a signal says that the order was sent.
    pub fn note_sent(&self) {
        self.is_sent.store(true, Ordering::SeqCst);
    }

    /// From now on the stop is only held, and its end is not that of an order on its way.
    pub fn note_held(&self) {
        self.is_held.store(true, Ordering::SeqCst);
    }

    /// Adds a session.
    fn add(&self, bus: Bus) -> Result<()> {
        self.switch.join(&bus)?;
        lock(&self.sessions).push(bus);
        Ok(())
    }

    /// Joins the room as [`join_at_once`](Self::join_at_once) does, and with a session that lasts beyond the end of each
    /// process in `connect`. Where an endpoint has no process yet, it waits for one.
    pub fn join_and_wait(&self, config: BusConfig) -> Result<Room> {
        let has_first = is_joined_through(&config).then(|| self.join_behind(&config, true));
        let (room, bus) = (config.room.clone(), Bus::open(&config)?);
        let limit = ACCEPTS_WITHIN.min(self.limit);
        let is_connected = match has_first {
            Some(has_first) => has_first.recv_timeout(limit).is_ok(),
            None => bus.wait_connected(limit),
        };
        if !is_connected {
            // The search for the reason delays no order.
            thread::spawn(move || note_unconnected(&config));
        }
        self.add(bus)?;
        Ok(room)
    }

    /// Joins the room through each endpoint, and returns with the first session. The others join the switch when they
    /// are open: a process that does not answer delays no order.
    pub fn join_at_once(&self, config: BusConfig) -> Result<Room> {
        if !is_joined_through(&config) {
            return self.join_widely(config);
        }
        if self.join_behind(&config, false).recv().is_ok() {
            return Ok(config.room.clone());
        }
        self.join_late(&config)
    }

    /// Joins the room through each endpoint on another thread. A message comes with each session of the first attempt,
    /// and the channel ends with it. A lasting order goes on with the endpoints that have not answered.
    fn join_behind(&self, config: &BusConfig, is_lasting: bool) -> Receiver<()> {
        let place = Place { switch: Arc::downgrade(&self.switch), sessions: Arc::downgrade(&self.sessions) };
        let (first, has_first) = mpsc::channel();
        let config = config.clone();
        self.switch.set_joining(true);
        thread::spawn(move || {
            // Only the first one is awaited.
            let joined = place.join_each(&config, || {
                let _ = first.send(());
            });
            // No first session comes any more, and the wait for it ends.
            drop(first);
            let Some(unanswered) = joined else { return };
            place.finish();
            if config.connect.len() > 1 {
                unanswered.iter().for_each(|endpoint| note_unanswered(&config, endpoint));
            }
            if let Some(switch) = place.switch.upgrade() {
                switch.set_joining(false);
            }
            if is_lasting {
                place.join_later(&config, unanswered);
            }
        });
        has_first
    }

    /// Joins the room through each endpoint that reaches processes of its own.
    pub fn join_widely(&self, config: BusConfig) -> Result<Room> {
        if !is_joined_through(&config) {
            self.add(join(&config, self.limit).map_err(|reason| self.purpose.unsent(&reason))?)?;
            return Ok(config.room);
        }
        let (sessions, unanswered) = join_all_through(&config, ACCEPTS_WITHIN);
        if config.connect.len() > 1 {
            unanswered.iter().for_each(|endpoint| note_unanswered(&config, endpoint));
        }
        if sessions.is_empty() {
            return self.join_late(&config);
        }
        sessions.into_iter().try_for_each(|bus| self.add(bus))?;
        Ok(config.room)
    }

    /// Where no process has answered in time: why, or a further attempt.
    fn join_late(&self, config: &BusConfig) -> Result<Room> {
        let left = self.limit.saturating_sub(ACCEPTS_WITHIN);
        let sessions = why_unconnected(config, self.limit, || {
            let (sessions, _) = join_all_through(config, left);
            (!sessions.is_empty()).then_some(sessions)
        });
        let sessions = sessions.map_err(|reason| self.purpose.unsent(&reason))?;
        sessions.into_iter().try_for_each(|bus| self.add(bus))?;
        Ok(config.room.clone())
    }

    /// That the room has no process where other rooms have some, over all sessions.
    pub fn absent_room(&self) -> Option<String> {
        let enter = |bus: &Bus| bus.enter(bus.room().clone());
        // Without the lock: a further session joins meanwhile.
        let sessions: Vec<Bus> = lock(&self.sessions).iter().map(enter).collect();
        find_absent_room(&sessions)
    }

    /// The stops that are ordered from now on, of a command that began at this time.
    pub fn meanwhile(&self, begun_ns: Nanos) -> Result<Meanwhile> {
        Meanwhile::over(begun_ns, lock(&self.sessions).iter())
    }

    /// Ends the sessions, so that what was sent leaves.
    pub fn close(self) -> Result<(), BusError> {
        let sessions = std::mem::take(&mut *lock(&self.sessions));
        drop(self.switch);
        // Each takes up to half a second where no process answers.
        let closing: Vec<_> = sessions.into_iter().map(|bus| thread::spawn(move || bus.close())).collect();
        let closed: Vec<_> = closing.into_iter().map(|thread| thread.join().unwrap_or(Ok(()))).collect();
        closed.into_iter().collect()
    }
}

/// Says why one of several endpoints has no connection.
fn note_unanswered(config: &BusConfig, endpoint: &str) {
    let alone = BusConfig { connect: vec![endpoint.to_owned()], ..config.clone() };
    output::note(find_problem(&alone).unwrap_or_else(|| unanswered_in_words(endpoint)));
}

/// Says why a stop that waits for a connection has none yet.
fn note_unconnected(config: &BusConfig) {
    let reason = match config.connect.is_empty() {
        true => format!("no process has connected to {} yet", config.listen.join(", ")),
        false => find_problem(config).unwrap_or_else(|| accepting_in_words(config)),
    };
    output::note(format_args!(
        "{reason}. Until a process connects, no array has the stop: to stop the mirrors now, cut their power. The stop is \
         sent to the first process that connects"
    ));
}

#[cfg(test)]
mod tests {
    use heliostat_bus::free_loopback_endpoint;

    use super::*;

    #[test]
    fn an_operator_has_a_name_that_can_be_seen() {
        assert_eq!(operator_name("Anna B").as_deref(), Ok("Anna B"));
        for unseen in ["", " ", "\t\u{1b}"] {
            assert!(operator_name(unseen).is_err(), "{unseen:?}");
            assert_eq!(user_name(Some(unseen.to_owned())), "operator");
        }
        assert_eq!(user_name(None), "operator");
        assert_eq!(user_name(Some("ann".to_owned())), "ann");
    }

    #[test]
    fn only_a_reason_that_names_no_remedy_of_its_own_gets_one() {
        let keys = Purpose::Stop.unsent(&Unconnected::advised("the certificate expired: renew it")).to_string();
        assert_eq!(
            keys,
            "the certificate expired: renew it. Nothing was sent, and nothing is known about the arrays. To stop the \
             mirrors now, cut their power"
        );
        let absent = free_loopback_endpoint().expect("a free port");
        let config = BusConfig::new(Room::new("unsent").expect("a valid name")).connect_to(&absent);
        let refused = join(&config, Duration::ZERO).err().expect("no process is there");
        for (purpose, end) in [(Purpose::Stop, "cut their power"), (Purpose::Rearm, "stop that is in force stays so")] {
            let refused = purpose.unsent(&refused).to_string();
            assert!(refused.contains("about the arrays: give --connect the endpoint of the controller"), "{refused}");
            assert!(refused.ends_with(end), "{refused}");
        }
    }
}
