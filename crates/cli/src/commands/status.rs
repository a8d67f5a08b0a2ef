//! `heliostat status`: the state of a running room, once.

use std::thread;
use std::time::Duration;

use anyhow::{Result, anyhow, bail};
use heliostat_bus::{AccessRole, BusArgs};
use heliostat_service::counted::counted;
use heliostat_service::outln;
use heliostat_ui::View;
use heliostat_ui::status::RoomStatus;

use super::join::join;
use super::keys::first_end;

/// Each process publishes its status once a second. A problem is present where its count rises between two.
const OBSERVED: Duration = Duration::from_millis(2300);

/// Print the state of a running room once: controllers, arrays, stops, reports, problems.
///
/// It observes the room for more than two seconds. The exit status is 0 if the room is healthy, otherwise 1.
///
/// In a healthy room a controller leads, or a calibration commands the mirrors. Position reports arrive here,
/// or a controller decides on them. Every array follows, and each controller reports. No standby refuses the
/// reports or has gone, and no stop is in force. The expected light arrives, and telemetry is at most 50 ms old when it
/// arrives here. No process reports a problem whose cause recurs.
///
/// Connect to one process of the room, which passes on the messages of those to which it is connected, or to
/// their router; with --tls, to each process or to their router. `heliostat ui` shows the same figures
/// continuously; `heliostat doctor` checks a machine before a run.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    bus: BusArgs,
    /// Print the state as one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let config = args.bus.config_or_connect(&[AccessRole::Viewer, AccessRole::Operator])?;
    let advice = "Give --connect the endpoints of the room's process and of the controller, or of their router";
    let bus = join(&config, OBSERVED).map_err(|unconnected| anyhow!(unconnected.with_advice(advice)))?;
    let view = View::open(&bus, None)?;
    thread::sleep(OBSERVED);
    let mut status = RoomStatus::new(config.room.name(), &view);
    let first_end = args.bus.tls.tls.as_ref().and_then(|folder| first_end(folder).ok().flatten());
    let ends_soon = first_end.and_then(|(certificate, is_soon)| is_soon.then_some(certificate));
    status.figures.remarks.extend(ends_soon.map(|certificate| format!("certificate: {certificate}; renew it")));
    if args.json {
        outln!("{}", serde_json::to_string(&status)?)?;
    } else {
        outln!("{}", status.to_string().trim_end())?;
    }
    drop(view);
    bus.close()?;
    match status.problems.len() {
        0 => Ok(()),
        count => bail!("room {}: {}", status.room, counted(count, "problem")),
    }
}
