//! The paper's room, and random rooms, for the tests.

use heliostat_channel::{
    ArraySpec, Branch, ChannelModel, Combining, Cylinder, Led, LinkBudget, MirrorArray, MirrorArrays, Mode,
    NoiseBudget, Orientation, PowerLaw, Receiver, Vec3, Wall,
};
use std::f64::consts::PI;

/// The paper's mode as printed, read sensibly.
pub const PAPER: Mode = Mode::Paper { literal: false, gain_scale: 1.0 };

/// Height of the receivers in m.
pub const RECEIVER_HEIGHT_M: f64 = 0.85;

/// What a test may change of the paper's room.
#[derive(Clone, Debug)]
pub struct Room {
    pub mode: Mode,
    pub leds: Vec<Led>,
    pub array: ArraySpec,
    /// Arrays after the first.
    pub others: Vec<ArraySpec>,
    pub receiver: Receiver,
    pub budget: LinkBudget,
}

impl Room {
    /// 5 m x 5 m x 3 m, one LED in the middle of the ceiling as a point, 10 x 10 mirrors on the +y
    /// wall, one upward detector.
    pub fn paper() -> Self {
        Self {
            mode: Mode::Specular,
            leds: vec![led(0.0, 0.0, 0.0)],
            array: ArraySpec {
                rows: 10,
                columns: 10,
                mirror_width_m: 0.25,
                mirror_height_m: 0.10,
                gap_m: 0.02,
                centre_height_m: 2.0,
                wall: Wall::PlusY,
                wall_distance_m: 2.5,
                reflectivity: 0.95,
            },
            others: Vec::new(),
            receiver: Receiver {
                branches: vec![Branch { normal: Vec3::z(), fov_semi_angle: 90.0_f64.to_radians() }],
                detector_area_m2: 20e-6,
                filter_gain: 1.0,
                concentrator_index: None,
                combining: Combining::Best,
            },
            budget: LinkBudget {
                power_w: 2.0,
                power_law: PowerLaw::Linear,
                responsivity_a_per_w: 0.4,
                noise: NoiseBudget::default(),
                bandwidth_hz: 20e6,
            },
        }
    }

    /// The same with a square panel of 0.1 m, averaged over 5 x 5 points.
    pub fn with_panel(mut self) -> Self {
        self.leds[0].side_m = 0.1;
        self.leds[0].points_per_side = 5;
        self
    }

    pub fn with_mode(mut self, mode: Mode) -> Self {
        self.mode = mode;
        self
    }

    pub fn mirrors(&self) -> MirrorArrays {
        let array = |spec| MirrorArray::new(spec).expect("the array is valid");
        MirrorArrays::new(std::iter::once(&self.array).chain(&self.others).map(array).collect()).expect("few arrays")
    }

    pub fn model(&self) -> ChannelModel {
        let parts = self.clone();
        ChannelModel::new(parts.mode, parts.leds, self.mirrors(), parts.receiver, parts.budget)
            .expect("the room is valid")
    }
}

/// An LED on the ceiling; a side of 0 is a point.
pub fn led(x: f64, y: f64, side_m: f64) -> Led {
    Led { position: Vec3::new(x, y, 3.0), side_m, points_per_side: 1, half_power_semi_angle: 60.0_f64.to_radians() }
}

/// One branch up and six tilted by 45 degrees, each with a field of view of 35 degrees.
pub fn angle_diversity() -> Vec<Branch> {
    let fov_semi_angle = 35.0_f64.to_radians();
    let tilted = (0..6).map(|index| {
        let azimuth = f64::from(index) * 60.0_f64.to_radians();
        let tilt = 45.0_f64.to_radians();
        Vec3::new(tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos())
    });
    std::iter::once(Vec3::z()).chain(tilted).map(|normal| Branch { normal, fov_semi_angle }).collect()
}

/// A small generator (SplitMix64), so that test rooms are the same everywhere.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    pub fn uniform(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A standard normal number (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(0.0, 1.0)).ln()).sqrt();
        radius * self.uniform(0.0, std::f64::consts::TAU).cos()
    }

    /// A position on the receiver plane, uniform over the floor.
    pub fn position(&mut self) -> Vec3 {
        Vec3::new(self.uniform(-2.5, 2.5), self.uniform(-2.5, 2.5), RECEIVER_HEIGHT_M)
    }

    /// A position on the receiver plane by the stationary distribution of a random waypoint walk,
    /// eq. (4): each coordinate is the median of three uniform ones.
    pub fn walker(&mut self) -> Vec3 {
        let mut coordinate = || {
            let mut draws = [self.uniform(-2.5, 2.5), self.uniform(-2.5, 2.5), self.uniform(-2.5, 2.5)];
            draws.sort_by(f64::total_cmp);
            draws[1]
        };
        Vec3::new(coordinate(), coordinate(), RECEIVER_HEIGHT_M)
    }

    /// An orientation that tilts the device by up to 70 degrees in any direction.
    pub fn orientation(&mut self) -> Orientation {
        Orientation::from_polar_azimuth(self.uniform(0.0, 1.2), self.uniform(-PI, PI))
    }

    pub fn positions(&mut self, count: usize) -> Vec<Vec3> {
        (0..count).map(|_| self.position()).collect()
    }

    /// The obstacles and bodies of a room: two cylinders of 0.25 m, and a body 0.3 m behind each
    /// device.
    pub fn blockers(&mut self, users: &[Vec3]) -> Vec<Cylinder> {
        let mut blockers: Vec<Cylinder> = (0..2)
            .map(|_| Cylinder {
                x_m: self.uniform(-2.5, 2.5),
                y_m: self.uniform(-2.5, 2.5),
                radius_m: 0.25,
                height_m: 1.75,
            })
            .collect();
        for user in users {
            let heading = self.uniform(0.0, std::f64::consts::TAU);
            blockers.push(Cylinder {
                x_m: user.x - 0.3 * heading.cos(),
                y_m: user.y - 0.3 * heading.sin(),
                radius_m: 0.2,
                height_m: 1.75,
            });
        }
        blockers
    }
}
