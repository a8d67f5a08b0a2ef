//! `heliostat stop` and `heliostat rearm`: the emergency stop from the command line.

use std::time::Duration;

use anyhow::Result;
use heliostat_bus::{AccessRole, Bus, BusArgs};
use heliostat_proto::SafetyReport;
use heliostat_service::{duration, output};
use heliostat_ui::StopSwitch;
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
    #[arg(long, value_name = "N", default_value = "5", value_parser = duration::seconds, allow_negative_numbers = true)]
    timeout: Duration,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `heliostat stop`.
pub fn stop(args: StopArgs) -> Result<()> {
    let OrderArgs { reason, timeout, .. } = &args.order;
    // Every role may stop the array, so any certificate of the folder serves.
    let (bus, switch) = args.order.join(&[&[AccessRole::Operator], &AccessRole::ALL[..]].concat())?;
    let took = switch.stop_and_confirm(reason, *timeout)?;
    args.order.report(&bus, "stopped", took, None)?;
    drop(switch);
    Ok(bus.close()?)
}

/// Runs `heliostat rearm`.
pub fn rearm(args: RearmArgs) -> Result<()> {
    let OrderArgs { reason, timeout, .. } = &args.order;
    let (bus, switch) = args.order.join(&[AccessRole::Operator])?;
    let (took, stop) = switch.rearm_and_confirm(reason, *timeout)?;
    args.order.report(&bus, "released", took, stop)?;
    drop(switch);
    Ok(bus.close()?)
}

impl OrderArgs {
    fn join(&self, roles: &[AccessRole]) -> Result<(Bus, StopSwitch)> {
        let bus = Bus::open(&self.bus.config_or_connect(roles)?)?;
        let user = || std::env::var("USER").unwrap_or_else(|_| "operator".into());
        let operator = self.operator.clone().unwrap_or_else(user);
        let switch = StopSwitch::new(&bus, &operator)?;
        Ok((bus, switch))
    }

    fn report(&self, bus: &Bus, outcome: &str, took: Duration, stop: Option<SafetyReport>) -> Result<()> {
        let (room, took_ms) = (bus.room().name(), took.as_secs_f64() * 1e3);
        if self.json {
            let stop = stop.map(|SafetyReport { stop_source, stop_sequence, operator, reason, .. }| {
                json!({
                    "source": format!("{stop_source:016x}"),
                    "sequence": stop_sequence,
                    "operator": operator,
                    "reason": reason,
                })
            });
            output::line(json!({ "room": room, "array": outcome, "confirmed_after_ms": took_ms, "stop": stop }))?;
            return Ok(());
        }
        output::line(format_args!("the array of room {room} is {outcome}, confirmed after {took_ms:.1} ms"))?;
        if let Some(SafetyReport { stop_source, stop_sequence, operator, reason, .. }) = stop {
            output::line(format_args!("the stop: {stop_source:016x}/{stop_sequence} of {operator:?}: {reason:?}"))?;
        }
        Ok(())
    }
}
