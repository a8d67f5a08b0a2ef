//! The inner loops of a scene: blocks of mirrors, and one mirror's light on one user.
//!
//! Layout: one array a component, a fixed number of mirrors a block, no branch on data inside a loop over lanes. rustc
//! vectorises these loops on its own; checked with `cargo rustc --release -p heliostat-channel -- --emit asm`, where
//! `Turned::candidates` and `sin_cos` consist of packed `mulpd`, `addpd`, `andpd` and `minpd` (two lanes on the x86-64 baseline, four or eight with
//! `-C target-cpu=native`).

use crate::Vec3;
use crate::emitter::lambertian;
use crate::mirrors::{MirrorAngles, MirrorArray};
use crate::model::{ChannelModel, Panel};
use crate::receiver::BRANCHES_MAX;
use crate::specular::Plate;
use crate::trig::{BLOCK, Lanes, sin_cos};

/// Points of a panel that are treated together.
pub(crate) const POINT_LANES: usize = 4;

/// Room for rounding, in m2, in a test that may pass too much but never too little: products of lengths of a room are known to about 1e-14.
const ROUNDING_M2: f64 = 1e-9;

/// A block of mirrors turned to their angles, in the room's frame.
pub(crate) struct Turned {
    /// Centre in m; lanes past the last mirror repeat it.
    centre: [Lanes; 3],
    /// Unit normal.
    pub normal: [Lanes; 3],
    /// Unit vector along the width; its z is zero.
    width: [Lanes; 2],
    /// Unit vector along the height.
    height: [Lanes; 3],
    half_width: f64,
    half_height: f64,
}

/// The centre of an LED panel as a block of mirrors sees it, in m.
pub(crate) struct Source {
    /// Height above each mirror's plane.
    above: Lanes,
    along_width: Lanes,
    along_height: Lanes,
    /// Largest distance of a point of the panel from its centre.
    radius: f64,
}

impl Turned {
    /// The mirrors from index `first` on.
    pub fn new(mirrors: &MirrorArray, angles: &MirrorAngles, first: usize) -> Self {
        let (sin_roll, cos_roll) = sin_cos(&block(&angles.roll, first));
        let (sin_yaw, cos_yaw) = sin_cos(&block(&angles.yaw, first));
        let (cos_wall, sin_wall) = mirrors.rotation();
        let mut turned = Self {
            centre: [block(&mirrors.x, first), block(&mirrors.y, first), block(&mirrors.z, first)],
            normal: [[0.0; BLOCK]; 3],
            width: [[0.0; BLOCK]; 2],
            height: [[0.0; BLOCK]; 3],
            half_width: 0.5 * mirrors.spec().mirror_width_m,
            half_height: 0.5 * mirrors.spec().mirror_height_m,
        };
        for lane in 0..BLOCK {
            // The yaw seen from the room: the wall's own rotation comes on top.
            let sin = sin_yaw[lane] * cos_wall - cos_yaw[lane] * sin_wall;
            let cos = sin_yaw[lane] * sin_wall + cos_yaw[lane] * cos_wall;
            turned.normal[0][lane] = -sin * cos_roll[lane];
            turned.normal[1][lane] = -cos * cos_roll[lane];
            turned.normal[2][lane] = -sin_roll[lane];
            turned.width[0][lane] = cos;
            turned.width[1][lane] = -sin;
            turned.height[0][lane] = -sin * sin_roll[lane];
            turned.height[1][lane] = -cos * sin_roll[lane];
            turned.height[2][lane] = cos_roll[lane];
        }
        turned
    }

    /// How the mirrors see an LED panel.
    pub fn source(&self, panel: &Panel) -> Source {
        let (above, along_width, along_height) = self.seen(&panel.centre);
        Source { above, along_width, along_height, radius: panel.radius }
    }

    /// For each lane a number that is negative when no light of the panel can reach the point over that mirror.
    ///
    /// A point of the panel is at most `radius` from its centre, so each of its coordinates in the mirror's axes differs by no more: what
    /// this bound rules out, no point of the panel can reach. What it lets through is then computed exactly.
    #[inline]
    pub fn candidates(&self, source: &Source, point: &Vec3) -> Lanes {
        let (above, along_width, along_height) = self.seen(point);
        let mut slack = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let heights = source.above[lane] + above[lane] + source.radius;
            let off = |along: f64, source_along: f64| (source.above[lane] * along + above[lane] * source_along).abs();
            let spread = |along: f64| source.radius * (along.abs() + above[lane]) + ROUNDING_M2;
            let across = self.half_width * heights + spread(along_width[lane])
                - off(along_width[lane], source.along_width[lane]);
            let up = self.half_height * heights + spread(along_height[lane])
                - off(along_height[lane], source.along_height[lane]);
            slack[lane] = across.min(up).min(above[lane]);
        }
        slack
    }

    /// Cosine between each mirror's normal and the direction to a point, whose distances' reciprocals are given.
    #[inline]
    pub fn tilt_cosines(&self, point: &Vec3, inverse_distance: &Lanes) -> Lanes {
        let mut cosines = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let (x, y, z) =
                (point.x - self.centre[0][lane], point.y - self.centre[1][lane], point.z - self.centre[2][lane]);
            let height = self.normal[0][lane] * x + self.normal[1][lane] * y + self.normal[2][lane] * z;
            cosines[lane] = height * inverse_distance[lane];
        }
        cosines
    }

    /// One mirror of the block.
    #[inline]
    pub fn plate(&self, lane: usize) -> Plate {
        let vector = |parts: &[Lanes; 3]| Vec3::new(parts[0][lane], parts[1][lane], parts[2][lane]);
        Plate {
            centre: vector(&self.centre),
            normal: vector(&self.normal),
            width_axis: Vec3::new(self.width[0][lane], self.width[1][lane], 0.0),
            height_axis: vector(&self.height),
            half_width_m: self.half_width,
            half_height_m: self.half_height,
        }
    }

    /// A point in each mirror's own axes: height above the plane, along the width, along the height.
    #[inline]
    fn seen(&self, point: &Vec3) -> (Lanes, Lanes, Lanes) {
        let (mut above, mut along_width, mut along_height) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
        for lane in 0..BLOCK {
            let (x, y, z) =
                (point.x - self.centre[0][lane], point.y - self.centre[1][lane], point.z - self.centre[2][lane]);
            above[lane] = self.normal[0][lane] * x + self.normal[1][lane] * y + self.normal[2][lane] * z;
            along_width[lane] = self.width[0][lane] * x + self.width[1][lane] * y;
            along_height[lane] = self.height[0][lane] * x + self.height[1][lane] * y + self.height[2][lane] * z;
        }
        (above, along_width, along_height)
    }
}

/// A block of a list, from an index on; the last entry is repeated past the end.
#[inline]
pub(crate) fn block(values: &[f64], first: usize) -> Lanes {
    lanes(&values[first..])
}

/// The first entries of a list; the last one is repeated past the end.
#[inline]
pub(crate) fn lanes(values: &[f64]) -> Lanes {
    match values.first_chunk() {
        Some(full) => *full,
        None => std::array::from_fn(|lane| values[lane.min(values.len() - 1)]),
    }
}

/// Adds the light of a panel over one mirror to the gains of a detector's branches: the exact evaluation.
///
/// The same as [`specular::gain`](crate::specular::gain), with the detector mirrored in place of the source: D = |S - R'|, where R' is the
/// image of the detector, serves all points of the panel. The irradiance cosine is then (S_z - R'_z) / D and the incidence cosine on a
/// branch (S' - R) . n_b / D, with S' = S - 2 a n at height a above the mirror.
///
/// `gains`: one a branch, dimensionless.
#[inline]
pub(crate) fn add_reflected(model: &ChannelModel, panel: &Panel, plate: &Plate, detector: &Vec3, gains: &mut [f64]) {
    let to_detector = detector - plate.centre;
    let detector_above = to_detector.dot(&plate.normal);
    let image = detector - 2.0 * detector_above * plate.normal;
    let rise = panel.centre.z - image.z;
    // Written so that a coordinate that is not a number fails the test.
    if !(detector_above > 0.0 && rise > 0.0) {
        return;
    }
    let along_width = to_detector.dot(&plate.width_axis);
    let along_height = to_detector.dot(&plate.height_axis);
    let branches = gains.len();
    let mut sums = [[0.0; POINT_LANES]; BRANCHES_MAX];
    for (xs, ys, weights) in &panel.lanes {
        let mut squared = [0.0; POINT_LANES];
        let mut above = [0.0; POINT_LANES];
        let mut share = [0.0; POINT_LANES];
        for lane in 0..POINT_LANES {
            let point = Vec3::new(xs[lane], ys[lane], panel.centre.z);
            let to_point = point - plate.centre;
            above[lane] = to_point.dot(&plate.normal);
            let heights = above[lane] + detector_above;
            let across = above[lane] * along_width + detector_above * to_point.dot(&plate.width_axis);
            let up = above[lane] * along_height + detector_above * to_point.dot(&plate.height_axis);
            let inside = (above[lane] > 0.0)
                & (across.abs() <= plate.half_width_m * heights)
                & (up.abs() <= plate.half_height_m * heights);
            squared[lane] = (point - image).norm_squared();
            share[lane] = if inside { weights[lane] } else { 0.0 };
        }
        fade(&mut share, &squared, rise, panel.order);
        for (sum, branch) in sums[..branches].iter_mut().zip(&model.detectors) {
            let normal_part = 2.0 * plate.normal.dot(&branch.normal);
            let least = branch.fov_cosine * branch.fov_cosine;
            for lane in 0..POINT_LANES {
                let point = Vec3::new(xs[lane], ys[lane], panel.centre.z);
                let facing = (point - detector).dot(&branch.normal) - above[lane] * normal_part;
                let seen = (facing > 0.0) & (facing * facing >= least * squared[lane]);
                sum[lane] += if seen { share[lane] * facing } else { 0.0 };
            }
        }
    }
    for ((gain, sum), branch) in gains.iter_mut().zip(&sums).zip(&model.detectors) {
        *gain += model.reflectivity() * panel.front * branch.concentrator_gain * sum.iter().sum::<f64>();
    }
}

/// Multiplies each share by cos^n(irradiance) / D^3: the incidence cosine's own 1 / D is in it.
#[inline]
fn fade(share: &mut [f64; POINT_LANES], squared: &[f64; POINT_LANES], rise: f64, order: f64) {
    if order == 1.0 {
        for lane in 0..POINT_LANES {
            share[lane] *= rise / (squared[lane] * squared[lane]);
        }
    } else {
        for lane in 0..POINT_LANES {
            if share[lane] > 0.0 {
                let distance = squared[lane].sqrt();
                share[lane] *= lambertian(rise / distance, order) / (squared[lane] * distance);
            }
        }
    }
}

/// Sum of a list in eight interleaved parts: an order that the compiler can vectorise and that never changes.
pub(crate) fn interleaved_sum(values: &[f64]) -> f64 {
    let (full, rest) = values.as_chunks::<8>();
    let mut parts = [0.0; 8];
    for chunk in full {
        for lane in 0..8 {
            parts[lane] += chunk[lane];
        }
    }
    parts.iter().sum::<f64>() + rest.iter().sum::<f64>()
}
