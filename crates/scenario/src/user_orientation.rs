//! How users hold their receivers: the table `users.orientation`, and `orientation` of an entry of a mixture.

use serde::{Deserialize, Serialize};

/// The model of the users' orientations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OrientationModel {
    /// Every receiver faces up, as without the table.
    Up,
    /// Random angles with the distributions and coherence times of measured devices.
    Measured,
}

/// Distributions of the angles at which users hold their receivers.
///
/// The polar angle is that between the receiver's normal and the vertical. The azimuth of the
/// normal is relative to the direction towards the user's face. Both are Laplace distributed for a
/// user who sits or stands, and normally distributed for one who walks. The coherence time is that
/// at which the autocorrelation is [`Self::AT_COHERENCE_TIME`].
///
/// Source of the defaults: Soltani, Purwita, Zeng, Haas and Safari, IEEE Trans. Commun. 67(3),
/// 2019, with the measured values of 40 participants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UserOrientation {
    /// Whether the angles are drawn.
    pub model: OrientationModel,
    /// Mean polar angle of a user who sits or stands, in degrees.
    pub sitting_polar_mean_deg: f64,
    /// Standard deviation of that polar angle in degrees.
    pub sitting_polar_std_deg: f64,
    /// Standard deviation of the azimuth of a user who sits or stands, in degrees.
    pub sitting_azimuth_std_deg: f64,
    /// Coherence time of the angles of a user who sits or stands, in s.
    pub sitting_coherence_s: f64,
    /// Mean polar angle of a user who walks, in degrees.
    pub walking_polar_mean_deg: f64,
    /// Standard deviation of that polar angle in degrees.
    pub walking_polar_std_deg: f64,
    /// Standard deviation of the azimuth of a user who walks, in degrees.
    pub walking_azimuth_std_deg: f64,
    /// Coherence time of the angles of a user who walks, in s.
    pub walking_coherence_s: f64,
    /// Speed in m/s from which a user walks.
    pub walking_from_m_s: f64,
}

impl UserOrientation {
    /// Coherence time of the angles in s, of a user who sits or stands and of one who walks, as in the defaults.
    pub const COHERENCE_S: [f64; 2] = [0.373, 0.134];
    /// Autocorrelation of the angles at the coherence time.
    pub const AT_COHERENCE_TIME: f64 = 0.05;
}

impl Default for UserOrientation {
    fn default() -> Self {
        let [sitting_coherence_s, walking_coherence_s] = Self::COHERENCE_S;
        Self {
            model: OrientationModel::Measured,
            sitting_polar_mean_deg: 41.39,
            sitting_polar_std_deg: 7.68,
            sitting_azimuth_std_deg: 3.67,
            sitting_coherence_s,
            walking_polar_mean_deg: 29.67,
            walking_polar_std_deg: 7.78,
            walking_azimuth_std_deg: 10.0,
            walking_coherence_s,
            walking_from_m_s: 0.1,
        }
    }
}
