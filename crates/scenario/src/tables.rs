//! The tables of a scenario file that do not change while a room runs, with the unit in each key.
//!
//! Every table refuses unknown keys. A missing key has the value of the built-in `specular`
//! scenario.

use std::ops::RangeInclusive;

use heliostat_channel::Body;
pub use heliostat_channel::{Combining, NoiseBudget, PowerLaw, Wall};
use serde::{Deserialize, Serialize};

use crate::mobility::{GaussMarkov, MixtureShare, MobilityModel, RandomDirection, Seated, SmoothRandom, SocialForce};
use crate::user_orientation::{OrientationModel, UserOrientation};

/// Dimensions of the room; the origin is the centre of the floor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Room {
    /// Extent along x in m.
    pub length_x_m: f64,
    /// Extent along y in m.
    pub length_y_m: f64,
    /// Floor to ceiling in m.
    pub height_m: f64,
}

impl Default for Room {
    fn default() -> Self {
        Self { length_x_m: 5.0, length_y_m: 5.0, height_m: 3.0 }
    }
}

impl Room {
    /// The extent of the floor along x and y in m.
    pub fn floor_m(&self) -> [RangeInclusive<f64>; 2] {
        [self.length_x_m, self.length_y_m].map(|length_m| -length_m / 2.0..=length_m / 2.0)
    }
}

/// The model of the mirror gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ChannelMode {
    /// The law of reflection: for real hardware.
    Specular,
    /// Equations (2) and (3) as printed: for comparison with the paper.
    Paper,
    /// `paper` with an explicit, unphysical gain scale: lands on the paper's quoted rates.
    PaperCalibrated,
}

impl ChannelMode {
    /// The name in scenario files, actor metadata and file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Specular => "specular",
            Self::Paper => "paper",
            Self::PaperCalibrated => "paper-calibrated",
        }
    }
}

/// The channel mode and the interpretation of its equations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Channel {
    /// The model of the mirror gain.
    pub mode: ChannelMode,
    /// Whether the symbols of equations (2) and (3) are interpreted literally; no effect in
    /// `specular`.
    pub literal: bool,
    /// Factor on the mirror gain in `paper-calibrated`; must be 1 elsewhere.
    pub gain_scale: f64,
    /// P or P squared in equation (6).
    pub power_law: PowerLaw,
}

impl Default for Channel {
    fn default() -> Self {
        Self { mode: ChannelMode::Specular, literal: false, gain_scale: 1.0, power_law: PowerLaw::Linear }
    }
}

/// The LEDs on the ceiling.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Led {
    /// Optical power in W.
    pub power_w: f64,
    /// Half-power semi-angle in degrees; 60 degrees is Lambertian order 1.
    pub half_power_semi_angle_deg: f64,
    /// Side of the square panel in m; 0 is a point.
    pub side_m: f64,
    /// Number of points along each side over which the panel is averaged.
    pub points_per_side: usize,
    /// Position of each panel's centre in m.
    pub positions_m: Vec<[f64; 3]>,
}

impl Default for Led {
    fn default() -> Self {
        Self {
            power_w: 2.0,
            half_power_semi_angle_deg: 60.0,
            side_m: 0.1,
            points_per_side: 5,
            positions_m: vec![[0.0, 0.0, 3.0]],
        }
    }
}

/// The mirror array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Mirrors {
    /// Number of rows; row 0 is the lowest.
    pub rows: usize,
    /// Number of columns; column 0 is at the smallest x on the +y wall.
    pub columns: usize,
    /// Width of a mirror in m.
    pub width_m: f64,
    /// Height of a mirror in m.
    pub height_m: f64,
    /// Space between neighbouring mirrors in m.
    pub gap_m: f64,
    /// Height of the array's centre above the floor in m.
    pub centre_height_m: f64,
    /// The wall that carries the array.
    pub wall: Wall,
    /// Reflection coefficient, from 0 to 1.
    pub reflectivity: f64,
}

impl Default for Mirrors {
    fn default() -> Self {
        Self {
            rows: 10,
            columns: 10,
            width_m: 0.25,
            height_m: 0.10,
            gap_m: 0.02,
            centre_height_m: 2.0,
            wall: Wall::PlusY,
            reflectivity: 0.95,
        }
    }
}

/// One detector of an angle-diversity receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Branch {
    /// Angle between the branch and the vertical in degrees; 0 faces up.
    pub tilt_deg: f64,
    /// Direction of the tilt about the vertical in degrees, from +x towards +y.
    pub azimuth_deg: f64,
    /// Field of view, semi-angle in degrees.
    pub fov_deg: f64,
}

/// A predefined list of branches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReceiverPreset {
    /// One branch that faces up, with `receiver.fov_deg`.
    Single,
    /// One up and six tilted by 45 degrees, each with a field of view of 35 degrees.
    AngleDiversity,
}

/// The users' receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Receiver {
    /// Height of the detectors above the floor in m.
    pub height_m: f64,
    /// Physical area of one detector in mm2.
    pub area_mm2: f64,
    /// Responsivity R0 in A/W.
    pub responsivity_a_per_w: f64,
    /// Field of view of the `single` preset, semi-angle in degrees.
    pub fov_deg: f64,
    /// Gain of the optical filter.
    pub filter_gain: f64,
    /// Whether an optical concentrator multiplies the gain inside the field of view.
    pub concentrator: bool,
    /// Refractive index of the concentrator.
    pub concentrator_index: f64,
    /// The predefined branches, if `branches` is empty.
    pub preset: ReceiverPreset,
    /// The branches one by one; they replace the preset.
    pub branches: Vec<Branch>,
    /// How branches are combined.
    pub combining: Combining,
}

impl Default for Receiver {
    fn default() -> Self {
        Self {
            height_m: 0.85,
            area_mm2: 20.0,
            responsivity_a_per_w: 0.4,
            fov_deg: 90.0,
            filter_gain: 1.0,
            concentrator: false,
            concentrator_index: 1.5,
            preset: ReceiverPreset::Single,
            branches: Vec::new(),
            combining: Combining::Best,
        }
    }
}

/// The bandwidth that the users share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Link {
    /// Modulation bandwidth in MHz, divided equally among the users.
    pub bandwidth_mhz: f64,
}

impl Default for Link {
    fn default() -> Self {
        Self { bandwidth_mhz: 20.0 }
    }
}

/// A minimum rate for all users or one for each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum MinRate {
    /// The same for all users, in Mbit/s.
    All(f64),
    /// One per user, in Mbit/s.
    Each(Vec<f64>),
}

/// The users: number, speed, minimum rates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Users {
    /// Number of users, with arrivals that at the start.
    pub count: usize,
    /// How the users move.
    pub mobility: MobilityModel,
    /// Minimum speed in m/s; 0 only if the maximum is 0 too, so that all users stand still.
    pub speed_min_m_s: f64,
    /// Maximum speed in m/s.
    pub speed_max_m_s: f64,
    /// Mean duration in s (exponential) of a pause at each point of a walk, in which the user is
    /// turned to a direction drawn at random; 0: no pauses. For `random-waypoint`,
    /// `random-direction` and `social-force`.
    pub pause_mean_s: f64,
    /// Time constant in s with which the heading follows the model, first-order; 0: at once.
    pub heading_lag_s: f64,
    /// Parameters of `random-direction`.
    pub random_direction: RandomDirection,
    /// Parameters of `gauss-markov`.
    pub gauss_markov: GaussMarkov,
    /// Parameters of `smooth-random`.
    pub smooth_random: SmoothRandom,
    /// Parameters of `social-force`.
    pub social_force: SocialForce,
    /// Parameters of `seated`.
    pub seated: Seated,
    /// Places of seated users in m, in the order in which they are taken; empty: drawn at random.
    /// Obstacles near them are left out.
    pub seats_m: Vec<[f64; 2]>,
    /// The models of `mixture` and their shares.
    pub mixture: Vec<MixtureShare>,
    /// Minimum rate R_min in Mbit/s.
    pub min_rate_mbps: MinRate,
    /// A CSV file of recorded movement (`time,user,x,y[,heading_deg]`) that replaces the random
    /// walk. A relative path starts at the folder of the scenario file, in `--set` at the working
    /// directory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trace: Option<String>,
    /// Users who enter and leave the simulated room; absent: the users stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arrivals: Option<Arrivals>,
    /// How users hold their receivers; absent: every receiver faces up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<UserOrientation>,
}

impl Default for Users {
    fn default() -> Self {
        Self {
            count: 5,
            mobility: MobilityModel::RandomWaypoint,
            speed_min_m_s: 0.1,
            speed_max_m_s: 2.0,
            pause_mean_s: 0.0,
            heading_lag_s: 0.0,
            random_direction: RandomDirection::default(),
            gauss_markov: GaussMarkov::default(),
            smooth_random: SmoothRandom::default(),
            social_force: SocialForce::default(),
            seated: Seated::default(),
            seats_m: Vec::new(),
            mixture: Vec::new(),
            min_rate_mbps: MinRate::All(1.0),
            trace: None,
            arrivals: None,
            orientation: None,
        }
    }
}

impl Users {
    /// The largest number of users in the room: `count`, or with arrivals their `max_users`.
    pub fn largest(&self) -> usize {
        self.arrivals.as_ref().map_or(self.count, |arrivals| arrivals.max_users)
    }

    /// How each group of users holds its receivers: the key of the table, and the table; `None` where the
    /// receivers face up. A recorded walk has no entries of a mixture.
    pub fn orientations(&self) -> Vec<(String, Option<&UserOrientation>)> {
        let room = || ("users.orientation".to_owned(), self.orientation.as_ref());
        let mut found = Vec::new();
        if self.mobility == MobilityModel::Mixture && self.trace.is_none() {
            for (index, entry) in self.mixture.iter().enumerate().filter(|(_, entry)| entry.has_users()) {
                let own = entry.orientation.as_ref();
                found.push(own.map_or_else(room, |own| (format!("users.mixture.{index}.orientation"), Some(own))));
            }
        } else {
            found.push(room());
        }
        let is_measured = |held: &&UserOrientation| held.model == OrientationModel::Measured;
        found.into_iter().map(|(key, held)| (key, held.filter(is_measured))).collect()
    }
}

/// Users who enter and leave: a Poisson process of arrivals, and stays of exponential duration.
///
/// The users at the start leave too. An arrival at a full room does not enter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Arrivals {
    /// Mean number of arrivals a minute.
    pub rate_per_min: f64,
    /// Mean duration of a stay in s.
    pub mean_stay_s: f64,
    /// Largest number of users in the room.
    pub max_users: usize,
}

impl Default for Arrivals {
    fn default() -> Self {
        Self { rate_per_min: 5.0, mean_stay_s: 60.0, max_users: 10 }
    }
}

/// Obstacles and users' bodies that block light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Blockage {
    /// Number of users whose line-of-sight path is blocked regardless of obstacles.
    pub forced_users: usize,
    /// Whether the users' own bodies block light.
    pub bodies: bool,
    /// Radius of a body in m.
    pub body_radius_m: f64,
    /// Height of a body in m.
    pub body_height_m: f64,
    /// Distance of the body's axis behind the device in m.
    pub body_offset_m: f64,
    /// Mean number of obstacles per square metre (Matern hard-core process, after thinning); 0 is
    /// none.
    pub obstacles_per_m2: f64,
    /// Minimum distance between the axes of two obstacles in m.
    pub obstacle_min_distance_m: f64,
    /// Radius of an obstacle in m.
    pub obstacle_radius_m: f64,
    /// Height of an obstacle in m.
    pub obstacle_height_m: f64,
}

impl Blockage {
    /// The body of a user; `None` where bodies block no light.
    pub fn body(&self) -> Option<Body> {
        let Self { body_radius_m: radius_m, body_height_m: height_m, body_offset_m: offset_m, .. } = *self;
        self.bodies.then_some(Body { radius_m, height_m, offset_m })
    }
}

impl Default for Blockage {
    fn default() -> Self {
        Self {
            forced_users: 0,
            bodies: true,
            body_radius_m: 0.2,
            body_height_m: 1.75,
            body_offset_m: 0.3,
            obstacles_per_m2: 0.08,
            obstacle_min_distance_m: 1.0,
            obstacle_radius_m: 0.25,
            obstacle_height_m: 1.75,
        }
    }
}
