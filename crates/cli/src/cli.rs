//! The commands and their help.

use anyhow::Result;
use clap::{Args, CommandFactory, Parser, Subcommand};
use heliostat_models::library::LibraryArgs;
use heliostat_service::exit::UnusableInput;

use crate::arguments::parsed;
use crate::commands::{
    self, bench, calibrate, completions, config, controller, demo, doctor, keys, link, scenario, status, stop, ui,
};

/// Real-time control of a MEMS mirror array for indoor optical wireless communication (LiFi).
///
/// A ceiling LED transmits to moving users. Bodies and furniture block the direct path. The mirrors
/// on a wall provide a second path. Start with `heliostat demo`. Training, evaluation and reports are
/// in `heliostat-lab`.
#[derive(Debug, Parser)]
#[command(name = "heliostat", version, arg_required_else_help = true, mut_subcommands(without_library))]
pub struct Cli {
    #[command(flatten)]
    library: LibraryArgs,
    #[command(subcommand)]
    command: Command,
}

/// Commands that load no network.
const WITHOUT_NETWORK: [&str; 10] =
    ["sim-node", "driver", "status", "stop", "rearm", "keys", "record", "config", "completions", "manual"];

/// The same command; one that loads no network takes the flag of the library, and does not list it.
fn without_library(command: clap::Command) -> clap::Command {
    if !WITHOUT_NETWORK.contains(&command.get_name()) {
        return command;
    }
    let flags = LibraryArgs::augment_args(clap::Command::new("library"));
    let hidden: Vec<clap::Arg> = flags.get_arguments().map(|flag| flag.clone().hide(true)).collect();
    command.args(hidden)
}

// The doc comment of a variant replaces the help text of its arguments, the long one too. So a
// variant has one only where its arguments have no long help text.
#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Ui(ui::Args),
    Status(status::Args),
    Controller(controller::Args),
    /// Run the simulated room: users, obstacles, mirrors, reports
    SimNode(heliostat_sim_node::cli::Args),
    /// Drive real mirrors, or check a driver against the wire contract
    Driver(heliostat_driver::cli::Args),
    Stop(stop::StopArgs),
    Rearm(stop::RearmArgs),
    Keys(keys::Args),
    /// Compute the link budget of users under given mirror angles
    Link(link::Args),
    /// Measure decision and loop relative to a reference in the same run
    Bench(bench::Args),
    /// Check, write or print a scenario file
    Scenario(scenario::Args),
    Doctor(doctor::Args),
    Config(config::Args),
    Calibrate(calibrate::Args),
    Record(heliostat_record::cli::RecordArgs),
    Replay(heliostat_record::cli::ReplayArgs),
    Completions(completions::CompletionArgs),
    /// Write manual pages
    Manual(completions::ManualArgs),
}

/// Reads the command line and runs the command.
///
/// # Errors
/// Those of the command, and advice for a command of the laboratory.
pub fn run() -> Result<()> {
    let words: Vec<String> = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    if let Some(advice) = commands::advice(&words) {
        return Err(UnusableInput::new(advice).into());
    }
    let Cli { library, command } = parsed()?;
    library.apply();
    match command {
        Command::Demo(args) => demo::run(args),
        Command::Ui(args) => ui::run(args),
        Command::Status(args) => status::run(args),
        Command::Controller(args) => controller::run(args),
        Command::SimNode(args) => heliostat_sim_node::cli::run(args),
        Command::Driver(args) => heliostat_driver::cli::run(args),
        Command::Stop(args) => stop::stop(args),
        Command::Rearm(args) => stop::rearm(args),
        Command::Keys(args) => keys::run(args),
        Command::Link(args) => link::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Scenario(args) => scenario::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Config(args) => config::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Record(args) => heliostat_record::cli::record(args),
        Command::Replay(args) => heliostat_record::cli::replay(args),
        Command::Completions(args) => completions::completions(args, Cli::command()),
        Command::Manual(args) => completions::manual(args, Cli::command()),
    }
}

#[cfg(test)]
mod tests {
    use heliostat_bus::DEFAULT_ENDPOINT;

    use super::*;

    #[test]
    fn the_library_is_listed_where_a_network_is_loaded_and_taken_everywhere() {
        let mut program = Cli::command();
        program.build();
        for (path, is_listed) in [
            (&["driver", "check"][..], false),
            (&["status"], false),
            (&["demo"], true),
            (&["controller"], true),
            (&["replay"], true),
            (&["bench", "decide"], true),
        ] {
            let find =
                |command: &clap::Command, name: &&str| command.find_subcommand(*name).expect("a command").clone();
            let mut command = path.iter().fold(program.clone(), |command, name| find(&command, name));
            assert_eq!(command.render_long_help().to_string().contains("--onnxruntime"), is_listed, "{path:?}");
        }
        for name in WITHOUT_NETWORK {
            assert!(program.find_subcommand(name).is_some(), "{name} is a command");
        }
        for words in [["driver", "check", "--onnxruntime", "lib.so"], ["--onnxruntime", "lib.so", "driver", "check"]] {
            let parsed = Cli::try_parse_from(["heliostat"].into_iter().chain(words)).expect("a command line");
            assert!(format!("{:?}", parsed.library).contains("lib.so"), "{words:?}");
        }
    }

    #[test]
    fn each_command_names_the_endpoint_that_it_has_by_default() {
        let program = Cli::command();
        for name in ["ui", "status", "controller", "sim-node", "stop", "rearm", "calibrate", "record"] {
            let command = program.find_subcommand(name).expect("a command");
            let names_default = |flag: &str| {
                let argument = command.get_arguments().find(|argument| argument.get_long() == Some(flag));
                let help = argument.and_then(|argument| argument.get_help()).expect("a flag with a help text");
                help.to_string().contains(DEFAULT_ENDPOINT)
            };
            let listens = name == "sim-node";
            assert_eq!([names_default("listen"), names_default("connect")], [listens, !listens], "{name}");
        }
    }
}
