//! A room's equipment as one checked value: what every computation of a link starts from.

use crate::Vec3;
use crate::diffuse::{self, Reading};
use crate::emitter::{Led, lambertian};
use crate::error::{ChannelError, check};
use crate::link::LinkBudget;
use crate::los::front_factor;
use crate::mirrors::MirrorArray;
use crate::quadrature::{FewPoints, smooth_from_squared};
use crate::receiver::Receiver;
use crate::scene::kernel::POINT_LANES;
use crate::trig::{Lanes, in_blocks};

/// Most LEDs of a room.
pub const LEDS_MAX: usize = 64;

/// How the light of a mirror is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// The law of reflection (see [`specular`](crate::specular)): for real hardware.
    Specular,
    /// Eqs. (2) and (3) of the paper (see [`diffuse`]): for comparison with it.
    Paper {
        /// Whether the symbols are read literally ([`Reading::Literal`]).
        literal: bool,
        /// Factor on every mirror's gain; 1 is the paper as printed, anything else is unphysical.
        gain_scale: f64,
    },
}

impl Mode {
    /// How eqs. (2) and (3) are read, or `None` for the law of reflection.
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
/// The fields can be read. Changing `budget` takes effect at once; the others have been worked into tables by
/// [`ChannelModel::new`], so a different geometry is a new model.
#[derive(Clone, Debug)]
pub struct ChannelModel {
    /// Which mirror gain.
    pub mode: Mode,
    /// The access points, all with the power of `budget`.
    pub leds: Vec<Led>,
    /// The mirror array.
    pub mirrors: MirrorArray,
    /// The receiver of every user.
    pub receiver: Receiver,
    /// Power, responsivity, noise, bandwidth.
    pub budget: LinkBudget,
    pub(crate) panels: Vec<Panel>,
    pub(crate) detectors: Vec<Detector>,
}

/// What is known of one LED before any user is.
#[derive(Clone, Debug)]
pub(crate) struct Panel {
    pub centre: Vec3,
    /// The points that stand for the panel, in m.
    pub points: Vec<Vec3>,
    /// The same points in groups; the last group is filled up with weight 0.
    pub lanes: Vec<PointLanes<POINT_LANES>>,
    /// Fewer points with the same mean of what is smooth; empty where there are none.
    pub few_lanes: Vec<PointLanes<POINT_LANES>>,
    /// Squared distance in m2 from which on the light of a point is smooth enough for them.
    pub few_from_squared: f64,
    /// Largest distance of a point from the panel's centre in m.
    pub radius: f64,
    /// Largest offset of a point from the panel's centre along x or y in m.
    pub half_side: f64,
    pub order: f64,
    /// (n + 1) A_r T_s / (2 pi) over the number of points, in m2.
    pub front: f64,
    /// Distance from the panel's centre to each mirror in m, in blocks.
    pub distance: Vec<Lanes>,
    /// Unit vectors from each mirror to the panel's centre: x, y and z, in blocks.
    pub direction: [Vec<Lanes>; 3],
    /// Specular: rho (n + 1) A_r T_s cos^n / (2 pi) towards each mirror's centre in m2; paper: illumination times gain scale; in blocks.
    pub towards_mirror: Vec<Lanes>,
}

/// A few points of a panel: offsets from its centre in m, and weight.
#[derive(Clone, Debug)]
pub(crate) struct PointLanes<const N: usize> {
    pub x: [f64; N],
    pub y: [f64; N],
    pub weight: [f64; N],
}

/// What is known of one branch.
#[derive(Clone, Debug)]
pub(crate) struct Detector {
    pub normal: Vec3,
    pub fov_cosine: f64,
    pub concentrator_gain: f64,
}

impl ChannelModel {
    /// Checks the parts and prepares what does not depend on the users.
    ///
    /// # Errors
    /// [`ChannelError`] for an LED, receiver, budget or gain scale outside its domain, for no LED or more than [`LEDS_MAX`], and for an LED that is not in front of
    /// the mirror wall.
    pub fn new(
        mode: Mode,
        leds: Vec<Led>,
        mirrors: MirrorArray,
        receiver: Receiver,
        budget: LinkBudget,
    ) -> Result<Self, ChannelError> {
        if leds.is_empty() || leds.len() > LEDS_MAX {
            return Err(ChannelError::Count { things: "LEDs", count: leds.len(), wanted: "1 to 64" });
        }
        if let Mode::Paper { gain_scale, .. } = mode {
            check(gain_scale.is_finite() && gain_scale > 0.0, "gain scale", gain_scale, "finite and positive")?;
        }
        receiver.check()?;
        budget.check()?;
        for (index, led) in leds.iter().enumerate() {
            led.check()?;
            let distance_m = (led.position - mirrors.positions()[0]).dot(&mirrors.inward());
            if distance_m <= 0.5 * led.side_m {
                return Err(ChannelError::LedBehindWall { led: index, distance_m: distance_m - 0.5 * led.side_m });
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

    pub(crate) fn reflectivity(&self) -> f64 {
        self.mirrors.spec().reflectivity
    }
}

impl Panel {
    fn new(mode: Mode, led: &Led, mirrors: &MirrorArray, receiver: &Receiver) -> Self {
        let points = led.points();
        let order = led.lambertian_order();
        let front = front_factor(order, receiver);
        let distance: Vec<f64> = mirrors.positions().iter().map(|mirror| (led.position - mirror).norm()).collect();
        let towards_mirror = |index: usize| match mode {
            Mode::Specular => {
                let rise = led.position.z - mirrors.positions()[index].z;
                let cosine = (rise / distance[index]).max(0.0);
                mirrors.spec().reflectivity * front * lambertian(cosine, order)
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
            distance: in_blocks(distance.iter().copied()),
        }
    }
}

impl PointLanes<1> {
    /// All of a point LED.
    pub const CENTRE: Self = Self { x: [0.0], y: [0.0], weight: [1.0] };
}

impl PointLanes<POINT_LANES> {
    /// Eight points with the weight of all of a panel's.
    fn of_few(few: &FewPoints, all: usize) -> Vec<Self> {
        let lanes = |values: &[f64; 8], first: usize| std::array::from_fn(|lane| values[first + lane]);
        (0..few.x.len())
            .step_by(POINT_LANES)
            .map(|first| Self {
                x: lanes(&few.x, first),
                y: lanes(&few.y, first),
                weight: lanes(&few.weight, first).map(|weight: f64| weight * all as f64),
            })
            .collect()
    }
}

impl<const N: usize> PointLanes<N> {
    fn new(points: &[Vec3], centre: &Vec3) -> Self {
        let offset = |index: usize| points.get(index).map_or(Vec3::zeros(), |point| point - centre);
        Self {
            x: std::array::from_fn(|index| offset(index).x),
            y: std::array::from_fn(|index| offset(index).y),
            weight: std::array::from_fn(|index| if index < points.len() { 1.0 } else { 0.0 }),
        }
    }
}
