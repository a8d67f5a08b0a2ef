//! Policies on the same states of one scenario, with the oracle as the reference: the results of
//! `heliostat-lab eval`.
//!
//! Two kinds of comparison use the same evaluation and the same statistics:
//!
//! - **static**: each policy receives the same held-out states, without delay or error, and its
//!   angles take effect at once;
//! - **closed loop**: each policy runs in the controller's core in simulated time. It observes
//!   reports that are sparse, late and noisy, and its commands turn mirrors with their dynamics.
//!   The oracle observes the true state, and its mirrors turn at once.
//!
//! A learned policy is evaluated once for each training seed with an actor.
//! Each actor is evaluated on every state. The confidence interval includes variation across states
//! and across training seeds.
//!
//! The denominator of a ratio is the sum rate of the oracle with minimum rates under the true
//! evaluation. The oracle is no proven optimum, so a ratio slightly above 1 is possible. Policies
//! have the controller's names. The measured time is that of the policy alone, encoding included;
//! in closed loop it includes belief and observation.

mod belief_log;
mod belief_quality;
mod ceiling;
mod closed_loop;
mod episode_row;
mod evaluated_policy;
mod paired;
mod progress;
mod python_policy;
mod row;
mod run;
mod settings;
mod stale_aim;
mod static_states;
mod tracked_user;
mod trained;

use anyhow::ensure;
use indicatif::ProgressBar;
use serde::{Serialize, Serializer};

use heliostat_core::belief::conditions::{Condition, conditions};
use heliostat_environment::EnvironmentError;
use heliostat_environment::exact_states;
use heliostat_scenario::Scenario;

/// The rows of a comparison, and the figures of each episode.
type Compared = (row::Rows, Vec<EpisodeRow>);

pub use belief_quality::BeliefQuality;
pub use ceiling::Known;
pub use episode_row::EpisodeRow;
pub use evaluated_policy::{EvaluatedPolicy, UnknownPolicy};
pub use heliostat_environment::outage::{OUTAGE_LENGTHS_S, Outages};
pub use heliostat_environment::statistics::Spread;
pub use paired::{paired, paired_with_mean};
pub use progress::Progress;
pub(crate) use progress::progress_bar;
pub use row::{Row, Times, bounded};
pub use settings::{Loop, Settings};
pub use stale_aim::kept_sinr;
pub use tracked_user::TrackedUser;

/// The result of a comparison.
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
    /// Number of seeds; each episode, or state of a static comparison, is a room with a seed of its own.
    pub seeds: usize,
    /// Independent groups of states of all seeds, from which intervals come: episodes in closed loop,
    /// states in a static comparison.
    pub episodes: usize,
    /// Mirrors in the room.
    pub mirrors: usize,
    /// Threads for episodes and actors; several disturb the decision times.
    pub threads: usize,
    /// Users in the room.
    pub users: usize,
    /// Users whose direct path is forced off.
    pub blocked: usize,
    /// The promises of policies that do not hold in the room; in closed loop the methods of the
    /// controller's belief that do not apply to it, in a static comparison the faults of reports and mirrors, and
    /// places out of the range of the controller.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<Condition>,
    /// The oracle with minimum rates, on the true states.
    pub oracle: Row,
    /// The policies, in the order of the settings.
    #[serde(serialize_with = "as_map")]
    pub policies: Vec<(String, Row)>,
    /// Closed loop: the quality of each belief about the users, by its name, with the first policy
    /// that has it.
    #[serde(serialize_with = "as_map", skip_serializing_if = "Vec::is_empty")]
    pub beliefs: Vec<(String, BeliefQuality)>,
    /// Closed loop: the users of the first episode, by the first policy with the belief `filter`,
    /// from the controller's start on.
    #[serde(skip)]
    pub tracked: Vec<TrackedUser>,
    /// The figures of each episode.
    #[serde(skip)]
    pub each: Vec<EpisodeRow>,
}

/// Fewer independent groups than this give an interval that says little.
pub const EPISODES_MIN: usize = 10;

impl Report {
    /// Whether there are too few episodes for an interval that one can rely on.
    pub fn has_few_episodes(&self) -> bool {
        self.episodes < EPISODES_MIN
    }

    /// The number of episodes in which a user has no direct path, from which the rate of such users comes.
    pub fn blocked_episodes(&self) -> usize {
        let of_oracle = self.each.iter().filter(|row| row.policy.is_none());
        of_oracle.filter(|row| row.figure(episode_row::BLOCKED_STATES) > 0.0).count()
    }

    /// The word for an independent group of states.
    pub fn group(&self) -> &'static str {
        match self.mode {
            Loop::Static => "state",
            Loop::ClosedLoop => "episode",
        }
    }
}

/// Compares, and shows the progress.
///
/// # Errors
/// The scenario describes no room, an actor does not fit it, or a policy fails.
pub fn compare(settings: &Settings, progress: &Progress) -> anyhow::Result<Report> {
    compare_under(settings, progress.bar())
}

/// Compares with a progress bar of the caller; [`ProgressBar::hidden`] shows none.
///
/// # Errors
/// As [`compare`].
pub fn compare_under(settings: &Settings, bar: &ProgressBar) -> anyhow::Result<Report> {
    ensure!(
        settings.mode == Loop::ClosedLoop || settings.scenario.users.trace.is_none(),
        "users.trace: held-out states come from the random walk, not from a recording; remove the recording, or choose --closed-loop"
    );
    ensure!(
        settings.mode == Loop::ClosedLoop || settings.scenario.users.arrivals.is_none(),
        EnvironmentError::Arrivals
    );
    ensure!(settings.states > 0 && settings.seeds > 0, "a comparison needs at least one state and one seed");
    let scenario = &settings.scenario;
    // Refuse an actor that does not fit before the oracle's long computation.
    for evaluated in &settings.policies {
        for training in evaluated.trainings(scenario, settings.training_seed) {
            training.build(scenario, scenario.seed)?;
        }
    }
    let (((oracle, policies), each), beliefs, tracked) = match settings.mode {
        Loop::Static => (static_states::compare(settings, bar)?, Vec::new(), Vec::new()),
        Loop::ClosedLoop => closed_loop::compare(settings, bar)?,
    };
    bar.finish_and_clear();
    let names = settings.policies.iter().map(|evaluated| evaluated.name().to_owned());
    let is_closed = settings.mode == Loop::ClosedLoop;
    let mut found = if is_closed {
        conditions(scenario, &scenario.channel_model()?)
    } else {
        exact_states::conditions(scenario, "a static comparison", "choose --closed-loop")?
    };
    found.extend(without_deadline(scenario).filter(|_| is_closed));
    for (evaluated, row) in settings.policies.iter().zip(&policies) {
        let of_policy = evaluated
            .conditions(scenario)
            .into_iter()
            .chain(is_closed.then(|| in_time(scenario, evaluated, row)).flatten());
        for condition in of_policy {
            if !found.contains(&condition) {
                found.push(condition);
            }
        }
    }
    Ok(Report {
        scenario: scenario.name.clone(),
        configuration: configuration(settings),
        channel_mode: scenario.channel.mode.name(),
        mode: settings.mode,
        states: settings.states,
        seed: scenario.seed,
        seeds: settings.seeds,
        episodes: settings.seeds * settings.episodes(),
        mirrors: if settings.without_mirrors { 0 } else { scenario.mirror_count() },
        threads: rayon::current_num_threads(),
        users: scenario.users.count,
        blocked: scenario.blockage.forced_users,
        conditions: found,
        oracle,
        policies: names.zip(policies).collect(),
        beliefs,
        tracked,
        each,
    })
}

/// The condition of a scenario with a deadline, by which a decision in zero simulated time is never late.
fn without_deadline(scenario: &Scenario) -> Option<Condition> {
    let deadline_ms = scenario.control.deadline_ms;
    (deadline_ms > 0.0).then(|| Condition {
        method: "the deadline of decisions".into(),
        because: format!("control.deadline_ms = {deadline_ms}"),
        consequence: "the comparison lets each policy decide in no time, so no decision is late; measure decision times with `heliostat bench decide`".into(),
    })
}

/// A closed loop decides in zero simulated time; the condition of a policy for which this is far from
/// the truth.
fn in_time(scenario: &Scenario, evaluated: &EvaluatedPolicy, row: &Row) -> Option<Condition> {
    let interval_us = 1e6 / scenario.streams.positions.rate_hz;
    let median_us = row.decision_us?.p50;
    (median_us > interval_us).then(|| Condition {
        method: format!("the assumption of timely decisions of {}", evaluated.name()),
        because: format!(
            "its median takes longer on this machine than the {:.0} ms between two reports",
            1e-3 * interval_us
        ),
        consequence: "the comparison lets it decide in no time; a controller would be late and repeat the last command"
            .into(),
    })
}

/// The hash of the effective scenario; no scenario describes a room without mirrors.
fn configuration(settings: &Settings) -> String {
    let hash = settings.scenario.hash();
    if settings.without_mirrors { format!("{hash} without mirrors") } else { hash }
}

fn as_map<T: Serialize, S: Serializer>(rows: &[(String, T)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(rows.iter().map(|(name, row)| (name, row)))
}
