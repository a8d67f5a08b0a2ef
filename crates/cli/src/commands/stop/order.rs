//! An order of `heliostat stop` or `heliostat rearm` on its way: its sessions, and what is known of it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::Duration;

use anyhow::{Result, anyhow};
use heliostat_bus::{
    ACCEPTS_WITHIN, Bus, BusConfig, BusError, is_joined_through, join_all_through, join_each, reached,
};
use heliostat_proto::Room;
use heliostat_service::output;
use heliostat_service::signals::end_on_signals;
use heliostat_ui::StopSwitch;

use crate::commands::join::{find_problem, join, why_unconnected};

/// An operator knows within this time whether the order has a connection. The help of `--timeout` names it.
const JOINED_WITHIN: Duration = Duration::from_secs(2);

/// An order on its way: its switch, and the sessions through which it goes out.
pub(super) struct Order {
    pub switch: Arc<StopSwitch>,
    sessions: Arc<Mutex<Vec<Bus>>>,
    /// Longest wait for a process that accepts connections.
    limit: Duration,
    /// Whether anything was sent.
    is_sent: Arc<AtomicBool>,
}

impl Order {
    /// An order of this operator, or of the user. `timeout` bounds the wait for a connection too.
    pub fn new(operator: Option<&str>, timeout: Duration) -> Self {
        let user = || std::env::var("USER").unwrap_or_else(|_| "operator".into());
        let operator = operator.map_or_else(user, str::to_owned);
        Self {
            switch: Arc::new(StopSwitch::new(&operator)),
            sessions: Arc::default(),
            limit: JOINED_WITHIN.min(timeout),
            is_sent: Arc::default(),
        }
    }

    /// Ends at a signal with what is known of the order: `sent`, or that nothing was sent.
    pub fn end_with_a_word(&self, program: &'static str, sent: &'static str) {
        let is_sent = Arc::clone(&self.is_sent);
        let said = move || match is_sent.load(Ordering::SeqCst) {
            true => format!("{sent}; look at `heliostat status`"),
            false => "nothing was sent".to_owned(),
        };
        // Nothing keeps an order from being sent.
        let _ = end_on_signals(program, said);
    }

    /// From now on a signal says that the order was sent.
    pub fn note_sent(&self) {
        self.is_sent.store(true, Ordering::SeqCst);
    }

    /// Adds a session.
    fn add(&self, bus: Bus) -> Result<()> {
        self.switch.join(&bus)?;
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner).push(bus);
        Ok(())
    }

    /// Joins the room; where there is no connection yet, it waits for one.
    pub fn join_and_wait(&self, config: BusConfig) -> Result<Room> {
        let (room, bus) = (config.room.clone(), Bus::open(&config)?);
        if !bus.wait_connected(ACCEPTS_WITHIN.min(self.limit)) {
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
        let opened = join_each(&config, ACCEPTS_WITHIN);
        let (switch, sessions) = (Arc::clone(&self.switch), Arc::clone(&self.sessions));
        let (first, has_first) = mpsc::channel();
        let of_thread = config.clone();
        switch.set_joining(true);
        thread::spawn(move || {
            let mut unanswered = Vec::new();
            for (index, bus) in opened {
                match bus.filter(|bus| switch.join(bus).is_ok()) {
                    Some(bus) => {
                        sessions.lock().unwrap_or_else(PoisonError::into_inner).push(bus);
                        // Only the first one is awaited.
                        let _ = first.send(());
                    }
                    None => unanswered.push(of_thread.connect[index].clone()),
                }
            }
            // No first session comes any more, and the wait for it ends.
            drop(first);
            // The drivers that each session reaches are known, and no stop is confirmed without them.
            sessions.lock().unwrap_or_else(PoisonError::into_inner).iter().map(reached).for_each(drop);
            if of_thread.connect.len() > 1 {
                unanswered.iter().for_each(|endpoint| note_unanswered(&of_thread, endpoint));
            }
            switch.set_joining(false);
        });
        if has_first.recv().is_ok() {
            return Ok(config.room.clone());
        }
        self.join_late(&config)
    }

    /// Joins the room through each endpoint that reaches processes of its own.
    pub fn join_widely(&self, config: BusConfig) -> Result<Room> {
        if !is_joined_through(&config) {
            self.add(join(&config, self.limit).map_err(unsent)?)?;
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
        sessions.map_err(unsent)?.into_iter().try_for_each(|bus| self.add(bus))?;
        Ok(config.room.clone())
    }

    /// Ends the sessions, so that what was sent leaves.
    pub fn close(self) -> Result<(), BusError> {
        let sessions = std::mem::take(&mut *self.sessions.lock().unwrap_or_else(PoisonError::into_inner));
        drop(self.switch);
        let closed: Vec<_> = sessions.into_iter().map(Bus::close).collect();
        closed.into_iter().collect()
    }
}

/// What an operator has to know where no process answers.
pub(super) fn unsent(reason: String) -> anyhow::Error {
    anyhow!(
        "{reason}. Nothing was sent, and nothing is known about the arrays: give --connect the endpoint of the controller, of \
         the driver or of their router. To stop the mirrors now, cut their power"
    )
}

/// Says why one of several endpoints has no connection.
fn note_unanswered(config: &BusConfig, endpoint: &str) {
    let alone = BusConfig { connect: vec![endpoint.to_owned()], ..config.clone() };
    let silent = || format!("no process of a room answers at {endpoint}");
    output::note(find_problem(&alone).unwrap_or_else(silent));
}

/// Says why a stop that waits for a connection has none yet.
fn note_unconnected(config: &BusConfig) {
    let accepts =
        || format!("the process at {} accepts connections and has not answered yet", config.connect.join(", "));
    let reason = match config.connect.is_empty() {
        true => format!("no process has connected to {} yet", config.listen.join(", ")),
        false => find_problem(config).unwrap_or_else(accepts),
    };
    output::note(format_args!(
        "{reason}. Until a process connects, no array has the stop: to stop the mirrors now, cut their power. The stop is \
         sent to the first process that connects"
    ));
}
