//! How the users of a simulated room move: the models of `users.mobility`, and their tables.
//!
//! The table of a model has no effect while no user has that model.

use serde::{Deserialize, Serialize};

use crate::user_orientation::UserOrientation;

/// Above this speed in m/s a motion shows the direction in which a user faces; half of the slowest walk.
pub const WALKING_M_S: f64 = 0.05;

/// A mobility model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MobilityModel {
    /// Straight to a point drawn at random, then to the next one.
    RandomWaypoint,
    /// In a direction drawn at random for a time drawn at random, with reflection at walls.
    RandomDirection,
    /// Speed and direction with memory, with reflection at walls.
    GaussMarkov,
    /// Speed changes with bounded acceleration, direction changes with bounded turn rate.
    SmoothRandom,
    /// To goals drawn at random, with repulsion by users, walls and obstacles.
    SocialForce,
    /// At fixed places, with turns.
    Seated,
    /// Each user has one of the models in `users.mixture`.
    Mixture,
}

/// The users that have one model: their number, or their share of those without a numbered entry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MixtureShare {
    /// The model; not `mixture`.
    pub mobility: MobilityModel,
    /// Share of the users without a numbered entry, from 0 to 1; all shares add up to 1.
    #[serde(default)]
    pub share: f64,
    /// Number of the users with this model, in place of a share. The first users are those of the first
    /// entry with a number, and so on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub count: Option<usize>,
    /// How these users hold their receivers, in place of `users.orientation`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub orientation: Option<UserOrientation>,
}

impl MixtureShare {
    /// The index of the entry of a user in a mixture, where `place` in [0, 1) is that of the user on the scale
    /// of the shares; `None` in an empty mixture.
    pub fn index_of(mixture: &[Self], user: usize, place: f64) -> Option<usize> {
        let numbered = mixture.iter().enumerate().filter_map(|(index, entry)| Some((index, entry.count?)));
        let mut before = 0;
        for (index, count) in numbered {
            before += count;
            if user < before {
                return Some(index);
            }
        }
        let mut sum = 0.0;
        let index = mixture.iter().position(|entry| {
            sum += entry.share;
            place < sum
        });
        // Rounding can leave the sum of all shares below the place.
        index.or_else(|| mixture.iter().rposition(|entry| entry.share > 0.0))
    }

    /// Whether a user can have the entry.
    pub(crate) fn has_users(&self) -> bool {
        self.count.map_or(self.share > 0.0, |count| count > 0)
    }
}

/// Parameters of `random-direction`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RandomDirection {
    /// Mean duration in s (exponential) of a walk in one direction.
    pub travel_time_mean_s: f64,
}

impl Default for RandomDirection {
    fn default() -> Self {
        Self { travel_time_mean_s: 5.0 }
    }
}

/// Parameters of `gauss-markov`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GaussMarkov {
    /// Correlation of speed and of direction over one interval, from 0 to below 1.
    pub memory: f64,
    /// Time between two changes in s.
    pub interval_s: f64,
    /// Standard deviation of the direction about the mean direction of a user in degrees.
    pub direction_std_deg: f64,
}

impl Default for GaussMarkov {
    fn default() -> Self {
        Self { memory: 0.75, interval_s: 1.0, direction_std_deg: 57.3 }
    }
}

/// Parameters of `smooth-random`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SmoothRandom {
    /// Largest acceleration in m/s2.
    pub acceleration_m_s2: f64,
    /// Largest deceleration in m/s2.
    pub deceleration_m_s2: f64,
    /// Largest turn rate in degrees/s.
    pub turn_rate_deg_per_s: f64,
    /// Mean time in s (exponential) between two target speeds.
    pub speed_change_mean_s: f64,
    /// Mean time in s (exponential) between two target directions.
    pub direction_change_mean_s: f64,
}

impl Default for SmoothRandom {
    fn default() -> Self {
        Self {
            acceleration_m_s2: 1.0,
            deceleration_m_s2: 1.5,
            turn_rate_deg_per_s: 90.0,
            speed_change_mean_s: 4.0,
            direction_change_mean_s: 4.0,
        }
    }
}

/// Parameters of `social-force`; the defaults are those of the paper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SocialForce {
    /// Mean of the users' desired speeds in m/s, which stay within `users.speed_min_m_s` and
    /// `users.speed_max_m_s`.
    pub desired_speed_m_s: f64,
    /// Standard deviation of the desired speeds in m/s.
    pub desired_speed_std_m_s: f64,
    /// Relaxation time of the velocity in s.
    pub relaxation_s: f64,
    /// Strength of the repulsion by another user in m2/s2.
    pub user_repulsion_m2_s2: f64,
    /// Range of the repulsion by another user in m.
    pub user_range_m: f64,
    /// Time in s by which a user anticipates the steps of another user.
    pub anticipation_s: f64,
    /// Strength of the repulsion by walls and obstacles in m2/s2.
    pub wall_repulsion_m2_s2: f64,
    /// Range of the repulsion by walls and obstacles in m.
    pub wall_range_m: f64,
    /// Angle of sight in degrees, both sides together.
    pub sight_deg: f64,
    /// Weight of the repulsion by users out of sight, from 0 to 1.
    pub out_of_sight_weight: f64,
}

impl Default for SocialForce {
    fn default() -> Self {
        Self {
            desired_speed_m_s: 1.34,
            desired_speed_std_m_s: 0.26,
            relaxation_s: 0.5,
            user_repulsion_m2_s2: 2.1,
            user_range_m: 0.3,
            anticipation_s: 2.0,
            wall_repulsion_m2_s2: 10.0,
            wall_range_m: 0.2,
            sight_deg: 200.0,
            out_of_sight_weight: 0.5,
        }
    }
}

/// Parameters of `seated`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Seated {
    /// Mean time in s (exponential) between two turns.
    pub turn_mean_s: f64,
    /// Smallest distance between two places drawn at random in m, where the room permits it.
    pub spacing_m: f64,
}

impl Default for Seated {
    fn default() -> Self {
        Self { turn_mean_s: 30.0, spacing_m: 1.0 }
    }
}
