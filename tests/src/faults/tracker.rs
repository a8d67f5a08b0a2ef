//! A tracker that reports users at rest, for rooms whose array is a driver.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use heliostat_bus::{Bus, BusConfig, Class};
use heliostat_proto::{ChannelReport, Stamp, UserChannel, UserReport, UserState};
use heliostat_service::clock::utc_ns;
use heliostat_service::source_id;

use crate::observer::encoded;

/// Time between two reports, the default of the scenarios.
pub const PERIOD: Duration = Duration::from_millis(10);

/// Users in the default scenario.
const USERS: u32 = 5;

/// A tracker; dropping it ends its reports.
pub struct Tracker {
    ended: Arc<AtomicBool>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Tracker {
    /// Starts to report.
    ///
    /// # Panics
    /// When the bus does not open.
    pub fn start(config: &BusConfig) -> Self {
        let bus = Bus::open(config).expect("the bus opens");
        let ended = Arc::<AtomicBool>::default();
        let reporting = Arc::clone(&ended);
        let thread = thread::spawn(move || report(&bus, &reporting));
        Self { ended, thread: Mutex::new(Some(thread)) }
    }
}

impl Drop for Tracker {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.lock().ok().and_then(|mut thread| thread.take()) {
            // A panic of the thread was printed already.
            let _ = thread.join();
        }
    }
}

fn report(bus: &Bus, ended: &AtomicBool) {
    let publisher = |key: &str| bus.publisher(key, Class::RealTimeDrop).expect("the key is valid");
    let (of_users, of_channel) = (publisher(&bus.room().users()), publisher(&bus.room().channel()));
    let (mut due, mut tick, source) = (Instant::now(), 0, source_id::random());
    while !ended.load(Ordering::SeqCst) {
        due = (due + PERIOD).max(Instant::now());
        thread::sleep(due.saturating_duration_since(Instant::now()));
        tick += 1;
        let users = users_at_rest(source, tick);
        let channel = ChannelReport { stamp: users.stamp, tick, users: (0..USERS).map(gains).collect() };
        // The user report completes the tick.
        of_channel.put(&encoded(&channel)).expect("the session is open");
        of_users.put(&encoded(&users)).expect("the session is open");
    }
}

/// A report of users at rest.
pub fn users_at_rest(source: u64, tick: u64) -> UserReport {
    let stamp = Stamp { source, sequence: tick, time_ns: utc_ns() };
    UserReport { stamp, tick, users: (0..USERS).map(user).collect() }
}

fn user(user: u32) -> UserState {
    let position_m = [user as f32 - 2.0, 0.5 * user as f32 - 1.0, 0.85];
    UserState { user, position_m, velocity_m_s: [0.0, 0.0], min_rate_bps: 1e6 }
}

fn gains(user: u32) -> UserChannel {
    UserChannel { user, los_gain: 1e-6, irs_gain: 1e-6, sinr: 10.0 }
}
