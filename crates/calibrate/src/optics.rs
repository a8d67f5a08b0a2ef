//! The light of one mirror and of one LED at a receiver, with derivatives by every quantity that a
//! calibration estimates.
//!
//! The equations are those of [`heliostat_channel::specular`] and [`heliostat_channel::los`] with
//! one difference. There a panel is a set of points, and each is visible in a mirror or not. Here
//! each point stands for its cell of the panel, so the share of visible cells falls smoothly at the
//! edge of the light. That is closer to a real panel, and it has a derivative. Path length and
//! cosines are those of the panel's centre.
//!
//! The functions are generic over the numbers of `num-dual`: with `f64` they give the gain, with
//! dual numbers also its exact derivatives. Positions are in the frame of the mirrors' wall.

use heliostat_channel::{ChannelModel, MirrorArray, Vec3};
use num_dual::{DualNum, DualSVec64};

/// Number of quantities on which a gain depends.
pub const QUANTITIES: usize = 15;

/// Deviation of the roll from its command, in rad; the yaw follows.
pub const OFFSET: usize = 0;
/// Relative error of the roll's scale; the yaw follows.
pub const SCALE: usize = 2;
/// x, y and z of the LED relative to its nominal place below the raised ceiling, in m.
pub const LED: usize = 4;
/// Relative deviation of the half-power semi-angle.
pub const SEMI_ANGLE: usize = 7;
/// Height of LED and mirrors above their nominal height over the tracker's floor, in m.
pub const RAISE: usize = 8;
/// Slopes of the detector's normal along x and y, as tangents.
pub const TILT: usize = 9;
/// x, y and z of the detector in m.
pub const PLACE: usize = 11;
/// Natural logarithm of the factor on the gain.
pub const LOG_FACTOR: usize = 14;

/// A number and its derivatives by the quantities.
pub type Dual = DualSVec64<QUANTITIES>;

/// Values of the quantities.
pub type Quantities = [f64; QUANTITIES];

/// The quantities of a nominal mirror and LED, with the detector at a place and a height in m.
pub fn nominal_at([x, y]: [f64; 2], height_m: f64) -> Quantities {
    let mut quantities = [0.0; QUANTITIES];
    quantities[PLACE..PLACE + 3].copy_from_slice(&[x, y, height_m]);
    quantities
}

/// Smallest spread of an edge, as a share of half a side of the mirror.
const EDGE_MIN: f64 = 0.04;

/// Slope that fits the logistic function to the normal distribution: pi / sqrt(3).
const LOGISTIC: f64 = 1.813_799_364;

/// An argument of the logistic function beyond which it is 0 or 1.
const LOGISTIC_MAX: f64 = 40.0;

/// The equipment of one array at its nominal values.
#[derive(Clone, Debug)]
pub struct Optics {
    /// Centres of the mirrors in m, in the wall frame.
    pub centres: Vec<Vec3>,
    /// Centres of the LEDs in m, in the wall frame.
    pub leds: Vec<Vec3>,
    /// Half of a mirror's width and of its height in m.
    half_m: [f64; 2],
    /// Offsets of the panel's points from its centre in m.
    points: Vec<[f64; 2]>,
    /// Side of a point's cell in m.
    cell_m: f64,
    /// Half-power semi-angle in rad.
    semi_angle: f64,
    /// A_r T_s g / (2 pi) in m2.
    front_m2: f64,
    reflectivity: f64,
    array: MirrorArray,
}

impl Optics {
    /// The optics of array `index` of a room; `None` unless the receiver has one branch that faces
    /// up, since a report of several branches does not say which of them received the light.
    pub fn new(model: &ChannelModel, index: usize) -> Option<Self> {
        let [branch] = model.receiver.branches.as_slice() else { return None };
        let (array, led) = (model.mirrors.arrays().get(index)?.clone(), model.leds.first()?);
        if (branch.normal - Vec3::z()).norm() > 1e-9 {
            return None;
        }
        let points: Vec<[f64; 2]> =
            led.points().iter().map(|point| [point.x - led.position.x, point.y - led.position.y]).collect();
        let receiver = &model.receiver;
        let front_m2 = receiver.detector_area_m2 * receiver.filter_gain * receiver.concentrator_gain(branch)
            / std::f64::consts::TAU;
        Some(Self {
            centres: array.positions().iter().map(|centre| array.wall_from_room(centre)).collect(),
            leds: model.leds.iter().map(|led| array.wall_from_room(&led.position)).collect(),
            half_m: [0.5 * array.spec().mirror_width_m, 0.5 * array.spec().mirror_height_m],
            cell_m: if led.side_m > 0.0 { led.side_m / led.points_per_side as f64 } else { 0.0 },
            points,
            semi_angle: led.half_power_semi_angle,
            front_m2,
            reflectivity: array.spec().reflectivity,
            array,
        })
    }

    /// The array.
    pub fn array(&self) -> &MirrorArray {
        &self.array
    }

    /// Gain of the light from an LED by way of a mirror at commanded angles.
    pub fn mirror_gain<D: DualNum<Primitive = f64> + Copy>(
        &self,
        (mirror, led): (usize, usize),
        command: [f64; 2],
        q: &[D; QUANTITIES],
    ) -> D {
        let zero = D::from(0.0);
        let [roll, yaw] = [0, 1].map(|axis| q[SCALE + axis] * command[axis] + q[OFFSET + axis] + command[axis]);
        let ((sin_roll, cos_roll), (sin_yaw, cos_yaw)) = (roll.sin_cos(), yaw.sin_cos());
        let normal = [-sin_yaw * cos_roll, -cos_yaw * cos_roll, -sin_roll];
        let width = [cos_yaw, -sin_yaw, zero];
        let height = [-sin_yaw * sin_roll, -cos_yaw * sin_roll, cos_roll];
        let centre = &self.centres[mirror];
        let detector = [q[PLACE] - centre.x, q[PLACE + 1] - centre.y, q[PLACE + 2] - q[RAISE] - centre.z];
        let nominal = self.leds[led] - centre;
        let source = [q[LED] + nominal.x, q[LED + 1] + nominal.y, q[LED + 2] + nominal.z];
        let (source_height, detector_height) = (dot(&source, &normal), dot(&detector, &normal));
        if source_height.re() <= 0.0 || detector_height.re() <= 0.0 {
            return zero;
        }
        let visible = self.visible([&normal, &width, &height], &source, &detector, [source_height, detector_height]);
        if visible.re() <= 0.0 {
            return zero;
        }
        let image = [0, 1, 2].map(|axis| source[axis] - normal[axis] * source_height * 2.0 - detector[axis]);
        let length = dot(&image, &image).sqrt();
        let along = dot(&image, &normal) / length;
        let irradiance = image[2] / length - along * normal[2] * 2.0;
        let incidence = self.incidence(&image, length, q);
        if irradiance.re() <= 0.0 || incidence.re() <= 0.0 {
            return zero;
        }
        let factor = (q[LOG_FACTOR]).exp() * (self.front_m2 * self.reflectivity);
        self.lambertian(irradiance, q) * incidence / (length * length) * factor * visible
    }

    /// Gain of the unblocked direct path from an LED.
    pub fn direct_gain<D: DualNum<Primitive = f64> + Copy>(&self, led: usize, q: &[D; QUANTITIES]) -> D {
        let nominal = self.leds[led];
        let ray = [
            q[LED] - q[PLACE] + nominal.x,
            q[LED + 1] - q[PLACE + 1] + nominal.y,
            q[LED + 2] + q[RAISE] - q[PLACE + 2] + nominal.z,
        ];
        let length = dot(&ray, &ray).sqrt();
        let (irradiance, incidence) = (ray[2] / length, self.incidence(&ray, length, q));
        if irradiance.re() <= 0.0 || incidence.re() <= 0.0 {
            return D::from(0.0);
        }
        self.lambertian(irradiance, q) * incidence / (length * length) * q[LOG_FACTOR].exp() * self.front_m2
    }

    /// The largest gain by way of a mirror, of any mirror and wherever the detector is: by the shortest path from an
    /// LED to a mirror, without angles of emission and incidence.
    pub fn mirror_gain_max(&self) -> f64 {
        let paths = self.leds.iter().flat_map(|led| self.centres.iter().map(move |centre| (led - centre).norm()));
        self.reflectivity * self.gain_at(paths.fold(f64::INFINITY, f64::min))
    }

    /// The same of the direct path to a detector of this height in m; infinite where it can be at an LED.
    pub fn direct_gain_max(&self, height_m: f64) -> f64 {
        let paths = self.leds.iter().map(|led| (led.z - height_m).max(0.0));
        self.gain_at(paths.fold(f64::INFINITY, f64::min))
    }

    /// The gain at this distance in m in the middle of an LED's light.
    fn gain_at(&self, distance_m: f64) -> f64 {
        self.front_m2 * self.lambertian(1.0_f64, &[0.0; QUANTITIES]) / (distance_m * distance_m)
    }

    /// Roll and yaw in rad of the mirror that reflects an LED's centre to the detector.
    ///
    /// `None` where the three points are in line.
    pub fn aim(&self, (mirror, led): (usize, usize), q: &Quantities) -> Option<[f64; 2]> {
        let raised = Vec3::new(0.0, 0.0, q[RAISE]);
        let source = self.leds[led] + raised + Vec3::new(q[LED], q[LED + 1], q[LED + 2]);
        let detector = Vec3::new(q[PLACE], q[PLACE + 1], q[PLACE + 2]);
        let normal = heliostat_channel::specular::bisector(&(self.centres[mirror] + raised), &source, &detector)?;
        let (roll, yaw) = self.array.angles_of(&self.array.room_from_wall(&normal));
        Some([roll, yaw])
    }

    /// The half-power semi-angle in rad with this relative deviation.
    pub fn semi_angle(&self, deviation: f64) -> f64 {
        self.semi_angle * (1.0 + deviation)
    }

    /// (n + 1) cos^n with the order n of the LED.
    fn lambertian<D: DualNum<Primitive = f64> + Copy>(&self, cosine: D, q: &[D; QUANTITIES]) -> D {
        let semi_angle = (q[SEMI_ANGLE] + 1.0) * self.semi_angle;
        let order = -semi_angle.cos().ln().recip() * std::f64::consts::LN_2;
        (order + 1.0) * (order * cosine.ln()).exp()
    }

    /// Cosine of the incidence angle on the tilted detector.
    fn incidence<D: DualNum<Primitive = f64> + Copy>(&self, ray: &[D; 3], length: D, q: &[D; QUANTITIES]) -> D {
        let (a, b) = (q[TILT], q[TILT + 1]);
        (ray[0] * a + ray[1] * b + ray[2]) / (length * (a * a + b * b + 1.0).sqrt())
    }

    /// Share of the panel's cells that the detector sees in the mirror's rectangle.
    fn visible<D: DualNum<Primitive = f64> + Copy>(
        &self,
        [normal, width, height]: [&[D; 3]; 3],
        source: &[D; 3],
        detector: &[D; 3],
        [source_height, detector_height]: [D; 2],
    ) -> D {
        let share = detector_height / (source_height + detector_height);
        let axes = [width, height].map(|axis| (axis, dot(source, axis), dot(detector, axis)));
        // A cell is uniform over its side, which has the variance of side^2 / 12.
        let steepness = [0, 1].map(|side: usize| {
            let axis = axes[side].0;
            let across = (axis[0] * axis[0] + axis[1] * axis[1]) * share * share * (self.cell_m * self.cell_m / 12.0);
            (across + (EDGE_MIN * self.half_m[side]).powi(2)).sqrt().recip() * LOGISTIC
        });
        // Far outside all shares are 0; most probes of a search are there.
        let reach = self.points.iter().map(|[x, y]| x.abs().max(y.abs())).fold(0.0, f64::max) * 2.0;
        for side in 0..2 {
            let (_, source, detector) = &axes[side];
            let hit = (source_height.re() * detector.re() + detector_height.re() * source.re())
                / (source_height.re() + detector_height.re());
            if hit.abs() > self.half_m[side] + reach + LOGISTIC_MAX / steepness[side].re() {
                return D::from(0.0);
            }
        }
        let mut sum = D::from(0.0);
        for [x, y] in &self.points {
            let at = source_height + normal[0] * *x + normal[1] * *y;
            let mut lit = D::from(1.0);
            for side in 0..2 {
                let (axis, source, along) = &axes[side];
                let point = *source + axis[0] * *x + axis[1] * *y;
                let hit = (at * *along + detector_height * point) / (at + detector_height);
                let half = self.half_m[side];
                lit *= logistic((-hit + half) * steepness[side]) * logistic((hit + half) * steepness[side]);
            }
            sum += lit;
        }
        sum / self.points.len() as f64
    }
}

/// 1 / (1 + e^-x).
fn logistic<D: DualNum<Primitive = f64> + Copy>(x: D) -> D {
    if x.re() < -LOGISTIC_MAX {
        D::from(0.0)
    } else if x.re() > LOGISTIC_MAX {
        D::from(1.0)
    } else {
        ((-x).exp() + 1.0).recip()
    }
}

fn dot<D: DualNum<Primitive = f64> + Copy>(a: &[D; 3], b: &[D; 3]) -> D {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The quantities as dual numbers, each the variable of its own index.
pub fn variables(values: &Quantities) -> [Dual; QUANTITIES] {
    std::array::from_fn(|index| Dual::from_re(values[index]).derivative(index))
}
