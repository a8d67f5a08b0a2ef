//! The flags of `heliostat doctor`.

use std::path::PathBuf;

use heliostat_bus::TlsArgs;
use heliostat_core::policy::{NameParser, PolicyKind};
use heliostat_models::EngineChoice;
use heliostat_scenario::ScenarioArgs;

/// Check what a run needs: scenario, policy, driver, ports, clock, permissions, processors.
///
/// Each line holds ok, warn or fail, what was found, and what to do. The exit status is 1 if a
/// check fails. A warning concerns speed or accuracy; a run is still possible.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Policy of the planned run
    #[arg(long, value_enum, value_parser = NameParser::<PolicyKind>::default(), default_value_t = PolicyKind::Ddpg)]
    pub policy: PolicyKind,
    /// ONNX file of a learned policy, instead of the built-in one
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Engine of learned policies: `auto` (dense for graphs of dense layers, otherwise the embedded
    /// one), `dense`, or the embedded one by its name (`tract`, or `ort` in builds with ONNX Runtime)
    #[arg(long, default_value_t = EngineChoice::Auto)]
    pub engine: EngineChoice,
    /// Name of the room [default: the room of --tls, or demo]
    #[arg(long, value_name = "NAME")]
    pub room: Option<String>,
    /// Endpoint of a driver or simulator whose capabilities are checked (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub tls: TlsArgs,
    /// Port of 127.0.0.1 that must be free (repeatable)
    #[arg(long, value_name = "PORT", default_values_t = [7447], value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Vec<u16>,
    /// Print the checks as one JSON object
    #[arg(long)]
    pub json: bool,
}
