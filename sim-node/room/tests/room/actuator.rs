//! The actuators of the profiles: motion, settling, slew limit and faults.

use heliostat_channel::MirrorAngles;
use heliostat_room::mirrors::actuator::Actuator;
use heliostat_room::mirrors::fault::AxisFault;
use heliostat_room::random::{Purpose, stream, uniform, uniform_in};
use heliostat_scenario::{Actuator as Table, ActuatorParameters, ActuatorProfile};

const MIRRORS: usize = 6;

fn parameters(profile: ActuatorProfile) -> ActuatorParameters {
    Table { profile, jitter_deg: Some(0.0), ..Table::default() }.parameters()
}

fn actuator(parameters: &ActuatorParameters) -> Actuator {
    Actuator::new(parameters, MIRRORS, stream(1, Purpose::Actuator, 0))
}

/// Commands at irregular times over half a second.
fn commands() -> Vec<(f64, MirrorAngles)> {
    let mut rng = stream(7, Purpose::Walk, 0);
    let mut time = 0.0;
    let mut commands = Vec::new();
    while time < 0.5 {
        let mut angles = || (0..MIRRORS).map(|_| uniform_in(&mut rng, -0.6, 0.6)).collect();
        let (roll, yaw) = (angles(), angles());
        commands.push((time, MirrorAngles { roll, yaw }));
        time += 0.002 + 0.02 * uniform(&mut rng);
    }
    commands
}

/// Runs the commands with steps of at most `longest` seconds; returns the angles just before each
/// command.
fn run(parameters: &ActuatorParameters, longest: f64) -> Vec<MirrorAngles> {
    let mut mirrors = actuator(parameters);
    let mut seen = Vec::new();
    let mut now = 0.0;
    for (at, angles) in commands() {
        while now < at {
            let step = longest.min(at - now);
            mirrors.step(step);
            now += step;
        }
        seen.push(mirrors.angles().clone());
        mirrors.command(&angles);
    }
    seen
}

#[test]
fn the_motion_does_not_depend_on_the_step_size() {
    for profile in [ActuatorProfile::Ideal, ActuatorProfile::Mems, ActuatorProfile::Servo] {
        let parameters = ActuatorParameters { hysteresis_rad: 0.05, scale_error_relative: 0.02, ..parameters(profile) };
        let single = run(&parameters, 1.0);
        assert!(single.iter().any(|angles| angles.roll[0] != 0.0));
        for longest in [3e-3, 1e-3, 0.7e-4] {
            for (a, b) in single.iter().zip(&run(&parameters, longest)) {
                let pairs = a.roll.iter().zip(&b.roll).chain(a.yaw.iter().zip(&b.yaw));
                let gap = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(gap < 1e-9, "{profile:?} in steps of {longest} s differs by {gap} rad");
            }
        }
    }
}

/// Seconds until all axes stay within a hundredth of a step of 0.2 rad.
fn settling_s(profile: ActuatorProfile) -> f64 {
    let mut mirrors = actuator(&parameters(profile));
    mirrors.command(&MirrorAngles { roll: vec![0.2; MIRRORS], yaw: vec![-0.2; MIRRORS] });
    let (step, mut last_out) = (1e-4, 0.0);
    for i in 0..20_000 {
        mirrors.step(step);
        let angles = mirrors.angles();
        let off = angles.roll.iter().map(|roll| (roll - 0.2).abs());
        if off.chain(angles.yaw.iter().map(|yaw| (yaw + 0.2).abs())).any(|off| off > 0.002) {
            last_out = f64::from(i + 1) * step;
        }
    }
    last_out
}

#[test]
fn fast_mirrors_settle_in_milliseconds_and_servos_in_tenths_of_a_second() {
    let mems = settling_s(ActuatorProfile::Mems);
    assert!((0.5e-3..20e-3).contains(&mems), "{mems} s");
    let servo = settling_s(ActuatorProfile::Servo);
    assert!((0.03..0.5).contains(&servo), "{servo} s");
}

#[test]
fn the_slew_limit_bounds_the_mean_speed_of_a_long_turn() {
    let slew = 2.0;
    let limited = ActuatorParameters { slew_rad_per_s: Some(slew), ..parameters(ActuatorProfile::Mems) };
    let mut mirrors = actuator(&limited);
    mirrors.command(&MirrorAngles { roll: vec![0.8; MIRRORS], yaw: vec![0.0; MIRRORS] });
    mirrors.step(0.1);
    let after_100_ms = mirrors.angles().roll[0];
    mirrors.step(0.2);
    let speed = (mirrors.angles().roll[0] - after_100_ms) / 0.2;
    assert!((speed - slew).abs() < 1e-6, "{speed} rad/s");
}

#[test]
fn each_fault_has_its_effect() {
    for profile in [ActuatorProfile::Ideal, ActuatorProfile::Mems] {
        let mut mirrors = actuator(&ActuatorParameters { resolution_bits: None, ..parameters(profile) });
        let to = |angle: f64| MirrorAngles { roll: vec![angle; MIRRORS], yaw: vec![angle; MIRRORS] };
        mirrors.command(&to(0.2));
        mirrors.step(0.1);
        mirrors.set_fault(0, AxisFault::Stuck, AxisFault::Stuck);
        mirrors.set_fault(1, AxisFault::Dead, AxisFault::None);
        mirrors.set_fault(2, AxisFault::None, AxisFault::Flipped);
        mirrors.command(&to(0.4));
        mirrors.step(0.1);
        // In urad, rounded.
        let at = |mirrors: &Actuator, mirror: usize| {
            let angles = mirrors.angles();
            [angles.roll[mirror], angles.yaw[mirror]].map(|angle| (angle * 1e6).round() as i64)
        };
        assert_eq!(at(&mirrors, 0), [200000, 200000], "{profile:?}");
        assert_eq!(at(&mirrors, 1), [0, 400000], "{profile:?}");
        assert_eq!(at(&mirrors, 2), [400000, -400000], "{profile:?}");
        assert_eq!(at(&mirrors, 3), [400000, 400000], "{profile:?}");
        assert_eq!(mirrors.faulty_mirrors(), 3);
        mirrors.set_fault(0, AxisFault::None, AxisFault::None);
        mirrors.step(0.1);
        assert_eq!(at(&mirrors, 0), [400000, 400000], "a healed mirror follows its command: {profile:?}");
        mirrors.go_offline(0.5);
        mirrors.command(&to(0.1));
        mirrors.step(0.4);
        assert!(mirrors.is_offline());
        assert_eq!(at(&mirrors, 3), [400000, 400000], "an offline array ignores commands: {profile:?}");
        mirrors.step(0.2);
        mirrors.command(&to(0.1));
        mirrors.step(0.1);
        assert_eq!(at(&mirrors, 3), [100000, 100000], "{profile:?}");
        mirrors.set_delay_fault(0.05);
        mirrors.command(&to(0.3));
        mirrors.step(0.04);
        assert_eq!(at(&mirrors, 3), [100000, 100000], "{profile:?}");
        mirrors.step(0.1);
        assert_eq!(at(&mirrors, 3), [300000, 300000], "{profile:?}");
        mirrors.reboot(0.2);
        mirrors.step(0.1);
        assert_eq!(at(&mirrors, 3), [0, 0], "{profile:?}");
        assert!(mirrors.is_offline());
    }
}
