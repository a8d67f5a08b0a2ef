//! Any set of policies on the same states of one scenario, beside the oracle: the `heliostat eval` command's figures.
//!
//! Two ways to compare, with the same judge and the same statistics:
//!
//! - **static**: each policy meets the same held-out states, undelayed and exact, and its angles are taken at once;
//! - **closed loop**: each policy sits in the controller's own core, in simulated time, and sees what reports say:
//!   rare, late, noisy; its commands turn mirrors that take time. The oracle knows the true state and turns its mirrors at once.
//!
//! A learned policy of which several training seeds are built in is all of them: each meets every state, and the interval holds the
//! spread over states and over training seeds.
//!
//! A ratio's denominator is the sum rate of the oracle with minimum rates, truly evaluated: with the spill of each spot onto
//! other users, which the oracle ignores, so that a ratio slightly above 1 is legitimate. Policies are those of the controller, by the
//! controller's names; what is timed is the policy alone, encoding included.

mod closed_loop;
mod entrant;
mod held_out;
pub(crate) mod judge;
mod stale_aim;
mod statistics;

use std::time::Duration;

use anyhow::ensure;
use heliostat_scenario::Scenario;
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Serialize, Serializer};

pub use entrant::{Entrant, UnknownPolicy};
pub use stale_aim::kept_sinr;
pub use statistics::{Row, Spread, Times};

use judge::Sample;

/// Draws over which a random policy is averaged.
const RANDOM_DRAWS: usize = 30;

/// How states come about and commands take effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Loop {
    /// Held-out states, one by one.
    Static,
    /// Reports, latency, noise and actuators in simulated time.
    ClosedLoop,
}

/// What to compare, and on what.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The room; its seed is the first one.
    pub scenario: Scenario,
    /// Who takes part.
    pub entrants: Vec<Entrant>,
    /// States of each seed.
    pub states: usize,
    /// Consecutive seeds.
    pub seeds: usize,
    /// How.
    pub mode: Loop,
    /// Take only this training seed of the built-in actors, in place of all.
    pub training_seed: Option<u32>,
}

/// The whole comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Name of the scenario.
    pub scenario: String,
    /// Hash of the effective scenario.
    pub configuration: String,
    /// Name of the channel mode.
    pub channel_mode: &'static str,
    /// Static or closed loop.
    pub mode: Loop,
    /// States of each seed.
    pub states: usize,
    /// The first seed.
    pub seed: u64,
    /// How many seeds.
    pub seeds: usize,
    /// Users in the room.
    pub users: usize,
    /// Users whose direct path is off, whatever stands there.
    pub blocked: usize,
    /// The oracle with minimum rates, on the true states.
    pub oracle: Row,
    /// Everybody who took part, in order.
    #[serde(serialize_with = "as_map")]
    pub policies: Vec<(String, Row)>,
}

/// Compares; a progress bar on standard error shows how far it is.
///
/// # Errors
/// A scenario that makes no room, an actor that does not fit it, or a policy that fails.
pub fn compare(settings: &Settings) -> anyhow::Result<Report> {
    compare_under(settings, &progress_bar()?)
}

/// A bar on standard error that shows what is done, what there is, what it is, and the time left.
pub(crate) fn progress_bar() -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new(0);
    bar.set_style(ProgressStyle::with_template("{bar:32} {pos}/{len} {msg}, {eta} left")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    Ok(bar)
}

/// The same under a progress bar of the caller, [`ProgressBar::hidden`] for none.
///
/// # Errors
/// As [`compare`].
pub fn compare_under(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<Report> {
    ensure!(
        settings.mode == Loop::ClosedLoop || settings.scenario.users.trace.is_none(),
        "users.trace: held-out states are drawn from the random walk, not from a recording; leave the recording out, or choose --closed-loop"
    );
    ensure!(settings.states > 0 && settings.seeds > 0, "a comparison needs a state and a seed at least");
    let scenario = &settings.scenario;
    // An actor that does not fit is told before the oracle's long work, not after it.
    for entrant in &settings.entrants {
        for training in entrant.trainings(scenario, settings.training_seed) {
            training.build(scenario, scenario.seed)?;
        }
    }
    let (oracle, policies) = match settings.mode {
        Loop::Static => held_out::compare(settings, bar)?,
        Loop::ClosedLoop => closed_loop::compare(settings, bar)?,
    };
    bar.finish_and_clear();
    let names = settings.entrants.iter().map(|entrant| entrant.name().to_owned());
    Ok(Report {
        scenario: scenario.name.clone(),
        configuration: scenario.hash(),
        channel_mode: scenario.channel.mode.name(),
        mode: settings.mode,
        states: settings.states,
        seed: scenario.seed,
        seeds: settings.seeds,
        users: scenario.users.count,
        blocked: scenario.blockage.forced_users,
        oracle,
        policies: names.zip(policies).collect(),
    })
}

/// Rows of the oracle and of each entrant.
type Rows = (Row, Vec<Row>);

/// What a policy made of all states, group by group, and how long each decision took in us.
#[derive(Default)]
struct Run {
    groups: Vec<Vec<Sample>>,
    decisions_us: Vec<f64>,
}

impl Run {
    /// One run whose samples are the means of those of several runs on the same states.
    fn mean(mut runs: Vec<Self>) -> Self {
        let decisions_us = runs.iter_mut().flat_map(|run| std::mem::take(&mut run.decisions_us)).collect();
        let same = |group: usize, state: usize| {
            Sample::mean(&runs.iter().map(|run| run.groups[group][state]).collect::<Vec<_>>())
        };
        let groups = runs.first().map_or(&[][..], |run| &run.groups);
        let groups = groups.iter().enumerate();
        Self {
            groups: groups.map(|(group, states)| (0..states.len()).map(|state| same(group, state)).collect()).collect(),
            decisions_us,
        }
    }
}

fn as_map<S: Serializer>(rows: &[(String, Row)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(rows.iter().map(|(name, row)| (name, row)))
}
