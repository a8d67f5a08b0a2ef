//! The true room of a scenario: nominal values plus differences drawn from a seed.
//!
//! The controller knows the scenario. Here the spreads of
//! [`mismatch`](heliostat_scenario::mismatch) become values, once for each seed, so that a restart
//! of the walks leaves the equipment as it is.

use heliostat_channel::{Body, Orientation};
use heliostat_scenario::{Blockage, Scenario, Spreads};

use crate::random::{self, Purpose, RoomRng};

/// Smallest share of a nominal value that a drawn one can have.
const LEAST_SHARE: f64 = 0.5;

/// Smallest distance of a device from the surface of its user's body in m.
const DEVICE_MARGIN_M: f64 = 0.05;

/// A half-power semi-angle stays below this, in degrees.
const SEMI_ANGLE_MAX_DEG: f64 = 89.0;

/// The true equipment of a scenario's room: LED, mirrors, receivers and tracker. Positions stay as
/// far from walls and ceiling as the nominal ones.
pub fn true_room(nominal: &Scenario, seed: u64) -> Scenario {
    let mut room = nominal.clone();
    if nominal.mismatch.key().is_none() {
        return room;
    }
    let spreads = nominal.mismatch.spreads();
    let mut rng = random::stream(seed, Purpose::Mismatch, 0);
    let mut deviation = |spread: f64| spread * random::normal(&mut rng);

    let raised_m = deviation(spreads.floor_m);
    room.room.height_m += raised_m;
    room.mirrors.arrays_mut().iter_mut().for_each(|array| array.centre_height_m += raised_m);
    let half_m = [0.5 * room.room.length_x_m, 0.5 * room.room.length_y_m];
    for [x, y, z] in &mut room.led.positions_m {
        *x = (*x + deviation(spreads.led_m)).clamp(-half_m[0], half_m[0]);
        *y = (*y + deviation(spreads.led_m)).clamp(-half_m[1], half_m[1]);
        // A panel on the ceiling cannot be above it.
        *z = (*z + raised_m + deviation(spreads.led_m)).min(room.room.height_m);
    }
    let semi_angle_deg = scaled(room.led.half_power_semi_angle_deg, deviation(spreads.semi_angle));
    room.led.half_power_semi_angle_deg = semi_angle_deg.min(SEMI_ANGLE_MAX_DEG);
    room.receiver.area_mm2 = scaled(room.receiver.area_mm2, deviation(spreads.received));
    for array in room.mirrors.arrays_mut() {
        array.reflectivity = scaled(array.reflectivity, -deviation(spreads.reflectivity_loss).abs());
    }
    room.streams.positions.noise_m *= 1.0 + spreads.tracker_excess;
    room.streams.positions.velocity_noise_m_s *= 1.0 + spreads.tracker_excess;
    room.led.positions_m.extend(&nominal.mismatch.unknown_leds_m);
    let offset_deg = room.actuator.parameters().offset_rad.to_degrees().hypot(spreads.mirror_deg);
    room.actuator.offset_deg = Some(offset_deg);
    room
}

/// The true body of a user, and the tilt of the receiver in the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueBody {
    /// The body.
    pub shape: Body,
    /// The fixed tilt of the receiver.
    pub tilt: Orientation,
}

impl TrueBody {
    /// The body of the user with this number.
    pub fn draw(nominal: &Blockage, spreads: &Spreads, (seed, user): (u64, u32)) -> Self {
        let Blockage { body_radius_m, body_height_m, body_offset_m, .. } = *nominal;
        let mut rng: RoomRng = random::stream(seed, Purpose::Body, user);
        let mut drawn = |value: f64, spread: f64| {
            let deviation = if spread > 0.0 { spread * random::normal(&mut rng) } else { 0.0 };
            (value + deviation).max(LEAST_SHARE * value)
        };
        let radius_m = drawn(body_radius_m, spreads.body_radius_m);
        let height_m = drawn(body_height_m, spreads.body_height_m);
        // A device is outside the body, as the nominal one is.
        let margin_m = (body_offset_m - body_radius_m).min(DEVICE_MARGIN_M);
        let offset_m = drawn(body_offset_m, spreads.body_offset_m).max(radius_m + margin_m);
        let tilt = if spreads.tilt_deg > 0.0 {
            let mut rng = random::stream(seed, Purpose::ReceiverTilt, user);
            let [about_x, about_y] =
                random::normal_pair(&mut rng).map(|normal| (spreads.tilt_deg * normal).to_radians());
            Orientation::from_rotation_vector([about_x, about_y, 0.0])
        } else {
            Orientation::UPRIGHT
        };
        Self { shape: Body { radius_m, height_m, offset_m }, tilt }
    }
}

/// A value with a relative deviation.
fn scaled(value: f64, deviation: f64) -> f64 {
    value * (1.0 + deviation).max(LEAST_SHARE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(overrides: &[&str]) -> Scenario {
        Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap()
    }

    #[test]
    fn an_unknown_led_shines_in_the_true_room_and_nothing_else_differs() {
        let nominal = Scenario::builtin("hall").unwrap();
        let with_neighbour = nominal.with_overrides(&["mismatch.unknown_leds_m=[[2.0,2.0,3.0]]"]).unwrap();
        let room = true_room(&with_neighbour, 1);
        assert_eq!(room.led.positions_m, [[0.0, 0.0, 3.0], [2.0, 2.0, 3.0]]);
        assert_eq!((room.receiver, room.mirrors), (nominal.receiver, nominal.mirrors));
        let told_apart = ["mismatch.unknown_leds_m=[[2,2,3]]", "streams.channel.leds=gains"];
        let refusal = Scenario::builtin("hall").unwrap().with_overrides(&told_apart).unwrap_err().to_string();
        assert!(refusal.contains("mismatch.unknown_leds_m"), "{refusal}");
    }

    #[test]
    fn without_a_level_the_true_room_is_the_scenario() {
        let nominal = scenario(&[]);
        assert_eq!(true_room(&nominal, 1), nominal);
    }

    #[test]
    fn each_kind_changes_its_own_values_and_no_others() {
        let nominal = scenario(&[]);
        let of_kind = |kind: &str| {
            let level = scenario(&["mismatch.level=rough", &format!("mismatch.kinds=[\"{kind}\"]")]);
            true_room(&level, 3)
        };
        let led = of_kind("led");
        assert_ne!(led.led, nominal.led);
        assert_eq!((&led.mirrors, &led.receiver, &led.room), (&nominal.mirrors, &nominal.receiver, &nominal.room));
        let receiver = of_kind("receiver");
        assert_ne!(receiver.receiver.area_mm2, nominal.receiver.area_mm2);
        assert_eq!((&receiver.led, &receiver.mirrors), (&nominal.led, &nominal.mirrors));
        let mirrors = of_kind("mirrors");
        assert!(mirrors.mirrors.first().reflectivity < nominal.mirrors.first().reflectivity);
        assert_eq!(mirrors.actuator.offset_deg, Some(0.6));
        let floor = of_kind("floor");
        let raised_m = floor.room.height_m - nominal.room.height_m;
        assert!(
            raised_m != 0.0 && (floor.led.positions_m[0][2] - nominal.led.positions_m[0][2] - raised_m).abs() < 1e-12
        );
        let tracker = of_kind("tracker");
        assert_eq!(tracker.streams.positions.noise_m, 2.0 * nominal.streams.positions.noise_m);
        assert_eq!((&tracker.led, &tracker.mirrors), (&nominal.led, &nominal.mirrors));
        let bodies = of_kind("bodies");
        assert_eq!((&bodies.led, &bodies.mirrors), (&nominal.led, &nominal.mirrors));
        assert!(bodies.channel_model().is_ok());
    }

    #[test]
    fn the_drawn_values_have_the_spreads_of_the_level() {
        let level = scenario(&["mismatch.level=typical"]);
        let (count, mut area, mut radius) = (4000, [0.0; 2], [0.0; 2]);
        let spreads = level.mismatch.spreads();
        for seed in 0..count {
            let ratio = true_room(&level, seed).receiver.area_mm2 / level.receiver.area_mm2 - 1.0;
            let body =
                TrueBody::draw(&level.blockage, &spreads, (seed, 2)).shape.radius_m - level.blockage.body_radius_m;
            for ([sum, squares], value) in [(&mut area, ratio), (&mut radius, body)] {
                (*sum, *squares) = (*sum + value, *squares + value * value);
            }
        }
        let deviation = |[sum, squares]: [f64; 2]| (squares / count as f64 - (sum / count as f64).powi(2)).sqrt();
        assert!((deviation(area) - 0.05).abs() < 0.003, "{}", deviation(area));
        assert!((deviation(radius) - 0.02).abs() < 0.0012, "{}", deviation(radius));
    }

    #[test]
    fn a_device_stays_outside_the_body_of_its_user() {
        let rough = scenario(&["mismatch.level=rough"]);
        let spreads = rough.mismatch.spreads();
        let bodies = (0..1000).map(|user| TrueBody::draw(&rough.blockage, &spreads, (1, user)).shape);
        assert!(bodies.into_iter().all(|body| body.offset_m >= body.radius_m + 0.049));
    }

    #[test]
    fn receivers_are_tilted_by_their_own_kind_only() {
        let tilt = |kind: &str| {
            let level = scenario(&["mismatch.level=rough", &format!("mismatch.kinds=[\"{kind}\"]")]);
            TrueBody::draw(&level.blockage, &level.mismatch.spreads(), (3, 1)).tilt
        };
        assert_eq!(tilt("bodies"), Orientation::UPRIGHT);
        let mean = (0..2000)
            .map(|user| {
                let level = scenario(&[]);
                let spreads = Spreads { tilt_deg: 10.0, ..Spreads::default() };
                TrueBody::draw(&level.blockage, &spreads, (3, user)).tilt.normal().z.acos().to_degrees().powi(2)
            })
            .sum::<f64>()
            / 2000.0;
        assert!((mean - 200.0).abs() < 15.0, "two axes of 10 degrees: {mean}");
    }

    #[test]
    fn every_drawn_room_is_a_valid_one() {
        for name in heliostat_scenario::BUILTIN_NAMES {
            let level = Scenario::builtin(name).unwrap();
            let level = level.with_overrides(&["mismatch.level=rough"]).unwrap();
            for seed in 0..200 {
                let room = true_room(&level, seed);
                assert!(room.channel_model().is_ok(), "{name}, seed {seed}");
                assert!(room.with_overrides::<&str>(&[]).is_ok(), "{name}, seed {seed}");
            }
        }
    }
}
