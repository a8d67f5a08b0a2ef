//! Closed-form values: line-of-sight gain, fields of view, link budget, angles.

use crate::common::{Room, angle_diversity};
use heliostat_channel::{
    Branch, ChannelError, Combining, GeometryError, Led, Mechanical, Optical, PowerLaw, Receiver, Vec3, ber_ook, jain,
    los,
};
use std::f64::consts::{E, PI};

fn direct(room: &Room, user: Vec3) -> f64 {
    los::gain(&room.leds[0], &room.receiver, &room.receiver.branches[0], &user).expect("apart")
}

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{found} instead of {expected}");
}

#[test]
fn direct_gain_below_the_led() {
    close(direct(&Room::paper(), Vec3::new(0.0, 0.0, 0.85)), 20e-6 / (PI * 2.15 * 2.15));
}

#[test]
fn direct_gain_falls_with_the_square_of_the_distance() {
    let room = Room::paper();
    let direction = Vec3::new(0.6, -0.3, -0.74).normalize();
    let at = |distance: f64| direct(&room, room.leds[0].position + distance * direction);
    for factor in [1.5, 2.0, 3.0] {
        close(at(0.9) / at(0.9 * factor), factor * factor);
    }
}

#[test]
fn direct_gain_at_the_half_power_angle() {
    // At the half-power semi-angle the intensity is one half and the detector is tilted by the same
    // angle.
    for half_power_deg in [20.0_f64, 45.0, 60.0, 75.0] {
        let mut room = Room::paper();
        let angle = half_power_deg.to_radians();
        room.leds[0].half_power_semi_angle = angle;
        let order = room.leds[0].lambertian_order();
        let user = room.leds[0].position + 1.7 * Vec3::new(angle.sin(), 0.0, -angle.cos());
        close(direct(&room, user), (order + 1.0) * 20e-6 * 0.5 * angle.cos() / (2.0 * PI * 1.7 * 1.7));
    }
    assert_eq!(Room::paper().leds[0].lambertian_order(), 1.0, "60 degrees is order 1 without rounding");
}

#[test]
fn no_light_outside_the_field_of_view_or_behind_the_led() {
    let mut room = Room::paper();
    room.receiver.branches[0].fov_semi_angle = 40.0_f64.to_radians();
    let at = |degrees: f64| {
        let angle = degrees.to_radians();
        Vec3::new(2.15 * angle.tan(), 0.0, 0.85)
    };
    assert!(direct(&room, at(39.99)) > 0.0);
    assert_eq!(direct(&room, at(40.01)), 0.0);
    assert_eq!(direct(&room, Vec3::new(0.5, 0.0, 3.2)), 0.0, "above the LED");
    assert_eq!(direct(&room, Vec3::new(0.5, 0.0, 3.0)), 0.0, "in the LED's plane");
}

#[test]
fn a_concentrator_multiplies_within_the_field_of_view() {
    let mut room = Room::paper();
    room.receiver.branches[0].fov_semi_angle = 50.0_f64.to_radians();
    let user = Vec3::new(0.4, 0.7, 0.85);
    let without = direct(&room, user);
    room.receiver.concentrator_index = Some(1.5);
    room.receiver.filter_gain = 0.8;
    close(direct(&room, user), without * 0.8 * 2.25 / 50.0_f64.to_radians().sin().powi(2));
    assert_eq!(direct(&room, Vec3::new(2.4, 2.4, 2.0)), 0.0);
}

#[test]
fn a_panel_is_the_mean_of_its_points() {
    let led = Led { side_m: 0.2, points_per_side: 2, ..Room::paper().leds[0].clone() };
    let points = led.points();
    assert_eq!(points.len(), 4);
    assert!((points[0] - Vec3::new(-0.05, -0.05, 3.0)).norm() < 1e-15);
    assert!((points[3] - Vec3::new(0.05, 0.05, 3.0)).norm() < 1e-15);
    // The midpoint rule converges: 3 and 40 points per side differ little; both differ from a
    // point.
    let at = |points_per_side, side_m| {
        let mut room = Room::paper();
        room.leds[0] = Led { side_m, points_per_side, ..led.clone() };
        direct(&room, Vec3::new(0.7, -0.4, 0.85))
    };
    let (point, coarse, fine) = (at(1, 0.0), at(3, 0.6), at(40, 0.6));
    assert!((coarse / fine - 1.0).abs() < 0.2 * (point / fine - 1.0).abs(), "{point} {coarse} {fine}");
}

#[test]
fn combining_rules() {
    let gains = [3.0, 0.0, 4.0];
    assert_eq!(Combining::Best.combine(&gains), 4.0);
    close(Combining::EqualGain.combine(&gains), 7.0 / 3.0_f64.sqrt());
    close(Combining::MaximalRatio.combine(&gains), 5.0);
    for rule in [Combining::Best, Combining::EqualGain, Combining::MaximalRatio] {
        close(rule.combine(&[2.5]), 2.5);
    }
}

#[test]
fn sinr_rate_and_amplitude_scale() {
    let mut budget = Room::paper().budget;
    budget.noise.variance_a2 = Some(4e-15);
    close(budget.sinr(1e-6), 0.16 * 2.0 * 1e-12 / 4e-15);
    let sinr = 80.0;
    close(budget.rate_bps(sinr, 5), 4e6 * (1.0 + E / (2.0 * PI) * sinr).log2());
    let amplitude = budget.amplitude_scale() * 1e-6;
    close(amplitude * amplitude, E / (2.0 * PI) * sinr);
    budget.power_law = PowerLaw::Squared;
    close(budget.sinr(1e-6), 160.0);
    assert_eq!(budget.rate_bps(0.0, 5), 0.0);
}

#[test]
fn noise_items_have_their_sources() {
    let bandwidth_hz = 20e6_f64;
    let close_to = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 0.06, "{found} {expected}");
    // Komine and Nakagawa, IEEE Trans. Consumer Electronics 50(1), 2004: shot noise 2 q I_bg I2 B with 5.1 mA per cm2
    // in direct sunlight and 0.74 mA in indirect sunlight, on 0.2 cm2.
    let shot = |background_a: f64| 2.0 * 1.602_176_634e-19 * background_a * 0.562 * bandwidth_hz;
    close_to(shot(0.2 * 5.1e-3), 3.7e-15);
    close_to(shot(0.2 * 0.74e-3), 5.3e-16);
    // Thermal noise (8 pi k T / G) eta A I2 B^2 + (16 pi^2 k T Gamma / g_m) eta^2 A^2 I3 B^3.
    let (energy, capacitance) = (1.380_649e-23 * 295.0, 112e-8 * 20e-6);
    let feedback = 8.0 * PI * energy / 10.0 * capacitance * 0.562;
    let channel = 16.0 * PI * PI * energy * 1.5 / 30e-3 * capacitance * capacitance * 0.0868;
    close_to(feedback * bandwidth_hz.powi(2) + channel * bandwidth_hz.powi(3), 6e-17);
    // An input noise of 4.47 pA per root hertz.
    close_to(4.47e-12_f64.powi(2) * bandwidth_hz, 4e-16);
    let mut noise = Room::paper().budget.noise;
    close_to(noise.variance_over(bandwidth_hz), 4.1e-15);
    close(noise.variance_over(2.0 * bandwidth_hz), 2.0 * noise.variance_over(bandwidth_hz));
    noise.variance_a2 = Some(9e-14);
    assert_eq!(noise.variance_over(bandwidth_hz), 9e-14);
}

#[test]
fn bit_error_rate_of_on_off_keying() {
    assert_eq!(ber_ook(0.0), 0.5);
    // Q(1) and Q(3), tabulated.
    assert!((ber_ook(1.0) - 0.158_655_253_931_457).abs() < 1e-15);
    assert!((ber_ook(9.0) / 0.001_349_898_031_630_095 - 1.0).abs() < 1e-12);
    // The paper states 1e-4 at 15 dB; the equation gives 9.4e-9.
    assert!((ber_ook(10.0_f64.powf(1.5)) / 9.4e-9 - 1.0).abs() < 0.02);
    let mut last = 0.5;
    for step in 1..400 {
        let rate = ber_ook(f64::from(step) * 0.1);
        assert!(rate < last, "falls with the SINR");
        last = rate;
    }
}

#[test]
fn jains_index_is_defined_where_a_user_has_a_rate() {
    close(jain(&[2.0, 2.0, 2.0]), 1.0);
    close(jain(&[5.0, 0.0, 0.0, 0.0]), 0.25);
    assert!(jain(&[0.0, 0.0]).is_nan() && jain(&[]).is_nan());
}

#[test]
fn the_optical_angle_is_twice_the_mechanical_angle() {
    assert_eq!(Mechanical::from_degrees(10.0).optical().degrees(), 20.0);
    assert_eq!(Optical::from(Mechanical(0.3)), Optical(0.6));
    assert_eq!(Mechanical::from(Optical::from_degrees(90.0)).radians(), PI / 4.0);
    assert_eq!(Optical(0.5).mechanical().degrees(), 0.25_f64.to_degrees());
    assert_eq!(Optical(0.5).radians(), 0.5);
}

#[test]
fn ends_of_a_path_must_be_distinct_and_finite() {
    let room = Room::paper();
    let branch = Branch { normal: Vec3::z(), fov_semi_angle: 1.0 };
    let gain = |user: Vec3| los::gain(&room.leds[0], &room.receiver, &branch, &user);
    assert!(matches!(gain(room.leds[0].position), Err(GeometryError::Coincident { .. })));
    assert!(matches!(gain(Vec3::new(0.0, f64::NAN, 0.0)), Err(GeometryError::NotFinite { .. })));
}

#[test]
fn errors_state_the_value_found_and_the_values_expected() {
    let mut room = Room::paper();
    room.receiver = Receiver { detector_area_m2: -1.0, branches: angle_diversity(), ..room.receiver };
    let parts = room.clone();
    let error =
        heliostat_channel::ChannelModel::new(parts.mode, parts.leds, room.mirrors(), parts.receiver, parts.budget)
            .expect_err("an area is positive");
    assert!(matches!(error, ChannelError::OutOfRange { value: -1.0, .. }));
    assert_eq!(error.to_string(), "detector area in m2 is -1: expected a finite number above 0");
}
