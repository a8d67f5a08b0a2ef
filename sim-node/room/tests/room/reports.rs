//! The report streams: rates, latencies, order, noise.

use heliostat_array::moment::Moment;
use heliostat_channel::{Combining, Orientation};
use heliostat_proto::{BranchReport, ChannelReport, LedReport, OrientationReport, UserReport};
use heliostat_room::SimulatedRoom;
use heliostat_room::reports::{Report, Reports};
use heliostat_scenario::Scenario;

const MS: u64 = 1_000_000;
const SOURCE: u64 = 42;

/// Runs the streams in simulated time; returns each report with the time of its release.
fn run(overrides: &[&str], until_ms: u64) -> Vec<(u64, Report)> {
    let scenario = Scenario::builtin("specular").unwrap().with_overrides(overrides).unwrap();
    let mut room = SimulatedRoom::new(&scenario, None, 3).unwrap();
    let mut reports = Reports::new(&scenario.streams, 3, SOURCE);
    let mut out = Vec::new();
    loop {
        let now = reports.next_sample_ns().min(reports.next_release_ns());
        if now > until_ms * MS {
            return out;
        }
        room.advance(now);
        reports.sample(Moment::simulated(now), room.world(), room.angles());
        while let Some(report) = reports.release(now) {
            out.push((now, report));
        }
    }
}

/// Functions that select the reports of one kind, each with the time of its release.
macro_rules! selections {
    ($($name:ident: $kind:ident($report:ty)),+) => { $(
        fn $name(reports: &[(u64, Report)]) -> Vec<(u64, &$report)> {
            reports
                .iter()
                .filter_map(|(at, report)| if let Report::$kind(found) = report { Some((*at, found)) } else { None })
                .collect()
        }
    )+ };
}

selections!(
    users: Users(UserReport),
    channels: Channel(ChannelReport),
    branches: Branches(BranchReport),
    orientations: Orientation(OrientationReport)
);

/// Receivers of seven branches, which are reported.
const BRANCHES: [&str; 2] = ["receiver.preset=angle-diversity", "streams.channel.branches=true"];

#[test]
fn each_stream_has_its_own_rate_and_latency_and_stamps_have_the_sample_time() {
    let settings = [
        "streams.positions.rate_hz=50",
        "streams.positions.latency_ms=30",
        "streams.channel.rate_hz=100",
        "streams.channel.latency_ms=5",
        "streams.obstacles.rate_hz=0",
    ];
    let reports = run(&settings, 1000);
    let (users, channels) = (users(&reports), channels(&reports));
    assert_eq!((users.len(), channels.len()), (49, 100));
    assert_eq!(users.len() + channels.len(), reports.len(), "obstacles are switched off");
    for (i, (at, report)) in users.iter().enumerate() {
        assert_eq!((report.tick, report.stamp.sequence), (i as u64 + 1, i as u64 + 1));
        assert_eq!(report.stamp.source, SOURCE);
        assert_eq!(report.stamp.time_ns, i as u64 * 20 * MS);
        assert_eq!(at - report.stamp.time_ns, 30 * MS);
    }
    for (i, (at, report)) in channels.iter().enumerate() {
        assert_eq!(report.stamp.sequence, i as u64 + 1);
        assert_eq!(at - report.stamp.time_ns, 5 * MS);
        assert_eq!(report.tick, i as u64 / 2 + 1, "the tick in which it was sampled");
    }
}

#[test]
fn positions_are_the_last_report_of_an_instant() {
    let settings = ["streams.obstacles.rate_hz=50", "streams.orientation.rate_hz=50"];
    let reports = run(&[&settings[..], &BRANCHES, &LEDS].concat(), 100);
    let rank = |report: &Report| match report {
        Report::Obstacles(_) => 0,
        Report::Orientation(_) => 1,
        Report::Branches(_) => 2,
        Report::Leds(_) => 3,
        Report::Channel(_) => 4,
        Report::Users(_) => 5,
    };
    let order: Vec<(u64, i32)> = reports.iter().map(|(at, report)| (*at, rank(report))).collect();
    assert!(order.is_sorted(), "{order:?}");
    assert_eq!(order[..6], [0, 1, 2, 3, 4, 5].map(|rank| (0, rank)));
    assert_eq!(order[6..10], [2, 3, 4, 5].map(|rank| (10 * MS, rank)));
}

#[test]
fn noise_has_its_size_and_does_not_change_the_other_streams() {
    let quiet = run(&[], 20_000);
    let noisy = run(&["streams.positions.noise_m=0.05", "streams.positions.velocity_noise_m_s=0.2"], 20_000);
    let deviation = |pick: fn(&UserReport, usize) -> f32| {
        let pairs = users(&quiet)
            .into_iter()
            .zip(users(&noisy))
            .flat_map(|((_, a), (_, b))| (0..5).map(move |user| f64::from(pick(b, user) - pick(a, user))));
        let squares: Vec<f64> = pairs.map(|difference| difference * difference).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    assert!((deviation(|r, u| r.users[u].position_m[0]) / 0.05 - 1.0).abs() < 0.05);
    assert!((deviation(|r, u| r.users[u].position_m[2]) / 0.05 - 1.0).abs() < 0.05);
    assert!((deviation(|r, u| r.users[u].velocity_m_s[1]) / 0.2 - 1.0).abs() < 0.05);
    assert_eq!(channels(&quiet), channels(&noisy));
}

#[test]
fn gain_noise_is_relative_and_a_blocked_path_remains_blocked() {
    let quiet = run(&["blockage.forced_users=1"], 20_000);
    let noisy = run(&["blockage.forced_users=1", "streams.channel.noise_relative=0.1"], 20_000);
    let mut ratios = Vec::new();
    for ((_, a), (_, b)) in channels(&quiet).into_iter().zip(channels(&noisy)) {
        assert_eq!((a.users[0].los_gain, b.users[0].los_gain), (0.0, 0.0));
        for (a, b) in a.users.iter().zip(&b.users).filter(|(a, _)| a.los_gain > 0.0) {
            let ratio = f64::from(b.los_gain / a.los_gain);
            ratios.push(ratio);
            if a.irs_gain == 0.0 {
                assert!((f64::from(b.sinr / a.sinr) - ratio * ratio).abs() < 1e-4);
            }
        }
    }
    let deviation = (ratios.iter().map(|r| (r - 1.0).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
    assert!((deviation / 0.1 - 1.0).abs() < 0.05, "{deviation}");
    assert_eq!(users(&quiet), users(&noisy));
}

const CONVERTER: [&str; 2] = ["streams.channel.resolution_bits=6", "streams.channel.full_scale_gain=1.26e-6"];

#[test]
fn quantised_gains_are_multiples_of_a_step_up_to_the_full_scale() {
    let (exact, quantised) = (run(&[], 2000), run(&CONVERTER, 2000));
    let step = 2e-8;
    let (mut zeros, mut saturated) = (0, 0);
    for ((_, a), (_, b)) in channels(&exact).into_iter().zip(channels(&quantised)) {
        for (a, b) in a.users.iter().zip(&b.users) {
            for (exact, read) in [(a.los_gain, b.los_gain), (a.irs_gain, b.irs_gain)] {
                let (exact, steps) = (f64::from(exact), f64::from(read) / step);
                assert!((steps - steps.round()).abs() < 1e-4 && steps < 63.01, "{steps}");
                assert!((exact.min(63.0 * step) - steps * step).abs() < 0.501 * step, "{exact} {steps}");
                zeros += u32::from(exact > 0.0 && read == 0.0);
                saturated += u32::from(exact > 63.5 * step);
            }
            let ratio = f64::from(b.los_gain + b.irs_gain) / f64::from(a.los_gain + a.irs_gain);
            if ratio.is_finite() {
                assert!((f64::from(b.sinr) - f64::from(a.sinr) * ratio * ratio).abs() < 1e-4 * f64::from(a.sinr));
            }
        }
    }
    assert!(zeros > 0 && saturated > 0, "{zeros} {saturated}");
    assert_eq!(users(&exact), users(&quantised));
}

#[test]
fn the_noise_of_a_receiver_has_its_size_at_every_gain_and_is_never_negative() {
    let relative = "streams.channel.noise_relative=0.1";
    let quiet = run(&["blockage.forced_users=1", relative], 20_000);
    let noisy = run(&["blockage.forced_users=1", relative, "streams.channel.noise_gain=1e-8"], 20_000);
    let (mut errors, mut blocked) = (Vec::new(), Vec::new());
    for ((_, a), (_, b)) in channels(&quiet).into_iter().zip(channels(&noisy)) {
        blocked.push(f64::from(b.users[0].los_gain));
        let clear = a.users.iter().zip(&b.users).filter(|(a, _)| a.los_gain > 1e-7);
        errors.extend(clear.map(|(a, b)| f64::from(b.los_gain) - f64::from(a.los_gain)));
    }
    let deviation = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
    assert!((deviation / 1e-8 - 1.0).abs() < 0.05, "{deviation}");
    // Half of the readings of a blocked path are clipped; the mean of the others is that of a
    // half-normal number.
    let zeros = blocked.iter().filter(|gain| **gain == 0.0).count() as f64 / blocked.len() as f64;
    let mean = blocked.iter().sum::<f64>() / blocked.len() as f64 / (1.0 - zeros);
    assert!((zeros - 0.5).abs() < 0.05 && (mean / 0.798e-8 - 1.0).abs() < 0.06, "{zeros} {mean}");
}

#[test]
fn lost_reports_are_missing_and_the_others_do_not_change() {
    let noise = ["streams.channel.noise_relative=0.1", "streams.positions.noise_m=0.05"];
    let losses = ["streams.channel.loss=0.3", "streams.positions.loss=0.2", "streams.positions.loss_burst_reports=4"];
    let (complete, lossy) = (run(&noise, 20_000), run(&[&noise[..], &losses].concat(), 20_000));
    let share = |lost: usize, all: usize| 1.0 - lost as f64 / all as f64;
    let (arrived, all) = (channels(&lossy), channels(&complete));
    assert!((share(arrived.len(), all.len()) - 0.3).abs() < 0.04, "{} {}", arrived.len(), all.len());
    assert!(arrived.iter().all(|report| all.contains(report)));
    let (arrived, all) = (users(&lossy), users(&complete));
    assert!((share(arrived.len(), all.len()) - 0.2).abs() < 0.06, "{} {}", arrived.len(), all.len());
    assert!(arrived.iter().all(|report| all.contains(report)));
    assert!(arrived.windows(2).any(|pair| pair[1].1.tick >= pair[0].1.tick + 5), "losses in a row");
}

fn held(report: &OrientationReport) -> Vec<Orientation> {
    let of = |quaternion: [f32; 4]| Orientation::from_quaternion(quaternion.map(f64::from)).unwrap();
    report.users.iter().map(|user| of(user.quaternion)).collect()
}

#[test]
fn orientations_are_reported_where_the_scenario_names_their_stream() {
    let tilted = "users.orientation.model=measured";
    assert!(orientations(&run(&[tilted], 1000)).is_empty());
    let stream = ["streams.orientation.rate_hz=20", "streams.orientation.latency_ms=30"];
    let up = run(&stream, 100);
    assert!(orientations(&up).iter().all(|(_, report)| held(report) == [Orientation::UPRIGHT; 5]));
    let reports = run(&[&[tilted], &stream[..]].concat(), 1000);
    let scenario = Scenario::builtin("specular").unwrap().with_overrides(&[tilted]).unwrap();
    let mut room = SimulatedRoom::new(&scenario, None, 3).unwrap();
    for (index, (at, report)) in orientations(&reports).into_iter().enumerate() {
        let (sampled_ns, sequence) = (index as u64 * 50 * MS, index as u64 + 1);
        assert_eq!((report.stamp.time_ns, report.stamp.sequence, at), (sampled_ns, sequence, sampled_ns + 30 * MS));
        room.advance(sampled_ns);
        assert_eq!(report.users.iter().map(|user| user.user).collect::<Vec<_>>(), room.world().ids());
        for (reported, true_one) in held(report).iter().zip(room.world().orientations()) {
            assert!((reported.normal() - true_one.normal()).norm() < 1e-6);
        }
    }
}

#[test]
fn noise_of_orientations_turns_them_about_each_axis_and_does_not_change_the_other_streams() {
    let settings = ["users.orientation.model=measured", "streams.orientation.rate_hz=100"];
    let quiet = run(&settings, 20_000);
    let noisy = run(&[&settings[..], &["streams.orientation.noise_deg=3"]].concat(), 20_000);
    let mut squares = [Vec::new(), Vec::new(), Vec::new()];
    for ((_, a), (_, b)) in orientations(&quiet).into_iter().zip(orientations(&noisy)) {
        for (a, b) in held(a).iter().zip(held(b)) {
            let [w, x, y, z] = a.quaternion();
            let back = Orientation::from_quaternion([w, -x, -y, -z]).unwrap();
            // For small rotations, twice the vector part is the angle about each axis.
            let [_, error @ ..] = back.then(&b).quaternion();
            squares.iter_mut().zip(error).for_each(|(squares, part)| squares.push((2.0 * part).powi(2)));
        }
    }
    for squares in &squares {
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt().to_degrees();
        assert!((deviation / 3.0 - 1.0).abs() < 0.05, "{deviation}");
    }
    assert_eq!((users(&quiet), channels(&quiet)), (users(&noisy), channels(&noisy)));
}

#[test]
fn reports_have_the_users_of_their_moment_and_channel_entries_match_them() {
    let arrivals = [
        "users.arrivals.rate_per_min=240",
        "users.arrivals.mean_stay_s=1",
        "users.arrivals.max_users=8",
        "streams.channel.latency_ms=25",
    ];
    let reports = run(&arrivals, 10_000);
    let (users, channels) = (users(&reports), channels(&reports));
    let ids = |report: &UserReport| report.users.iter().map(|user| user.user).collect::<Vec<_>>();
    let mut sizes: Vec<usize> = users.iter().map(|(_, report)| report.users.len()).collect();
    for (_, channel) in &channels {
        let same = users.iter().find(|(_, report)| report.stamp.time_ns == channel.stamp.time_ns);
        let Some((_, report)) = same else { continue };
        assert_eq!(channel.users.iter().map(|user| user.user).collect::<Vec<_>>(), ids(report));
    }
    sizes.sort_unstable();
    sizes.dedup();
    assert!(sizes.len() > 4, "{sizes:?}");
}

#[test]
fn combined_branches_are_the_gains_of_the_channel_report_with_the_same_stamp() {
    for (rule, combining) in [("best", Combining::Best), ("equal-gain", Combining::EqualGain)] {
        let rule = format!("receiver.combining={rule}");
        let tilted = "users.orientation.model=measured";
        let reports = run(&[&BRANCHES[..], &[&rule, tilted, "streams.channel.latency_ms=5"]].concat(), 1000);
        let (branches, channels) = (branches(&reports), channels(&reports));
        assert_eq!((branches.len(), channels.len()), (100, 100));
        let mut lit = 0;
        for ((at, branch), (channel_at, channel)) in branches.into_iter().zip(channels) {
            assert_eq!((at, branch.stamp, branch.tick), (channel_at, channel.stamp, channel.tick));
            for (gains, combined) in branch.users.iter().zip(&channel.users) {
                assert_eq!((gains.user, gains.los_gain.len(), gains.irs_gain.len()), (combined.user, 7, 7));
                for (gains, combined) in [(&gains.los_gain, combined.los_gain), (&gains.irs_gain, combined.irs_gain)] {
                    let gains: Vec<f64> = gains.iter().map(|gain| f64::from(*gain)).collect();
                    let (found, expected) = (combining.combine(&gains), f64::from(combined));
                    assert!((found - expected).abs() <= 1e-6 * expected, "{found} instead of {expected}");
                    let different = gains.iter().any(|gain| *gain > 0.0 && *gain != gains[0]);
                    lit += u32::from(different);
                }
            }
        }
        assert!(lit > 300, "{lit}");
    }
    assert!(branches(&run(&["receiver.preset=angle-diversity"], 1000)).is_empty(), "only where the scenario asks");
}

#[test]
fn branches_are_measured_one_by_one_and_lost_with_the_channel_report() {
    let noise = ["streams.channel.noise_relative=0.1", "streams.channel.loss=0.3"];
    let (quiet, noisy) = (run(&BRANCHES, 20_000), run(&[&BRANCHES[..], &noise].concat(), 20_000));
    let (quiet, arrived) = (branches(&quiet), branches(&noisy));
    let of_channel: Vec<u64> = channels(&noisy).iter().map(|(_, report)| report.stamp.sequence).collect();
    assert_eq!(arrived.iter().map(|(_, report)| report.stamp.sequence).collect::<Vec<_>>(), of_channel);
    let mut errors = Vec::new();
    for (_, report) in arrived {
        let (_, exact) = quiet[report.stamp.sequence as usize - 1];
        for (exact, read) in exact.users.iter().zip(&report.users) {
            let pairs = exact.los_gain.iter().zip(&read.los_gain).filter(|(exact, _)| **exact > 0.0);
            let pairs: Vec<f64> = pairs.map(|(exact, read)| f64::from(read / exact) - 1.0).collect();
            errors.extend(pairs.windows(2).map(|pair| [pair[0], pair[1]]));
        }
    }
    let mean = |of: &dyn Fn(&[f64; 2]) -> f64| errors.iter().map(of).sum::<f64>() / errors.len() as f64;
    let deviation = mean(&|[one, _]| one * one).sqrt();
    assert!((deviation / 0.1 - 1.0).abs() < 0.05, "{deviation}");
    let correlation = mean(&|[one, other]| one * other) / deviation.powi(2);
    assert!(correlation.abs() < 0.05, "each branch has noise of its own: {correlation}");

    let quantised = run(&[&BRANCHES[..], &CONVERTER].concat(), 500);
    let steps = |gain: &f32| f64::from(*gain) / 2e-8;
    let mut readings = 0;
    for (_, report) in branches(&quantised) {
        for gain in report.users.iter().flat_map(|user| user.los_gain.iter().chain(&user.irs_gain)) {
            assert!((steps(gain) - steps(gain).round()).abs() < 1e-4 && steps(gain) < 63.01, "{gain}");
            readings += u32::from(*gain > 0.0);
        }
    }
    assert!(readings > 100, "{readings}");
}

#[test]
fn branch_reports_do_not_change_the_other_reports() {
    let noise = ["streams.channel.noise_relative=0.1", "streams.channel.noise_gain=1e-8", "streams.channel.loss=0.1"];
    let without = run(&[&["receiver.preset=angle-diversity"], &noise[..]].concat(), 2000);
    let with = run(&[&BRANCHES[..], &noise].concat(), 2000);
    assert_eq!(channels(&without), channels(&with));
    assert_eq!(users(&without), users(&with));
    assert_eq!(with.len(), without.len() + channels(&with).len());
}

/// Two LEDs, of which the receivers report the gains.
const LEDS: [&str; 2] = ["led.positions_m=[[-1,0,3],[1,0,3]]", "streams.channel.leds=gains"];

fn leds(reports: &[(u64, Report)]) -> Vec<&LedReport> {
    reports.iter().filter_map(|(_, report)| if let Report::Leds(r) = report { Some(r) } else { None }).collect()
}

#[test]
fn receivers_report_the_gain_of_each_led_past_bodies_and_obstacles() {
    let scenario = Scenario::builtin("specular").unwrap().with_overrides(&LEDS).unwrap();
    let mut room = SimulatedRoom::new(&scenario, None, 3).unwrap();
    let reports = run(&LEDS, 500);
    let mut blocked = 0;
    for (report, (_, channel)) in leds(&reports).into_iter().zip(channels(&reports)) {
        assert_eq!((report.stamp, report.tick), (channel.stamp, channel.tick));
        room.advance(report.stamp.time_ns);
        let world = room.world();
        for (index, (user, measured)) in report.users.iter().zip(&channel.users).enumerate() {
            let gain = |led: u32| {
                let found = report.gains.iter().find(|gain| (gain.user, gain.led) == (user.user, led));
                found.map_or(0.0, |gain| gain.los_gain)
            };
            let by_led = |led: usize| world.scene().los_gain_by(world.model(), world.blockers(), index, led);
            assert_eq!([gain(0), gain(1)], [by_led(0) as f32, by_led(1) as f32]);
            assert_eq!(user.serving.map_or(0.0, gain), measured.los_gain);
            assert!(gain(0).max(gain(1)) == measured.los_gain, "the serving LED is the strongest one");
            blocked += u32::from(gain(0) == 0.0 || gain(1) == 0.0);
        }
    }
    assert!(blocked > 0, "some path is blocked");
}

#[test]
fn led_reports_name_the_serving_led_alone_where_gains_are_not_measured_and_none_below_the_noise() {
    let serving = run(&[LEDS[0], "streams.channel.leds=serving"], 100);
    let reports = leds(&serving);
    assert!(
        reports.iter().all(|report| report.gains.is_empty() && report.users.iter().all(|user| !user.measures_each))
    );
    assert!(reports.iter().flat_map(|report| &report.users).any(|user| user.serving.is_some()));
    let noisy = run(&[&LEDS[..], &["streams.channel.noise_gain=1e-3"]].concat(), 100);
    assert!(leds(&noisy).iter().flat_map(|report| &report.users).all(|user| user.serving.is_none()));
    assert!(leds(&run(&LEDS[..1], 100)).is_empty());
}

#[test]
fn led_reports_do_not_change_the_other_reports() {
    let noise = ["streams.channel.noise_relative=0.1", "streams.channel.noise_gain=1e-8", "streams.channel.loss=0.1"];
    let without = run(&[&LEDS[..1], &noise[..]].concat(), 2000);
    let with = run(&[&LEDS[..], &noise].concat(), 2000);
    assert_eq!(channels(&without), channels(&with));
    assert_eq!(users(&without), users(&with));
    assert_eq!(with.len(), without.len() + channels(&with).len());
}
