//! `heliostat config`: the effective configuration of a process from file, flags and defaults.

use anyhow::{Context, Result};
use heliostat_bus::{BusConfig, BusError, Reach, Role};
use heliostat_core::observation::{ObservationEncoder, Part, USERS_CAPACITY};
use heliostat_core::policy::actor_file::{ANGLES, INPUT_NAME, room_entries};
use heliostat_proto::Room;
use heliostat_scenario::{Scenario, ScenarioArgs};
use heliostat_sim_node::Pace;
use serde_json::{Map, Value, json};

use super::demo;
use heliostat_service::{exit, outln};

/// Print the effective configuration of a process.
///
/// It has the scenario with its defaults, the room and the endpoints. Give the same flags as to the
/// process; no process is started. The file of a policy is checked.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print JSON instead of TOML
    #[arg(long, global = true)]
    as_json: bool,
    #[command(subcommand)]
    process: Process,
}

#[derive(Debug, clap::Subcommand)]
enum Process {
    /// The configuration of `heliostat controller` with these flags
    Controller(Box<heliostat_controller::cli::Args>),
    /// The configuration of `heliostat sim-node` with these flags
    SimNode(Box<heliostat_sim_node::cli::Args>),
    /// The configuration of `heliostat demo` with these flags
    Demo(Box<demo::Args>),
    /// The requirements for an ONNX actor in a scenario: inputs and outputs, shapes, layout and
    /// metadata
    Actor {
        #[command(flatten)]
        scenario: ScenarioArgs,
        /// Largest number of users in the observation
        #[arg(long, value_name = "U", default_value_t = USERS_CAPACITY)]
        users_max: usize,
    },
}

/// Runs the command.
pub fn run(args: Args) -> Result<()> {
    let configuration = match args.process {
        Process::Controller(args) => {
            let config = args.node_config()?;
            config.check_model().map_err(exit::unusable)?;
            let process = json!({
                "name": "controller",
                "policy": config.policy.kind().name(),
                "model": config.policy.model,
                "pace": if config.is_lockstep { "lockstep" } else { "live" },
                "seconds": config.run_for.map(|duration| duration.as_secs_f64()),
            });
            document(&config.scenario, Some(&config.bus), process)?
        }
        Process::SimNode(args) => {
            let settings = args.settings()?;
            let (pace, seconds, ticks) = match settings.pace {
                Pace::Live { duration } => ("live", duration.map(|duration| duration.as_secs_f64()), None),
                Pace::Lockstep { ticks } => ("lockstep", None, Some(ticks)),
            };
            let process = json!({ "name": "sim-node", "pace": pace, "seconds": seconds, "ticks": ticks });
            document(&settings.scenario, Some(&settings.bus), process)?
        }
        Process::Demo(args) => {
            let room = Room::new(&args.room).map_err(BusError::from)?;
            let process = json!({ "name": "demo", "policy": args.policy.kind().name(), "room": room.name() });
            // Its endpoints are free ports, chosen at the start.
            document(&args.scenario.load_arrays()?, None, process)?
        }
        Process::Actor { scenario, users_max } => actor(&scenario.load_arrays()?, users_max),
    };
    if args.as_json {
        outln!("{}", serde_json::to_string_pretty(&configuration)?)?;
    } else {
        outln!("{}", toml::to_string(&configuration)?.trim_end())?;
    }
    Ok(())
}

/// The requirements of `heliostat controller --model`.
fn actor(scenario: &Scenario, users_max: usize) -> Map<String, Value> {
    let mirrors = scenario.mirror_count();
    let encoder = ObservationEncoder::new(users_max, mirrors);
    // Index of the first value, and one past the last.
    let range = |Part { name, values, .. }: Part| (name.to_owned(), json!([values.start, values.end]));
    let layout: Map<String, Value> = encoder.parts().into_iter().map(range).collect();
    let metadata: Map<String, Value> =
        room_entries(scenario, users_max).into_iter().map(|(key, value)| (key, value.into())).collect();
    let document = json!({
        "input": { "name": INPUT_NAME, "type": "f32", "shape": [1, encoder.len()] },
        "output": { "name": ANGLES, "type": "f32", "shape": [1, 2 * mirrors] },
        "metadata": metadata,
        "layout": layout,
    });
    match document {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

fn document(scenario: &Scenario, bus: Option<&BusConfig>, process: Value) -> Result<Map<String, Value>> {
    let scenario_table: Value = toml::from_str(&scenario.to_toml()).context("the effective scenario is TOML")?;
    let mut document = Map::new();
    document.insert("scenario_hash".into(), scenario.hash().into());
    document.insert("process".into(), without_nulls(process));
    if let Some(bus) = bus {
        let (role, patience_ms) = match (bus.role, bus.reach) {
            (Role::Peer, _) => ("peer", Value::Null),
            (Role::Client, Reach::Within(limit)) => ("client", json!(limit.as_millis() as u64)),
            (Role::Client, Reach::Eventually) => ("client", Value::Null),
        };
        let bus = json!({
            "room": bus.room.name(),
            "role": role,
            "listen": bus.listen,
            "connect": bus.connect,
            "router_patience_ms": patience_ms,
            "certificate": bus.identity.as_ref().map(|identity| identity.role().name()),
        });
        document.insert("bus".into(), without_nulls(bus));
    }
    document.insert("scenario".into(), scenario_table);
    Ok(document)
}

/// Removes unset values, since TOML has no null.
fn without_nulls(value: Value) -> Value {
    match value {
        Value::Object(map) => map.into_iter().filter(|(_, value)| !value.is_null()).collect(),
        other => other,
    }
}
