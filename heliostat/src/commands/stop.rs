//! `heliostat stop` and `heliostat rearm`: the emergency stop from the command line.

use std::io::{self, Write};
use std::time::Duration;

use anyhow::Result;
use heliostat_bus::{AccessRole, Bus, BusArgs};
use heliostat_service::duration;
use heliostat_ui::{StopSwitch, UiError};
use serde_json::json;

/// Stop all mirrors of a room at once, and wait until telemetry confirms it.
///
/// The stop stays in force, also over a restart of the driver, until an operator releases it with
/// `heliostat rearm`. Connect to the process that drives the mirrors, or to its router.
#[derive(Debug, clap::Args)]
pub struct StopArgs {
    #[command(flatten)]
    order: OrderArgs,
}

/// Release the emergency stop of a room, and wait until telemetry confirms it.
///
/// The re-arm names the stop that the array reports, so it does not release a later one. The
/// mirrors park; then they follow the next valid command.
#[derive(Debug, clap::Args)]
pub struct RearmArgs {
    #[command(flatten)]
    order: OrderArgs,
}

#[derive(Debug, clap::Args)]
struct OrderArgs {
    #[command(flatten)]
    bus: BusArgs,
    /// Reason, which the array reports
    #[arg(long, value_name = "TEXT", default_value = "command line")]
    reason: String,
    /// Name of the operator, which the array reports; without it, the name of the user
    #[arg(long, value_name = "NAME")]
    operator: Option<String>,
    /// Longest wait for the confirmation in seconds
    #[arg(long, value_name = "N", default_value = "5", value_parser = duration::seconds)]
    timeout: Duration,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `heliostat stop`.
pub fn stop(args: StopArgs) -> Result<()> {
    // Every role may stop.
    args.order.carry_out("stopped", &AccessRole::ALL, StopSwitch::stop_and_confirm)
}

/// Runs `heliostat rearm`.
pub fn rearm(args: RearmArgs) -> Result<()> {
    args.order.carry_out("released", &[AccessRole::Operator], StopSwitch::rearm_and_confirm)
}

impl OrderArgs {
    fn carry_out(
        self,
        outcome: &str,
        roles: &[AccessRole],
        order: impl FnOnce(&StopSwitch, &str, Duration) -> Result<Duration, UiError>,
    ) -> Result<()> {
        let config = self.bus.config_or_connect(roles)?;
        let bus = Bus::open(&config)?;
        let user = || std::env::var("USER").unwrap_or_else(|_| "operator".into());
        let switch = StopSwitch::new(&bus, &self.operator.unwrap_or_else(user))?;
        let took_ms = order(&switch, &self.reason, self.timeout)?.as_secs_f64() * 1e3;
        let room = config.room.name();
        let mut out = io::stdout();
        if self.json {
            writeln!(out, "{}", json!({ "room": room, "array": outcome, "confirmed_after_ms": took_ms }))?;
        } else {
            writeln!(out, "the array of room {room} is {outcome}, confirmed after {took_ms:.1} ms")?;
        }
        drop(switch);
        Ok(bus.close()?)
    }
}
