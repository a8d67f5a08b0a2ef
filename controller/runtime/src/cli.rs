//! The flags of the controller, for its own program and for the `heliostat` command line.

use anyhow::{Context, bail};
use heliostat_bus::{AccessRole, BusArgs};
use heliostat_core::capabilities::Force;
use heliostat_models::PolicyArgs;
use heliostat_proto::Room;
use heliostat_scenario::ScenarioArgs;
use heliostat_service::exit::UnusableInput;
use heliostat_service::{EndArgs, LogArgs, LogGuard, MetricsArgs, Stop, output};

use crate::{
    config::NodeConfig, machine::MachineArgs, node, report::summary::Summary, room_runtime::transport::LocalArray,
};

/// The flag of every command that judges the range of mirrors by the floor.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct RangeArgs {
    /// Accept mirrors whose range does not reach all of the floor
    #[arg(long)]
    pub accept_small_range: bool,
}

/// Run the controller: it receives reports and publishes mirror commands.
///
/// Without --listen or --connect it connects to tcp/127.0.0.1:7447, where sim-node listens by
/// default.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    #[command(flatten)]
    policy: PolicyArgs,
    /// Serve these rooms too (comma-separated), with the same scenario and over the same session
    #[arg(long, value_name = "ROOM", value_delimiter = ',')]
    also_room: Vec<String>,
    /// Begin the statistics of times with the report of this tick: a benchmark warms up before it
    #[arg(long, value_name = "TICK", default_value_t = 0, hide = true)]
    times_from_tick: u64,
    #[command(flatten)]
    range: RangeArgs,
    /// Send angles of a `paper` channel mode to real mirrors, which they do not aim
    #[arg(long)]
    force_paper_angles: bool,
    #[command(flatten)]
    machine: MachineArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    /// Stand by from the start. RANK is the number of reports without an accepted command after which
    /// this controller takes over [default: by source id among the controllers that it sees]. Give a
    /// RANK of its own to each controller of the room, or to none: two with one rank both take over.
    /// Without this flag, a controller stands by if the array follows another one
    #[arg(long, value_name = "RANK", conflicts_with = "lockstep", value_parser = clap::value_parser!(u8).range(1..=16))]
    standby: Option<Option<u8>>,
    /// Take time from the reports, for a room that runs in lockstep; the same reports then give the
    /// same commands
    #[arg(long)]
    lockstep: bool,
    #[command(flatten)]
    end: EndArgs,
    /// Print the summary as one JSON object on the last line
    #[arg(long)]
    json: bool,
}

impl Args {
    /// The configuration that the flags describe.
    ///
    /// # Errors
    /// If a flag or the scenario is invalid.
    pub fn node_config(&self) -> anyhow::Result<NodeConfig> {
        let policy = &self.policy;
        policy
            .actor()
            .check_used_by(policy.kind())
            .context(UnusableInput::new("--model names the file of a learned policy"))?;
        let bus = self.bus.config_or_connect(&[AccessRole::Controller])?;
        if bus.is_authenticated() && !self.also_room.is_empty() {
            bail!(UnusableInput::new(
                "--also-room: a certificate gives rights in one room only; start one controller with --tls for each room"
            ));
        }
        let rooms: Vec<&str> =
            std::iter::once(bus.room.name()).chain(self.also_room.iter().map(String::as_str)).collect();
        if let Some(twice) = rooms.iter().enumerate().find(|(index, room)| rooms[..*index].contains(room)) {
            let refused = format!("--also-room {}: this room is already named; name each room once", twice.1);
            bail!(UnusableInput::new(refused));
        }
        Ok(NodeConfig {
            scenario: self.scenario.load_arrays()?,
            bus,
            also_rooms: self.also_room.iter().map(|name| Room::new(name)).collect::<Result<_, _>>()?,
            times_from_tick: self.times_from_tick,
            policy: policy.clone(),
            force: Force { small_range: self.range.accept_small_range, paper_angles: self.force_paper_angles },
            is_lockstep: self.lockstep,
            standby: self.standby,
            run_for: self.end.seconds,
            metrics: self.metrics,
        })
    }
}

/// A controller that is ready to run.
pub struct Prepared {
    /// Its configuration.
    pub config: NodeConfig,
    /// Ends it.
    pub stop: Stop,
    /// Whether its summary is printed as JSON.
    pub json: bool,
    machine: Vec<String>,
    _log: LogGuard,
}

impl Args {
    /// Starts the log, listens for signals, and makes the requests to the operating system. Call it
    /// before any other thread starts: later threads inherit the settings.
    ///
    /// # Errors
    /// If a flag or the scenario is invalid.
    pub fn prepare(self) -> anyhow::Result<Prepared> {
        let config = self.node_config()?;
        let log = self.log.start();
        let stop = self.end.stop()?;
        let obtained = self.machine.obtain();
        for result in &obtained {
            match result {
                Ok(granted) => tracing::info!("{granted}"),
                Err(refused) => tracing::warn!("{refused}"),
            }
        }
        let machine = obtained.into_iter().map(|result| result.unwrap_or_else(|refused| refused)).collect();
        Ok(Prepared { config, stop, json: self.json, machine, _log: log })
    }
}

impl Prepared {
    /// Runs the controller until Ctrl-C, SIGTERM, the end of its time or of its parent, with the arrays
    /// of its room that this process drives.
    ///
    /// # Errors
    /// If it cannot start; the message states what to do.
    pub fn run(&self, local: Vec<LocalArray>) -> anyhow::Result<Summary> {
        let summary = node::run(&self.config, local, &self.stop)?;
        Ok(Summary { machine: self.machine.clone(), ..summary })
    }
}

/// Runs a controller until Ctrl-C, SIGTERM, the end of its time or of its parent, and prints its
/// summary.
///
/// # Errors
/// If it cannot start; the message states what to do.
pub fn run(args: Args) -> anyhow::Result<()> {
    let prepared = args.prepare()?;
    let summary = prepared.run(Vec::new())?;
    if prepared.json {
        output::line(serde_json::to_string(&summary)?)?
    } else {
        output::line(summary)?
    }
    Ok(())
}
