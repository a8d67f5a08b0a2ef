//! Commit, machine and time of a computation.

use std::time::SystemTime;

use cpu_time::ProcessTime;

pub use heliostat_learn::training::card::hardware;

/// The commit of this build, followed by `+changes` if the working copy was modified.
pub const COMMIT: &str = env!("HELIOSTAT_COMMIT");

/// Now, in UTC, to the second.
pub fn now() -> String {
    humantime::format_rfc3339_seconds(SystemTime::now()).to_string()
}

/// Processor time of this process so far in s.
pub fn cpu_s() -> f64 {
    ProcessTime::now().as_duration().as_secs_f64()
}

/// Cores that this process may use.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The load average over the last minute, if the system reports it.
pub fn load() -> Option<f64> {
    std::fs::read_to_string("/proc/loadavg").ok()?.split(' ').next()?.parse().ok()
}
