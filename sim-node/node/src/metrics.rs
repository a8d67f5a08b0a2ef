//! The metrics of the room.

use heliostat_room::baselines::Measured;
use heliostat_service::{Histogram, Page};

use crate::summary::{BeliefSummary, Summary};
use crate::tick_ledger::TickLedger;

/// The metrics of the room without the rates.
pub(crate) fn page(room: &str, summary: &Summary, ticks: &TickLedger) -> Page {
    let mut page = Page::new(&[("room", room)]);
    page.build_info("sim-node", env!("CARGO_PKG_VERSION"));
    for (name, help, value) in [
        ("heliostat_ticks", "Position reports published", summary.ticks),
        ("heliostat_ticks_lost", "Ticks that no accepted command answered in time", summary.lost_ticks),
        ("heliostat_ticks_late", "Delayed ticks: published after their due time, or skipped", summary.late_ticks),
        (
            "heliostat_ticks_unattended",
            "Ticks before the first answer, or without one during a stop",
            summary.unattended_ticks,
        ),
    ] {
        page.counter(name, help, &[], value);
    }
    page.commands(summary.commands, summary.clipped_commands, &summary.refused);
    if let Some(BeliefSummary { places, inside_50, inside_95 }) = summary.belief {
        let help = "Places in the controller's belief that were compared with the truth";
        page.counter("heliostat_belief_places", help, &[], places);
        for (ellipse, count) in [("50", inside_50), ("95", inside_95)] {
            let help = "Those whose ellipse of this probability in percent held the true place";
            page.counter("heliostat_belief_places_inside", help, &[("ellipse", ellipse)], count);
        }
    }
    let help = "Time from the publication of a position report to the arrival of the command that answers it";
    page.histogram("heliostat_loop_seconds", help, &[], Histogram::of_ns(ticks.latency_ns()));
    page
}

/// Adds the rates at the last computed instant.
pub(crate) fn add_rates(page: &mut Page, measured: &Measured) {
    let sums = &measured.sum_rates_bps;
    for (angles, rate) in
        [("policy", sums.policy), ("no-irs", sums.no_irs), ("flat", sums.flat), ("oracle", sums.oracle)]
    {
        page.gauge(
            "heliostat_sum_rate_bps",
            "Sum rate with the policy's angles, without the array, with flat mirrors, and with the oracle",
            &[("angles", angles)],
            rate,
        );
    }
    let blocked = measured.los_blocked.iter().filter(|blocked| **blocked).count();
    for (name, help, count) in [
        ("heliostat_users", "Users in the room", measured.rates_bps.len()),
        ("heliostat_users_met", "Users whose minimum rate is met", measured.met),
        ("heliostat_users_met_oracle", "Users whose minimum rate the oracle would meet", measured.met_oracle),
        ("heliostat_users_blocked", "Users whose direct path is blocked", blocked),
    ] {
        page.gauge(name, help, &[], count as f64);
    }
}
