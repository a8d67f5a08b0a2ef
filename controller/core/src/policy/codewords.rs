//! Codewords: a finite set of angles for every mirror of a room.
//!
//! - **paper modes**: 5 x 5 angles that all mirrors share, roll from 0 to 60 and yaw from -60 to 60
//!   degrees ([`ROLLS_DEG`], [`YAWS_DEG`]).
//! - **`specular`**: if all mirrors have equal angles, each illuminates a different point. A
//!   codeword therefore aims every mirror at one point of a grid over the floor, at the height of
//!   the receivers.

use heliostat_channel::{ChannelModel, Vec3, decode, mirrors::MirrorAngles};
use heliostat_scenario::{ChannelMode, Scenario};

use crate::output::safety::Limits;

/// Rolls common to all mirrors in degrees, in the paper's modes.
pub const ROLLS_DEG: [f64; 5] = [0.0, 15.0, 30.0, 45.0, 60.0];

/// Yaws common to all mirrors in degrees, in the paper's modes.
pub const YAWS_DEG: [f64; 5] = [-60.0, -30.0, 0.0, 30.0, 60.0];

/// Points of the grid along each side of the room, in `specular`; `lab/learn/experiments.md` has
/// other numbers.
pub const GRID: usize = 12;

/// The codewords of a room, within the range of its mirrors: row by row of [`GRID`] x [`GRID`]
/// points, x along a row, in `specular`; rolls and then yaws in the paper's modes.
pub fn codewords(scenario: &Scenario, model: &ChannelModel) -> Vec<MirrorAngles> {
    let range_rad = Limits::new(&scenario.control).range_rad();
    let mut codewords = match scenario.channel.mode {
        ChannelMode::Specular => focuses(model, scenario),
        ChannelMode::Paper | ChannelMode::PaperCalibrated => common(model.mirrors.len()),
    };
    for angle in codewords.iter_mut().flat_map(MirrorAngles::axes_mut) {
        *angle = angle.clamp(-range_rad, range_rad);
    }
    codewords
}

/// The coordinates of each codeword in the codebook's grid, from its middle: along x and y, or in
/// steps of yaw and roll.
pub fn coordinates(mode: ChannelMode) -> Vec<[f32; 2]> {
    let [columns, rows] = match mode {
        ChannelMode::Specular => [GRID; 2],
        ChannelMode::Paper | ChannelMode::PaperCalibrated => [YAWS_DEG.len(), ROLLS_DEG.len()],
    };
    let middle = |index: usize, count: usize| index as f32 - 0.5 * (count - 1) as f32;
    (0..columns * rows)
        .map(|codeword| [middle(codeword % columns, columns), middle(codeword / columns, rows)])
        .collect()
}

fn common(mirrors: usize) -> Vec<MirrorAngles> {
    let codeword = |roll: f64, yaw: f64| MirrorAngles {
        roll: vec![roll.to_radians(); mirrors],
        yaw: vec![yaw.to_radians(); mirrors],
    };
    ROLLS_DEG.iter().flat_map(|roll| YAWS_DEG.iter().map(move |yaw| codeword(*roll, *yaw))).collect()
}

fn focuses(model: &ChannelModel, scenario: &Scenario) -> Vec<MirrorAngles> {
    let coordinate = |index: usize, extent_m: f64| extent_m * ((index as f64 + 0.5) / GRID as f64 - 0.5);
    let focus = |index: usize| {
        let (x, y) =
            (coordinate(index % GRID, scenario.room.length_x_m), coordinate(index / GRID, scenario.room.length_y_m));
        let mut angles = MirrorAngles::flat(model.mirrors.len());
        decode::aim_at_point(model, &Vec3::new(x, y, scenario.receiver.height_m), &mut angles);
        angles
    };
    (0..GRID * GRID).map(focus).collect()
}
