use heliostat_proto::Stamp;

use super::*;

#[test]
fn a_stop_report_that_arrives_late_shows_no_device_as_stopped() {
    let order = EmergencyStop { stamp: Stamp { source: 3, sequence: 4, time_ns: 0 }, ..EmergencyStop::default() };
    let report = |sequence, device_stopped| StopReport {
        stamp: Stamp { source: 9, sequence, time_ns: 0 },
        device_stopped,
        stops: vec![LatchedStopReport { source: 3, sequence: 4, ..LatchedStopReport::default() }],
        ..StopReport::default()
    };
    let mut seen = Seen::default();
    seen.add_arrays(1);
    seen.order(Instant::now(), &order);
    seen.handle_stops(0, report(2, false));
    seen.handle_stops(0, report(1, true));
    assert_eq!(seen.standings(None), [(0, Standing::Latched { problem: String::new() })]);
    seen.handle_stops(0, report(3, true));
    assert_eq!(seen.standings(None), [(0, Standing::Stopped)]);
}
