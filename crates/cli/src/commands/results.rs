//! `heliostat results PAGE`: runs the commands behind a results page and writes the page.
//!
//! A page is data ([`pages`]): sections, each with one command, the columns of its table and the
//! bounds it is held to. Each command runs in a process of its own, exactly as the page prints it,
//! so that a reader who repeats it gets the same measurement ([`steps`]). Finished sections are kept as
//! JSON beside the page ([`archive`]); [`document`] renders the page from that file alone. The suite of
//! `heliostat eval` uses the same parts.

pub(super) mod archive;
mod bound;
pub(super) mod document;
pub(super) mod pages;
pub(super) mod steps;
pub(super) mod table;

use std::path::PathBuf;

use anyhow::{Result, ensure};

use super::whole_file;
use crate::output::outln;
use archive::Archive;
use pages::{PageName, Section};

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
            outln!("{:<18} {}", section.name, document::command(&section.arguments(args.quick)))?;
        }
        return Ok(());
    }

    let out = args.out.clone().unwrap_or_else(|| PathBuf::from(page.name).with_extension("md"));
    let kept = archive::beside(&out)?;
    let mut archive = match args.resume {
        true => steps::resumed(&kept, page.name, args.quick)?,
        false => Archive::new(page.name, args.quick),
    };
    let mut steps = Vec::new();
    for section in sections {
        steps.push((section, section.arguments(args.quick)));
    }
    steps::run(&steps, &mut archive, |archive| {
        archive.write(&kept)?;
        whole_file::write(&out, document::markdown(page, archive)?.as_bytes())
    })?;
    outln!("written: {} and {}", out.display(), kept.display())?;
    Ok(())
}
