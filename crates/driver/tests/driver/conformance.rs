//! The conformance check: the kit keeps every rule, and each driver with a flaw fails exactly the
//! rules that it breaks.
//!
//! - [`stopped`]: the check of an array that is stopped.

mod stopped;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use heliostat_array::content::Content;
use heliostat_array::latch::{Latch, LatchedStop};
use heliostat_array::moment::Moment;
use heliostat_array::refusal_counts::RefusalCounts;
use heliostat_bus::{Bus, BusConfig, Class, Presence, join_through, private_endpoint};
use heliostat_channel::MirrorAngles;
use heliostat_driver::check::{self, Report, Verdict};
use heliostat_driver::clock::Clock;
use heliostat_driver::run::Settings;
use heliostat_driver::session::{ArraySession, MessagePublisher};
use heliostat_driver::{Device, DeviceError, Kit, run};
use heliostat_proto::{
    AxisLimits, Capabilities, EmergencyStop, Feedback, NodeKind, NodeStatus, Room, Stamp, StopAction, StopReport,
    ValidityClock, encode,
};
use heliostat_service::Stop;

use crate::LIMIT;

/// How mirrors fail.
enum Failure {
    Raises,
    /// The driver ends.
    Ends(Stop),
    /// The call returns when the driver is to end.
    Hangs(Stop),
}

/// Mirrors that are always at their commanded angles.
struct Exact {
    capabilities: Capabilities,
    angles: MirrorAngles,
    /// It fails after so many turns.
    turns: u32,
    failure: Failure,
    /// Measured angles over those of the mirrors.
    scale: f64,
}

impl Exact {
    fn new() -> Self {
        let axis = AxisLimits { min_rad: -0.25, max_rad: 0.5, ..AxisLimits::default() };
        let capabilities = Capabilities {
            hardware: "exact".into(),
            driver: "test".into(),
            rows: 1,
            columns: 3,
            roll: axis,
            yaw: axis,
            feedback: Feedback::ClosedLoop,
            park_after_ms: 1000,
            ..Capabilities::default()
        };
        Self { capabilities, angles: MirrorAngles::flat(3), turns: u32::MAX, failure: Failure::Raises, scale: 1.0 }
    }
}

impl Device for Exact {
    fn capabilities(&self) -> Capabilities {
        self.capabilities.clone()
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        match (self.turns.checked_sub(1), &self.failure) {
            (Some(turns), _) => self.turns = turns,
            (None, Failure::Raises) => return Err(DeviceError::new("exact", "turn raised")),
            (None, Failure::Ends(driver)) => driver.request(),
            (None, Failure::Hangs(driver)) => {
                driver.wait_for(LIMIT);
            }
        }
        self.angles.clone_from(angles);
        Ok(())
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        into.clone_from(&self.angles);
        into.roll.iter_mut().chain(&mut into.yaw).for_each(|angle| *angle *= self.scale);
        Ok(true)
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// Waits for the tokens of so many drivers: the check waits for one.
fn wait_for_drivers(config: &BusConfig, count: usize) {
    let Ok(bus) = Bus::open(config) else { return };
    let begun = Instant::now();
    let drivers = bus.room().array(0).drivers_alive();
    while begun.elapsed() < LIMIT && bus.alive(&drivers, LIMIT).is_ok_and(|tokens| tokens.len() < count) {
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Checks the driver that `drive` runs, in a separate room.
fn checked(room: &str, drive: impl FnOnce(BusConfig, &Stop) + Send) -> Report {
    checked_until(room, (&Stop::default(), &drop), drive).unwrap()
}

/// The same until a request; the lines before the rules are shown.
fn checked_until(
    room: &str,
    (end, show): (&Stop, &dyn Fn(String)),
    drive: impl FnOnce(BusConfig, &Stop) + Send,
) -> anyhow::Result<Report> {
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new(room).unwrap());
    let stop = Stop::default();
    std::thread::scope(|scope| {
        let driver = config.clone().listen_at(&endpoint);
        scope.spawn(|| drive(driver, &stop));
        let config = config.connect_to(&endpoint);
        let report = check::run(&config, 0, LIMIT, end, show);
        stop.request();
        report
    })
}

fn broken(report: &Report) -> Vec<&'static str> {
    report.broken().map(|finding| finding.rule).collect()
}

#[test]
fn a_driver_with_the_kit_keeps_every_rule() {
    let report =
        checked("kept", |bus, stop| drop(run::run(Kit::new(Exact::new()), &Settings::new(bus), stop).unwrap()));
    assert!(report.findings.iter().all(|finding| finding.verdict == Verdict::Kept), "{report}");
    assert_eq!((report.mirrors, report.hardware.as_str()), (3, "exact"));
}

#[test]
fn a_device_that_fails_is_named_before_the_rules_and_breaks_none() {
    let mut device = Exact::new();
    device.turns = 3;
    let report = checked("failing", |bus, stop| drop(run::run(Kit::new(device), &Settings::new(bus), stop).unwrap()));
    assert!(report.problem.as_ref().is_some_and(|problem| problem.contains("turn raised")), "{report}");
    assert_eq!(broken(&report), [""; 0], "{report}");
    let flood = report.findings.iter().find(|finding| finding.rule == "flood");
    assert!(flood.is_some_and(|flood| flood.verdict == Verdict::NotJudged), "no command is applied: {report}");
}

#[test]
fn a_driver_that_ends_or_hangs_during_the_check_breaks_no_rule_and_is_named() {
    type Fail = fn(Stop) -> Failure;
    let cases = [
        ("ended", Failure::Ends as Fail, "the driver ended", "the driver had ended"),
        ("hanging", Failure::Hangs, "sends no telemetry", "the driver sends no telemetry"),
    ];
    for (room, failure, problem, evidence) in cases {
        let report = checked(room, |bus, stop| {
            let device = Exact { turns: 3, failure: failure(stop.clone()), ..Exact::new() };
            drop(run::run(Kit::new(device), &Settings::new(bus), stop).unwrap());
        });
        assert!(report.problem.as_ref().is_some_and(|found| found.contains(problem)), "{report}");
        assert_eq!(broken(&report), [""; 0], "{report}");
        let last = report.findings.last().map(|finding| (finding.verdict, finding.evidence.as_str()));
        assert_eq!(last, Some((Verdict::NotJudged, evidence)), "{report}");
    }
}

#[test]
fn a_device_that_always_measures_zero_or_measures_degrees_breaks_the_rule_of_measured_angles() {
    for (room, scale) in [("zeros", 0.0), ("degrees", 1_f64.to_degrees())] {
        let device = Exact { scale, ..Exact::new() };
        let report = checked(room, |bus, stop| drop(run::run(Kit::new(device), &Settings::new(bus), stop).unwrap()));
        assert!(broken(&report).contains(&"measured"), "{report}");
    }
}

#[test]
fn validity_rules_are_not_judged_for_a_driver_that_counts_from_arrival() {
    let mut device = Exact::new();
    device.capabilities.validity_clock = ValidityClock::Arrival;
    device.capabilities.feedback = Feedback::ClosedLoop;
    let report = checked("clockless", |bus, stop| drop(run::run(Kit::new(device), &Settings::new(bus), stop).unwrap()));
    let not_judged = report.findings.iter().filter(|finding| finding.verdict == Verdict::NotJudged);
    assert_eq!(not_judged.map(|finding| finding.rule).collect::<Vec<_>>(), ["expired", "future"]);
    assert_eq!(broken(&report), [""; 0], "{report}");
}

/// The flaw of a driver.
#[derive(Clone, Copy, PartialEq)]
enum Flaw {
    IgnoresStops,
    ReleasesOrphanedStops,
    FollowsAnySequence,
    FollowsAnyTime,
    Unlimited,
    NeverParks,
    FollowsAnyNumber,
    FollowsAnyValidity,
    ReleasesAnyName,
    UsesAnyGain,
    IgnoresRepetitions,
    ListsFewStops,
    PublishesNoSafety,
    PublishesNoStatus,
    PublishesAnothersStatus,
}

/// A driver with one flaw: a correct kit whose messages are changed on the way in or out.
fn flawed(flaw: Flaw, bus: &BusConfig, stop: &Stop) {
    let bus = Bus::open(bus).unwrap();
    let clock = Clock::start_in(Duration::ZERO);
    let mut session = ArraySession::open(&bus, 0, clock, Class::HighDrop).unwrap();
    let mut statuses = MessagePublisher::new(&bus, &bus.room().status(NodeKind::Driver), Class::LowDrop).unwrap();
    let _token = bus.announce(&bus.room().alive(NodeKind::Driver, 1)).unwrap();
    let left = Arc::new(AtomicBool::new(false));
    let watcher = Arc::clone(&left);
    let watched = bus.room().alive_of(NodeKind::Viewer);
    let on_change = move |_: &str, presence| watcher.store(presence == Presence::Gone, Ordering::Relaxed);
    let _watch = bus.watch(&watched, on_change).unwrap();
    let announced = Exact::new().capabilities;
    let mut device = Exact::new();
    match flaw {
        Flaw::Unlimited => {
            let wide = AxisLimits { min_rad: -1.5, max_rad: 1.5, ..AxisLimits::default() };
            (device.capabilities.roll, device.capabilities.yaw) = (wide, wide);
        }
        Flaw::NeverParks => device.capabilities.park_after_ms = 3_600_000,
        _ => {}
    }
    let mut kit = Kit::new(device);
    let mut refused = RefusalCounts::default();
    let (mut reported, mut count, mut sequence) = ((0, 0), 0, 0);
    let (mut announcement, mut latch) = (Instant::now(), Latch::default());
    while !stop.is_requested() {
        while let Some(mut arrival) = session.received().pop_until(Instant::now() + Duration::from_millis(20)) {
            if matches!(
                (flaw, &arrival.content),
                (Flaw::IgnoresStops, Content::Stop(_)) | (Flaw::IgnoresRepetitions, Content::Repetition(_))
            ) {
                continue;
            }
            let mut sent = None;
            if let Content::Command(Ok(command)) = &mut arrival.content {
                sent = Some((command.epoch, command.sequence));
                if flaw == Flaw::FollowsAnySequence {
                    count += 1;
                    (command.epoch, command.sequence) = (1, count);
                }
                if flaw == Flaw::FollowsAnyTime {
                    command.time_ns = arrival.at.room_ns;
                }
                if flaw == Flaw::FollowsAnyNumber {
                    // As if the numbers had no bound: they exclude all later ones.
                    command.epoch = command.epoch.min(arrival.at.room_ns / 1_000_000 + 30_000);
                    command.sequence = command.sequence.min(1 << 31);
                }
                if flaw == Flaw::FollowsAnyValidity {
                    command.validity_ms = command.validity_ms.min(10_000);
                }
            }
            match (&mut arrival.content, kit.array().latch().stop()) {
                (Content::Rearm(Ok(order)), Some(stop)) if flaw == Flaw::ReleasesAnyName => {
                    (order.stop_source, order.stop_sequence) = (stop.source, stop.sequence);
                }
                (Content::Calibration(Ok(calibration)), _) if flaw == Flaw::UsesAnyGain => {
                    for gain in calibration.roll_gain.iter_mut().chain(&mut calibration.yaw_gain) {
                        *gain = gain.clamp(0.5, 2.0);
                    }
                }
                _ => {}
            }
            if kit.handle((arrival.at, arrival.at), arrival.content, &mut refused).is_some() {
                reported = sent.unwrap();
            }
        }
        let now = clock.now();
        kit.advance(now);
        if flaw == Flaw::ReleasesOrphanedStops && left.swap(false, Ordering::Relaxed) {
            let stamp = Stamp { time_ns: now.room_ns, ..Stamp::default() };
            let order = EmergencyStop { stamp, action: StopAction::Rearm, ..EmergencyStop::default() };
            kit.handle_stop(now, &order).ok();
        }
        sequence += 1;
        let stamp = Stamp { source: 1, sequence, time_ns: now.room_ns };
        if flaw != Flaw::PublishesNoSafety && (Instant::now() >= announcement || *kit.array().latch() != latch) {
            latch.clone_from(kit.array().latch());
            session.publish_safety(&kit.safety(stamp)).unwrap();
            if matches!(flaw, Flaw::IgnoresRepetitions | Flaw::ListsFewStops) {
                let listed = if flaw == Flaw::ListsFewStops { 4 } else { usize::MAX };
                let stops = latch.stops().iter().take(listed).map(LatchedStop::report).collect();
                let report =
                    StopReport { stamp, device_stopped: latch.stop().is_some(), stops, ..StopReport::default() };
                session.publish_stops(&report).unwrap();
            }
        }
        let mut telemetry = kit.telemetry(now, stamp);
        (telemetry.epoch, telemetry.applied_sequence) = reported;
        session.publish_telemetry(&telemetry).unwrap();
        if Instant::now() >= announcement {
            announcement += Duration::from_secs(1);
            session.publish_capabilities(&Capabilities { stamp, ..announced.clone() }).unwrap();
            let source = if flaw == Flaw::PublishesAnothersStatus { 2 } else { stamp.source };
            let status =
                NodeStatus { stamp: Stamp { source, ..stamp }, node: NodeKind::Driver, ..NodeStatus::default() };
            statuses.encode(&status).unwrap();
            if flaw != Flaw::PublishesNoStatus {
                statuses.put().unwrap();
            }
        }
    }
}

#[test]
fn each_driver_with_a_flaw_fails_exactly_the_rules_that_it_breaks() {
    let cases: [(Flaw, &str, &[&str]); 14] = [
        (Flaw::IgnoresStops, "ignores-stops", &["stop", "orphaned-stop", "safety-report", "named-rearm"]),
        (Flaw::ReleasesOrphanedStops, "releases-stops", &["orphaned-stop"]),
        (Flaw::FollowsAnySequence, "sequences", &["old-sequence", "old-epoch", "epoch-bound", "sequence-bound"]),
        (Flaw::FollowsAnyTime, "times", &["expired", "future"]),
        (Flaw::Unlimited, "unlimited", &["limits"]),
        (Flaw::NeverParks, "never-parks", &["silence"]),
        (Flaw::FollowsAnyNumber, "numbers", &["epoch-bound", "sequence-bound", "validity-bound"]),
        (Flaw::FollowsAnyValidity, "validity", &["validity-bound"]),
        (Flaw::IgnoresRepetitions, "repetitions", &["stop-repetition"]),
        (Flaw::ListsFewStops, "few-stops", &["stop-list"]),
        (Flaw::ReleasesAnyName, "names", &["named-rearm"]),
        (Flaw::UsesAnyGain, "gains", &["calibration-bound"]),
        (Flaw::PublishesNoStatus, "no-status", &["status"]),
        (Flaw::PublishesAnothersStatus, "foreign-status", &["status"]),
    ];
    std::thread::scope(|scope| {
        let runs = cases.map(|(flaw, room, expected)| {
            (scope.spawn(move || checked(room, |bus, stop| flawed(flaw, &bus, stop))), expected)
        });
        for (run, expected) in runs {
            let report = run.join().unwrap();
            assert_eq!(broken(&report), expected, "{report}");
        }
    });
}

#[test]
fn a_driver_without_safety_reports_is_not_judged_by_the_rules_that_need_them() {
    let report = checked("older", |bus, stop| flawed(Flaw::PublishesNoSafety, &bus, stop));
    let not_judged = report.findings.iter().filter(|finding| finding.verdict == Verdict::NotJudged);
    let expected = [
        "safety-report",
        "stop-report",
        "stop-repetition",
        "named-rearm",
        "epoch-bound",
        "sequence-bound",
        "validity-bound",
        "calibration-bound",
        "stop-list",
    ];
    assert_eq!(not_judged.map(|finding| finding.rule).collect::<Vec<_>>(), expected, "{report}");
    assert_eq!(broken(&report), [""; 0], "{report}");
}

#[test]
fn an_array_with_two_drivers_is_not_checked() {
    let endpoints = [private_endpoint().unwrap(), private_endpoint().unwrap()];
    let config = BusConfig::new(Room::new("two").unwrap());
    let both = endpoints.iter().fold(config.clone(), |config, endpoint| config.connect_to(endpoint));
    let stop = Stop::default();
    std::thread::scope(|scope| {
        for endpoint in &endpoints {
            // They do not see each other when they start.
            let settings = Settings::new(config.clone().listen_at(endpoint));
            let stop = &stop;
            scope.spawn(move || run::run(Kit::new(Exact::new()), &settings, stop).unwrap());
        }
        wait_for_drivers(&both, 2);
        let refusal = check::run(&both, 0, LIMIT, &Stop::default(), &drop);
        stop.request();
        let refusal = format!("{:#}", refusal.unwrap_err());
        assert!(refusal.contains("2 drivers report this array"), "{refusal}");
    });
}

#[test]
fn a_room_with_a_controller_that_only_the_driver_reaches_is_not_checked() {
    let endpoint = private_endpoint().unwrap();
    let config = BusConfig::new(Room::new("used").unwrap());
    let settings = Settings::new(config.clone().listen_at(&endpoint));
    let config = config.connect_to(&endpoint);
    let [stop, end] = [Stop::default(), Stop::default()];
    std::thread::scope(|scope| {
        scope.spawn(|| run::run(Kit::new(Exact::new()), &settings, &stop).unwrap());
        scope.spawn(|| {
            let bus = Bus::open(&config).unwrap();
            let room = bus.room();
            let _token = bus.announce(&room.alive(NodeKind::Controller, 7)).unwrap();
            let publisher = bus.publisher(&room.status(NodeKind::Controller), Class::LowDrop).unwrap();
            let counters = vec![(format!("{}host-a", NodeStatus::HOST), 1)];
            let stamp = Stamp { source: 7, ..Stamp::default() };
            let mut status = Vec::new();
            encode(&NodeStatus { stamp, counters, ..NodeStatus::default() }, &mut status).unwrap();
            while !end.wait_for(Duration::from_millis(50)) {
                publisher.put(&status).unwrap();
            }
        });
        wait_for_drivers(&config, 1);
        let begun = Instant::now();
        let through = join_through(&config, LIMIT).0.unwrap();
        let controllers = through.room().alive_of(NodeKind::Controller);
        while begun.elapsed() < LIMIT && through.alive(&controllers, LIMIT).is_ok_and(|tokens| tokens.is_empty()) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let refusal = check::run(&config, 0, LIMIT, &Stop::default(), &drop);
        stop.request();
        end.request();
        let refusal = format!("{:#}", refusal.unwrap_err());
        let expected = "1 controller in room \"used\": end 0000000000000007 on host-a first";
        assert!(refusal.starts_with(expected) && refusal.ends_with("Nothing was sent"), "{refusal}");
    });
}
