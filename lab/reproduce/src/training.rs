//! The policy ddpg for rooms without a built-in actor, trained by `heliostat-lab train`.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use heliostat_learn::comparison::EvaluatedPolicy;
use heliostat_learn::{TrainArgs, run_train};
use heliostat_models::ActorSource;
use heliostat_scenario::Scenario;

use crate::plan::Room;

/// `heliostat-lab train` by its own flags.
#[derive(Parser)]
struct Train {
    #[command(flatten)]
    args: TrainArgs,
}

/// The built-in actor if one fits, else the path of an actor in the output folder, which may not
/// exist yet.
pub fn source(scenario: &Scenario, out: &Path) -> ActorSource {
    if fits(scenario, &ActorSource::Shipped) {
        ActorSource::Shipped
    } else {
        ActorSource::Path(place(scenario, out).join("ddpg.onnx"))
    }
}

/// Trains an actor for a room without one, if allowed.
///
/// # Errors
/// A room without an actor if training is not allowed, or an error of the training.
pub fn provide(room: &Room, out: &Path, train: bool) -> Result<()> {
    if fits(&room.scenario, &room.actor) {
        return Ok(());
    }
    let folder = place(&room.scenario, out);
    let file = folder.join("scenario.toml");
    if !train {
        bail!(
            "room {} has no trained actor: none is built in for channel mode {} with {} mirrors in this geometry; give --train-missing to train one \
             now (some minutes), or build in one that you train with `heliostat-lab train ddpg`",
            room.name,
            room.scenario.channel.mode.name(),
            room.scenario.mirrors
        );
    }
    fs::create_dir_all(&folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    crate::store::write(&file, room.scenario.to_toml().as_bytes())?;
    drop(writeln!(std::io::stderr(), "training the policy ddpg for room {}", room.name));
    let [file, into] = [&file, &folder].map(|path| path.display().to_string());
    let mut command = vec!["train", "ddpg", "--scenario", &file, "--out", &into];
    if folder.join("checkpoint.safetensors").exists() {
        command.push("--resume");
    }
    run_train(Train::parse_from(command).args, &|| false)?;
    let actors = fs::read_dir(&folder)?.filter_map(|entry| Some(entry.ok()?.path()));
    let trained =
        actors.filter(|path| path.extension().is_some_and(|extension| extension == "onnx")).collect::<Vec<_>>();
    ensure!(trained.len() == 1, "expected one actor in {}, found {}", folder.display(), trained.len());
    fs::rename(&trained[0], folder.join("ddpg.onnx"))?;
    ensure!(fits(&room.scenario, &room.actor), "the actor that was trained for room {} does not fit it", room.name);
    Ok(())
}

fn fits(scenario: &Scenario, actor: &ActorSource) -> bool {
    EvaluatedPolicy::parse("ddpg", actor).is_ok_and(|evaluated| evaluated.fits(scenario))
}

fn place(scenario: &Scenario, out: &Path) -> PathBuf {
    out.join("actors").join(format!("{}-{}", scenario.name, scenario.geometry_hash()))
}
