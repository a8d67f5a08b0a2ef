//! The training runs behind a page: each in a process of its own and a folder of its own.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use anyhow::{Context, Result, ensure};

use super::document::command;
use super::pages::{Training, trainings};
use super::steps::report;
use crate::commands::own_program;

/// Whether all actors that the command of a section evaluates exist; those that do not are trained
/// first, if `train`.
///
/// # Errors
/// A training fails.
pub fn provide(section: &str, arguments: &[String], (train, quick): (bool, bool)) -> Result<bool> {
    for training in trainings(arguments) {
        if is_finished(training) {
            continue;
        }
        if !train {
            report(&format!("{section}: left out, because {} does not exist; --train makes it", training.folder()));
            return Ok(false);
        }
        report(&format!("{section}: {}", command(&training.arguments())));
        run(training, quick)?;
    }
    Ok(true)
}

/// Whether the folder of a run holds an actor, which a run writes at its end.
fn is_finished(training: &Training) -> bool {
    let files = fs::read_dir(training.folder()).into_iter().flatten().flatten();
    files.map(|file| file.path()).any(|path| path.extension().is_some_and(|extension| extension == "onnx"))
}

/// Runs a training, or continues it where its folder holds a checkpoint.
///
/// # Errors
/// The training fails.
fn run(training: &Training, quick: bool) -> Result<()> {
    let mut process = own_program::process(&training.arguments())?;
    process.arg("--json").stdout(Stdio::null());
    if quick {
        process.args(training.quick());
    }
    if Path::new(&training.folder()).join("checkpoint.safetensors").exists() {
        process.arg("--resume");
    }
    let status = process.status().context("cannot start the training")?;
    ensure!(status.success(), "{}: {status}", command(&training.arguments()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_about_an_actor_that_does_not_exist_is_left_out() {
        let arguments = |policies: &str| ["eval", "--policies", policies].map(String::from);
        let missing = arguments("greedy,training/analytic/residual.onnx");
        assert!(!provide("section", &missing, (false, true)).unwrap());
        assert!(provide("section", &arguments("greedy,residual"), (false, true)).unwrap());
    }
}
