//! A tracker that reports users at rest, for rooms whose array is a driver.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class};
use heliostat_proto::{ChannelReport, Stamp, UserChannel, UserReport, UserState};
use heliostat_service::clock::utc_ns;
use heliostat_service::source_id;

use crate::faults::attacker::encoded;

/// Time between two reports, the default of the scenarios.
pub const PERIOD: Duration = Duration::from_millis(10);

/// Users in the default scenario.
const USERS: u32 = 5;

#[derive(Default)]
struct State {
    source: AtomicU64,
    clock_shift_ns: AtomicI64,
    paused: AtomicBool,
    ended: AtomicBool,
}

/// A tracker; dropping it ends its reports.
pub struct Tracker {
    state: Arc<State>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Tracker {
    /// Starts to report.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn start(config: &BusConfig) -> Self {
        let bus = Bus::open(config).expect("the bus opens");
        let state: Arc<State> = Arc::default();
        state.source.store(source_id::random(), Ordering::SeqCst);
        let reporting = Arc::clone(&state);
        let thread = thread::spawn(move || report(&bus, &reporting));
        Self { state, thread: Mutex::new(Some(thread)) }
    }

    /// Adds this to the time of its later reports, in ns.
    pub fn shift_clock(&self, shift_ns: i64) {
        self.state.clock_shift_ns.store(shift_ns, Ordering::SeqCst);
    }

    /// Ends its reports until [`Tracker::resume`].
    pub fn pause(&self) {
        self.state.paused.store(true, Ordering::SeqCst);
    }

    /// Reports again.
    pub fn resume(&self) {
        self.state.paused.store(false, Ordering::SeqCst);
    }

    /// Takes a new source id, as after a restart.
    pub fn change_source(&self) {
        self.state.source.store(source_id::random(), Ordering::SeqCst);
    }
}

impl Drop for Tracker {
    fn drop(&mut self) {
        self.state.ended.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.lock().ok().and_then(|mut thread| thread.take()) {
            // A panic of the thread was printed already.
            let _ = thread.join();
        }
    }
}

fn report(bus: &Bus, state: &State) {
    let publisher = |key: &str| bus.publisher(key, Class::RealTimeDrop).expect("the key is valid");
    let (of_users, of_channel) = (publisher(&bus.room().users()), publisher(&bus.room().channel()));
    let (mut due, mut tick, mut sequence, mut source) = (Instant::now(), 0, 0, 0);
    while !state.ended.load(Ordering::SeqCst) {
        due = (due + PERIOD).max(Instant::now());
        thread::sleep(due.saturating_duration_since(Instant::now()));
        if state.paused.load(Ordering::SeqCst) {
            continue;
        }
        let present = state.source.load(Ordering::SeqCst);
        sequence = if present == source { sequence + 1 } else { 1 };
        (source, tick) = (present, tick + 1);
        let time_ns = utc_ns().saturating_add_signed(state.clock_shift_ns.load(Ordering::SeqCst));
        let stamp = Stamp { source, sequence, time_ns };
        let channel = ChannelReport { stamp, tick, users: (0..USERS).map(gains).collect() };
        let users = UserReport { stamp, tick, users: (0..USERS).map(user).collect() };
        // The user report completes the tick.
        of_channel.put(&encoded(&channel)).expect("the session is open");
        of_users.put(&encoded(&users)).expect("the session is open");
    }
}

fn user(user: u32) -> UserState {
    let position_m = [user as f32 - 2.0, 0.5 * user as f32 - 1.0, 0.85];
    UserState { user, position_m, velocity_m_s: [0.0, 0.0], min_rate_bps: 1e6 }
}

fn gains(user: u32) -> UserChannel {
    UserChannel { user, los_gain: 1e-6, irs_gain: 1e-6, sinr: 10.0 }
}
