//! One run of the simulator, live or in lockstep.

use crate::error::NodeError;
use crate::node::Node;
use crate::settings::{Pace, Settings};
use crate::summary::Summary;
use crate::{live, lockstep};
use heliostat_service::Stop;

/// Runs a simulated room until its end, or until `stop` is set.
///
/// # Errors
/// [`NodeError`]: a room that cannot be created, a transport that fails, another driver or
/// simulator in the room, a tick of a lockstep run without an answer.
pub fn run(settings: &Settings, stop: &Stop) -> Result<Summary, NodeError> {
    let node = Node::open(settings)?;
    let Settings { scenario, bus, .. } = settings;
    tracing::info!(
        room = %bus.room,
        scenario = scenario.name,
        hash = scenario.hash(),
        seed = scenario.seed,
        "{}",
        endpoints(&bus.listen, &bus.connect)
    );
    match settings.pace {
        Pace::Live { duration } => live::run(node, duration, stop),
        Pace::Lockstep { ticks } => lockstep::run(node, ticks, stop),
    }
}

fn endpoints(listen: &[String], connect: &[String]) -> String {
    let at = listen.iter().map(|endpoint| format!("listening at {endpoint}"));
    let to = connect.iter().map(|endpoint| format!("connecting to {endpoint}"));
    at.chain(to).collect::<Vec<_>>().join(", ")
}
