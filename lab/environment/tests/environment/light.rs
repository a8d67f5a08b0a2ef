//! The watch over the light of served users: silent in rooms as described, and not where mirrors or LEDs
//! differ.

use heliostat_core::belief::light::LightLevel;
use heliostat_core::core::Controller;
use heliostat_core::policy::build_fallback;
use heliostat_environment::ClosedLoop;
use heliostat_room::episode::Episode;
use heliostat_scenario::{Fallback, Scenario};

const SECOND_NS: u64 = 1_000_000_000;

fn scenario(name: &str, overrides: &[&str]) -> Scenario {
    Scenario::builtin(name).unwrap().with_overrides(overrides).unwrap()
}

/// What the watch found of the mirrors, and of the LED that differs most.
#[derive(Clone, Copy, Debug)]
struct Found {
    /// At the end.
    ratios: [f64; 2],
    /// Time in s from the controller's start to the first alarm.
    alarms_s: [Option<f64>; 2],
}

/// A controller of the room `name` in one that differs by `truth`, for some seconds of virtual time.
fn watched((name, room): (&str, &[&str]), truth: &[&str], seed: u64, seconds: u64) -> Found {
    let nominal = scenario(name, room);
    let policy = build_fallback(Fallback::FixedPoint, &nominal).unwrap();
    let controller = Controller::new(&nominal, nominal.channel_model().unwrap(), policy, 1);
    let episode = Episode::new(&scenario(name, &[room, truth].concat()), None, seed, SECOND_NS).unwrap();
    let mut room = ClosedLoop::new(episode, controller);
    let mut found = Found { ratios: [1.0; 2], alarms_s: [None; 2] };
    while let Some((now, event)) = room.poll_event((1 + seconds) * SECOND_NS) {
        room.deliver(now, event, &mut |_| {}).unwrap();
        let light = room.controller().light().expect("a belief");
        let by_distance = |level: &&LightLevel| level.ratio().ln().abs();
        let led = light.leds().iter().max_by(|one, other| by_distance(one).total_cmp(&by_distance(other)));
        for (index, level) in [light.mirrors(), led.expect("a room has an LED")].into_iter().enumerate() {
            found.ratios[index] = level.ratio();
            if level.off_since_ns().is_some() {
                found.alarms_s[index].get_or_insert((now.room_ns - SECOND_NS) as f64 * 1e-9);
            }
        }
    }
    found
}

#[test]
fn a_room_as_described_is_silent() {
    for room in [("hall", &[][..]), ("hall", &["users.orientation={}"]), ("specular", &[])] {
        for seed in 0..3 {
            let found = watched(room, &[], seed, 40);
            assert_eq!(found.alarms_s, [None; 2], "{room:?}, seed {seed}: {found:?}");
        }
    }
}

#[test]
fn mirrors_out_of_place_and_dirty_mirrors_are_noticed_and_the_led_is_not_blamed() {
    for (truth, ratio_max) in [("actuator.offset_deg=2.0", 0.7), ("mirrors.reflectivity=0.57", 0.75)] {
        for seed in 0..3 {
            let found = watched(("hall", &[]), &[truth], seed, 60);
            let [mirrors_s, led_s] = found.alarms_s;
            assert!(mirrors_s.is_some() && led_s.is_none(), "{truth}, seed {seed}: {found:?}");
            assert!(found.ratios[0] < ratio_max, "{truth}, seed {seed}: {found:?}");
        }
    }
}

#[test]
fn a_dimmed_led_is_noticed_before_the_mirrors_are() {
    for seed in 0..3 {
        // A smaller detector receives less light on all paths. The belief takes a part of the loss for tilted
        // receivers, which receive another share of the light over the mirrors.
        let found = watched(("hall", &[]), &["receiver.area_mm2=8"], seed, 60);
        let [mirrors_s, led_s] = found.alarms_s;
        let led_s = led_s.unwrap_or_else(|| panic!("seed {seed}: {found:?}"));
        assert!(mirrors_s.is_none_or(|mirrors_s| mirrors_s > led_s), "seed {seed}: {found:?}");
    }
}

const ROOMS: [(&str, &[&str]); 10] = [
    ("hall", &[]),
    ("hall", &["users.mobility=social-force"]),
    ("hall", &["users.mobility=seated"]),
    ("hall", &["users.orientation={}"]),
    ("hall", &["blockage.obstacles_per_m2=0"]),
    ("office", &[]),
    ("corridor", &[]),
    ("atrium", &[]),
    ("lab", &[]),
    ("specular", &[]),
];

const TRUTHS: [&[&str]; 13] = [
    &[],
    &["mismatch.level=typical"],
    &["mismatch.level=rough", "mismatch.kinds=[\"tracker\"]"],
    &["mismatch.level=rough"],
    &["actuator.offset_deg=0.6"],
    &["actuator.offset_deg=1"],
    &["actuator.offset_deg=2"],
    &["mirrors.reflectivity=0.76"],
    &["mirrors.reflectivity=0.57"],
    &["led.positions_m=[[0.1,0,3]]"],
    &["led.positions_m=[[0.3,0,3]]"],
    &["receiver.area_mm2=12"],
    &["receiver.area_mm2=8"],
];

/// A quantile of some values, in one word.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// Prints the tables of docs/experiments/light.md.
#[test]
#[ignore = "prints the tables of docs/experiments/light.md"]
fn light_of_rooms_as_described_and_of_others() {
    let number = |name: &str, default: u64| std::env::var(name).map_or(default, |text| text.parse().expect("a number"));
    let (seeds, seconds) = (number("HELIOSTAT_LIGHT_SEEDS", 20), number("HELIOSTAT_LIGHT_SECONDS", 120));
    let as_described = ROOMS.iter().map(|room| (*room, TRUTHS[0]));
    let others = TRUTHS[1..].iter().map(|truth| (ROOMS[0], *truth));
    println!("| room | differs by | mirrors: ratio | alarms | after (s) | LED: ratio | alarms | after (s) |");
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    for ((name, room), truth) in as_described.chain(others) {
        let found: Vec<Found> = (0..seeds).map(|seed| watched((name, room), truth, 9100 + seed, seconds)).collect();
        let cells = [0, 1].map(|of| {
            let mut ratios: Vec<f64> = found.iter().map(|found| found.ratios[of]).collect();
            let mut after_s: Vec<f64> = found.iter().filter_map(|found| found.alarms_s[of]).collect();
            let [least, middle, most] = [0.0, 0.5, 1.0].map(|share| quantile(&mut ratios, share));
            let delay = match after_s.is_empty() {
                true => "-".to_owned(),
                false => format!("{:.0}, {:.0}", quantile(&mut after_s, 0.5), quantile(&mut after_s, 1.0)),
            };
            format!("{middle:.2} ({least:.2} to {most:.2}) | {} of {seeds} | {delay}", after_s.len())
        });
        let words = |overrides: &[&str]| overrides.iter().map(|word| format!(" `{word}`")).collect::<String>();
        println!("| `{name}`{} |{} | {} | {} |", words(room), words(truth), cells[0], cells[1]);
    }
}
