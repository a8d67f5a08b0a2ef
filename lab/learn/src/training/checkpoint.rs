//! Checkpoints: one safetensors file with everything that a run needs to continue as if it had not
//! stopped.
//!
//! Networks, moments of the optimiser and replay are tensors of that file. Other parts of the state
//! are JSON in a tensor of bytes named `state`. The file is complete at any time, so a crash during
//! the write loses nothing. A run with other settings or another
//! scenario cannot be resumed from it.

use std::io;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use candle_core::{Device, Tensor, safetensors};
use heliostat_files::write_whole;
use serde_json::Value;

use super::run::Training;
use super::store::Store;

/// Incremented when the contents of a checkpoint change.
const VERSION: u32 = 2;

/// Writes the state of a run to a file.
///
/// # Errors
/// The file cannot be written, or a value is not finite; in both cases the old file remains.
pub fn save(training: &mut Training, path: &Path) -> anyhow::Result<()> {
    let mut store = Store::default();
    training.save(&mut store)?;
    if let Some(name) = store.not_finite()? {
        bail!(
            "after {} episodes {name} holds values that are not finite: the training has diverged, and nothing is written; try lower \
             learning rates or a smaller reward.lambda",
            training.episodes_done()
        );
    }
    store.put("version", &VERSION)?;
    store.put("settings", training.settings())?;
    store.put("scenario", &training.scenario().hash())?;
    let bytes = serde_json::to_vec(&store.values)?;
    store.put_tensor("state".into(), Tensor::from_slice(&bytes, bytes.len(), &Device::Cpu)?);
    write_whole(path, |part| safetensors::save(&store.tensors, part).map_err(io::Error::other))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Restores the state of a run from a file.
///
/// # Errors
/// The file is missing, damaged, of another version, or of a run with other settings or another
/// scenario.
pub fn load(training: &mut Training, path: &Path) -> anyhow::Result<()> {
    let tensors = safetensors::load(path, &Device::Cpu)
        .with_context(|| format!("cannot read the checkpoint {}", path.display()))?;
    let state = tensors.get("state").with_context(|| format!("{} holds no state of a run", path.display()))?;
    let values = serde_json::from_slice(&state.to_vec1::<u8>()?)
        .with_context(|| format!("{} holds no state of a run", path.display()))?;
    let store = Store { tensors, values };
    let version: u32 = store.get("version")?;
    ensure!(version == VERSION, "checkpoint version {version}, but this program reads version {VERSION}");
    let (found, expected): (Value, &Value) = (store.get("settings")?, training.settings());
    if found != *expected {
        bail!("the checkpoint has other settings than this run:\n  checkpoint {found}\n  this run   {expected}");
    }
    let (found, expected): (String, String) = (store.get("scenario")?, training.scenario().hash());
    ensure!(found == expected, "the checkpoint is of scenario {found}, this run of scenario {expected}");
    training.restore(&store)
}
