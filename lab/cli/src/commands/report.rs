//! `heliostat-lab report FILE.toml`: runs the commands behind a page of results and writes the page.
//!
//! A report is data ([`definition`]): sections, each with one command, its tables and the bounds it is
//! held to. Each command runs in a process of its own, exactly as the page prints it, so that a reader
//! who repeats it gets the same measurement. Finished sections are kept as JSON beside the page
//! ([`archive`]); [`page`] renders the page from them alone.

mod archive;
mod bound;
mod definition;
mod page;
mod summary;
mod table;

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use heliostat::programs;
use heliostat_reproduce::machine;
use heliostat_scenario::ScenarioArgs;
use heliostat_service::locks::lock;
use heliostat_service::{exit, outln, output, signals, whole_file};

use super::json_command;
use archive::{Archive, Finished};
use definition::{Definition, Section};
use page::Page;

/// Run the commands of a report, and write its page as Markdown.
///
/// A report is a TOML file; lab/reports has those of the project. Each section is one command. The page
/// is written again after each finished section, with a JSON file of the same name beside it. A section
/// that fails does not end the others. A run that was interrupted continues with --resume.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The report (TOML)
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Fewer states, seeds and seconds: checks that every command works; the figures mean little
    #[arg(long)]
    quick: bool,
    /// The Markdown file to write [default: the report's name with .md, in this folder]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Run only these sections, by their names (comma-separated); --check shows the names
    #[arg(long, value_name = "SECTION,..", value_delimiter = ',')]
    only: Vec<String>,
    /// Replace a word of the report's commands, for example policies=greedy,own.onnx (repeatable)
    #[arg(long, value_name = "NAME=VALUE", value_parser = word)]
    word: Vec<(String, String)>,
    /// Keep the sections that the same command finished at the same commit
    #[arg(long)]
    resume: bool,
    /// Check the file, and its tables against finished sections if there are any; print each section's
    /// name and command, and run nothing
    #[arg(long)]
    check: bool,
}

fn word(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=').ok_or("expected NAME=VALUE")?;
    Ok((parts.0.into(), parts.1.into()))
}

/// Runs the command.
///
/// # Errors
/// An invalid report or section, a file that cannot be read or written, or a command that fails.
pub fn run(args: Args) -> Result<()> {
    let definition = Definition::read(&args.file, &args.word).map_err(exit::unusable)?;
    let names: Vec<&str> = definition.sections.iter().map(|section| section.name.as_str()).collect();
    for name in &args.only {
        let expected = || format!("--only {name}: expected one of {}", names.join(", "));
        ensure!(names.contains(&name.as_str()), exit::UnusableInput::new(expected()));
    }
    let chosen = |section: &&Section| args.only.is_empty() || args.only.contains(&section.name);
    let mut steps = Vec::new();
    for section in definition.sections.iter().filter(chosen) {
        let arguments = definition.arguments(section, args.quick).map_err(exit::unusable)?;
        let checked = check_section(section, &arguments);
        checked.with_context(|| format!("in section {}", section.name)).map_err(exit::unusable)?;
        steps.push((section, arguments));
    }
    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(&definition.name).with_extension("md"));
    if args.check {
        for (section, arguments) in &steps {
            outln!("{:<18} {}", section.name, page::command(arguments))?;
        }
        return check_finished(&definition, &steps, &out);
    }
    let kept = archive::beside(&out)?;
    let mut archive = match args.resume {
        true => Archive::resume(&kept, &definition.name, args.quick)?,
        false => Archive::new(&definition.name, args.quick),
    };
    let running: Arc<Mutex<Option<String>>> = Arc::default();
    let interrupted = Arc::clone(&running);
    signals::end_on_signals(programs::LAB, move || said(lock(&interrupted).as_deref()))?;
    let (mut problems, mut not_shown) = (Vec::new(), Vec::new());
    for (index, (section, arguments)) in steps.iter().enumerate() {
        let step = format!("{} of {}: {}", index + 1, steps.len(), section.name);
        if archive.holds(&section.name, arguments, machine::COMMIT) {
            output::note(format_args!("{step}: finished before"));
            continue;
        }
        output::note(format_args!("{step}: {}", page::command(arguments)));
        *lock(&running) = Some(section.name.clone());
        match measure(section, arguments).with_context(|| unfinished(&section.name)) {
            Ok(finished) => archive.put(finished),
            Err(error) => {
                output::note(format_args!("{step}: {error:#}"));
                problems.push(format!("{error:#}"));
            }
        }
        let found = write(&definition, &archive, &out, &kept)?;
        for problem in found.iter().filter(|problem| !not_shown.contains(*problem)) {
            output::note(problem);
        }
        not_shown = found;
        *lock(&running) = None;
    }
    problems.extend(write(&definition, &archive, &out, &kept)?);
    outln!("written: {} and {}", out.display(), kept.display())?;
    ensure!(
        problems.is_empty(),
        "{}; correct the report, and continue with report --resume, which keeps the finished sections",
        problems.join("; ")
    );
    Ok(())
}

/// What an interrupted report says, in a section or between two.
fn said(section: Option<&str>) -> String {
    section.map_or_else(|| "each finished section is kept; report --resume continues".to_owned(), unfinished)
}

/// What is kept of a report that ends in a section, and how to go on.
fn unfinished(section: &str) -> String {
    format!("section {section} did not finish; report --resume continues with it, after the finished ones")
}

/// Writes page and archive; the result is what the page cannot show.
fn write(definition: &Definition, archive: &Archive, out: &Path, kept: &Path) -> Result<Vec<String>> {
    archive.write(kept)?;
    let Page { text, problems } = page::write(definition, archive)?;
    whole_file::write(out, text.as_bytes())?;
    Ok(problems)
}

/// Refuses a report that cannot show what the same commands printed before, where it is kept beside the page.
fn check_finished(definition: &Definition, steps: &[(&Section, Vec<String>)], out: &Path) -> Result<()> {
    // A file of another kind is the matter of a run, which refuses or replaces it.
    let Ok(mut archive) = Archive::read(&out.with_extension("json")) else { return Ok(()) };
    let of_step = |finished: &Finished| {
        steps.iter().any(|(section, arguments)| section.name == finished.section && *arguments == finished.arguments)
    };
    archive.sections.retain(of_step);
    let Page { problems, .. } = page::write(definition, &archive)?;
    ensure!(problems.is_empty(), "{}", problems.join("; "));
    Ok(())
}

/// Refuses a command that its program would refuse, and rows that it does not print.
fn check_section(section: &Section, arguments: &[String]) -> Result<()> {
    check_command(arguments)?;
    section.rows().try_for_each(|pointer| table::check_rows(pointer, arguments))
}

/// Refuses a command that its program would refuse.
fn check_command(arguments: &[String]) -> Result<()> {
    let words = with_json(arguments);
    let checked = match arguments.first().map(String::as_str) {
        Some(programs::HELIOSTAT) => check_words::<heliostat::cli::Cli>(words),
        Some(programs::LAB) => check_words::<crate::cli::Cli>(words),
        other => bail!("command {other:?}: expected {} or {}", programs::HELIOSTAT, programs::LAB),
    };
    checked.with_context(|| page::command(arguments))
}

/// Refuses words that a program does not accept, and a scenario that does not exist.
fn check_words<P: Parser>(words: Vec<String>) -> Result<()> {
    let matches = P::command().try_get_matches_from(words)?;
    P::from_arg_matches(&matches)?;
    let mut innermost = &matches;
    while let Some((_, command)) = innermost.subcommand() {
        innermost = command;
    }
    if let Ok(Some(scenario)) = innermost.try_get_one::<String>("scenario") {
        ScenarioArgs { scenario: scenario.clone(), ..ScenarioArgs::default() }.text()?;
    }
    Ok(())
}

/// The arguments with `--json` in front of those that are passed on to another process.
fn with_json(arguments: &[String]) -> Vec<String> {
    let end = arguments.iter().position(|word| word == "--").unwrap_or(arguments.len());
    let (own, passed_on) = arguments.split_at(end);
    own.iter().cloned().chain(["--json".into()]).chain(passed_on.iter().cloned()).collect()
}

/// Runs one section's command and keeps its JSON object.
fn measure(section: &Section, arguments: &[String]) -> Result<Finished> {
    let (made, start) = (machine::now(), Instant::now());
    let program = if arguments[0] == programs::LAB { programs::own_file() } else { programs::heliostat() };
    let output = json_command::json(program?, &with_json(arguments)[1..], Stdio::inherit());
    Ok(Finished {
        section: section.name.clone(),
        arguments: arguments.to_vec(),
        made,
        commit: machine::COMMIT.into(),
        machine: machine::hardware(),
        load: machine::load(),
        seconds: start.elapsed().as_secs_f64(),
        output: output.with_context(|| page::command(arguments))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_stands_before_the_flags_of_another_process() {
        let words = |text: &str| text.split(' ').map(String::from).collect::<Vec<_>>();
        assert_eq!(with_json(&words("bench loop -- --pin 1")), words("bench loop --json -- --pin 1"));
        assert_eq!(with_json(&words("bench loop")), words("bench loop --json"));
    }

    #[test]
    fn an_interrupted_report_says_where_it_was_and_how_to_go_on() {
        assert_eq!(
            said(Some("exact")),
            "section exact did not finish; report --resume continues with it, after the finished ones"
        );
        assert_eq!(said(None), "each finished section is kept; report --resume continues");
    }

    #[test]
    fn every_report_of_the_project_is_valid_and_the_programs_accept_its_commands() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../reports");
        let mut count = 0;
        for file in std::fs::read_dir(folder).expect("the reports").flatten().map(|entry| entry.path()) {
            let definition = Definition::read(&file, &[]).unwrap_or_else(|error| panic!("{error:#}"));
            for (section, quick) in definition.sections.iter().flat_map(|section| [(section, false), (section, true)]) {
                let arguments = definition.arguments(section, quick).expect("words are known");
                check_section(section, &arguments).unwrap_or_else(|error| panic!("{}: {error:#}", section.name));
                count += 1;
            }
        }
        assert!(count >= 150, "only {count} commands were checked");
    }

    #[test]
    fn a_command_of_another_program_an_unknown_flag_and_a_missing_scenario_are_refused() {
        let check = |command: &str| check_command(&command.split(' ').map(str::to_owned).collect::<Vec<_>>());
        for command in ["ls", "heliostat eval", "heliostat-lab eval --sweeep users.count=1"] {
            assert!(check(command).is_err(), "{command}");
        }
        for (program, scenario) in [("heliostat-lab eval", "nope.toml"), ("heliostat bench decide", "nope")] {
            let refused = check(&format!("{program} --scenario {scenario}")).expect_err("there is no such scenario");
            assert!(format!("{refused:#}").contains(scenario), "{refused:#}");
            check(&format!("{program} --scenario hall")).expect("it is built in");
        }
    }
}
