//! The commands and their help.

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};
use heliostat_models::library::LibraryArgs;

use crate::commands::{
    bench, calibrate, completions, config, demo, doctor, eval, keys, link, map, results, scenario, stop, trace, ui,
};

/// Real-time control of a MEMS mirror array for indoor optical wireless communication (LiFi).
///
/// A ceiling LED transmits to moving users. Bodies and furniture block the direct path. The mirrors
/// on a wall provide a second path. Start with `heliostat demo`.
#[derive(Debug, Parser)]
#[command(name = "heliostat", version, arg_required_else_help = true)]
pub struct Cli {
    #[command(flatten)]
    library: LibraryArgs,
    #[command(subcommand)]
    command: Command,
}

// The doc comment of a variant replaces the help text of its arguments, the long one too. So a
// variant has one only where its arguments have no long help text.
#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Ui(ui::Args),
    Controller(heliostat_controller::cli::Args),
    /// Run the simulated room: users, obstacles, mirrors, reports
    SimNode(heliostat_sim_node::cli::Args),
    /// Drive real mirrors, or check a driver against the wire contract
    Driver(heliostat_driver::cli::Args),
    Stop(stop::StopArgs),
    Rearm(stop::RearmArgs),
    Keys(keys::Args),
    Calibrate(calibrate::Args),
    Train(heliostat_learn::TrainArgs),
    Eval(eval::Args),
    Reproduce(heliostat_reproduce::ReproduceArgs),
    /// Compute the link budget of users under given mirror angles
    Link(link::Args),
    Map(map::Args),
    /// Measure speed relative to a reference in the same run
    Bench(bench::Args),
    Results(results::Args),
    /// Check, write or print a scenario file
    Scenario(scenario::Args),
    /// Make a recorded walk from a data set or from a recording
    Trace(trace::Args),
    Doctor(doctor::Args),
    Config(config::Args),
    Record(heliostat_record::cli::RecordArgs),
    Replay(heliostat_record::cli::ReplayArgs),
    Completions(completions::CompletionArgs),
    /// Write manual pages
    Manual(completions::ManualArgs),
}

/// Reads the command line and runs the command.
pub fn run() -> Result<()> {
    let Cli { library, command } = Cli::parse();
    library.apply();
    match command {
        Command::Demo(args) => demo::run(args),
        Command::Ui(args) => ui::run(args),
        Command::Controller(args) => heliostat_controller::cli::run(args),
        Command::SimNode(args) => heliostat_sim_node::cli::run(args),
        Command::Driver(args) => heliostat_driver::cli::run(args),
        Command::Stop(args) => stop::stop(args),
        Command::Rearm(args) => stop::rearm(args),
        Command::Keys(args) => keys::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Train(args) => {
            let stop = heliostat_service::signals::stop_on_signals()?;
            heliostat_learn::run_train(args, &|| stop.is_requested())
        }
        Command::Eval(args) => eval::run(args),
        Command::Reproduce(args) => heliostat_reproduce::run_reproduce(args),
        Command::Link(args) => link::run(args),
        Command::Map(args) => map::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Results(args) => results::run(args),
        Command::Scenario(args) => scenario::run(args),
        Command::Trace(args) => trace::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Config(args) => config::run(args),
        Command::Record(args) => heliostat_record::cli::record(args),
        Command::Replay(args) => heliostat_record::cli::replay(args),
        Command::Completions(args) => completions::completions(args, Cli::command()),
        Command::Manual(args) => completions::manual(args, Cli::command()),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;

    /// Commands of a Markdown file: lines in blocks, and spans in backticks if `spans`.
    fn commands(text: &str, spans: bool) -> Vec<String> {
        let lines = text.lines().filter(|line| !line.contains('`')).map(str::trim_start);
        let in_line = text.split('`').skip(1).step_by(2).filter(|_| spans);
        let commands = lines.chain(in_line).filter(|text| text.starts_with("heliostat "));
        let ends = [" #", " > ", " | ", " &"];
        let first_part = |text: &str| {
            ends.iter().fold(text.to_owned(), |text, end| text.split(end).next().unwrap_or_default().into())
        };
        commands.map(first_part).collect()
    }

    fn markdown(folder: &Path, found: &mut Vec<PathBuf>) {
        for path in fs::read_dir(folder).expect("a folder of documents").flatten().map(|entry| entry.path()) {
            if path.is_dir() {
                markdown(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                found.push(path);
            }
        }
    }

    #[test]
    fn the_command_line_accepts_every_command_of_the_documents() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut documents = vec![root.join("README.md"), root.join("SPECIFICATION.md")];
        markdown(&root.join("docs"), &mut documents);
        let mut count = 0;
        for document in documents {
            let text = fs::read_to_string(&document).expect("a document is readable");
            for command in commands(&text, document.ends_with("SPECIFICATION.md")) {
                let parsed = Cli::try_parse_from(command.split_whitespace());
                assert!(parsed.is_ok(), "{}: {command}\n{}", document.display(), parsed.unwrap_err());
                count += 1;
            }
        }
        assert!(count >= 100, "only {count} commands were found");
    }
}
