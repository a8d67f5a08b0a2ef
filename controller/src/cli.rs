//! The flags of the controller, for its own program and for the `heliostat` command line.

use std::{io::Write, path::PathBuf};

use anyhow::bail;
use heliostat_bus::BusArgs;
use heliostat_proto::Room;
use heliostat_scenario::ScenarioArgs;
use heliostat_service::{EndArgs, LogArgs, MetricsArgs};

use crate::{
    intake::{Deciding, KeepWarm, Place},
    machine::MachineArgs,
    node::{self, NodeConfig, Pace},
    summary::Summary,
};
use heliostat_decide::{capabilities::Force, policy::PolicyKind};
use heliostat_engine::ActorSource;

/// Run the central unit: reports in, mirror commands out.
///
/// Without --listen or --connect it connects to tcp/127.0.0.1:7447, where sim-node listens by default.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    bus: BusArgs,
    /// Which policy turns the mirrors
    #[arg(long, value_enum, default_value_t = PolicyKind::Ddpg)]
    policy: PolicyKind,
    /// ONNX file of a learned policy, in place of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Serve these rooms too (comma-separated), by the same scenario and over the same session
    #[arg(long, value_name = "ROOM", value_delimiter = ',')]
    also_room: Vec<String>,
    /// Where decisions are made
    #[arg(long, value_enum, default_value_t = Deciding::default().place)]
    decide_in: Place,
    /// Rehearse on the room's thread, so that caches stay warm: `expected` (shortly before each report, for a slow policy in a process of one room),
    /// `off`, or a pause in us between rehearsals of any policy
    #[arg(long, value_name = "WHEN", default_value_t = Deciding::default().keep_warm)]
    keep_warm: KeepWarm,
    /// Command mirrors that cannot reach all of the floor
    #[arg(long)]
    accept_small_range: bool,
    /// Send angles of a `paper` channel mode to real mirrors, where they gain nothing
    #[arg(long)]
    force_paper_angles: bool,
    #[command(flatten)]
    machine: MachineArgs,
    #[command(flatten)]
    metrics: MetricsArgs,
    #[command(flatten)]
    log: LogArgs,
    /// Take time from the reports, for a room that runs in lockstep; the same room then gets the same commands
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
    /// Whatever is wrong with a flag or with the scenario.
    pub fn node_config(&self) -> anyhow::Result<NodeConfig> {
        self.model.clone().map_or(ActorSource::Shipped, ActorSource::Path).check_used_by(self.policy)?;
        let rooms: Vec<&String> = std::iter::once(&self.bus.room).chain(&self.also_room).collect();
        if let Some(twice) = rooms.iter().enumerate().find(|(index, room)| rooms[..*index].contains(room)) {
            bail!("--also-room {}: this room is served already; name each room once", twice.1);
        }
        Ok(NodeConfig {
            scenario: self.scenario.load()?,
            bus: self.bus.config_or_connect()?,
            also_rooms: self.also_room.iter().map(|name| Room::new(name)).collect::<Result<_, _>>()?,
            deciding: Deciding { place: self.decide_in, keep_warm: self.keep_warm },
            policy: self.policy,
            model: self.model.clone(),
            force: Force { small_range: self.accept_small_range, paper_angles: self.force_paper_angles },
            pace: if self.lockstep { Pace::Lockstep } else { Pace::Live },
            run_for: self.end.seconds,
            metrics: self.metrics,
        })
    }
}

/// Runs a controller until Ctrl-C, SIGTERM, the end of its time or of its parent, and prints its summary.
///
/// # Errors
/// Whatever keeps it from starting, with what to do about it.
pub fn run(args: Args) -> anyhow::Result<()> {
    let config = args.node_config()?;
    args.log.start();
    let stop = args.end.stop()?;
    // Before any other thread is there: those that follow inherit it.
    let machine = args.machine.obtain();
    machine.iter().for_each(|granted| tracing::info!("{granted}"));
    let summary = Summary { machine, ..node::run(&config, &stop)? };
    // Not println!, which panics when the reader is gone.
    let mut out = std::io::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&summary)?)?;
    } else {
        writeln!(out, "{summary}")?;
    }
    Ok(())
}
