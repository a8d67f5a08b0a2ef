//! The process: joins the rooms, looks after them twice a second, and ends in order.
//!
//! Nothing here is on the way from a report to its command.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use heliostat_bus::{Bus, BusConfig};
use heliostat_proto::Room;
use heliostat_scenario::Scenario;
use heliostat_service::{MetricsArgs, Stop};

use crate::{intake::Deciding, metrics, post::Post, summary::Summary};
use heliostat_decide::{
    capabilities::{Force, Unfit},
    policy::PolicyKind,
};

/// Time between two status reports.
const STATUS_INTERVAL: Duration = Duration::from_millis(500);

/// Time without any position report after which that is worth a word.
const SILENCE: Duration = Duration::from_secs(3);

/// Time between two looks whether a room has fallen silent; several fit into the validity of a command.
const SILENCE_INTERVAL: Duration = Duration::from_millis(50);

/// What decides where time and epochs come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// UTC; the epoch is the time of the start.
    #[default]
    Live,
    /// The time of the reports; the epoch is 1. The same room gives the same commands, bit for bit.
    Lockstep,
}

/// Everything that a node needs to start.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    /// The room.
    pub scenario: Scenario,
    /// Where to meet it.
    pub bus: BusConfig,
    /// More rooms to serve, all by the same scenario and over the same session.
    pub also_rooms: Vec<Room>,
    /// Where and how decisions are made.
    pub deciding: Deciding,
    /// How to decide.
    pub policy: PolicyKind,
    /// The actor's file in place of the built-in one.
    pub model: Option<PathBuf>,
    /// Live or lockstep.
    pub pace: Pace,
    /// What of an array that does not fit is accepted all the same.
    pub force: Force,
    /// When to end without being asked.
    pub run_for: Option<Duration>,
    /// Where metrics are served.
    pub metrics: MetricsArgs,
}

/// Runs a controller until it is stopped, and gives its account.
///
/// # Errors
/// Where the actor does not fit, the bus cannot be opened, or other controllers have taken over every room.
pub fn run(config: &NodeConfig, stop: &Stop) -> anyhow::Result<Summary> {
    let started = Instant::now();
    let exporter = config.metrics.open()?;
    let bus = Bus::open(&config.bus).context("cannot join the room")?;
    let others = config.also_rooms.iter().map(|room| bus.enter(room.clone()));
    let rooms: Vec<Bus> = std::iter::once(bus.enter(config.bus.room.clone())).chain(others).collect();
    let mut posts = rooms.iter().map(|room| Post::open(room, config)).collect::<anyhow::Result<Vec<_>>>()?;
    let mut left = Vec::new();
    let deadline = config.run_for.map(|run_for| started + run_for);
    let mut next_look = Instant::now() + STATUS_INTERVAL;
    let mut silence_told = false;
    while !wait_for_stop(stop, deadline) {
        posts.iter_mut().for_each(Post::elapse);
        if Instant::now() < next_look {
            continue;
        }
        next_look += STATUS_INTERVAL;
        posts.iter_mut().for_each(Post::look);
        if let Some(exporter) = &exporter {
            exporter.publish(metrics::page(&posts));
        }
        for index in (0..posts.len()).rev() {
            if let Some(unfit) = posts[index].unfit() {
                left.push(refuse(posts.swap_remove(index), &unfit));
            } else if let Some(epoch) = posts[index].deposed_by() {
                left.push(leave(posts.swap_remove(index), epoch));
            }
        }
        if posts.is_empty() {
            bail!("{}", left.iter().map(|(_, problem)| problem.as_str()).collect::<Vec<_>>().join("; "));
        }
        let heard = posts.iter().any(|post| post.summary().decisions > 0);
        if !heard && !silence_told && started.elapsed() > SILENCE {
            tracing::warn!("{}", nobody_reports(config));
            silence_told = true;
        }
    }
    posts.iter_mut().for_each(Post::close);
    posts.extend(left.into_iter().map(|(post, _)| post));
    let mut summary = Summary::of_posts(&posts);
    if summary.decisions == 0 && summary.last_problem.is_empty() {
        summary.last_problem = nobody_reports(config);
    }
    drop(posts);
    bus.close()?;
    Ok(summary)
}

/// Gives a room up whose array cannot be commanded.
fn refuse(mut post: Post, unfit: &Unfit) -> (Post, String) {
    let problem = format!("room \"{}\" is not commanded: {unfit}", post.room());
    tracing::warn!("{problem}");
    post.close();
    (post, problem)
}

/// Gives a room up to the controller that has taken it over.
fn leave(mut post: Post, epoch: u64) -> (Post, String) {
    let room = post.room().clone();
    let problem = format!(
        "another controller (epoch {epoch}) took over the array of room \"{room}\": a room has one controller; stop one of the two"
    );
    tracing::warn!("{problem}");
    post.close();
    (post, problem)
}

fn nobody_reports(config: &NodeConfig) -> String {
    let bus = &config.bus;
    let rooms: Vec<&str> = std::iter::once(&bus.room).chain(&config.also_rooms).map(Room::name).collect();
    format!(
        "no position report came from room \"{}\" (connecting to {}, listening at {}): does the room's process run, with the same --room and a matching endpoint?",
        rooms.join("\", \""),
        if bus.connect.is_empty() { "nobody".into() } else { bus.connect.join(", ") },
        if bus.listen.is_empty() { "nothing".into() } else { bus.listen.join(", ") },
    )
}

/// Waits until the rooms are due for a check; true where the node has to end instead.
fn wait_for_stop(stop: &Stop, deadline: Option<Instant>) -> bool {
    let left = deadline.map_or(SILENCE_INTERVAL, |deadline| deadline.saturating_duration_since(Instant::now()));
    left.is_zero()
        || stop.wait_for(left.min(SILENCE_INTERVAL))
        || deadline.is_some_and(|deadline| Instant::now() >= deadline)
}
