//! The figures as text: what the full-screen view and the lines share.

use ratatui::style::Color;

use heliostat_service::printable::printable;

use crate::figures::{Figures, Origin, TimeFigures};
use crate::stop_state::StopFigure;
use crate::stop_watch::RoomStops;
use crate::sums::SumFigures;

/// The Okabe-Ito palette, which is distinguishable with colour-vision deficiency.
pub(super) const POLICY: Color = Color::Rgb(0x56, 0xB4, 0xE9);
pub(super) const FLAT: Color = Color::Rgb(0xCC, 0x79, 0xA7);
pub(super) const NO_IRS: Color = Color::Rgb(0x99, 0x99, 0x99);
pub(super) const ORACLE: Color = Color::Rgb(0xF0, 0xE4, 0x42);

/// The emergency stops, each with the arrays that have stopped, then what is open.
pub(crate) fn stops(room: &RoomStops) -> Vec<String> {
    let indices = |arrays: &[usize]| arrays.iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
    let are = |stopped: &[usize]| match stopped {
        [one] => (format!("array {one}"), "has"),
        several => (format!("arrays {}", indices(several)), "have"),
    };
    let line = |stop: &StopFigure| {
        let StopFigure { name, operator, reason, arrays, stopped, .. } = stop;
        let by = if operator.is_empty() { String::new() } else { format!(" of {operator}") };
        let (which, have) = are(stopped);
        let stopped = match stopped.len() {
            0 => "no array has stopped".to_owned(),
            count if count == arrays.len() => format!("{which} {have} stopped"),
            _ => format!("{which} of {} {have} stopped", indices(arrays)),
        };
        format!("{stopped}: stop {name}{by} ({reason})")
    };
    let free = room.free().into_iter().map(|array| format!("array {array} is not stopped: no stop holds it"));
    let open = room.problems().into_iter().chain(free).map(|text| printable(&text).into_owned());
    StopFigure::of(room).iter().map(line).chain(open).collect()
}

/// The figures in one line.
pub(super) fn line(figures: &Figures) -> String {
    let Some(sum) = &figures.sum_mbps else { return without_rates(figures) };
    let blocked = figures.users.iter().filter(|user| user.blocked == Some(true)).count();
    let others = named(sum)[1..].iter().map(|(name, rate, _)| format!("{name} {rate:.1}")).collect::<Vec<_>>();
    let others = if others.is_empty() { String::new() } else { format!(" ({})", others.join(", ")) };
    let [decision, round, ..] = &figures.times[..] else { return String::new() };
    format!(
        "tick {:>6}  {}  blocked {blocked}/{}  {} {:6.1} Mbit/s{others}  decision p99 {}  loop p99 {}",
        figures.tick,
        figures.array.state,
        figures.users.len(),
        sum.name(),
        sum.policy,
        time(decision, |us| us.p99),
        time(round, |us| us.p99),
    )
}

/// The known sum rates by name, the policy first.
pub(super) fn named(sum: &SumFigures) -> Vec<(&'static str, f64, Color)> {
    let all = [
        ("policy", Some(sum.policy), POLICY),
        ("no IRS", sum.no_irs, NO_IRS),
        ("flat", sum.flat, FLAT),
        ("oracle", sum.oracle, ORACLE),
    ];
    all.into_iter().filter_map(|(name, rate, colour)| Some((name, rate?, colour))).collect()
}

pub(crate) fn time(of: &TimeFigures, which: fn(&heliostat_proto::Quantiles) -> f64) -> String {
    of.us.as_ref().map_or("-".into(), |us| format!("{:.0} us", which(us)))
}

/// Why there are no sum rates.
pub(crate) fn why_without_rates(figures: &Figures) -> &'static str {
    match figures.origin {
        Origin::NoData => "no messages from the room",
        Origin::Simulated | Origin::Real => "no measured gains",
    }
}

/// The figures in one line, without sum rates.
pub(super) fn without_rates(figures: &Figures) -> String {
    let why = why_without_rates(figures);
    match figures.origin {
        Origin::NoData => why.to_owned(),
        Origin::Simulated | Origin::Real => {
            format!("tick {:>6}  {}  sum rate unknown: {why}", figures.tick, figures.array.state)
        }
    }
}
