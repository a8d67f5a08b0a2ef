//! The inner loops of a scene: blocks of mirrors, and the gain of one mirror for one user.
//!
//! Layout: one array per component, a fixed number of mirrors per block, no data-dependent branch
//! in a loop over lanes. rustc vectorises these loops: two mirrors at a time on the x86-64
//! baseline, four with AVX2, eight with AVX-512 (see
//! [`with_widest_simd`](crate::simd::with_widest_simd)). To inspect the code:
//! `cargo rustc --release -p heliostat-channel -- --emit asm`.

use crate::arrays::{MirrorArrays, Surfaces};
use crate::emitter::lambertian;
use crate::geometry::Vec3;
use crate::mirrors::MirrorAngles;
use crate::model::{Detector, Panel};
use crate::quadrature::PointLanes;
use crate::specular::Plate;
use crate::trig::{BLOCK, Lanes, sin_cos};

/// Margin for rounding in m2, in a test that must never reject a valid path; products of lengths
/// have errors of about 1e-14.
const ROUNDING_M2: f64 = 1e-9;

/// The receiver of one user: the position of its detectors, and the branches as the user holds it.
#[derive(Clone, Copy)]
pub(crate) struct Held<'a> {
    pub position: &'a Vec3,
    pub branches: &'a [Detector],
}

/// A block of mirrors at their angles, in the room's frame.
pub(crate) struct Turned<'a> {
    /// Centre in m; lanes past the last mirror repeat it.
    pub centre: [Lanes; 3],
    /// Unit normal.
    pub normal: [Lanes; 3],
    /// Unit vector along the width; its z is zero.
    pub width: [Lanes; 2],
    /// Unit vector along the height.
    pub height: [Lanes; 3],
    /// Sizes and reflectivities.
    pub surfaces: &'a Surfaces,
}

/// An LED panel relative to a block of mirrors, for the test whether its light can reach a point.
///
/// The point where the ray from the panel's centre S to a point R meets the mirror's plane,
/// multiplied by the sum of both heights above the plane, is (S . n) (R . u) + (R . n) (S . u)
/// along an axis u, relative to the mirror's centre. This is linear in R, so a constant and a slope
/// represent it.
pub(crate) struct Source {
    /// Height of the panel's centre above each mirror's plane in m.
    above: Lanes,
    /// Height of a point above each mirror's plane in m.
    height: Form,
    /// Weighted coordinate along the width in m2.
    across: Form,
    /// Weighted coordinate along the height in m2.
    up: Form,
    /// Largest distance of a point of the panel from its centre.
    radius: f64,
}

/// A linear function of a point for each mirror of a block: a constant and a slope.
struct Form {
    constant: Lanes,
    slope: [Lanes; 3],
}

impl Form {
    #[inline(always)]
    fn at(&self, point: &Vec3, lane: usize) -> f64 {
        self.constant[lane]
            + self.slope[0][lane] * point.x
            + self.slope[1][lane] * point.y
            + self.slope[2][lane] * point.z
    }
}

impl<'a> Turned<'a> {
    /// The mirrors from index `first` on.
    #[inline(always)]
    pub fn new(mirrors: &'a MirrorArrays, angles: &MirrorAngles, first: usize) -> Self {
        Self::at(mirrors, &lanes(&angles.roll[first..]), &lanes(&angles.yaw[first..]), first / BLOCK)
    }

    /// The mirrors of a block at these angles in radians.
    #[inline(always)]
    pub fn at(mirrors: &'a MirrorArrays, roll: &Lanes, yaw: &Lanes, block: usize) -> Self {
        let (sin_roll, cos_roll) = sin_cos(roll);
        let (sin_yaw, cos_yaw) = sin_cos(yaw);
        let surfaces = mirrors.surfaces(block);
        let mut turned = Self {
            centre: mirrors.block(block).map(|lanes| *lanes),
            normal: [[0.0; BLOCK]; 3],
            width: [[0.0; BLOCK]; 2],
            height: [[0.0; BLOCK]; 3],
            surfaces,
        };
        for lane in 0..BLOCK {
            // Yaw in the room's frame: the mirror's yaw plus the rotation of the wall.
            let (cos_wall, sin_wall) = (surfaces.wall_cos[lane], surfaces.wall_sin[lane]);
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

    /// The LED panel relative to these mirrors.
    #[inline(always)]
    pub fn source(&self, panel: &Panel) -> Source {
        let width = [self.width[0], self.width[1], [0.0; BLOCK]];
        let above = self.along(&self.normal, &panel.centre);
        Source {
            height: self.form(&[1.0; BLOCK], &self.normal, (&[0.0; BLOCK], &self.normal)),
            across: self.form(&above, &width, (&self.along(&width, &panel.centre), &self.normal)),
            up: self.form(&above, &self.height, (&self.along(&self.height, &panel.centre), &self.normal)),
            above,
            radius: panel.radius,
        }
    }

    /// A number per lane that is negative if no light of the panel can reach the point by way of
    /// that mirror.
    ///
    /// A point of the panel is at most `radius` from the panel's centre, so each coordinate in the
    /// mirror's axes differs by at most `radius`. The bound is conservative; the caller computes
    /// the remaining mirrors exactly.
    #[inline(always)]
    #[expect(clippy::needless_range_loop, reason = "one index into several arrays is what the compiler vectorises")]
    pub fn candidates(&self, source: &Source, point: &Vec3) -> Lanes {
        let mut slack = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let height = source.height.at(point, lane);
            let heights = source.above[lane] + height + source.radius;
            let across = self.surfaces.half_width[lane] * heights + ROUNDING_M2 - source.across.at(point, lane).abs();
            let up = self.surfaces.half_height[lane] * heights + ROUNDING_M2 - source.up.at(point, lane).abs();
            // f64::min ignores a NaN, so a comparison handles the height.
            slack[lane] = if across < up { across } else { up };
            slack[lane] = if height > 0.0 { slack[lane] } else { -1.0 };
        }
        if source.radius > 0.0 {
            let width = [self.width[0], self.width[1], [0.0; BLOCK]];
            let (along_width, along_height) = (self.along(&width, point), self.along(&self.height, point));
            for lane in 0..BLOCK {
                let farthest = along_width[lane].abs().max(along_height[lane].abs()) + source.height.at(point, lane);
                slack[lane] += source.radius * farthest;
            }
        }
        slack
    }

    /// Cosine between each mirror's normal and the direction to a point, from the reciprocals of
    /// the distances.
    #[inline(always)]
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
    #[inline(always)]
    pub fn plate(&self, lane: usize) -> Plate {
        let vector = |parts: &[Lanes; 3]| Vec3::new(parts[0][lane], parts[1][lane], parts[2][lane]);
        Plate {
            centre: vector(&self.centre),
            normal: vector(&self.normal),
            width_axis: Vec3::new(self.width[0][lane], self.width[1][lane], 0.0),
            height_axis: vector(&self.height),
            half_width_m: self.surfaces.half_width[lane],
            half_height_m: self.surfaces.half_height[lane],
        }
    }

    /// Coordinate of a point along an axis of each mirror, from its centre, in m.
    #[inline(always)]
    fn along(&self, axis: &[Lanes; 3], point: &Vec3) -> Lanes {
        let mut along = [0.0; BLOCK];
        for lane in 0..BLOCK {
            along[lane] = axis[0][lane] * (point.x - self.centre[0][lane])
                + axis[1][lane] * (point.y - self.centre[1][lane])
                + axis[2][lane] * (point.z - self.centre[2][lane]);
        }
        along
    }

    /// a (R - p) . u + b (R - p) . v as a linear function of R.
    #[inline(always)]
    fn form(&self, a: &Lanes, u: &[Lanes; 3], (b, v): (&Lanes, &[Lanes; 3])) -> Form {
        let mut form = Form { constant: [0.0; BLOCK], slope: [[0.0; BLOCK]; 3] };
        for axis in 0..3 {
            for lane in 0..BLOCK {
                let slope = a[lane] * u[axis][lane] + b[lane] * v[axis][lane];
                form.slope[axis][lane] = slope;
                form.constant[lane] -= slope * self.centre[axis][lane];
            }
        }
        form
    }
}

/// The first entries of a list; the last entry is repeated.
#[inline(always)]
pub(crate) fn lanes(values: &[f64]) -> Lanes {
    match values.first_chunk() {
        Some(full) => *full,
        None => std::array::from_fn(|lane| values[lane.min(values.len() - 1)]),
    }
}

/// Adds the gain of a panel by way of one mirror to the gains of a receiver's branches: the exact
/// evaluation.
///
/// Equal to [`specular::gain`](crate::specular::gain), but with the image R' of the detector
/// instead of the image of the source, which all points S of the panel share: D = |S - R'|. The
/// irradiance cosine is (S_z - R'_z) / D, and the incidence cosine on a branch is (S' - R) . n_b /
/// D with S' = S - 2 a n at height a above the mirror. As the panel is horizontal, each numerator
/// is linear in a point's offset from the panel's centre.
///
/// `gains`: one per branch, dimensionless.
#[inline(always)]
pub(crate) fn add_reflected(reflectivity: f64, panel: &Panel, plate: &Plate, held: Held, gains: &mut [f64]) {
    // One lane is enough for a point LED.
    if panel.points.len() == 1 {
        add_points(reflectivity, (panel, &[PointLanes::CENTRE], &[]), plate, held, gains);
    } else {
        add_points(reflectivity, (panel, &panel.lanes, &panel.few_lanes), plate, held, gains);
    }
}

#[inline(always)]
#[expect(clippy::needless_range_loop, reason = "one index into several arrays is what the compiler vectorises")]
fn add_points<const N: usize>(
    reflectivity: f64,
    (panel, all, few): (&Panel, &[PointLanes<N>], &[PointLanes<N>]),
    plate: &Plate,
    Held { position: detector, branches }: Held,
    gains: &mut [f64],
) {
    let to_detector = detector - plate.centre;
    let to_panel = panel.centre - plate.centre;
    let detector_above = to_detector.dot(&plate.normal);
    let image = detector - 2.0 * detector_above * plate.normal;
    let towards_panel = panel.centre - image;
    // A NaN fails both comparisons.
    if !(detector_above > 0.0 && towards_panel.z > 0.0) {
        return;
    }
    let above = Linear::new(to_panel.dot(&plate.normal), &plate.normal);
    // Point where the ray meets the mirror's plane along one axis, times the sum of heights; see
    // `Plate::path`.
    let hit = |axis: &Vec3| {
        let along = to_detector.dot(axis);
        let slope = along * plate.normal + detector_above * axis;
        Linear::new(above.centre * along + detector_above * to_panel.dot(axis), &slope)
    };
    let (across, up) = (hit(&plate.width_axis), hit(&plate.height_axis));
    // An aimed mirror mostly reflects all points of the panel to the detector; a bound then
    // replaces the test per point.
    let half = panel.half_side;
    let least_height = above.centre - above.spread(half);
    let room = least_height + detector_above;
    let all_inside = (least_height > 0.0)
        & (across.centre.abs() + across.spread(half) <= plate.half_width_m * room)
        & (up.centre.abs() + up.spread(half) <= plate.half_height_m * room);
    let (far_x, far_y) = (towards_panel.x.abs() + half, towards_panel.y.abs() + half);
    let most_squared = far_x * far_x + far_y * far_y + towards_panel.z * towards_panel.z;
    let facing = |branch: &Detector| {
        let turned = branch.normal - 2.0 * plate.normal.dot(&branch.normal) * plate.normal;
        let facing = Linear::new(towards_panel.dot(&turned), &turned);
        let least = facing.centre - facing.spread(half);
        let all_seen = (least > 0.0) & (least * least >= branch.fov_cosine * branch.fov_cosine * most_squared);
        (facing, all_seen)
    };
    // Inside the mirror's rectangle and the field of view, the gain is smooth in the point: the
    // eight points give its mean.
    let smooth = all_inside
        && !few.is_empty()
        && towards_panel.norm_squared() >= panel.few_from_squared
        && branches.iter().all(|branch| facing(branch).1);
    let front = reflectivity * panel.front;
    for lanes in if smooth { few } else { all } {
        let (mut squared, mut share) = ([0.0; N], lanes.weight);
        for lane in 0..N {
            let (dx, dy) = (towards_panel.x + lanes.x[lane], towards_panel.y + lanes.y[lane]);
            squared[lane] = dx * dx + dy * dy + towards_panel.z * towards_panel.z;
        }
        if !all_inside {
            for lane in 0..N {
                let (x, y) = (lanes.x[lane], lanes.y[lane]);
                let height = above.at(x, y);
                let heights = height + detector_above;
                let inside = (height > 0.0)
                    & (across.at(x, y).abs() <= plate.half_width_m * heights)
                    & (up.at(x, y).abs() <= plate.half_height_m * heights);
                share[lane] = if inside { share[lane] } else { 0.0 };
            }
        }
        fade(&mut share, &squared, towards_panel.z, panel.order);
        for (gain, branch) in gains.iter_mut().zip(branches) {
            let (facing, all_seen) = facing(branch);
            let mut detected = [0.0; N];
            for lane in 0..N {
                detected[lane] = facing.at(lanes.x[lane], lanes.y[lane]);
            }
            if !all_seen {
                let least = branch.fov_cosine * branch.fov_cosine;
                for lane in 0..N {
                    let facing = detected[lane];
                    let seen = (facing > 0.0) & (facing * facing >= least * squared[lane]);
                    detected[lane] = if seen { facing } else { 0.0 };
                }
            }
            for lane in 0..N {
                detected[lane] *= share[lane];
            }
            *gain += front * branch.concentrator_gain * detected.iter().sum::<f64>();
        }
    }
}

/// A quantity that is linear in a point's offset from the panel's centre.
struct Linear {
    centre: f64,
    x: f64,
    y: f64,
}

impl Linear {
    #[inline(always)]
    fn new(centre: f64, slope: &Vec3) -> Self {
        Self { centre, x: slope.x, y: slope.y }
    }

    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> f64 {
        self.centre + self.x * x + self.y * y
    }

    /// Largest difference from the value at the centre, on a panel of this half side.
    #[inline(always)]
    fn spread(&self, half_side: f64) -> f64 {
        half_side * (self.x.abs() + self.y.abs())
    }
}

/// Multiplies each weight by cos^n(irradiance_angle) / D^3; the third 1 / D belongs to the
/// incidence cosine.
#[inline(always)]
fn fade<const N: usize>(share: &mut [f64; N], squared: &[f64; N], rise: f64, order: f64) {
    if order == 1.0 {
        for lane in 0..N {
            share[lane] *= rise / (squared[lane] * squared[lane]);
        }
    } else {
        for lane in 0..N {
            if share[lane] > 0.0 {
                let distance = squared[lane].sqrt();
                share[lane] *= lambertian(rise / distance, order) / (squared[lane] * distance);
            }
        }
    }
}

/// Sum of a list in eight interleaved parts: a fixed order that the compiler can vectorise.
#[inline(always)]
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
