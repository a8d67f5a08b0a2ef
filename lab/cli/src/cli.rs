//! The commands and their help.

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};
use heliostat::arguments::parsed;
use heliostat::commands::completions;
use heliostat::programs::LAB;
use heliostat_models::library::LibraryArgs;
use heliostat_service::outln;

use crate::commands::{bench, calibrate, eval, map, report, trace};

/// The laboratory of Heliostat: training, evaluation, the paper's figures, reports.
///
/// The program `heliostat` runs and measures a real or simulated system; this one compares policies
/// in simulated rooms. `bench rooms`, `bench demo` and some reports start `heliostat`, which they
/// expect in the same folder.
#[derive(Debug, Parser)]
#[command(name = "heliostat-lab", version, arg_required_else_help = true)]
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
    Train(heliostat_learn::TrainArgs),
    Eval(eval::Args),
    Reproduce(heliostat_reproduce::ReproduceArgs),
    Report(report::Args),
    Map(map::Args),
    /// Make a recorded walk from a data set or from a recording
    Trace(trace::Args),
    Calibrate(calibrate::Args),
    /// Measure speed relative to a reference in the same run
    Bench(bench::Args),
    Completions(completions::CompletionArgs),
    /// Write manual pages
    Manual(completions::ManualArgs),
}

/// Reads the command line and runs the command.
///
/// # Errors
/// Those of the command.
pub fn run() -> Result<()> {
    let Cli { library, command } = parsed()?;
    library.apply();
    match command {
        Command::Train(args) => {
            let stop = heliostat_service::signals::stop_on_signals()?;
            outln!("{}", heliostat_learn::run_train(args, &|| stop.is_requested())?)?;
            Ok(())
        }
        Command::Eval(args) => eval::run(args),
        Command::Reproduce(args) => {
            let progress = heliostat_reproduce::Progress::default();
            let (watched, out) = (progress.clone(), args.out.clone());
            heliostat_service::signals::end_on_signals(LAB, move || watched.interrupted(&out))?;
            heliostat_reproduce::run_reproduce(args, &progress)
        }
        Command::Report(args) => report::run(args),
        Command::Map(args) => map::run(args),
        Command::Trace(args) => trace::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Bench(args) => bench::run(args),
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
        let is_command = |text: &&str| text.starts_with("heliostat ") || text.starts_with("heliostat-lab ");
        let ends = [" #", " > ", " | ", " &"];
        let first_part = |text: &str| {
            ends.iter().fold(text.to_owned(), |text, end| text.split(end).next().unwrap_or_default().into())
        };
        lines.chain(in_line).filter(is_command).map(first_part).collect()
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

    /// The error of the program that a command names; `None` where the program accepts it.
    fn refusal(command: &str) -> Option<clap::Error> {
        let words = command.split_whitespace();
        match command.starts_with("heliostat-lab ") {
            true => Cli::try_parse_from(words).err(),
            false => heliostat::cli::Cli::try_parse_from(words).err(),
        }
    }

    #[test]
    fn the_programs_accept_every_command_of_the_documents() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut documents = vec![root.join("README.md"), root.join("SPECIFICATION.md")];
        markdown(&root.join("docs"), &mut documents);
        let mut count = 0;
        for document in documents {
            let text = fs::read_to_string(&document).expect("a document is readable");
            for command in commands(&text, document.ends_with("SPECIFICATION.md")) {
                let error = refusal(&command);
                assert!(error.is_none(), "{}: {command}\n{}", document.display(), error.expect("an error"));
                count += 1;
            }
        }
        assert!(count >= 300, "only {count} commands were found");
    }
}
