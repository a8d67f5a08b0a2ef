//! What a reader has to know of the intervals of a comparison.

use heliostat_learn::comparison::{BeliefQuality, EPISODES_MIN, Loop, Report, Row};
use heliostat_service::counted::counted;

use super::CROSSES_NOTE;
use super::cells::{CROSSES, of_policy, rows};
use super::differences::Difference;
use super::sweep::{Bases, Grid};

/// Why a figure has no interval, or one that says little; nothing where all is well.
/// The table of a sweep has fewer figures.
pub fn notes_on_episodes(reports: &[Report], sweep: Option<&Grid>) -> Vec<String> {
    let mut notes = Vec::new();
    let Some(few) = reports.iter().find(|report| report.has_few_episodes()) else {
        return few_blocked(reports, sweep.is_some()).into_iter().chain(crossing(reports, sweep)).collect();
    };
    let is_single = few.oracle.sum_rate_mbps.ci95.is_nan();
    // Each state of a static comparison is an episode of its own.
    let flag = if few.mode == Loop::Static { "--states" } else { "--episodes" };
    notes.push(few_episodes(&counted(few.episodes, few.group()), flag, few.seeds, is_single));
    notes.extend(crossing(reports, sweep));
    notes
}

/// That the threads of a comparison disturb its decision times: those of episodes in closed loop, and of several actors
/// of a policy. A single policy decides alone on the states of a static comparison.
pub fn note_on_times(report: &Report) -> Option<String> {
    let mut timed = report.policies.iter().filter(|(_, row)| row.decision_us.is_some());
    let is_divided = |row: &Row| report.mode == Loop::ClosedLoop || row.training_seeds.is_some_and(|seeds| seeds > 1);
    (report.threads > 1 && timed.any(|(_, row)| is_divided(row))).then(|| {
        format!(
            "decision times: beside the work of {} threads, which disturbs them; --threads 1 measures them undisturbed",
            report.threads
        )
    })
}

/// A warning that there are few independent episodes, and the flag that gives more for each seed.
fn few_episodes(found: &str, flag: &str, seeds: usize, is_single: bool) -> String {
    let of_seed = EPISODES_MIN.div_ceil(seeds);
    let (consequence, enough) = if is_single {
        (format!("{found} gives no confidence interval"), String::from(", or --seeds 2 or more"))
    } else {
        let each = if seeds == 1 { String::new() } else { format!(", for each of the {seeds} seeds") };
        (format!("the intervals come from {found} in all, too few to rely on them"), each)
    };
    format!("warning: {consequence}: use {flag} {of_seed} or more{enough}")
}

/// A warning where few of many episodes have a user without a direct path.
fn few_blocked(reports: &[Report], is_sweep: bool) -> Option<String> {
    let few = |report: &&Report| (1..EPISODES_MIN).contains(&report.blocked_episodes());
    let report = reports.iter().find(few).filter(|_| !is_sweep)?;
    let found = counted(report.blocked_episodes(), report.group());
    Some(format!("warning: the interval of `blocked` comes from {found} with such a user; use at least {EPISODES_MIN}"))
}

/// What a marked interval means, if there is one.
fn crossing(reports: &[Report], sweep: Option<&Grid>) -> Option<String> {
    let of_belief = |quality: &BeliefQuality| {
        let errors = [quality.place_error_cm, quality.heading_error_walking_deg, quality.heading_error_standing_deg];
        errors.into_iter().chain([quality.coverage_50, quality.coverage_95]).any(|spread| spread.crosses_bound)
    };
    let marked = marks_difference(reports, sweep)
        || reports.iter().any(|report| {
            rows(report).any(|(_, row)| is_marked(row, sweep.is_some()))
                || report.beliefs.iter().any(|(_, quality)| of_belief(quality))
        });
    marked.then(|| format!("{CROSSES}: {CROSSES_NOTE}; more episodes narrow it"))
}

/// Whether an interval of a row is marked. The table of a sweep has fewer intervals.
fn is_marked(row: &Row, is_sweep: bool) -> bool {
    let of_sweep = [row.sum_rate_mbps, row.ratio_to_oracle, row.qos_met].into_iter().chain(row.outage_time);
    let others = [row.jain, row.blocked_rate_mbps, row.ber];
    let mut shown = of_sweep.chain(others.into_iter().filter(|_| !is_sweep));
    shown.any(|spread| spread.crosses_bound)
}

/// Whether the interval of a difference is marked. A sweep subtracts one policy at all points, and other points.
fn marks_difference(reports: &[Report], sweep: Option<&Grid>) -> bool {
    let reference = Difference::reference(reports);
    let of_policies = |one: &Difference, report: &Report| {
        let shown = |row: &Row| if sweep.is_some() { one.to(reference, report, row) } else { (one.of)(row) };
        rows(report).filter_map(|(_, row)| shown(row)).any(|spread| spread.crosses_bound)
    };
    let of_point = |one: &Difference, bases: &Bases, index: usize| {
        let mut shown =
            rows(&reports[index]).filter_map(|(name, _)| one.to_base(reports, bases, index, of_policy(name)));
        shown.any(|spread| spread.crosses_bound)
    };
    let of_points = |bases: &Bases| {
        let mut shown = Difference::of_points(reports, bases);
        shown.any(|one| (0..reports.len()).any(|index| of_point(&one, bases, index)))
    };
    Difference::of_any(reports).any(|one| reports.iter().any(|report| of_policies(&one, report)))
        || sweep.is_some_and(|grid| grid.bases().iter().any(of_points))
}

#[cfg(test)]
mod tests {
    use heliostat_learn::comparison::Spread;

    use super::*;

    #[test]
    fn a_warning_of_few_episodes_names_their_number_the_consequence_and_the_flag() {
        for (found, flag, seeds, is_single, expected) in [
            (
                "5 states",
                "--states",
                1,
                false,
                "warning: the intervals come from 5 states in all, too few to rely on them: use --states 10 or more",
            ),
            (
                "6 episodes",
                "--episodes",
                3,
                false,
                "warning: the intervals come from 6 episodes in all, too few to rely on them: use --episodes 4 or more, \
                 for each of the 3 seeds",
            ),
            (
                "1 episode",
                "--episodes",
                1,
                true,
                "warning: 1 episode gives no confidence interval: use --episodes 10 or more, or --seeds 2 or more",
            ),
        ] {
            assert_eq!(few_episodes(found, flag, seeds, is_single), expected);
        }
    }

    #[test]
    fn a_mark_that_the_table_of_a_sweep_does_not_show_needs_no_legend() {
        let row = |outage_time: Spread, jain: Spread| Row {
            sum_rate_mbps: Spread::MISSING,
            difference_mbps: None,
            difference_ratio: None,
            difference_qos_met: None,
            difference_outage_time: None,
            difference_to_best: None,
            ratio_to_oracle: Spread::MISSING,
            qos_met: Spread::MISSING,
            jain,
            blocked_rate_mbps: Spread::MISSING,
            ber: Spread::MISSING,
            outage_time: Some(outage_time),
            outages: None,
            decision_us: None,
            training_seeds: None,
        };
        let beyond = Spread { crosses_bound: true, ..Spread::MISSING };
        let (outage, jain) = (row(beyond, Spread::MISSING), row(Spread::MISSING, beyond));
        for (row, expected) in [
            (outage, [true, true]),
            (Row { qos_met: beyond, ..jain }, [true, true]),
            (jain, [true, false]),
            (row(Spread::MISSING, Spread::MISSING), [false, false]),
        ] {
            assert_eq!([false, true].map(|is_sweep| is_marked(&row, is_sweep)), expected, "{row:?}");
        }
    }
}
