//! The actors that are built into the program: every file of `models/actors` at the time of the
//! build.

use heliostat_scenario::Scenario;

use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};

use crate::error::SourceError;

include!(concat!(env!("OUT_DIR"), "/shipped_actors.rs"));

/// The names of the built-in actors.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED_ACTORS.iter().map(|(name, _)| *name)
}

/// The file name of an actor: `<policy>-<mode>-<rows>x<columns>.onnx`, with `-seedN` before the dot
/// for training seeds other than 1. The actors of `residual` and `lstm` serve any room:
/// `residual.onnx`.
pub fn file_name(policy: PolicyKind, scenario: &Scenario, training_seed: u64) -> String {
    if matches!(policy, PolicyKind::Residual | PolicyKind::Lstm) {
        let seed = if training_seed == 1 { String::new() } else { format!("-seed{training_seed}") };
        return format!("{}{seed}.onnx", policy.name());
    }
    let mode = scenario.channel.mode.name();
    let sizes: Vec<_> =
        scenario.mirrors.arrays().iter().map(|array| format!("{}x{}", array.rows, array.columns)).collect();
    let seed = if training_seed == 1 { String::new() } else { format!("-seed{training_seed}") };
    format!("{}-{mode}-{}{seed}.onnx", policy.name(), sizes.join("-"))
}

/// The training seeds with a built-in actor for a scenario, in ascending order.
pub fn training_seeds(policy: PolicyKind, scenario: &Scenario) -> Vec<u32> {
    (1..=TRAINING_SEEDS_MAX).filter(|seed| bytes(&file_name(policy, scenario, u64::from(*seed))).is_some()).collect()
}

/// Largest training seed of a built-in actor.
const TRAINING_SEEDS_MAX: u32 = 10;

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
            // One per room, and none of policies whose names begin with the same word.
            let of_policy = |name: &&str| {
                let rest = name.strip_prefix(&prefix);
                rest.is_some_and(|rest| {
                    !["raw-", "basis-"].iter().any(|other| rest.starts_with(other)) && !rest.contains("-seed")
                })
            };
            let available = names().filter(of_policy).collect::<Vec<_>>().join(", ");
            let available = if available.is_empty() { "none of this policy".into() } else { available };
            let room = format!("{} mirrors in the mode {}", scenario.mirrors, scenario.channel.mode.name());
            Err(SourceError::NotShipped { policy: policy.name(), room, expected, available })
        }
    }
}

fn bytes(name: &str) -> Option<&'static [u8]> {
    SHIPPED_ACTORS.iter().find(|(found, _)| *found == name).map(|(_, bytes)| *bytes)
}
