//! The controller's metrics, made by the status loop.

use heliostat_core::{core::Stage, tenure::TenureEvent};
use heliostat_proto::{NodeStatus, gauges::ServedLight, messages::fault};
use heliostat_service::{Histogram, Page};

use super::summary::RoomReport;

/// The page of all rooms.
pub fn page(rooms: &[RoomReport<'_>]) -> Page {
    let mut page = Page::default();
    rooms.iter().for_each(|room| add_room(&mut page, room));
    // What follows is of the process, such as the end of its certificate. Keys are for one room.
    if let [only] = rooms {
        page.set_common(&[("room", only.room.name())]);
    }
    page.build_info("controller", env!("CARGO_PKG_VERSION"));
    page
}

fn add_room(page: &mut Page, report: &RoomReport<'_>) {
    let summary = report.summary;
    let room = ("room", report.room.name());
    let policy = [room, ("policy", summary.policy.as_str())];
    page.gauge("heliostat_policy_info", "Name of the policy in use; the value is always 1", &policy, 1.0);
    let source = format!("{:016x}", report.source);
    let controller = [room, ("source", source.as_str()), ("host", report.host)];
    let help = "Source id and host of the controller, as the page shows them; the value is always 1";
    page.gauge("heliostat_controller_info", help, &controller, 1.0);
    page.gauge("heliostat_epoch", "Epoch of the commands", &[room], summary.epoch as f64);
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
        page.counter(name, help, &[room], value);
    }
    add_times(page, report);
    for (name, help, counts) in [
        ("heliostat_fallbacks", NodeStatus::FALLBACKS_MEANING, &summary.fallbacks),
        ("heliostat_withheld", NodeStatus::WITHHELD_MEANING, &summary.withheld),
    ] {
        for (cause, count) in counts {
            page.counter(name, help, &[room, ("cause", cause.as_str())], *count);
        }
    }
    for (name, count) in &summary.refused {
        let (stream, reason) = name.split_once(':').unwrap_or((name.as_str(), ""));
        let labels = [room, ("stream", stream), ("reason", reason)];
        page.counter("heliostat_refused", "Messages refused, by stream and reason", &labels, *count);
    }
    let standby = f64::from(u8::from(summary.standby));
    page.gauge("heliostat_standby", "1 while the array follows another controller", &[room], standby);
    page.gauge(
        "heliostat_controller_peers",
        "Other controllers in the room from which statuses arrive, and calibrations; 16 at most",
        &[room],
        summary.peers as f64,
    );
    let missing = f64::from(u8::from(summary.standby_missing));
    page.gauge(
        "heliostat_standby_missing",
        "1 while no other controller reports, although there was one that did not end in order",
        &[room],
        missing,
    );
    page.gauge(
        "heliostat_trackers",
        "Trackers and simulators in the room, by their liveliness tokens",
        &[room],
        summary.trackers as f64,
    );
    page.gauge(
        "heliostat_stops_held",
        "Emergency stops that withhold commands, also for arrays that do not report; a stop of several arrays counts for each",
        &[room],
        summary.stops_held as f64,
    );
    let unfit = f64::from(u8::from(summary.unfit.is_some()));
    page.gauge("heliostat_array_unfit", "1 while the array does not fit the scenario", &[room], unfit);
    let absent = f64::from(u8::from(summary.driver_absent));
    page.gauge("heliostat_driver_absent", "1 while no driver receives the commands to an array", &[room], absent);
    let differs = f64::from(u8::from(summary.geometry_differs));
    page.gauge(
        "heliostat_geometry_differs",
        "1 while the room announces another geometry, unless a calibration explains it",
        &[room],
        differs,
    );
    // Each from 0: the increase of a counter that begins at its first event does not show that event.
    for event in TenureEvent::ALL.map(TenureEvent::name) {
        let count = summary.epoch_events.get(event).copied().unwrap_or_default();
        let help = "Changes of the epoch or of the standby, by kind";
        page.counter("heliostat_epoch_events", help, &[room, ("event", event)], count);
    }
    for (reason, count) in &summary.users {
        let help = "Users without a measured gain or beyond the policy's capacity, one for each decision";
        page.counter("heliostat_users_limited", help, &[room, ("reason", reason.as_str())], *count);
    }
    for (stream, count) in &summary.missed {
        let help = "Reports that did not arrive, by the gaps in their sequence numbers";
        page.counter("heliostat_reports_missed", help, &[room, ("stream", stream.as_str())], *count);
    }
    for (by, count) in [("range", summary.clipped.range), ("slew", summary.clipped.slew)] {
        let help = "Axis angles changed by a limit of range or slew rate";
        page.counter("heliostat_angles_limited", help, &[room, ("by", by)], count);
    }
    if let Some(belief) = &summary.belief {
        let help = "Positions in reports that were compared with the belief's predictions";
        page.counter("heliostat_belief_reports", help, &[room], belief.reports);
        let help =
            "Mean normalised innovation squared of these positions since the start; 2 if the covariance is right";
        page.gauge("heliostat_belief_innovation_mean", help, &[room], belief.innovation_mean);
    }
    if let Some(noise) = summary.belief.and_then(|belief| belief.noise) {
        for (by, position_m, velocity_m_s) in [
            ("belief", noise.position_m, noise.velocity_m_s),
            ("scenario", noise.position_stated_m, noise.velocity_stated_m_s),
        ] {
            let labels = [room, ("by", by)];
            let help = "Standard deviation of a reported coordinate: learned by the belief, stated by the scenario";
            page.gauge("heliostat_tracker_position_noise_metres", help, &labels, position_m);
            let help = "Standard deviation of a reported velocity component: learned, stated";
            page.gauge("heliostat_tracker_velocity_noise_metres_per_second", help, &labels, velocity_m_s);
        }
    }
    for ServedLight { of, ratio, off_since_s } in &summary.light {
        let labels = [room, ("of", of.as_str())];
        let help = "Median of the measured light of served users relative to the expected one";
        page.gauge("heliostat_light_ratio", help, &labels, *ratio);
        let off = f64::from(u8::from(off_since_s.is_some()));
        page.gauge("heliostat_light_off", "1 while it is not the expected light", &labels, off);
    }
    for array in &summary.arrays {
        let help = "Of several arrays: 1 while the array receives the commands of this controller";
        let commanded = f64::from(u8::from(array.commanded));
        page.gauge("heliostat_array_commanded", help, &[room, ("array", array.name.as_str())], commanded);
    }
    if let Some(array) = &summary.array {
        for (bit, name) in fault::NAMES {
            let value = f64::from(u8::from(array.faults & bit != 0));
            let help = "1 while the array reports this fault";
            page.gauge("heliostat_array_fault", help, &[room, ("fault", name)], value);
        }
        let (unusable, refused) = (array.unusable as f64, array.refused);
        page.gauge("heliostat_array_unusable_mirrors", "Mirrors that do not follow commands", &[room], unusable);
        page.counter(
            "heliostat_array_refused",
            "Commands that the array has refused since its start",
            &[room],
            refused,
        );
    }
}

fn add_times(page: &mut Page, report: &RoomReport<'_>) {
    let (room, times) = (("room", report.room.name()), report.times);
    let help = "From the arrival of a position report to the end of the command's publication";
    page.histogram("heliostat_decision_seconds", help, &[room], Histogram::of_ns(times.decision()));
    let help = "From the measurement of the positions to the decision";
    page.histogram("heliostat_information_age_seconds", help, &[room], Histogram::of_ns(times.age()));
    for stage in Stage::ALL {
        let (named, caused) = ([room, ("stage", stage.name())], [room, ("cause", stage.name())]);
        let help = "Duration of one stage of a decision";
        page.histogram("heliostat_stage_seconds", help, &named, Histogram::of_ns(times.stage(stage)));
        let help = "Decisions longer than 0.5 ms, by their longest stage";
        page.counter("heliostat_decision_misses", help, &caused, times.over_budget_by(stage));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use heliostat_proto::Room;

    use super::super::stage_times::{PolicyTimes, StageTimes};
    use super::super::summary::Summary;
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
