//! From samples to means with intervals.
//!
//! States form groups that are independent of each other. In a static comparison a group is one
//! state. In closed loop it is one episode, because the sampling times of an episode are not
//! independent. Intervals come from the means of the groups.

use heliostat_environment::outage::Outages;
use heliostat_environment::score::{Figure, Sample};
use heliostat_environment::statistics::{Estimate, Spread, mean, present, quantile};
use serde::Serialize;

use super::evaluated_policy::EvaluatedPolicy;
use super::run::Run;
use super::settings::{Loop, Settings};

/// Quantiles of a policy's decision time in us.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Times {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// Rows of the oracle and of each policy.
pub(super) type Rows = (Row, Vec<Row>);

/// The rows of a comparison; the first policy is the one that the oracle and the others are subtracted from.
pub(super) fn rows(settings: &Settings, runs: &[Vec<Run>], oracle: &[Vec<Sample>]) -> Rows {
    let minus_first = |row: Row, own: &[&[Vec<Sample>]]| {
        let of = |figure: Figure| {
            let own: Vec<_> = own.iter().map(|run| figure.values(run, oracle)).collect();
            Some(bounded(figure.name, difference(&own, &values(&runs[0], oracle, figure))))
        };
        Row {
            difference_mbps: of(Figure::SUM_RATE),
            difference_ratio: of(Figure::RATIO),
            difference_qos_met: of(Figure::QOS_MET),
            difference_outage_time: (settings.mode == Loop::ClosedLoop).then(|| of(Figure::OUTAGE_TIME)).flatten(),
            ..row
        }
    };
    let of_policies = settings.policies.iter().zip(runs).enumerate().map(|(index, (evaluated, own))| {
        let row = Row::new(own, oracle, (evaluated, settings.mode));
        if index == 0 { row } else { minus_first(row, &groups(own)) }
    });
    let mut of_policies: Vec<Row> = of_policies.collect();
    subtract_best(settings, runs, oracle, &mut of_policies);
    let of_oracle = Row::of_oracle(oracle, settings.mode);
    // A single policy has no table of differences.
    let of_oracle = if runs.len() > 1 { minus_first(of_oracle, &[oracle]) } else { of_oracle };
    (of_oracle, of_policies)
}

/// The samples of each run.
fn groups(runs: &[Run]) -> Vec<&[Vec<Sample>]> {
    runs.iter().map(|run| run.groups.as_slice()).collect()
}

/// Sets the difference to the policy with the largest ratio. A policy that knows the true room is not compared.
fn subtract_best(settings: &Settings, runs: &[Vec<Run>], oracle: &[Vec<Sample>], rows: &mut [Row]) {
    let ratios: Vec<f64> = rows.iter().map(|row| row.ratio_to_oracle.mean).collect();
    let is_compared = |index: &usize| settings.policies[*index].known().is_none() && !ratios[*index].is_nan();
    let compared = (0..rows.len()).filter(is_compared);
    // Of equal ratios the first one is the best.
    let Some(best) = compared.clone().rev().max_by(|one, other| ratios[*one].total_cmp(&ratios[*other])) else {
        return;
    };
    let of_best = values(&runs[best], oracle, Figure::RATIO);
    for index in compared.filter(|index| *index != best) {
        rows[index].difference_to_best = Some(difference(&values(&runs[index], oracle, Figure::RATIO), &of_best));
    }
}

/// A figure in each state of each group of each run.
fn values(runs: &[Run], oracle: &[Vec<Sample>], figure: Figure) -> Vec<Vec<Vec<f64>>> {
    runs.iter().map(|run| figure.values(&run.groups, oracle)).collect()
}

/// A quantity of a policy minus that of the first policy, paired state by state; NaN is a missing
/// value.
///
/// Several runs of the first policy are averaged in each state. Their spread widens the interval,
/// because the difference would be another one for other runs.
pub(super) fn difference(own: &[Vec<Vec<f64>>], first: &[Vec<Vec<f64>>]) -> Spread {
    let of_first = |group: usize, state: usize| mean(&first.iter().map(|run| run[group][state]).collect::<Vec<_>>());
    let mut differences = own.to_vec();
    for (group, values) in differences.iter_mut().flat_map(|run| run.iter_mut().enumerate()) {
        values.iter_mut().enumerate().for_each(|(state, value)| *value -= of_first(group, state));
    }
    let of_runs: Vec<f64> = first.iter().map(|run| mean(&present(&run.concat()))).collect();
    let over_runs = if of_runs.len() > 1 { Estimate::of(&of_runs).ci95 } else { 0.0 };
    let paired = Spread::of(&differences);
    Spread { ci95: paired.ci95.hypot(over_runs), ..paired }
}

/// A difference of a figure of this name, with the bounds that it has by its definition: two shares differ by at
/// most 1.
pub fn bounded(figure: &str, difference: Spread) -> Spread {
    match figure {
        "qos_met" | "outage_time" | "jain" | "ber" => difference.within(-1.0, 1.0),
        _ => difference,
    }
}

/// The results of one policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Sum rate in Mbit/s.
    pub sum_rate_mbps: Spread,
    /// Sum rate minus that of the first policy in Mbit/s, state by state; `None` for the first
    /// policy, and for the oracle beside a single policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference_mbps: Option<Spread>,
    /// Ratio to the oracle minus that of the first policy, state by state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference_ratio: Option<Spread>,
    /// Share of minimum rates met minus that of the first policy, state by state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference_qos_met: Option<Spread>,
    /// Closed loop: share of the users' time below their minimum rate minus that of the first policy,
    /// state by state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference_outage_time: Option<Spread>,
    /// Ratio to the oracle minus that of the policy with the largest one, state by state; `None` for that
    /// policy, for the oracle, and for a policy that knows the true room.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub difference_to_best: Option<Spread>,
    /// Ratio of the sum rate to that of the oracle with minimum rates, state by state; missing
    /// where no user can be served.
    pub ratio_to_oracle: Spread,
    /// Share of users whose minimum rate is met.
    pub qos_met: Spread,
    /// Jain's fairness index of the rates, over the states in which a user has one.
    pub jain: Spread,
    /// Mean rate of the users without a direct path in Mbit/s.
    pub blocked_rate_mbps: Spread,
    /// Mean bit error rate of the users with on-off keying.
    pub ber: Spread,
    /// Closed loop: share of the users' time below their minimum rate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outage_time: Option<Spread>,
    /// Closed loop: number and lengths of outages; `None` for the oracle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outages: Option<Outages>,
    /// Decision time; `None` for the oracle as the reference.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decision_us: Option<Times>,
    /// Number of training seeds of a learned policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub training_seeds: Option<usize>,
}

impl Row {
    /// The results of a policy's runs, one for each training seed, relative to the oracle's on
    /// the same states.
    pub(super) fn new(runs: &[Run], oracle: &[Vec<Sample>], (evaluated, mode): (&EvaluatedPolicy, Loop)) -> Self {
        let mut decisions_us: Vec<f64> = runs.iter().flat_map(|run| &run.decisions_us).copied().collect();
        decisions_us.sort_by(f64::total_cmp);
        let times = Times { p50: quantile(&decisions_us, 0.5), p99: quantile(&decisions_us, 0.99) };
        Self {
            outages: Outages::of(runs.iter().flat_map(|run| &run.outages)),
            decision_us: (!decisions_us.is_empty()).then_some(times),
            training_seeds: evaluated.is_learned().then_some(runs.len()),
            ..Self::of_samples(&groups(runs), oracle, mode)
        }
    }

    /// Whether the states do not tell the policy apart from the one with the largest ratio; false without an interval.
    pub fn is_near_best(&self) -> bool {
        self.difference_to_best.is_some_and(|difference| difference.includes_zero())
    }

    /// The results of the reference itself.
    pub(super) fn of_oracle(oracle: &[Vec<Sample>], mode: Loop) -> Self {
        Self::of_samples(&[oracle], oracle, mode)
    }

    fn of_samples(runs: &[&[Vec<Sample>]], oracle: &[Vec<Sample>], mode: Loop) -> Self {
        let spread = |figure: Figure| figure.spread(runs, oracle);
        Self {
            sum_rate_mbps: spread(Figure::SUM_RATE),
            difference_mbps: None,
            difference_ratio: None,
            difference_qos_met: None,
            difference_outage_time: None,
            difference_to_best: None,
            ratio_to_oracle: spread(Figure::RATIO),
            qos_met: spread(Figure::QOS_MET),
            jain: spread(Figure::JAIN),
            blocked_rate_mbps: spread(Figure::BLOCKED_RATE),
            ber: spread(Figure::BER),
            outage_time: (mode == Loop::ClosedLoop).then(|| spread(Figure::OUTAGE_TIME)),
            outages: None,
            decision_us: None,
            training_seeds: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 97.5 % quantiles of Student's t with one and three degrees of freedom.
    const T_1: f64 = 12.706204736174694;
    const T_3: f64 = 3.18244630528371;

    /// Runs with one state in each group.
    fn runs(rates: &[&[f64]]) -> Vec<Vec<Vec<f64>>> {
        rates.iter().map(|rates| rates.iter().map(|rate| vec![*rate]).collect()).collect()
    }

    #[test]
    fn differences_of_the_ratio_leave_out_states_without_one() {
        let sample =
            |sum_rate_mbps: f64| Sample { sum_rate_mbps, met: 1.0, jain: 1.0, blocked_rate_mbps: 0.0, ber: 0.0 };
        let run = |rates: &[f64]| {
            vec![Run { groups: rates.iter().map(|rate| vec![sample(*rate)]).collect(), ..Run::default() }]
        };
        let oracle: Vec<Vec<Sample>> = [10.0, 20.0, 0.0].map(|rate| vec![sample(rate)]).into();
        let of = |rates: &[f64]| values(&run(rates), &oracle, Figure::RATIO);
        let paired = difference(&of(&[6.0, 16.0, 0.0]), &of(&[5.0, 10.0, 0.0]));
        // 0.1 and 0.3 of the states with a ratio: a standard error of 0.1.
        assert!((paired.mean - 0.2).abs() < 1e-12 && (paired.ci95 - 0.1 * T_1).abs() < 1e-9, "{paired:?}");
    }

    #[test]
    fn paired_differences_ignore_what_both_policies_share() {
        let first = runs(&[&[10.0, 20.0, 30.0, 40.0]]);
        let better = difference(&runs(&[&[11.0, 22.0, 31.0, 42.0]]), &first);
        // The differences are 1, 2, 1 and 2: a standard error of sqrt(1/3) / 2.
        assert_eq!((better.mean, difference(&first, &first).ci95), (1.5, 0.0));
        assert!((better.ci95 - T_3 * (1.0_f64 / 3.0).sqrt() / 2.0).abs() < 1e-9, "{better:?}");
    }

    #[test]
    fn a_difference_of_shares_whose_interval_reaches_beyond_1_is_marked() {
        let wide = difference(&runs(&[&[0.9, 0.3]]), &runs(&[&[0.0, 0.2]]));
        assert!(wide.ci95 > 1.0 && !wide.crosses_bound, "{wide:?}");
        for figure in ["qos_met", "outage_time"] {
            let share = bounded(figure, wide);
            assert!(share.crosses_bound && share.ends() == [-1.0, 1.0], "{share:?}");
        }
        assert_eq!(bounded("sum_rate_mbps", wide), wide, "a rate has no largest difference");
        let narrow = difference(&runs(&[&[0.9, 0.8]]), &runs(&[&[0.8, 0.7]]));
        assert!(!bounded("qos_met", narrow).crosses_bound, "{narrow:?}");
    }

    #[test]
    fn the_training_spread_of_the_first_policy_widens_the_difference() {
        let own = runs(&[&[12.0, 23.0, 32.0, 43.0]]);
        let (one, two) =
            (runs(&[&[10.0, 20.0, 30.0, 40.0]]), runs(&[&[9.0, 19.0, 29.0, 39.0], &[11.0, 21.0, 31.0, 41.0]]));
        let [one, two] = [one, two].map(|first| difference(&own, &first));
        assert_eq!((one.mean, two.mean), (2.5, 2.5));
        // Over runs: a standard error of sqrt(2) / sqrt(2).
        assert!((two.ci95 - one.ci95.hypot(T_1)).abs() < 1e-9, "{one:?} {two:?}");
    }
}
