//! The rules that derive a verdict from a figure, one for each statement.

use crate::figure::{Figure, Point, Series};
use crate::figures::{ber_snr, inference, sum_rate_iterations, sum_rate_power};
use crate::verdict::Verdict;

/// Value, verdict and reason.
pub(super) struct RuleResult(pub String, pub Verdict, pub String);

fn is_calibrated(figure: &Figure) -> bool {
    figure.room == "paper-calibrated"
}

fn with_interval(point: &Point, digits: usize) -> String {
    interval(point.y, point.ci95, digits)
}

fn interval(mean: f64, ci95: Option<f64>, digits: usize) -> String {
    let mean = format!("{mean:.digits$}");
    ci95.map_or(mean.clone(), |ci95| format!("{mean} ± {ci95:.digits$}"))
}

/// At 2 W with two users blocked.
fn quoted_point<'a>(figure: &'a Figure, policy: &str) -> Option<&'a Point> {
    let panel = sum_rate_power::group(sum_rate_power::QUOTED_BLOCKED);
    figure.series(&panel, policy)?.at(sum_rate_power::QUOTED_POWER_W)
}

/// An error rate with two digits; smaller ones than 1e-12 are not distinguished.
fn error_rate(rate: f64) -> String {
    if rate < 1e-12 { "under 1e-12".into() } else { format!("{rate:.1e}") }
}

/// Whether a value is within 10 % of the paper's, which has two or three digits.
fn agrees(value: f64, paper: f64) -> bool {
    (value / paper - 1.0).abs() <= 0.1
}

pub(super) fn drl_rate(figure: &Figure) -> Option<RuleResult> {
    let (ddpg, oracle) = (quoted_point(figure, "ddpg")?, quoted_point(figure, "oracle")?);
    let ours = format!("ddpg {}, oracle {} Mbit/s", with_interval(ddpg, 2), with_interval(oracle, 2));
    Some(match (agrees(ddpg.y, 19.2), is_calibrated(figure)) {
        (true, true) => RuleResult(ours, Verdict::ConsistentWith, "two parameters were calibrated to this value, so the match is no evidence".into()),
        (true, false) => RuleResult(ours, Verdict::Reproduced, "within a tenth".into()),
        (false, _) if figure.room == "paper" => RuleResult(
            ours,
            Verdict::NotReproduced,
            "under eqs. (2) and (3) as printed the whole array brings about a hundredth of a direct path; not even the oracle comes near".into(),
        ),
        (false, _) => RuleResult(ours, Verdict::NotReproduced, "another rate: noise and physics differ from the paper's".into()),
    })
}

pub(super) fn benchmark_rate(figure: &Figure) -> Option<RuleResult> {
    let (random, flat, none) =
        (quoted_point(figure, "random")?, quoted_point(figure, "flat")?, quoted_point(figure, "no-irs")?);
    let ours = format!(
        "random {}, flat {}, no IRS {} Mbit/s",
        with_interval(random, 2),
        with_interval(flat, 2),
        with_interval(none, 2)
    );
    Some(match (agrees(random.y, 10.0), figure.room.as_str()) {
        (true, "paper" | "paper-calibrated") => {
            RuleResult(ours, Verdict::ConsistentWith, "the noise, which the paper does not give, was set for it".into())
        }
        (true, _) => RuleResult(ours, Verdict::Reproduced, "within a tenth".into()),
        (false, "specular") => RuleResult(
            ours,
            Verdict::NotReproduced,
            "the paper gives no noise; with the itemised one a direct path alone brings more".into(),
        ),
        (false, _) => RuleResult(ours, Verdict::NotReproduced, "not within a tenth on these states".into()),
    })
}

pub(super) fn gain(figure: &Figure) -> Option<RuleResult> {
    let over = |policy: &str| {
        let name = sum_rate_power::gain_name(policy);
        let series = figure.ratios.iter().find(|series| series.name == name)?;
        series.at(sum_rate_power::QUOTED_POWER_W)
    };
    let (random, flat) = (over("random")?, over("flat")?);
    let percent = |point: &Point| {
        let gain = 100.0 * (point.y - 1.0);
        point.ci95.map_or(format!("{gain:+.1} %"), |ci95| format!("{gain:+.1} ± {:.1} %", 100.0 * ci95))
    };
    let share = 100.0 * (1.0 - 1.0 / random.y);
    let ours =
        format!("{} over random ({share:.1} % of ddpg's own rate), {} over flat", percent(random), percent(flat));
    let matches = agrees(random.y, 1.92) || agrees(random.y, 1.48);
    Some(match (matches, is_calibrated(figure)) {
        (true, true) => RuleResult(
            ours,
            Verdict::ConsistentWith,
            "both rates were calibrated; over flat mirrors, which cost nothing either, the gain is far smaller than over random ones".into(),
        ),
        (true, false) => RuleResult(ours, Verdict::Reproduced, "within a tenth of one of the paper's two readings".into()),
        (false, _) if random.y > 2.0 => {
            RuleResult(ours, Verdict::NotReproduced, "larger than stated: real mirrors concentrate light".into())
        }
        (false, _) if figure.room == "paper" => {
            RuleResult(ours, Verdict::NotReproduced, "no angles reach it with two blocked users under eqs. (2) and (3)".into())
        }
        (false, _) => RuleResult(ours, Verdict::NotReproduced, "another gain than either reading".into()),
    })
}

/// The last point of a learner's curve on 10 x 10 mirrors or the side given.
fn last<'a>(figure: &'a Figure, name: &str, side: usize) -> Option<&'a Point> {
    figure.series(&sum_rate_iterations::group(side), name).and_then(|series: &Series| series.points.last())
}

pub(super) fn beats_dql(figure: &Figure) -> Option<RuleResult> {
    let (raw, ours, dql) = (last(figure, "ddpg-raw", 10)?, last(figure, "ddpg", 10)?, last(figure, "dql", 10)?);
    let text = format!(
        "10 x 10: ddpg-raw {}, ddpg {}, dql {} Mbit/s",
        with_interval(raw, 1),
        with_interval(ours, 1),
        with_interval(dql, 1)
    );
    Some(match (above(raw, dql), above(ours, dql)) {
        (true, _) => clearly(text, [raw, dql]),
        (false, true) => RuleResult(
            text,
            Verdict::InPart,
            "holds for DDPG with one weight a user; the paper's own, with all angles as outputs, does not come out above DQL".into(),
        ),
        (false, false) => RuleResult(text, Verdict::NotReproduced, "no DDPG comes out clearly above DQL".into()),
    })
}

/// Whether one mean is above another with disjoint intervals.
fn above(one: &Point, other: &Point) -> bool {
    clear_of((one.y, one.ci95), (other.y, other.ci95))
}

/// Whether one time, along x, is longer than another with disjoint intervals.
fn longer(one: &Point, other: &Point) -> bool {
    clear_of((one.x, one.x_ci95), (other.x, other.x_ci95))
}

/// Whether one mean is above another and their intervals, given by half widths, are disjoint.
fn clear_of((one, half): (f64, Option<f64>), (other, other_half): (f64, Option<f64>)) -> bool {
    one - half.unwrap_or(0.0) > other + other_half.unwrap_or(0.0)
}

/// The verdict on one mean above another; a single seed has no interval, so the verdict is
/// `InPart`.
fn clearly(text: String, points: [&Point; 2]) -> RuleResult {
    if points.iter().all(|point| point.ci95.is_some()) {
        RuleResult(text, Verdict::Reproduced, "the intervals do not meet".into())
    } else {
        RuleResult(text, Verdict::InPart, "by one training seed, without an interval".into())
    }
}

pub(super) fn near_optimal(figure: &Figure) -> Option<RuleResult> {
    let oracle = last(figure, "oracle", 10)?.y;
    let ratio = |name: &str| Some(last(figure, name, 10)?.y / oracle);
    let (raw, ours, flat) = (ratio("ddpg-raw")?, ratio("ddpg")?, ratio("flat")?);
    let text = format!("10 x 10, of the oracle's rate: ddpg-raw {raw:.2}, ddpg {ours:.2}, flat {flat:.2}");
    Some(match (raw >= 0.95, ours >= 0.95) {
        (true, _) if flat >= 0.95 => RuleResult(text, Verdict::InPart, "true, but also for flat mirrors".into()),
        (true, _) => RuleResult(text, Verdict::Reproduced, "0.95 or more with the paper's algorithm".into()),
        (false, true) => RuleResult(
            text,
            Verdict::InPart,
            "0.95 or more with one weight a user, not with the algorithm as printed".into(),
        ),
        (false, false) => {
            RuleResult(text, Verdict::NotReproduced, "no learner reaches 0.95 in so many episodes".into())
        }
    })
}

pub(super) fn grows(figure: &Figure) -> Option<RuleResult> {
    let (small, large) = (last(figure, "ddpg", 7)?, last(figure, "ddpg", 10)?);
    let none = last(figure, "no-irs", 10)?;
    let text = format!(
        "ddpg: {} with 49, {} Mbit/s with 100; no IRS {}",
        with_interval(small, 2),
        with_interval(large, 2),
        with_interval(none, 2)
    );
    Some(if above(large, small) {
        clearly(text, [large, small])
    } else {
        RuleResult(text, Verdict::NotReproduced, "the intervals meet".into())
    })
}

pub(super) fn error_rates(figure: &Figure) -> Option<RuleResult> {
    let at = |panel: &str, speed: f64| {
        Some(figure.series(panel, &ber_snr::speed_name(speed))?.at(ber_snr::QUOTED_SNR_DB)?.y)
    };
    let all: Vec<f64> = ber_snr::SPEEDS_M_S.iter().filter_map(|speed| at(ber_snr::NEAREST_DELAY, *speed)).collect();
    let (slow, fast) = (at(ber_snr::NEAREST_DELAY, 0.5)?, at(ber_snr::NEAREST_DELAY, 2.0)?);
    let list: Vec<String> = all.iter().map(|rate| format!("{rate:.1e}")).collect();
    let text = format!("{}, at 0, 0.5, 1, 1.5 and 2 m/s: {}", ber_snr::NEAREST_DELAY, list.join(", "));
    // Half a decade at either end.
    let near = |rate: f64, paper: f64| (rate / paper).log10().abs() <= 0.5;
    Some(if near(slow, 1e-4) && near(fast, 1e-1) {
        let why = "error rates rise as stated for one of five delays; shorter delays give almost no rise, so the paper's values imply old reports";
        RuleResult(text, Verdict::ConsistentWith, why.into())
    } else if fast > 10.0 * slow {
        RuleResult(text, Verdict::InPart, "error rates rise with speed, with other values at the ends".into())
    } else {
        RuleResult(text, Verdict::NotReproduced, "error rates hardly rise with speed".into())
    })
}

pub(super) fn error_floor(figure: &Figure) -> Option<RuleResult> {
    let at = |speed: f64| {
        Some(figure.series(ber_snr::NEAREST_DELAY, &ber_snr::speed_name(speed))?.at(ber_snr::SNR_MAX_DB)?.y)
    };
    let (slow, fast) = (at(0.5)?, at(2.0)?);
    let text = format!(
        "{}, at {} dB: {} at 0.5 m/s, {} at 2 m/s",
        ber_snr::NEAREST_DELAY,
        ber_snr::SNR_MAX_DB,
        error_rate(slow),
        error_rate(fast)
    );
    Some(match (slow < 1e-3, fast < 1e-3) {
        (true, true) => RuleResult(text, Verdict::Reproduced, "below 1e-3 at every speed".into()),
        (true, false) => RuleResult(
            text,
            Verdict::InPart,
            "for slow users; for fast users the light misses the detector for part of the time, which no SNR compensates".into(),
        ),
        _ => RuleResult(text, Verdict::NotReproduced, "the floor stays above 1e-3".into()),
    })
}

/// Median and 99th percentile, whose x is a time in us, in the panel of the whole array.
fn times<'a>(figure: &'a Figure, name: &str) -> Option<[&'a Point; 2]> {
    let panel = figure.panels.first()?;
    let series = panel.series.iter().find(|series| series.name == name)?;
    Some([series.points.first()?, series.points.get(1)?])
}

fn time(point: &Point) -> String {
    interval(point.x, point.x_ci95, 0)
}

pub(super) fn decision_time(figure: &Figure) -> Option<RuleResult> {
    let [p50, p99] = times(figure, "ddpg")?;
    let text = format!("ddpg {} us median, {} us 99th percentile", time(p50), time(p99));
    Some(match (p50.x <= inference::QUOTED_US, p99.x <= inference::QUOTED_US) {
        (true, true) => RuleResult(
            text,
            Verdict::Reproduced,
            "in a hot loop; see docs/latency.md for the loop from report to mirror".into(),
        ),
        (true, false) => {
            let circumstance = if figure.overloaded { ", on a machine with other work" } else { "" };
            RuleResult(text, Verdict::InPart, format!("the median, not the 99th percentile{circumstance}"))
        }
        _ => RuleResult(text, Verdict::NotReproduced, "slower".into()),
    })
}

pub(super) fn faster(figure: &Figure) -> Option<RuleResult> {
    let [ddpg, _] = times(figure, "ddpg")?;
    let medians: Vec<(&str, &Point)> = ["oracle", "pso", "sine-cosine", "greedy", "fixed-point"]
        .into_iter()
        .filter_map(|name| Some((name, times(figure, name)?[0])))
        .collect();
    let list: Vec<String> = medians.iter().map(|(name, p50)| format!("{name} {}", time(p50))).collect();
    let text = format!("medians in us: ddpg {}, {}", time(ddpg), list.join(", "));
    let slower = medians.iter().filter(|(_, p50)| longer(p50, ddpg)).count();
    Some(if slower == medians.len() {
        RuleResult(text, Verdict::Reproduced, "faster than each search".into())
    } else if slower > 0 {
        let why = "faster than general search methods; a solver that uses the structure of the problem takes a similar time and has a similar sum rate";
        RuleResult(text, Verdict::InPart, why.into())
    } else {
        RuleResult(text, Verdict::NotReproduced, "slower than each search".into())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_longer_if_the_intervals_are_disjoint() {
        let point = |x, half| Point { x, y: 0.5, ci95: None, x_ci95: Some(half) };
        let ours = point(32.0, 2.0);
        assert!(longer(&point(104.0, 18.0), &ours));
        assert!(!longer(&point(40.0, 17.0), &ours));
        assert!(!longer(&point(20.0, 1.0), &ours));
    }
}
