//! The controller process of `bench loop --driver`: it also drives an array, whose device notes when
//! it gets angles.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use heliostat_channel::MirrorAngles;
use heliostat_controller::report::summary::Summary;
use heliostat_driver::run::Settings;
use heliostat_driver::stop_record::StopRecordSettings;
use heliostat_driver::{Device, DeviceError, Kit};
use heliostat_proto::{AxisLimits, Capabilities, Feedback, MirrorCommand, decode_into};
use heliostat_service::{locks::lock, outln};
use serde::{Deserialize, Serialize};

use crate::{one_process, platform};
use heliostat_array::moment::Moment;

/// Range of the mirrors, in rad; it reaches all of the floor.
const RANGE_RAD: f32 = 1.4;
/// The array never parks between two blocks of reports.
const PARK_AFTER_MS: u32 = 60_000;
/// Commands for which memory is allocated in advance.
const EXPECTED_COMMANDS: usize = 1 << 18;

/// Run a controller with an array whose device notes when it gets angles.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    controller: heliostat_controller::cli::Args,
}

/// The last line of the process.
#[derive(Debug, Serialize, Deserialize)]
pub struct Outcome {
    /// The summary of the controller.
    pub summary: Summary,
    /// For each command the tick that it answers, and when the device got its angles, by
    /// [`monotonic_ns`].
    pub applied: Vec<(u64, u64)>,
}

/// Time of the monotonic clock of this machine in ns, which its processes share.
///
/// # Errors
/// The system has no such clock.
pub fn monotonic_ns() -> Result<u64> {
    Ok(platform::shared_clock()?.as_nanos() as u64)
}

/// The instant of a time by [`monotonic_ns`].
///
/// # Errors
/// As there.
pub fn instant_of(ns: u64) -> Result<Instant> {
    let (now, now_ns) = (Instant::now(), monotonic_ns()?);
    Ok(now - Duration::from_nanos(now_ns.saturating_sub(ns)))
}

/// Runs the process.
pub fn run(args: Args) -> Result<()> {
    let mut controller = args.controller.prepare()?;
    let bus = one_process::array_session(&mut controller.config.bus, &[])?;
    let array = controller.config.scenario.mirrors.first();
    let log: Arc<Mutex<Log>> = Arc::default();
    let device = NotingDevice { rows: array.rows as u32, columns: array.columns as u32, log: Arc::clone(&log) };
    let state = std::env::temp_dir().join(format!("heliostat-bench-{}", std::process::id()));
    let record = StopRecordSettings { directory: Some(state.clone()), start_armed: true };
    let settings = Settings { record, ..Settings::new(bus) };
    let noted = Arc::clone(&log);
    let both = one_process::run(&controller, Kit::new(device), &settings, move |mut direct| {
        let mut command = MirrorCommand::default();
        lock(&noted).times_ns.reserve(EXPECTED_COMMANDS);
        Box::new(move |payload| {
            lock(&noted).is_commanded = true;
            direct.apply(payload);
            // After the device has its angles, so that this is not measured.
            if decode_into(&mut command, payload).is_ok() {
                lock(&noted).ticks.push(command.answers);
            }
        })
    });
    // The folder is temporary; a failure leaves a small file behind.
    drop(std::fs::remove_dir_all(state));
    let (summary, _) = both?;
    let Log { ticks, times_ns, .. } = std::mem::take(&mut *lock(&log));
    ensure!(
        ticks.len() == times_ns.len(),
        "the device got angles {} times for {} commands; expected once for each: a command was refused or lost",
        times_ns.len(),
        ticks.len()
    );
    let applied = ticks.into_iter().zip(times_ns).collect();
    outln!("{}", serde_json::to_string(&Outcome { summary, applied })?)?;
    Ok(())
}

/// What the device and the entry of commands note. Both handle the commands in one order.
#[derive(Debug, Default)]
struct Log {
    /// Whether a command has arrived: the angles before it are the park position.
    is_commanded: bool,
    /// The tick that each command answers.
    ticks: Vec<u64>,
    /// When the device got the angles of each.
    times_ns: Vec<u64>,
}

struct NotingDevice {
    rows: u32,
    columns: u32,
    log: Arc<Mutex<Log>>,
}

impl Device for NotingDevice {
    fn capabilities(&self) -> Capabilities {
        let axis = AxisLimits { min_rad: -RANGE_RAD, max_rad: RANGE_RAD, ..AxisLimits::default() };
        Capabilities {
            hardware: "a device that notes when it gets angles".into(),
            driver: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            rows: self.rows,
            columns: self.columns,
            roll: axis,
            yaw: axis,
            feedback: Feedback::OpenLoop,
            park_after_ms: PARK_AFTER_MS,
            ..Capabilities::default()
        }
    }

    fn apply(&mut self, _now: Moment, _angles: &MirrorAngles) -> Result<(), DeviceError> {
        let time_ns = monotonic_ns().map_err(|error| DeviceError::new("clock", error))?;
        let mut log = lock(&self.log);
        if log.is_commanded {
            log.times_ns.push(time_ns);
        }
        Ok(())
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instant_of_the_shared_clock_lies_between_its_neighbours() {
        let before = Instant::now();
        let noted = monotonic_ns().expect("a clock");
        let after = Instant::now();
        let instant = instant_of(noted).expect("a clock");
        // The two readings of `instant_of` are not simultaneous.
        let slack = Duration::from_millis(100);
        assert!(before - slack < instant && instant < after + slack);
    }
}
