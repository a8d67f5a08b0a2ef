//! The flags of `heliostat doctor`.

use std::path::PathBuf;

use heliostat_bus::TlsArgs;
use heliostat_controller::cli::RangeArgs;
use heliostat_driver::cli::array_index;
use heliostat_models::PolicyArgs;
use heliostat_scenario::ScenarioArgs;

/// The port of [`heliostat_bus::DEFAULT_ENDPOINT`].
const DEFAULT_PORT: u16 = 7447;

/// Check what a run needs: scenario, policy, driver, ports, clock, permissions, processors.
///
/// Each line holds ok, warn, fail or ?, what was found, and what to do; ? marks what could not be checked. The exit status is 1 if a
/// check fails. A warning concerns speed, accuracy or a process that does not answer; a run is still possible.
///
/// With --connect, it compares the scenario and the controller that leads with the geometry that a simulated room
/// announces. With the files of a calibration too, it compares them with the running room: the array, the
/// calibration in use, the controller's geometry, and the light of served users.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    #[command(flatten)]
    pub policy: PolicyArgs,
    /// Name of the room [default: the room of --tls, or demo]
    #[arg(long, value_name = "NAME")]
    pub room: Option<String>,
    /// Endpoint of a driver or simulator whose capabilities are checked (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Endpoint at which to listen, for a room whose processes connect to this one (repeatable)
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Look at the room through the Zenoh router given by --connect
    #[arg(long, requires = "connect")]
    pub client: bool,
    #[command(flatten)]
    pub tls: TlsArgs,
    /// The --out of `heliostat calibrate`, to compare with the array
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// The --room-out of `heliostat calibrate`, to compare with the controller
    #[arg(long, value_name = "FILE")]
    pub measured: Option<PathBuf>,
    /// Index of the array of --calibration, from 0
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = array_index)]
    pub array: usize,
    #[command(flatten)]
    pub range: RangeArgs,
    /// Port of 127.0.0.1 that must be free (repeatable) [default: 7447, or none with --connect or --listen]
    #[arg(long, value_name = "PORT", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Vec<u16>,
    /// Print the checks as one JSON object
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// Whether the flags name a room to look at.
    pub fn joins(&self) -> bool {
        !self.connect.is_empty() || !self.listen.is_empty()
    }

    /// The ports that must be free, each with a remark where no flag names it.
    pub fn ports(&self) -> Vec<(u16, &'static str)> {
        if self.port.is_empty() && !self.joins() {
            return vec![(DEFAULT_PORT, " (default, --port names another one)")];
        }
        self.port.iter().map(|port| (*port, "")).collect()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn a_client_of_a_router_names_the_router() {
        assert!(Flags::parse_from(["doctor", "--client", "--connect", "tcp/127.0.0.1:7"]).args.client);
        assert!(Flags::try_parse_from(["doctor", "--client"]).is_err());
    }

    #[test]
    fn a_port_that_no_flag_names_is_marked_and_left_out_where_flags_name_the_room() {
        let ports = |flags: &[&str]| Flags::parse_from([&["doctor"][..], flags].concat()).args.ports();
        let [(port, remark)] = ports(&[])[..] else { panic!("one port") };
        assert!(heliostat_bus::DEFAULT_ENDPOINT.ends_with(&format!(":{port}")) && remark.contains("default"));
        assert_eq!(ports(&["--port", "7"]), [(7, "")]);
        assert!(ports(&["--connect", "tcp/127.0.0.1:7"]).is_empty());
        assert_eq!(ports(&["--listen", "tcp/127.0.0.1:7", "--port", "8"]), [(8, "")]);
    }
}
