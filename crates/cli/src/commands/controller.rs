//! `heliostat controller`: the controller process, and with `--driver` an array in the same process.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use anyhow::Result;
use heliostat_controller::room_runtime::transport::TakeCommand;
use heliostat_driver::cli::DrivenArgs;
use heliostat_driver::direct_commands::DirectCommands;
use heliostat_driver::run::Settings;
use heliostat_service::exporter::socket_address;
use heliostat_service::{MetricsArgs, output};
use serde_json::Value;

use crate::one_process;

// The help text is that of the controller's flags.
#[derive(Debug, clap::Args)]
#[command(
    mut_arg("calibration", |flag| flag.requires("driver")),
    mut_arg("state", |flag| flag.requires("driver")),
    mut_arg("start_armed", |flag| flag.requires("driver")),
    mut_arg("array", |flag| flag.requires("driver"))
)]
pub struct Args {
    #[command(flatten)]
    controller: heliostat_controller::cli::Args,
    /// Also drive the array of this file (see `heliostat driver run --config`), in this process: each
    /// command reaches it without a second socket. For a testbed on one host: both end together
    #[arg(long, value_name = "FILE", conflicts_with_all = ["lockstep", "also_room"])]
    driver: Option<PathBuf>,
    #[command(flatten)]
    driven: DrivenArgs,
    /// Endpoint at which the array's session listens (repeatable), for operators, viewers and other
    /// controllers. It connects to the endpoints of --connect too
    #[arg(long, value_name = "ENDPOINT", requires = "driver", conflicts_with = "client")]
    driver_listen: Vec<String>,
    /// Serve the metrics of the array at http://ADDRESS/metrics
    #[arg(long, value_name = "ADDRESS", value_parser = socket_address, requires = "driver")]
    driver_metrics_listen: Option<SocketAddr>,
}

/// Runs the command.
///
/// # Errors
/// If the controller or the driver cannot start; the message states what to do.
pub fn run(args: Args) -> Result<()> {
    match args.driver.clone() {
        Some(file) => run_both(args, &file),
        None => heliostat_controller::cli::run(args.controller),
    }
}

fn run_both(args: Args, file: &Path) -> Result<()> {
    let kit = args.driven.kit(file)?;
    let mut controller = args.controller.prepare()?;
    let bus = one_process::array_session(&mut controller.config.bus, &args.driver_listen)?;
    let metrics = MetricsArgs { metrics_listen: args.driver_metrics_listen };
    let settings = Settings { metrics, ..args.driven.settings(bus) };
    let direct = |mut direct: DirectCommands<_>| -> TakeCommand { Box::new(move |payload| direct.apply(payload)) };
    let (summary, driven) = one_process::run(&controller, kit, &settings, direct)?;
    if controller.json {
        let mut json = serde_json::to_value(&summary)?;
        if let Value::Object(fields) = &mut json {
            fields.insert("driver".to_owned(), serde_json::to_value(&driven)?);
        }
        output::line(json)?;
    } else {
        output::line(summary)?;
        output::text(driven)?;
    }
    Ok(())
}
