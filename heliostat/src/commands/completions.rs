//! `heliostat completions` and `heliostat manual`: what a shell and `man` read, made from the commands' own help.

use std::io;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::CommandFactory;
use clap_complete::Shell;

use crate::cli::Cli;
use crate::output::outln;

/// Print completions for a shell.
///
/// For example: heliostat completions bash > ~/.local/share/bash-completion/completions/heliostat
#[derive(Debug, clap::Args)]
pub struct CompletionArgs {
    /// Which shell
    shell: Shell,
}

/// Write manual pages, one a command, into a folder.
#[derive(Debug, clap::Args)]
pub struct ManualArgs {
    /// The folder; made where it does not exist
    folder: PathBuf,
}

/// Prints completions.
pub fn completions(args: CompletionArgs) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "heliostat", &mut script);
    // Whole, or nothing: a reader may close early.
    io::Write::write_all(&mut io::stdout(), &script)?;
    Ok(())
}

/// Writes manual pages.
pub fn manual(args: ManualArgs) -> Result<()> {
    let folder = &args.folder;
    let written = std::fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(Cli::command(), folder));
    written.with_context(|| format!("cannot write manual pages to {}", folder.display()))?;
    outln!("wrote manual pages to {}", folder.display())?;
    Ok(())
}
