//! The figures as text: what the full-screen view and the lines share.

use ratatui::style::Color;

use crate::figures::{Figures, Origin, SumFigures, TimeFigures};

/// The Okabe-Ito palette, which is distinguishable with colour-vision deficiency.
pub(super) const POLICY: Color = Color::Rgb(0x56, 0xB4, 0xE9);
pub(super) const FLAT: Color = Color::Rgb(0xCC, 0x79, 0xA7);
pub(super) const NO_IRS: Color = Color::Rgb(0x99, 0x99, 0x99);
pub(super) const ORACLE: Color = Color::Rgb(0xF0, 0xE4, 0x42);

/// The figures in one line.
pub(super) fn line(figures: &Figures) -> String {
    let Some(sum) = &figures.sum_mbps else { return without_rates(figures) };
    let blocked = figures.users.iter().filter(|user| user.blocked == Some(true)).count();
    let others = named(sum)[1..].iter().map(|(name, rate, _)| format!("{name} {rate:.1}")).collect::<Vec<_>>();
    let others = if others.is_empty() { String::new() } else { format!(" ({})", others.join(", ")) };
    let [decision, round, ..] = &figures.times[..] else { return String::new() };
    format!(
        "tick {:>6}  {}  blocked {blocked}/{}  sum rate {:6.1} Mbit/s{others}  decision p99 {}  loop p99 {}",
        figures.tick,
        figures.array.state,
        figures.users.len(),
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

pub(super) fn time(of: &TimeFigures, which: fn(&heliostat_proto::Quantiles) -> f64) -> String {
    of.us.as_ref().map_or("-".into(), |us| format!("{:.0} us", which(us)))
}

/// Why there are no sum rates.
pub(super) fn without_rates(figures: &Figures) -> String {
    match figures.origin {
        Origin::NoData => "no messages from the room".into(),
        Origin::Simulated | Origin::Measured => {
            format!("tick {:>6}  {}  sum rate unknown: no measured gains", figures.tick, figures.array.state)
        }
    }
}
