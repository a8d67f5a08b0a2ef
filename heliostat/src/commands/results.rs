//! `heliostat results PAGE`: runs the commands behind a results page and writes the page.
//!
//! A page is data ([`pages`]): sections, each with one command, the columns of its table and the
//! bounds it is held to. Each command runs in a process of its own, exactly as the page prints it,
//! so that a reader who repeats it gets the same measurement. Finished sections are kept as JSON
//! beside the page ([`archive`]); [`document`] renders the page from that file alone.

mod archive;
mod bound;
mod document;
mod pages;
mod table;
mod training;

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use heliostat_reproduce::machine;

use crate::output::outln;
use archive::{Archive, Finished};
use pages::{PageName, Section, Training, trainings};

/// Run the commands behind a results page, and write the page as Markdown.
///
/// Each section is one command. The page is written again after each finished section, with a JSON
/// file of the same name beside it. A run that was interrupted continues with --resume.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which page
    #[arg(value_enum)]
    page: PageName,
    /// Fewer states, seeds and seconds: checks that every command works; the figures mean little
    #[arg(long)]
    quick: bool,
    /// The Markdown file to write [default: PAGE.md in this folder]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Run only these sections, by their names (comma-separated); --list shows the names
    #[arg(long, value_name = "SECTION,..", value_delimiter = ',')]
    only: Vec<String>,
    /// Keep the sections that the same command finished at the same commit
    #[arg(long)]
    resume: bool,
    /// Train the actors that the page evaluates and that the folder `training` lacks; a run that was
    /// interrupted continues. Without it, sections about missing actors are left out
    #[arg(long)]
    train: bool,
    /// Print each section's name and command, and run nothing
    #[arg(long)]
    list: bool,
}

/// Runs the command.
///
/// # Errors
/// An unknown section, a file that cannot be read or written, or a command that fails.
pub fn run(args: Args) -> Result<()> {
    let page = args.page.page();
    for name in &args.only {
        let known: Vec<&str> = page.sections.iter().map(|section| section.name).collect();
        ensure!(known.contains(&name.as_str()), "--only {name}: expected one of {}", known.join(", "));
    }
    let chosen = |section: &&Section| args.only.is_empty() || args.only.iter().any(|name| name == section.name);
    let sections: Vec<&Section> = page.sections.iter().filter(chosen).collect();
    if args.list {
        for section in sections {
            outln!("{:<18} heliostat {}", section.name, section.arguments(args.quick).join(" "))?;
        }
        return Ok(());
    }

    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(page.name).with_extension("md"));
    let kept = out.with_extension("json");
    let mut archive = Archive::new(page.name, args.quick);
    if args.resume && kept.exists() {
        archive = Archive::read(&kept)?;
        ensure!(
            archive.page == page.name && archive.quick == args.quick,
            "{}: holds page {}{}; expected {}{}. Choose another --out, or leave out --resume",
            kept.display(),
            archive.page,
            if archive.quick { " --quick" } else { "" },
            page.name,
            if args.quick { " --quick" } else { "" },
        );
    }
    for (index, section) in sections.iter().enumerate() {
        let step = format!("{} of {}: {}", index + 1, sections.len(), section.name);
        let arguments = section.arguments(args.quick);
        if archive.holds(section.name, &arguments, machine::COMMIT) {
            report(&format!("{step}: finished before"));
            continue;
        }
        let missing: Vec<&Training> =
            trainings(page, &arguments).into_iter().filter(|training| !training::is_finished(training)).collect();
        if !missing.is_empty() && !args.train {
            let names: Vec<&str> = missing.iter().map(|training| training.name).collect();
            report(&format!("{step}: left out without --train, because of {}", names.join(", ")));
            continue;
        }
        for training in missing {
            report(&format!("{step}: heliostat {}", training.arguments().join(" ")));
            training::run(training, args.quick)?;
        }
        report(&format!("{step}: heliostat {}", arguments.join(" ")));
        let finished = measure(section, &arguments).with_context(|| {
            format!("section {} did not finish; --resume continues with it, after the finished ones", section.name)
        })?;
        archive.put(finished);
        archive.write(&kept)?;
        fs::write(&out, document::markdown(page, &archive)?)
            .with_context(|| format!("cannot write {}: expected a file in a folder that exists", out.display()))?;
    }
    outln!("written: {} and {}", out.display(), kept.display())?;
    Ok(())
}

/// Progress goes to standard error.
fn report(text: &str) {
    drop(writeln!(std::io::stderr(), "{text}"));
}

/// Runs one section's command and keeps its JSON object.
fn measure(section: &Section, arguments: &[String]) -> Result<Finished> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let (made, start) = (machine::now(), Instant::now());
    let output = Command::new(program)
        .args(section.with_json(arguments))
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .context("cannot start the command")?;
    if !output.status.success() {
        bail!("heliostat {}: {}", arguments.join(" "), output.status);
    }
    Ok(Finished {
        section: section.name.into(),
        arguments: arguments.to_vec(),
        made,
        commit: machine::COMMIT.into(),
        machine: machine::hardware(),
        seconds: start.elapsed().as_secs_f64(),
        output: serde_json::from_slice(&output.stdout).context("the command printed no JSON object")?,
    })
}
