//! Runs the commands of sections, one after the other, and keeps what they print.

use std::io::Write;
use std::path::Path;
use std::process::Stdio;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use heliostat_reproduce::machine;

use super::archive::{Archive, Finished};
use super::document::command;
use super::pages::Section;
use crate::commands::own_program;

/// A section, and the arguments of its command.
pub type Step<'a> = (&'a Section, Vec<String>);

/// The finished sections from which a run continues; none if the file does not exist.
///
/// # Errors
/// A file of another page, or of a quick run where a full one continues.
pub fn resumed(kept: &Path, page: &str, quick: bool) -> Result<Archive> {
    if !kept.exists() {
        return Ok(Archive::new(page, quick));
    }
    let archive = Archive::read(kept)?;
    let flag = |quick: bool| if quick { " --quick" } else { "" };
    ensure!(
        archive.page == page && archive.quick == quick,
        "{}: holds page {}{}; expected {page}{}. Choose another --out, or leave out --resume",
        kept.display(),
        archive.page,
        flag(archive.quick),
        flag(quick),
    );
    Ok(archive)
}

/// Runs each command that has not finished at this commit. It calls `keep` after each, and once if all
/// have finished before.
///
/// # Errors
/// A command that fails, or an error of `keep`.
pub fn run(steps: &[Step], archive: &mut Archive, keep: impl Fn(&Archive) -> Result<()>) -> Result<()> {
    let mut ran = false;
    for (index, (section, arguments)) in steps.iter().enumerate() {
        let step = format!("{} of {}: {}", index + 1, steps.len(), section.name);
        if archive.holds(section.name, arguments, machine::COMMIT) {
            report(&format!("{step}: finished before"));
            continue;
        }
        report(&format!("{step}: {}", command(arguments)));
        let finished = measure(section, arguments).with_context(|| {
            format!("section {} did not finish; --resume continues with it, after the finished ones", section.name)
        })?;
        archive.put(finished);
        keep(archive)?;
        ran = true;
    }
    if ran { Ok(()) } else { keep(archive) }
}

/// Progress goes to standard error.
pub(super) fn report(text: &str) {
    drop(writeln!(std::io::stderr(), "{text}"));
}

/// Runs one section's command and keeps its JSON object.
fn measure(section: &Section, arguments: &[String]) -> Result<Finished> {
    let (made, start) = (machine::now(), Instant::now());
    let output = own_program::json(&section.with_json(arguments), Stdio::inherit());
    let output = output.with_context(|| command(arguments))?;
    Ok(Finished {
        section: section.name.into(),
        arguments: arguments.to_vec(),
        made,
        commit: machine::COMMIT.into(),
        machine: machine::hardware(),
        load: machine::load(),
        seconds: start.elapsed().as_secs_f64(),
        output,
    })
}
