//! The judgement of a calibration by the truth of its simulated room, which the calibration does not
//! read.

use anyhow::Context;
use heliostat_array::calibration_file::CalibrationFile;
use heliostat_calibrate::outcome::QUANTILE_95;
use heliostat_calibrate::{Measured, Outcome, Verdict};
use heliostat_channel::specular::bisector;
use heliostat_channel::{ChannelModel, MirrorAngles, Scene, Vec3};
use heliostat_room::SimulatedRoom;
use heliostat_room::mismatch::true_room;
use heliostat_scenario::Scenario;

use super::live::walk;

/// Held-out places.
const PLACES: u32 = 40;

/// Half the side of the square of held-out places, as a share of half the room.
const SQUARE: f64 = 0.8;

/// Time after which the mirrors have settled in ns.
const SETTLED_NS: u64 = 1_000_000_000;

/// A corrected mirror has failed if it points wrong by more than this anywhere, in degrees.
const FAILED_DEG: f64 = 0.5;

/// The errors of a calibration by the truth.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// Root mean squares of roll and yaw in degrees at held-out places, over corrected mirrors.
    pub pointing_deg: [f64; 2],
    /// Number of corrected mirrors.
    pub corrected: usize,
    /// Share of corrected mirrors with an error above half a degree at any of the places.
    pub failed: f64,
    /// Root mean square of the LEDs' coordinates in m.
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
fn true_offsets(scenario: &Scenario, seed: u64) -> anyhow::Result<Vec<[f64; 2]>> {
    let still = scenario.with_overrides(&["actuator.jitter_deg=0", "users.count=1"])?;
    let mut room = SimulatedRoom::new(&still, Some(&walk(&still, "")), seed)?;
    room.advance(SETTLED_NS);
    let (angles, measured) = (room.actuator(0).angles(), room.actuator(0).measured());
    let offset =
        |mirror: usize| [angles.roll[mirror] - measured.roll[mirror], angles.yaw[mirror] - measured.yaw[mirror]];
    Ok((0..angles.len()).map(offset).collect())
}

/// Compares the result of a calibration of the room of this seed with the truth.
///
/// # Errors
/// A scenario that describes no room with one array.
pub fn judge(outcome: &Outcome, scenario: &Scenario, seed: u64) -> anyhow::Result<Errors> {
    let truth = true_room(scenario, seed);
    let (model, nominal) = (truth.channel_model()?, scenario.channel_model()?);
    let measured = outcome.measured_room(scenario, 0).channel_model()?;
    let offsets = true_offsets(scenario, seed)?;
    let places = held_out_places(scenario);
    let corrected: Vec<usize> = [Verdict::Calibrated, Verdict::NeedsSpot]
        .into_iter()
        .flat_map(|verdict| outcome.mirrors_with(verdict))
        .collect();
    let calibration = outcome.calibration();
    let by_result =
        |mirror: usize, place: &Vec3| Some(corrected_aim(&calibration, mirror, aim(&measured, mirror, place)?));
    let mut errors = Errors { corrected: corrected.len(), ..Errors::default() };
    let (mut squares, mut failed, mut count) = ([0.0; 2], 0, 0.0);
    for mirror in &corrected {
        let mut worst: f64 = 0.0;
        for place in &places {
            let aims = aim(&model, *mirror, place).zip(by_result(*mirror, place));
            let (wanted, command) = aims.with_context(|| unreachable(*mirror, place))?;
            for axis in 0..2 {
                let error = (command[axis] + offsets[*mirror][axis] - wanted[axis]).to_degrees();
                squares[axis] += error * error;
                worst = worst.max(error.abs());
            }
            count += 1.0;
        }
        failed += usize::from(worst > FAILED_DEG);
    }
    errors.pointing_deg = squares.map(|sum: f64| (sum / f64::max(count, 1.0)).sqrt());
    errors.failed = failed as f64 / corrected.len().max(1) as f64;
    let gain = |angles: &dyn Fn(usize, &Vec3) -> Option<[f64; 2]>| -> f64 {
        places.iter().map(|place| gain_at(&model, &offsets, place, &|mirror| angles(mirror, place))).sum()
    };
    let exact = gain(&|mirror, place| {
        let aim = aim(&model, mirror, place)?;
        Some([0, 1].map(|axis| aim[axis] - offsets[mirror][axis]))
    });
    errors.gain = gain(&by_result) / exact;
    errors.nominal_gain = gain(&|mirror, place| aim(&nominal, mirror, place)) / exact;
    let mut cover = |measured: &Measured, truth: f64| {
        let is_inside = (measured.value - truth).abs() < QUANTILE_95 * measured.deviation;
        errors.covered = [errors.covered[0] + usize::from(is_inside), errors.covered[1] + 1];
    };
    for mirror in &corrected {
        for (measured, truth) in outcome.mirrors[*mirror].offset_deg.iter().zip(offsets[*mirror]) {
            cover(measured, truth.to_degrees());
        }
    }
    let (mut led_squares, mut coordinates) = (0.0, 0.0);
    for (measured, truth) in outcome.leds_m.iter().zip(&truth.led.positions_m) {
        for (measured, truth) in measured.iter().zip(truth) {
            cover(measured, *truth);
            led_squares += (measured.value - truth).powi(2);
            coordinates += 1.0;
        }
    }
    let raise_m = truth.room.height_m - scenario.room.height_m;
    cover(&outcome.raise_m, raise_m);
    cover(&outcome.semi_angle_deg, truth.led.half_power_semi_angle_deg);
    errors.led_m = (led_squares / f64::max(coordinates, 1.0)).sqrt();
    errors.frame_m = (outcome.raise_m.value - raise_m).abs();
    Ok(errors)
}

/// Why a corrected mirror has no error at a held-out place, and what to do.
fn unreachable(mirror: usize, place: &Vec3) -> String {
    format!(
        "mirror {mirror} cannot send light to the held-out place at x = {:.2} m, y = {:.2} m; expected mirrors that \
         reach all places within {SQUARE} of half the room's length and width: use a scenario with such an array",
        place.x, place.y
    )
}

/// A low-discrepancy sequence over a square in the middle of the room, at the receiver's height.
fn held_out_places(scenario: &Scenario) -> Vec<Vec3> {
    let half = [0.5 * scenario.room.length_x_m, 0.5 * scenario.room.length_y_m];
    let place = |index: u32| {
        let share = |base: f64| (f64::from(index + 1) * base).fract() * 2.0 - 1.0;
        let [x, y] = [share(0.754_877_666), share(0.569_840_29)];
        Vec3::new(SQUARE * half[0] * x, SQUARE * half[1] * y, scenario.receiver.height_m)
    };
    (0..PLACES).map(place).collect()
}

/// The command by which the corrections turn a mirror to these angles.
fn corrected_aim(calibration: &CalibrationFile, mirror: usize, aim: [f64; 2]) -> [f64; 2] {
    let axes = [&calibration.roll, &calibration.yaw];
    [0, 1].map(|axis| axes[axis].gain[mirror] * aim[axis] + axes[axis].offset_deg[mirror].to_radians())
}

/// Gain over all mirrors at a place with these commands; a mirror without one is flat.
fn gain_at(
    model: &ChannelModel,
    offsets: &[[f64; 2]],
    place: &Vec3,
    command: &dyn Fn(usize) -> Option<[f64; 2]>,
) -> f64 {
    let mut scene = Scene::new(model, 1);
    scene.update(model, &[*place], &[], &[false]);
    let angles: Vec<[f64; 2]> = (0..offsets.len())
        .map(|mirror| {
            let command = command(mirror).unwrap_or_default();
            [0, 1].map(|axis| command[axis] + offsets[mirror][axis])
        })
        .collect();
    let [roll, yaw] = [0, 1].map(|axis| angles.iter().map(|angles| angles[axis]).collect());
    let mut out = [0.0];
    scene.irs_gain(model, &MirrorAngles { roll, yaw }, &mut out);
    out[0]
}

/// The angles by which a mirror sends the light of the first LED to a place.
fn aim(model: &ChannelModel, mirror: usize, place: &Vec3) -> Option<[f64; 2]> {
    let normal = bisector(&model.mirrors.positions()[mirror], &model.leds[0].position, place)?;
    Some(model.mirrors.angles_of(mirror, &normal).into())
}
