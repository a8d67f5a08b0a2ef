//! The actors that are built into the program: every file of `models/actors` at the time of the build.

use heliostat_scenario::Scenario;

use super::actor_file::{ActorError, ActorFile};

include!(concat!(env!("OUT_DIR"), "/shipped_actors.rs"));

/// The names of the built-in actors.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED_ACTORS.iter().map(|(name, _)| *name)
}

/// The file name of the actor for a scenario: channel mode, rows and columns.
pub fn name_for(scenario: &Scenario) -> String {
    format!("{}-{}x{}.onnx", scenario.channel.mode.name(), scenario.mirrors.rows, scenario.mirrors.columns)
}

/// The built-in actor for a scenario.
///
/// # Errors
/// [`ActorError::NotShipped`] with the names of those there are.
pub fn for_scenario(scenario: &Scenario) -> Result<ActorFile, ActorError> {
    let wanted = name_for(scenario);
    match SHIPPED_ACTORS.iter().find(|(name, _)| *name == wanted) {
        Some((name, bytes)) => Ok(ActorFile { origin: format!("the built-in actor {name}"), bytes: (*bytes).into() }),
        None => {
            let available = names().collect::<Vec<_>>().join(", ");
            let available = if available.is_empty() { "none".into() } else { available };
            Err(ActorError::NotShipped { wanted, available })
        }
    }
}
