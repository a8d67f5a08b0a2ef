//! The judgement of a calibration by the truth of its simulated room.

use heliostat_calibrate::{Measured, Verdict};
use heliostat_channel::specular::bisector;
use heliostat_channel::{ChannelModel, MirrorAngles, Vec3};
use heliostat_room::SimulatedRoom;
use heliostat_room::mismatch::true_room;
use heliostat_scenario::Scenario;

use crate::live::{Run, SPOTS, walk};

/// The errors of a run by the truth.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Root mean squares of roll and yaw in degrees at held-out places.
    pub pointing_deg: [f64; 2],
    /// Share of corrected mirrors with an error above half a degree at any of the places.
    pub failed: f64,
    /// Root mean square of the LED's coordinates in m.
    pub led_m: f64,
    /// Of the height of the frame in m.
    pub frame_m: f64,
    /// 95 % intervals that contain the truth, and all.
    pub covered: [usize; 2],
    /// Gain of all mirrors, aimed at held-out places by the result, over that with true aims.
    pub gain: f64,
    /// The same with nominal aims.
    pub nominal_gain: f64,
}

/// True offsets of roll and yaw in rad.
pub fn true_offsets(scenario: &Scenario, seed: u64) -> Vec<[f64; 2]> {
    let still = scenario.with_overrides(&["actuator.jitter_deg=0".to_owned(), "users.count=1".to_owned()]).unwrap();
    let trace = walk(&[SPOTS[0]], "");
    let mut room = SimulatedRoom::new(&still, Some(&trace), seed).unwrap();
    room.advance(1_000_000_000);
    let (angles, measured) = (room.actuator(0).angles(), room.actuator(0).measured());
    (0..angles.len())
        .map(|mirror| [angles.roll[mirror] - measured.roll[mirror], angles.yaw[mirror] - measured.yaw[mirror]])
        .collect()
}

/// Compares a run with the truth.
pub fn judge(run: &Run) -> Errors {
    let Run { outcome, scenario, seed, .. } = run;
    let truth = true_room(scenario, *seed);
    let (model, nominal) = (truth.channel_model().unwrap(), scenario.channel_model().unwrap());
    let measured = outcome.measured_room(scenario, 0).channel_model().unwrap();
    let offsets = true_offsets(scenario, *seed);
    let calibration = outcome.calibration();
    let height_m = scenario.receiver.height_m;
    let mut errors = Errors::default();
    let mut places = Vec::new();
    for index in 0..40_u32 {
        // A low-discrepancy sequence over the square of 4 m.
        let share = |base: f64| (f64::from(index + 1) * base).fract() * 4.0 - 2.0;
        places.push(Vec3::new(share(0.754_877_666), share(0.569_840_29), height_m));
    }
    let corrected: Vec<usize> = [Verdict::Calibrated, Verdict::NeedsSpot]
        .into_iter()
        .flat_map(|verdict| outcome.mirrors_with(verdict))
        .collect();
    let (mut squares, mut failed, mut count) = ([0.0; 2], 0, 0.0);
    for mirror in &corrected {
        let mut worst: f64 = 0.0;
        for place in &places {
            let (wanted, aim) = (aim(&model, *mirror, place), aim(&measured, *mirror, place));
            for (axis, list) in [&calibration.roll, &calibration.yaw].into_iter().enumerate() {
                let command = list.gain[*mirror] * aim[axis] + list.offset_deg[*mirror].to_radians();
                let error = (command + offsets[*mirror][axis] - wanted[axis]).to_degrees();
                squares[axis] += error * error;
                worst = worst.max(error.abs());
            }
            count += 1.0;
        }
        failed += usize::from(worst > 0.5);
    }
    errors.pointing_deg = squares.map(|sum: f64| (sum / f64::max(count, 1.0)).sqrt());
    errors.failed = failed as f64 / corrected.len().max(1) as f64;
    let (mut sums, mut exact) = ([0.0; 2], 0.0);
    for place in &places {
        let gain = |angles: &dyn Fn(usize) -> [f64; 2]| -> f64 {
            let mut scene = heliostat_channel::Scene::new(&model, 1);
            scene.update(&model, &[*place], &[], &[false]);
            let all: Vec<[f64; 2]> = (0..offsets.len())
                .map(|mirror| [0, 1].map(|axis| angles(mirror)[axis] + offsets[mirror][axis]))
                .collect();
            let angles = MirrorAngles {
                roll: all.iter().map(|angles| angles[0]).collect(),
                yaw: all.iter().map(|angles| angles[1]).collect(),
            };
            let mut out = [0.0];
            scene.irs_gain(&model, &angles, &mut out);
            out[0]
        };
        sums[0] += gain(&|mirror| {
            let aim = aim(&measured, mirror, place);
            [
                calibration.roll.gain[mirror] * aim[0] + calibration.roll.offset_deg[mirror].to_radians(),
                calibration.yaw.gain[mirror] * aim[1] + calibration.yaw.offset_deg[mirror].to_radians(),
            ]
        });
        sums[1] += gain(&|mirror| aim(&nominal, mirror, place));
        exact += gain(&|mirror| {
            let aim = aim(&model, mirror, place);
            [aim[0] - offsets[mirror][0], aim[1] - offsets[mirror][1]]
        });
    }
    (errors.gain, errors.nominal_gain) = (sums[0] / exact, sums[1] / exact);
    let mut cover = |measured: &Measured, truth: f64| {
        let is_inside = (measured.value - truth).abs() < 1.96 * measured.deviation;
        errors.covered = [errors.covered[0] + usize::from(is_inside), errors.covered[1] + 1];
    };
    for mirror in &corrected {
        for (measured, truth) in outcome.mirrors[*mirror].offset_deg.iter().zip(offsets[*mirror]) {
            cover(measured, truth.to_degrees());
        }
    }
    let mut led_squares = 0.0;
    for (axis, measured) in outcome.leds_m[0].iter().enumerate() {
        cover(measured, truth.led.positions_m[0][axis]);
        led_squares += (measured.value - truth.led.positions_m[0][axis]).powi(2);
    }
    let raise_m = truth.room.height_m - scenario.room.height_m;
    cover(&outcome.raise_m, raise_m);
    cover(&outcome.semi_angle_deg, truth.led.half_power_semi_angle_deg);
    errors.led_m = (led_squares / 3.0).sqrt();
    errors.frame_m = (outcome.raise_m.value - raise_m).abs();
    errors
}

fn aim(model: &ChannelModel, mirror: usize, place: &Vec3) -> [f64; 2] {
    let normal = bisector(&model.mirrors.positions()[mirror], &model.leds[0].position, place).unwrap();
    model.mirrors.angles_of(mirror, &normal).into()
}
