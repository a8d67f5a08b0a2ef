//! The actors that are built into the program: every file of `models/actors` at the time of the
//! build, all of training seed 1.

use heliostat_scenario::Scenario;

use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};

use crate::error::SourceError;

include!(concat!(env!("OUT_DIR"), "/actors.rs"));

/// The names of the built-in actors.
pub fn names() -> impl Iterator<Item = &'static str> {
    ACTORS.iter().map(|(name, _)| *name)
}

/// The file name of an actor: `<policy>-<mode>-<rows>x<columns>.onnx`, with `-seedN` before the dot
/// for training seeds other than 1.
pub fn file_name(policy: PolicyKind, scenario: &Scenario, training_seed: u64) -> String {
    let mode = scenario.channel.mode.name();
    let sizes: Vec<_> =
        scenario.mirrors.arrays().iter().map(|array| format!("{}x{}", array.rows, array.columns)).collect();
    let seed = if training_seed == 1 { String::new() } else { format!("-seed{training_seed}") };
    format!("{}-{mode}-{}{seed}.onnx", policy.name(), sizes.join("-"))
}

/// The built-in actor for a scenario.
///
/// # Errors
/// [`SourceError::NotShipped`] with the names of the built-in actors.
pub fn find(policy: PolicyKind, scenario: &Scenario, training_seed: u32) -> Result<ActorFile, SourceError> {
    let expected = file_name(policy, scenario, u64::from(training_seed));
    match bytes(&expected) {
        Some(bytes) => Ok(ActorFile { origin: format!("the built-in actor {expected}"), bytes: bytes.into() }),
        None => {
            let prefix = format!("{}-", policy.name());
            // The names of ddpg-raw begin with the same word as those of ddpg.
            let of_policy = |name: &&str| name.strip_prefix(&prefix).is_some_and(|rest| !rest.starts_with("raw-"));
            let available = names().filter(of_policy).collect::<Vec<_>>().join(", ");
            let available = if available.is_empty() { "none of this policy".into() } else { available };
            let room = format!("{} mirrors in the mode {}", scenario.mirrors, scenario.channel.mode.name());
            Err(SourceError::NotShipped { policy: policy.name(), room, expected, available })
        }
    }
}

fn bytes(name: &str) -> Option<&'static [u8]> {
    ACTORS.iter().find(|(found, _)| *found == name).map(|(_, bytes)| *bytes)
}
