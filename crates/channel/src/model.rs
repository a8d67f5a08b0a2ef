//! The optical equipment of a room as one checked value: LEDs, mirrors, receiver and link budget.

use crate::arrays::MirrorArrays;
use crate::diffuse::{self, Reading};
use crate::domain::positive;
use crate::emitter::{Led, lambertian};
use crate::error::ChannelError;
use crate::geometry::Vec3;
use crate::link::LinkBudget;
use crate::los::front_factor;
use crate::orientation::Orientation;
use crate::quadrature::{FewPoints, POINT_LANES, PointLanes, smooth_from_squared};
use crate::receiver::Receiver;
use crate::trig::{Lanes, in_blocks};

/// Largest number of LEDs of a room.
pub const LEDS_MAX: usize = heliostat_proto::MAX_LED_GAINS / heliostat_proto::MAX_USERS;

/// The model of the mirror gain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// The law of reflection (see [`specular`](crate::specular)): for real hardware.
    Specular,
    /// Eqs. (2) and (3) of the paper (see [`diffuse`]): for comparison with the paper.
    Paper {
        /// Whether the symbols are interpreted literally ([`Reading::Literal`]).
        literal: bool,
        /// Factor on the gain of every mirror, above 0; 1 is the paper as printed, any other value
        /// is unphysical.
        gain_scale: f64,
    },
}

impl Mode {
    /// The interpretation of eqs. (2) and (3); `None` for the law of reflection.
    pub(crate) fn reading(self) -> Option<Reading> {
        match self {
            Self::Specular => None,
            Self::Paper { literal: true, .. } => Some(Reading::Literal),
            Self::Paper { literal: false, .. } => Some(Reading::Sensible),
        }
    }
}

/// LEDs, mirrors, receiver and link budget of a room, checked.
///
/// A change of `budget` takes effect at once. [`ChannelModel::new`] computes tables from the other
/// fields, so a different geometry needs a new model.
#[derive(Clone, Debug)]
pub struct ChannelModel {
    /// The model of the mirror gain.
    pub mode: Mode,
    /// The LEDs; each has the optical power of `budget`.
    pub leds: Vec<Led>,
    /// The mirrors of all arrays.
    pub mirrors: MirrorArrays,
    /// The receiver of every user.
    pub receiver: Receiver,
    /// Power, responsivity, noise and bandwidth.
    pub budget: LinkBudget,
    pub(crate) panels: Vec<Panel>,
    /// The branches of an upright receiver. Shape: B.
    pub(crate) detectors: Vec<Detector>,
}

/// Quantities of one LED that do not depend on the users.
#[derive(Clone, Debug)]
pub(crate) struct Panel {
    pub centre: Vec3,
    /// The points that represent the panel, in m.
    pub points: Vec<Vec3>,
    /// The same points in groups; unused lanes of the last group have weight 0.
    pub lanes: Vec<PointLanes<POINT_LANES>>,
    /// The eight points for the mean of a smooth function; empty for a grid of few points.
    pub few_lanes: Vec<PointLanes<POINT_LANES>>,
    /// Square in m2 of the smallest distance at which the eight points may be used.
    pub few_from_squared: f64,
    /// Largest distance of a point from the panel's centre in m.
    pub radius: f64,
    /// Largest offset of a point from the panel's centre along x or y in m.
    pub half_side: f64,
    pub order: f64,
    /// (n + 1) A_r T_s / (2 pi) over the number of points, in m2.
    pub front: f64,
    /// Distance from the panel's centre to the nearest mirror in m.
    pub nearest_mirror_m: f64,
    /// Distance from the panel's centre to each mirror in m, in blocks.
    pub distance: Vec<Lanes>,
    /// Unit vectors from each mirror to the panel's centre: x, y and z in blocks.
    pub direction: [Vec<Lanes>; 3],
    /// Specular: rho (n + 1) A_r T_s cos^n(irradiance_angle) / (2 pi) towards each mirror's centre
    /// in m2. Paper: illumination times gain scale. In blocks.
    pub towards_mirror: Vec<Lanes>,
}

/// One branch of a user's receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Detector {
    /// Unit normal in the room's frame.
    pub normal: Vec3,
    pub fov_cosine: f64,
    pub concentrator_gain: f64,
}

impl ChannelModel {
    /// Checks the parts and computes the tables that do not depend on the users.
    ///
    /// # Errors
    /// [`ChannelError`] for a value of an LED, the receiver, the budget or the gain scale outside
    /// its domain, and for no LED or more than [`LEDS_MAX`]. An LED that is not in front of every
    /// wall with mirrors is refused too.
    pub fn new(
        mode: Mode,
        leds: Vec<Led>,
        mirrors: impl Into<MirrorArrays>,
        receiver: Receiver,
        budget: LinkBudget,
    ) -> Result<Self, ChannelError> {
        if leds.is_empty() || leds.len() > LEDS_MAX {
            return Err(ChannelError::Count { things: "LEDs", count: leds.len(), expected: "1 to 64" });
        }
        if let Mode::Paper { gain_scale, .. } = mode {
            positive("gain scale", gain_scale)?;
        }
        receiver.check()?;
        budget.check()?;
        let mirrors = mirrors.into();
        for (index, led) in leds.iter().enumerate() {
            led.check()?;
            for array in mirrors.arrays() {
                let distance_m = (led.position - array.positions()[0]).dot(&array.inward());
                if distance_m <= 0.5 * led.side_m {
                    return Err(ChannelError::LedBehindWall { led: index, distance_m: distance_m - 0.5 * led.side_m });
                }
            }
        }
        let panels = leds.iter().map(|led| Panel::new(mode, led, &mirrors, &receiver)).collect();
        let detectors = receiver
            .branches
            .iter()
            .map(|branch| Detector {
                normal: branch.normal,
                fov_cosine: branch.fov_cosine(),
                concentrator_gain: receiver.concentrator_gain(branch),
            })
            .collect();
        Ok(Self { mode, leds, mirrors, receiver, budget, panels, detectors })
    }

    /// Writes the branches of a receiver that is held like this. Shape of `out`: B.
    pub(crate) fn turn_detectors(&self, orientation: &Orientation, out: &mut [Detector]) {
        for (out, upright) in out.iter_mut().zip(&self.detectors) {
            *out = Detector { normal: orientation.turn(&upright.normal), ..*upright };
        }
    }

    /// Unit vectors from a block of mirrors to an LED: x, y and z.
    #[inline(always)]
    pub(crate) fn directions_to_led(&self, led: usize, block: usize) -> [&Lanes; 3] {
        self.panels[led].direction.each_ref().map(|axis| &axis[block])
    }
}

impl Panel {
    fn new(mode: Mode, led: &Led, mirrors: &MirrorArrays, receiver: &Receiver) -> Self {
        let points = led.points();
        let order = led.lambertian_order();
        let front = front_factor(order, receiver);
        let distance: Vec<f64> = mirrors.positions().iter().map(|mirror| (led.position - mirror).norm()).collect();
        let towards_mirror = |index: usize| match mode {
            Mode::Specular => {
                let rise = led.position.z - mirrors.positions()[index].z;
                let cosine = (rise / distance[index]).max(0.0);
                mirrors.reflectivity(index) * front * lambertian(cosine, order)
            }
            Mode::Paper { gain_scale, .. } => gain_scale * diffuse::illumination(led, mirrors, index),
        };
        let half_side = points
            .iter()
            .map(|point| point - led.position)
            .fold(0.0, |most: f64, offset| offset.x.abs().max(offset.y.abs()).max(most));
        let few = FewPoints::of_grid(led.points_per_side, led.side_m / led.points_per_side as f64);
        Self {
            radius: points.iter().map(|point| (point - led.position).norm()).fold(0.0, f64::max),
            half_side,
            few_from_squared: smooth_from_squared(half_side, order),
            few_lanes: few.map_or(Vec::new(), |few| PointLanes::of_few(&few, points.len())),
            centre: led.position,
            front: front / points.len() as f64,
            lanes: points.chunks(POINT_LANES).map(|chunk| PointLanes::new(chunk, &led.position)).collect(),
            points,
            order,
            direction: [0, 1, 2].map(|axis| {
                let along = mirrors.positions().iter().zip(&distance);
                in_blocks(along.map(|(mirror, distance)| (led.position[axis] - mirror[axis]) / distance))
            }),
            towards_mirror: in_blocks((0..mirrors.len()).map(towards_mirror)),
            nearest_mirror_m: distance.iter().copied().fold(f64::INFINITY, f64::min),
            distance: in_blocks(distance.iter().copied()),
        }
    }
}
