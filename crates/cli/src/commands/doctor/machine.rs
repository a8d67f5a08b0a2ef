//! Checks of the machine: clock, permissions, processors.

use std::fs;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use super::check::Check;

/// Time between two readings of both clocks.
const CLOCK_WATCH: Duration = Duration::from_millis(200);
/// A larger difference between the clocks in that time counts as a step.
const STEP_MIN: Duration = Duration::from_millis(2);
/// Number of measured wake-ups.
const WAKE_UPS: usize = 100;
/// A wake-up with this delay takes half of the latency budget of a decision, 0.5 ms.
const LATE_WAKE_UP: Duration = Duration::from_micros(250);

/// All checks of the machine.
pub(super) fn checks() -> Vec<Check> {
    let mut checks = vec![clock_source(), clock_steps(), clock_synchronised(), wake_ups()];
    checks.extend(limits());
    checks.extend([governor(), cores(), load()]);
    checks
}

fn text(path: &str) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().to_owned())
}

fn clock_source() -> Check {
    let begun = Instant::now();
    let mut last = begun;
    let mut smallest = Duration::MAX;
    while begun.elapsed() < Duration::from_millis(5) {
        let now = Instant::now();
        if now > last {
            smallest = smallest.min(now - last);
        }
        last = now;
    }
    let steps = format!("steps of {} ns", smallest.as_nanos());
    match text("/sys/devices/system/clocksource/clocksource0/current_clocksource") {
        None => Check::ok("clock", format!("source unknown, {steps}")),
        Some(source)
            if matches!(source.as_str(), "tsc" | "arch_sys_counter" | "kvm-clock" | "hyperv_clocksource_tsc_page") =>
        {
            Check::ok("clock", format!("{source}, {steps}"))
        }
        Some(source) => Check::warn(
            "clock",
            format!("{source}, {steps}"),
            "reading this clock is slow; if the processor has a constant TSC, boot with clocksource=tsc",
        ),
    }
}

fn clock_steps() -> Check {
    let (monotonic, utc) = (Instant::now(), SystemTime::now());
    thread::sleep(CLOCK_WATCH);
    let by_utc = SystemTime::now().duration_since(utc).unwrap_or_default();
    let apart = by_utc.abs_diff(monotonic.elapsed());
    let found =
        format!("UTC and the monotonic clock differ by {} us after {} ms", apart.as_micros(), CLOCK_WATCH.as_millis());
    if apart < STEP_MIN {
        Check::ok("clock steps", found)
    } else {
        Check::warn("clock steps", found, "UTC is set in steps: let NTP slew it (chrony: no makestep after the start)")
    }
}

fn clock_synchronised() -> Check {
    let name = "clock NTP";
    let answer = Command::new("timedatectl").args(["show", "-p", "NTPSynchronized", "--value"]).output();
    let answer = answer.ok().filter(|output| output.status.success());
    match answer.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).as_deref() {
        Some("yes") => Check::ok(name, "synchronised"),
        Some("no") => Check::warn(
            name,
            "not synchronised",
            "the clocks of several machines must agree to a small part of control.validity_ms: run chrony or systemd-timesyncd",
        ),
        _ => Check::warn(
            name,
            "unknown: timedatectl gave no answer",
            "on one machine no action is needed; on several, synchronise their clocks with NTP",
        ),
    }
}

fn wake_ups() -> Check {
    let pause = Duration::from_millis(1);
    let mut late: Vec<Duration> = (0..WAKE_UPS)
        .map(|_| {
            let begun = Instant::now();
            thread::sleep(pause);
            begun.elapsed().saturating_sub(pause)
        })
        .collect();
    late.sort_unstable();
    let (median, p99) = (late[WAKE_UPS / 2], late[WAKE_UPS * 99 / 100]);
    let found = format!("late by {} us (median), {} us (99th percentile)", median.as_micros(), p99.as_micros());
    if p99 < LATE_WAKE_UP {
        Check::ok("wake-ups", found)
    } else {
        Check::warn(
            "wake-ups",
            found,
            "some decisions will take more than 0.5 ms: give the processes real-time priority, and reduce other load",
        )
    }
}

#[cfg(target_os = "linux")]
fn limits() -> Vec<Check> {
    use nix::sys::resource::{Resource, getrlimit};

    let limit = |resource| getrlimit(resource).map_or(0, |(soft, _)| soft);
    // Bits of the effective capabilities, see capabilities(7).
    let (ipc_lock, sys_nice) = (14, 23);
    vec![
        memory_lock(limit(Resource::RLIMIT_MEMLOCK), has_capability(ipc_lock)),
        real_time(limit(Resource::RLIMIT_RTPRIO), has_capability(sys_nice)),
    ]
}

/// Whether a controller may lock its memory, by its limit in bytes or by the capability IPC_LOCK.
#[cfg(target_os = "linux")]
fn memory_lock(limit: u64, has_ipc_lock: bool) -> Check {
    /// Memory that a controller with its buffers and a model locks at most, in bytes.
    const NEEDED: u64 = 256 << 20;

    let name = "memory lock";
    let found = match (limit, has_ipc_lock) {
        (u64::MAX, _) => "unlimited".to_owned(),
        (_, true) => "unlimited: this process has CAP_IPC_LOCK".to_owned(),
        (bytes, false) => format!("{} KiB may be locked", bytes >> 10),
    };
    if has_ipc_lock || limit >= NEEDED {
        return Check::ok(name, found);
    }
    Check::warn(
        name,
        found,
        "pages of the controller may be swapped out: set LimitMEMLOCK=infinity in its unit, or memlock in /etc/security/limits.d",
    )
}

/// Whether a process may take real-time priority, by its limit or by the capability SYS_NICE.
#[cfg(target_os = "linux")]
fn real_time(limit: u64, has_sys_nice: bool) -> Check {
    /// The priority that the units in deploy/systemd request.
    const NEEDED: u64 = 50;

    let name = "real time";
    let found = match (limit, has_sys_nice) {
        (_, true) => "every real-time priority: this process has CAP_SYS_NICE".to_owned(),
        (0, false) => "no real-time priority".to_owned(),
        (priority, false) => format!("real-time priority up to {priority}"),
    };
    if has_sys_nice || limit >= NEEDED {
        return Check::ok(name, found);
    }
    let advice = format!(
        "other processes delay decisions: set LimitRTPRIO={NEEDED} in its unit, or rtprio in /etc/security/limits.d"
    );
    Check::warn(name, found, advice)
}

#[cfg(not(target_os = "linux"))]
fn limits() -> Vec<Check> {
    vec![Check::warn("permissions", "checked on Linux only", "measure instead: heliostat demo --seconds 20")]
}

#[cfg(target_os = "linux")]
fn has_capability(bit: u32) -> bool {
    let status = text("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    effective.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok()).is_some_and(|mask| mask >> bit & 1 == 1)
}

fn governor() -> Check {
    let name = "CPU governor";
    let governors: Vec<String> =
        (0..).map_while(|cpu| text(&format!("/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor"))).collect();
    match governors.iter().find(|governor| *governor != "performance") {
        None if governors.is_empty() => Check::ok(name, "none: the frequency of this machine cannot be set"),
        None => Check::ok(name, "performance"),
        Some(other) => Check::warn(
            name,
            other.clone(),
            "the processor slows down between reports, so decisions take longer: cpupower frequency-set -g performance",
        ),
    }
}

fn cores() -> Check {
    let count = thread::available_parallelism().map_or(1, usize::from);
    let shared = text("/proc/cpuinfo").is_some_and(|info| info.contains(" hypervisor"));
    let found = format!("{count}{}", if shared { ", virtual" } else { "" });
    match (count, shared) {
        (4.., false) => Check::ok("cores", found),
        (4.., true) => {
            Check::warn("cores", found, "virtual cores may be shared: pin them to the guest if latency matters")
        }
        _ => Check::warn(
            "cores",
            found,
            "simulator, controller and live page share them; with four or more each has its own",
        ),
    }
}

fn load() -> Check {
    let cores = thread::available_parallelism().map_or(1, usize::from) as f64;
    let Some(load) = text("/proc/loadavg").and_then(|text| text.split(' ').next()?.parse::<f64>().ok()) else {
        return Check::unknown("load", "not known");
    };
    let found = format!("{load:.1} on {cores} cores");
    if load <= 0.5 * cores {
        Check::ok("load", found)
    } else {
        Check::warn("load", found, "other processes use the cores that decisions need; measure when they have ended")
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::super::check::Verdict;
    use super::*;

    #[test]
    fn a_permission_by_capability_is_named_in_place_of_the_limit_that_does_not_bind() {
        let real_time = [(0, false), (0, true), (20, false), (50, false)].map(|(limit, capable)| {
            let Check { verdict, found, .. } = real_time(limit, capable);
            (verdict, found)
        });
        let expected = [
            (Verdict::Warn, "no real-time priority"),
            (Verdict::Ok, "every real-time priority: this process has CAP_SYS_NICE"),
            (Verdict::Warn, "real-time priority up to 20"),
            (Verdict::Ok, "real-time priority up to 50"),
        ];
        assert_eq!(real_time, expected.map(|(verdict, found)| (verdict, found.to_owned())));
        let by_capability = memory_lock(64 << 10, true);
        assert_eq!((by_capability.verdict, by_capability.found.contains("KiB")), (Verdict::Ok, false));
        let by_limit = memory_lock(64 << 10, false);
        assert_eq!((by_limit.verdict, by_limit.found.as_str()), (Verdict::Warn, "64 KiB may be locked"));
    }
}
