//! What the processes of a benchmark use: processor time and bytes on the loopback device.

use std::fs;
use std::ops::{AddAssign, Sub};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result};
use heliostat_bus::router_settings;
use serde::Serialize;

/// Units of the times in /proc/PID/stat a second: USER_HZ, a constant of the interface of Linux.
const USER_HZ: f64 = 100.0;

/// What was used up to an instant, or between two instants.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    /// Processor time of the controllers in s.
    pub controllers_s: f64,
    /// Processor time of the router in s.
    pub router_s: f64,
    /// Bytes on the loopback device of this network namespace.
    pub loopback_bytes: f64,
}

impl Usage {
    /// The use of these processes up to now; zero where the system does not tell.
    pub fn now(controllers: &[u32], router: Option<u32>) -> Self {
        // The files in /sys can be those of another network namespace.
        let devices = fs::read_to_string("/proc/self/net/dev").unwrap_or_default();
        Self {
            controllers_s: controllers.iter().map(|id| processor_s(*id)).sum(),
            router_s: router.map_or(0.0, processor_s),
            loopback_bytes: sent_bytes(&devices).unwrap_or_default(),
        }
    }

    /// The use for each of `reports` reports.
    pub fn of_a_report(self, reports: u64) -> ReportUsage {
        let share = 1.0 / reports.max(1) as f64;
        ReportUsage {
            controller_us: self.controllers_s * 1e6 * share,
            router_us: self.router_s * 1e6 * share,
            loopback_bytes: self.loopback_bytes * share,
        }
    }
}

impl Sub for Usage {
    type Output = Self;

    fn sub(self, before: Self) -> Self {
        Self {
            controllers_s: self.controllers_s - before.controllers_s,
            router_s: self.router_s - before.router_s,
            loopback_bytes: self.loopback_bytes - before.loopback_bytes,
        }
    }
}

impl AddAssign for Usage {
    fn add_assign(&mut self, more: Self) {
        self.controllers_s += more.controllers_s;
        self.router_s += more.router_s;
        self.loopback_bytes += more.loopback_bytes;
    }
}

/// What one report of a room uses, with its command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReportUsage {
    /// Processor time of the controllers in us.
    pub controller_us: f64,
    /// Processor time of the router in us.
    pub router_us: f64,
    /// Bytes on the loopback device, of all processes of this network namespace.
    pub loopback_bytes: f64,
}

/// Processor time of all threads of a process in s.
fn processor_s(id: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    units(&stat).map_or(0.0, |units| units / USER_HZ)
}

/// Bytes that were sent on the loopback device, in the text of /proc/PID/net/dev.
fn sent_bytes(devices: &str) -> Option<f64> {
    let fields = devices.lines().find_map(|line| line.trim_start().strip_prefix("lo:"))?;
    fields.split_whitespace().nth(8)?.parse().ok()
}

/// Time in user and in kernel mode in the text of /proc/PID/stat.
fn units(stat: &str) -> Option<f64> {
    // The name of the program may hold spaces and parentheses; the fields after it are numbered from 3.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let number = |field: usize| fields.get(field - 3)?.parse::<f64>().ok();
    Some(number(14)? + number(15)?)
}

/// A running Zenoh router; dropping it ends it.
pub struct Router(Child);

impl Router {
    /// Starts a router that listens at an endpoint, with the settings of every router.
    ///
    /// # Errors
    /// The program does not start.
    pub fn start(program: &str, endpoint: &str) -> Result<Self> {
        let mut command = Command::new(program);
        command.args(["--listen", endpoint]).args(flags());
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let router = command.spawn().with_context(|| {
            format!("cannot start {program}; expected the program zenohd, which docs/deploy.md builds")
        })?;
        Ok(Self(router))
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.0.id()
    }
}

/// The settings of every router as flags of zenohd.
fn flags() -> impl Iterator<Item = String> {
    router_settings().into_iter().flat_map(|(key, value)| ["--cfg".to_owned(), format!("{key}:{value}")])
}

impl Drop for Router {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_time_is_found_behind_any_name() {
        let stat = "7 (a) b (c) S 1 7 7 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 9 0 100";
        assert_eq!(units(stat), Some(300.0));
        assert_eq!(units("7 (a) S 1"), None);
    }

    #[test]
    fn the_sent_bytes_are_those_of_the_loopback_device() {
        let devices =
            "Inter-| Receive | Transmit\n  eth0: 1 2 0 0 0 0 0 0 3 4\n    lo: 10 2 0 0 0 0 0 0 30 4 0 0 0 0 0 0\n";
        assert_eq!(sent_bytes(devices), Some(30.0));
        assert_eq!(sent_bytes("  eth0: 1 2 0 0 0 0 0 0 3 4"), None);
    }

    #[test]
    fn the_router_has_the_settings_of_every_router_as_flags() {
        let flags: Vec<String> = flags().collect();
        assert_eq!(flags.len(), 2 * router_settings().len());
        for setting in ["mode:\"router\"", "transport/link/tx/queue/congestion_control/block/wait_before_close:50000"] {
            assert!(flags.windows(2).any(|two| two == ["--cfg", setting]), "{setting}: {flags:?}");
        }
    }

    #[test]
    fn a_use_is_divided_by_the_reports() {
        let mut used = Usage::default();
        let before = Usage { controllers_s: 1.0, router_s: 0.5, loopback_bytes: 100.0 };
        used += Usage { controllers_s: 1.5, router_s: 0.75, loopback_bytes: 4100.0 } - before;
        let one = used.of_a_report(1000);
        assert_eq!((one.controller_us, one.router_us, one.loopback_bytes), (500.0, 250.0, 4.0));
    }
}
