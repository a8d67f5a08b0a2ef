//! Limits of one input: a reader that allocates or computes without bound fails, although it does
//! not crash.

use std::io::{self, Write as _};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Mutex, Once};
use std::thread;
use std::time::{Duration, Instant};

use heliostat_service::locks::lock;

/// Largest memory in use at a time, in bytes; the largest sound input needs a small part of it.
const MEMORY_MAX: u64 = 256 << 20;

/// Longest time; a sound input takes a small part of it, on a busy machine too.
const TIME_MAX: Duration = Duration::from_secs(30);

/// The inputs that are running, each with the thread that runs it and its start.
static RUNNING: Mutex<Vec<(thread::ThreadId, Instant, Vec<u8>)>> = Mutex::new(Vec::new());

/// Runs a reader on an input, and fails if it exceeds the limits.
///
/// A thread that hangs cannot be stopped. The process then prints the input and aborts.
pub fn within_bounds(input: &[u8], run: impl FnOnce()) {
    static WATCHDOG: Once = Once::new();
    WATCHDOG.call_once(|| drop(thread::spawn(watch)));
    let this = thread::current().id();
    change(|running| running.push((this, Instant::now(), input.to_vec())));
    let mut outcome = Ok(());
    // A panic within `measure` would leave its counters nested.
    let memory = allocation_counter::measure(|| outcome = catch_unwind(AssertUnwindSafe(run)));
    change(|running| running.retain(|(thread, ..)| *thread != this));
    outcome.unwrap_or_else(|panic| resume_unwind(panic));
    assert!(memory.bytes_max <= MEMORY_MAX, "{} bytes in use: expected at most {MEMORY_MAX}", memory.bytes_max);
}

fn change(change: impl FnOnce(&mut Vec<(thread::ThreadId, Instant, Vec<u8>)>)) {
    change(&mut lock(&RUNNING));
}

/// Aborts the process when an input takes too long.
fn watch() {
    loop {
        thread::sleep(Duration::from_secs(1));
        change(|running| {
            if let Some((_, _, input)) = running.iter().find(|(_, start, _)| start.elapsed() > TIME_MAX) {
                let digits: String = input.iter().map(|byte| format!("{byte:02x}")).collect();
                // `eprintln!` writes to the output that the test harness keeps, and an abort loses that.
                let message = format!("an input takes longer than {TIME_MAX:?}; its bytes are {digits}\n");
                drop(io::stderr().write_all(message.as_bytes()));
                std::process::abort();
            }
        });
    }
}
