//! The controller's metrics, made by the status loop.

use std::collections::BTreeMap;

use heliostat_core::{
    core::{DegradedMode, Stage},
    refusal::{Refusal, Refused, Stream},
    tenure::TenureEvent,
};
use heliostat_proto::{NodeStatus, gauges::ServedLight, messages::fault};
use heliostat_service::{Histogram, Page};

use super::{
    stage_times::StageTimes,
    summary::{RoomReport, Summary},
};

/// The page of all rooms.
pub fn page(rooms: &[RoomReport<'_>]) -> Page {
    let mut page = Page::default();
    for room in rooms {
        page.set_common(&[("room", room.room.name())]);
        add_room(&mut page, room);
    }
    // What follows is of the process, such as the end of its certificate. Keys are for one room.
    if rooms.len() > 1 {
        page.set_common(&[]);
    }
    page.build_info("controller", env!("CARGO_PKG_VERSION"));
    page
}

fn add_room(page: &mut Page, report: &RoomReport<'_>) {
    let summary = report.summary;
    let policy = [("policy", summary.policy.as_str())];
    page.gauge("heliostat_policy_info", "Name of the policy in use; the value is always 1", &policy, 1.0);
    let source = format!("{:016x}", report.source);
    let controller = [("source", source.as_str()), ("host", report.host)];
    let help = "Source id and host of the controller, as the page shows them; the value is always 1";
    page.gauge("heliostat_controller_info", help, &controller, 1.0);
    for (name, help, value) in [
        (
            "heliostat_decisions",
            "Decisions on position reports: commands, and decisions to send none",
            summary.decisions,
        ),
        ("heliostat_commands", "Commands given to the transport", summary.commands),
        ("heliostat_commands_unsent", "Commands that the transport refused", summary.unsent),
        (
            "heliostat_reports_dropped",
            "Reports superseded by a newer one or dropped from a full queue",
            summary.dropped,
        ),
        (
            "heliostat_policy_stalls",
            "Policy timeouts: status checks at which the policy had not returned for 0.1 s",
            summary.unanswered,
        ),
        ("heliostat_room_sources", "Sources that owned the room, in succession", summary.sources),
    ] {
        page.counter(name, help, &[], value);
    }
    for (name, help, value) in [
        ("heliostat_epoch", "Epoch of the commands", summary.epoch),
        (
            "heliostat_controller_peers",
            "Other controllers in the room from which statuses arrive, and calibrations; 16 at most",
            summary.peers,
        ),
        ("heliostat_trackers", "Trackers and simulators in the room, by their liveliness tokens", summary.trackers),
        (
            "heliostat_stops_held",
            "Emergency stops that withhold commands, also for arrays that do not report; a stop of several arrays counts for each",
            summary.stops_held,
        ),
    ] {
        page.gauge(name, help, &[], value as f64);
    }
    for (name, help, is_set) in [
        ("heliostat_standby", "1 while the array follows another controller", summary.standby),
        (
            "heliostat_standby_missing",
            "1 while no other controller reports, although there was one that did not end in order",
            summary.standby_missing,
        ),
        ("heliostat_array_unfit", "1 while the array does not fit the scenario", summary.unfit.is_some()),
        ("heliostat_driver_absent", "1 while no driver receives the commands to an array", summary.driver_absent),
        (
            "heliostat_geometry_differs",
            "1 while the room announces another geometry, unless a calibration explains it",
            summary.geometry_differs,
        ),
    ] {
        page.flag(name, help, &[], is_set);
    }
    add_times(page, report.times);
    for (stream, count) in &summary.missed {
        let help = "Reports that did not arrive, by the gaps in their sequence numbers";
        page.counter("heliostat_reports_missed", help, &[("stream", stream.as_str())], *count);
    }
    add_counts_from_0(page, summary);
    for (by, count) in [("range", summary.clipped.range), ("slew", summary.clipped.slew)] {
        let help = "Axis angles changed by a limit of range or slew rate";
        page.counter("heliostat_angles_limited", help, &[("by", by)], count);
    }
    if let Some(belief) = &summary.belief {
        let help = "Positions in reports that were compared with the belief's predictions";
        page.counter("heliostat_belief_reports", help, &[], belief.reports);
        let help =
            "Mean normalised innovation squared of these positions since the start; 2 if the covariance is right";
        page.gauge("heliostat_belief_innovation_mean", help, &[], belief.innovation_mean);
    }
    if let Some(noise) = summary.belief.and_then(|belief| belief.noise) {
        for (by, position_m, velocity_m_s) in [
            ("belief", noise.position_m, noise.velocity_m_s),
            ("scenario", noise.position_stated_m, noise.velocity_stated_m_s),
        ] {
            let help = "Standard deviation of a reported coordinate: learned by the belief, stated by the scenario";
            page.gauge("heliostat_tracker_position_noise_metres", help, &[("by", by)], position_m);
            let help = "Standard deviation of a reported velocity component: learned, stated";
            page.gauge("heliostat_tracker_velocity_noise_metres_per_second", help, &[("by", by)], velocity_m_s);
        }
    }
    for ServedLight { of, ratio, off_since_s } in &summary.light {
        let labels = [("of", of.as_str())];
        let help = "Median of the measured light of served users relative to the expected one";
        page.gauge("heliostat_light_ratio", help, &labels, *ratio);
        page.flag("heliostat_light_off", "1 while it is not the expected light", &labels, off_since_s.is_some());
    }
    for array in &summary.arrays {
        let help = "Of several arrays: 1 while the array receives the commands of this controller";
        page.flag("heliostat_array_commanded", help, &[("array", array.name.as_str())], array.commanded);
    }
    if let Some(array) = &summary.array {
        for (bit, name) in fault::NAMES {
            let help = "1 while the array reports this fault";
            page.flag("heliostat_array_fault", help, &[("fault", name)], array.faults & bit != 0);
        }
        let unusable = array.unusable as f64;
        page.gauge("heliostat_array_unusable_mirrors", "Mirrors that do not follow commands", &[], unusable);
        let help = "Commands that the array has refused since its start";
        page.counter("heliostat_array_refused", help, &[], array.refused);
    }
}

/// Adds each count by cause, also one of 0: the increase of a counter that begins at its first event lacks that event.
fn add_counts_from_0(page: &mut Page, summary: &Summary) {
    let count_of = |counts: &BTreeMap<String, u64>, name: &str| counts.get(name).copied().unwrap_or_default();
    for mode in DegradedMode::ALL.map(DegradedMode::name) {
        let (name, help, counts) = match NodeStatus::WITHHELD.contains(&mode) {
            true => ("heliostat_withheld", NodeStatus::WITHHELD_MEANING, &summary.withheld),
            false => ("heliostat_fallbacks", NodeStatus::FALLBACKS_MEANING, &summary.fallbacks),
        };
        page.counter(name, help, &[("cause", mode)], count_of(counts, mode));
    }
    for reason in Summary::USERS {
        let help = "Users without a measured gain or beyond the policy's capacity, one for each decision";
        page.counter("heliostat_users_limited", help, &[("reason", reason)], count_of(&summary.users, reason));
    }
    let refusals =
        Stream::ALL.into_iter().flat_map(|stream| Refusal::ALL.map(|refusal| Refused::name_of(stream, refusal)));
    for name in refusals.chain([Summary::FOREIGN_ARRAY.to_owned()]) {
        let (stream, reason) = name.split_once(':').unwrap_or((name.as_str(), ""));
        let labels = [("stream", stream), ("reason", reason)];
        let count = count_of(&summary.refused, &name);
        page.counter("heliostat_refused", "Messages refused, by stream and reason", &labels, count);
    }
    for event in TenureEvent::ALL.map(TenureEvent::name) {
        let help = "Changes of the epoch or of the standby, by kind";
        page.counter("heliostat_epoch_events", help, &[("event", event)], count_of(&summary.epoch_events, event));
    }
}

fn add_times(page: &mut Page, times: &StageTimes) {
    let help = "From the arrival of a position report to the end of the command's publication";
    page.histogram("heliostat_decision_seconds", help, &[], Histogram::of_ns(times.decision()));
    let help = "From the measurement of the positions to the decision";
    page.histogram("heliostat_information_age_seconds", help, &[], Histogram::of_ns(times.age()));
    for stage in Stage::ALL {
        let (times_of, name) = (Histogram::of_ns(times.stage(stage)), stage.name());
        page.histogram("heliostat_stage_seconds", "Duration of one stage of a decision", &[("stage", name)], times_of);
        let help = "Decisions longer than 0.5 ms, by their longest stage";
        page.counter("heliostat_decision_misses", help, &[("cause", name)], times.over_budget_by(stage));
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::Room;

    use super::super::stage_times::PolicyTimes;
    use super::*;

    /// The page of the room "demo".
    fn page_of(summary: &Summary) -> String {
        let (room, times) = (Room::new("demo").expect("a valid name"), StageTimes::default());
        let policy_times = PolicyTimes::default();
        let (source, host) = (0x94ca, "host-a");
        page(&[RoomReport { room: &room, source, host, summary, times: &times, policy_times: &policy_times }]).text()
    }

    #[test]
    fn commands_that_are_withheld_are_no_fallbacks_as_on_the_page() {
        let counts = |mode: &str| BTreeMap::from([(mode.to_owned(), 3)]);
        let summary = Summary { fallbacks: counts("late"), withheld: counts("standby"), ..Summary::default() };
        let text = page_of(&summary);
        let info = "heliostat_controller_info{room=\"demo\",source=\"00000000000094ca\",host=\"host-a\"} 1";
        assert!(text.contains(info), "{text}");
        let lines: Vec<&str> = text.lines().filter(|line| line.contains("cause=\"") && line.ends_with(" 3")).collect();
        let expected = [
            "heliostat_fallbacks_total{room=\"demo\",cause=\"late\"} 3",
            "heliostat_withheld_total{room=\"demo\",cause=\"standby\"} 3",
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn each_cause_of_a_fallback_and_each_reason_of_a_refusal_is_counted_from_0() {
        let text = page_of(&Summary::default());
        for line in [
            "heliostat_fallbacks_total{room=\"demo\",cause=\"late\"} 0\n",
            "heliostat_withheld_total{room=\"demo\",cause=\"standby\"} 0\n",
            "heliostat_users_limited_total{room=\"demo\",reason=\"unserved\"} 0\n",
            "heliostat_refused_total{room=\"demo\",stream=\"users\",reason=\"stale\"} 0\n",
            "heliostat_refused_total{room=\"demo\",stream=\"array\",reason=\"foreign-source\"} 0\n",
        ] {
            assert!(text.contains(line), "{line}{text}");
        }
        let refused = BTreeMap::from([("users:stale".to_owned(), 4)]);
        let text = page_of(&Summary { refused, ..Summary::default() });
        assert!(
            text.contains("heliostat_refused_total{room=\"demo\",stream=\"users\",reason=\"stale\"} 4\n"),
            "{text}"
        );
    }

    #[test]
    fn each_event_of_the_tenure_is_counted_from_0_and_held_stops_are_shown() {
        let epoch_events = BTreeMap::from([("took-over".to_owned(), 2)]);
        let text =
            page_of(&Summary { epoch_events, stops_held: 1, trackers: 2, standby_missing: true, ..Summary::default() });
        for event in TenureEvent::ALL {
            let (name, count) = (event.name(), if event == TenureEvent::TookOver { 2 } else { 0 });
            let line = format!("heliostat_epoch_events_total{{room=\"demo\",event=\"{name}\"}} {count}\n");
            assert!(text.contains(&line), "{line}{text}");
        }
        assert!(text.contains("heliostat_stops_held{room=\"demo\"} 1"), "{text}");
        assert!(text.contains("heliostat_build_info{room=\"demo\",process=\"controller\""), "alerts name the room");
        assert!(text.contains("heliostat_trackers{room=\"demo\"} 2"), "{text}");
        assert!(text.contains("heliostat_standby_missing{room=\"demo\"} 1"), "{text}");
    }
}
