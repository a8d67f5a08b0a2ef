//! The training runs behind a page: each in a process of its own and a folder of its own.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};

use super::pages::Training;

/// Whether the folder of a run holds an actor, which a run writes at its end.
pub fn is_finished(training: &Training) -> bool {
    let files = fs::read_dir(training.folder()).into_iter().flatten().flatten();
    files.map(|file| file.path()).any(|path| path.extension().is_some_and(|extension| extension == "onnx"))
}

/// Runs a training, or continues it where its folder holds a checkpoint. A quick run has one episode.
///
/// # Errors
/// The training fails.
pub fn run(training: &Training, quick: bool) -> Result<()> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let mut command = Command::new(program);
    command.args(training.arguments()).arg("--json").stdin(Stdio::null()).stdout(Stdio::null());
    if quick {
        command.args(["--option", "episodes=1", "--option", "room_count=2", "--option", "room_s=3"]);
    }
    if Path::new(&training.folder()).join("checkpoint.safetensors").exists() {
        command.arg("--resume");
    }
    let status = command.status().context("cannot start the training")?;
    ensure!(status.success(), "heliostat {}: {status}", training.arguments().join(" "));
    Ok(())
}
