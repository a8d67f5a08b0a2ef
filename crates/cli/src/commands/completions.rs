//! `heliostat completions` and `heliostat manual`: generated from the definitions of the command
//! line.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Command;
use clap_complete::Shell;

use heliostat_service::{outln, output};

/// Print the completion script for a shell.
///
/// For example: heliostat completions bash > ~/.local/share/bash-completion/completions/heliostat
#[derive(Debug, clap::Args)]
pub struct CompletionArgs {
    /// The shell
    shell: Shell,
}

/// Write a manual page for each command into a folder.
#[derive(Debug, clap::Args)]
pub struct ManualArgs {
    /// The folder; it is created if it does not exist
    folder: PathBuf,
}

/// Prints completions for the program of a command.
pub fn completions(args: CompletionArgs, mut command: Command) -> Result<()> {
    let mut script = Vec::new();
    let program = command.get_name().to_owned();
    clap_complete::generate(args.shell, &mut command, program, &mut script);
    // Written at once: the reader may close the pipe early.
    Ok(output::bytes(&script)?)
}

/// Writes manual pages.
pub fn manual(args: ManualArgs, command: Command) -> Result<()> {
    let folder = &args.folder;
    let written = std::fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(command, folder));
    written.with_context(|| format!("cannot write manual pages to {}", folder.display()))?;
    outln!("wrote manual pages to {}", folder.display())?;
    Ok(())
}
