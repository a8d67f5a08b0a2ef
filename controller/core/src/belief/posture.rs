//! How users hold their receivers: as reported, or else as users usually do.
//!
//! A user tilts a device towards the face, whose direction is opposite to the heading. The angle is
//! that of a user who walks, or who sits or stands. A scenario can state that users do so. If it
//! does not, measured direct gains decide between this and upright receivers, for all users
//! together. The receiver of a user with an unknown heading faces up.

use heliostat_channel::{Orientation, Vec3};
use heliostat_proto::OrientationReport;
use heliostat_scenario::AssumedTilt;
use serde::{Deserialize, Serialize};

use crate::belief::device::Lean;

/// Logarithm of the prior odds that users tilt their receivers.
const PRIOR: f64 = -3.0;

/// Bound of the evidence of one user: a detector tilted in its device always misleads.
const LARGEST: f64 = 4.0;

/// Bound of the change by one measurement: the angles of a device persist from one to the next.
const LARGEST_CHANGE: f64 = 1.0;

/// A receiver with a larger correlation with the reported one is as reported.
const KNOWN: f64 = 0.95;

/// What the measurements of one user say about tilted receivers: the logarithm of a likelihood
/// ratio.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct TiltEvidence(f64);

impl TiltEvidence {
    /// Takes the logarithm of the likelihood ratio of a tilted receiver to an upright one.
    pub fn handle_log_ratio(&mut self, log_ratio: f64) {
        let change = log_ratio.clamp(-LARGEST_CHANGE, LARGEST_CHANGE);
        self.0 = (self.0 + change).clamp(-LARGEST, LARGEST);
    }

    /// The logarithm of the ratio.
    pub fn log_ratio(self) -> f64 {
        self.0
    }

    /// Whether measurements can give this value, which is read from a recording.
    pub fn is_sound(self) -> bool {
        self.0.abs() <= LARGEST
    }
}

/// How receivers without a report are held.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Posture {
    stated: Option<AssumedTilt>,
    /// Whether measurements show that users tilt their receivers.
    is_shown: bool,
}

/// What is known of the orientation of a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Held {
    /// As a report has shown.
    Reported(Lean),
    /// With this polar angle in rad, towards the face of a user of any heading.
    TowardsFace(f64),
    /// Upright; if users tilted their receivers, the polar angle in rad would be this.
    Upright(f64),
}

impl Posture {
    /// The statement of a scenario, if it has one.
    pub fn new(stated: Option<AssumedTilt>) -> Self {
        Self { stated, is_shown: false }
    }

    /// Decides by the evidence of all users.
    pub fn decide(&mut self, evidence: impl Iterator<Item = TiltEvidence>) {
        self.is_shown = PRIOR + evidence.map(TiltEvidence::log_ratio).sum::<f64>() > 0.0;
    }

    /// Whether every receiver without a report faces up.
    pub fn is_upright(&self) -> bool {
        self.stated.is_none() && !self.is_shown
    }

    /// The polar angle in rad of a tilted receiver that measurements can show: where the scenario
    /// states nothing.
    pub fn undecided(&self, held: Held) -> Option<f64> {
        match held {
            Held::Upright(polar_rad) | Held::TowardsFace(polar_rad) if self.stated.is_none() => Some(polar_rad),
            _ => None,
        }
    }

    /// What is known of a user's receiver: what reports have shown, or else how a user with this
    /// speed in m/s holds it.
    pub fn held(&self, reported: Option<Lean>, speed: f64) -> Held {
        if let Some(lean) = reported {
            return Held::Reported(lean);
        }
        let tilt = self.stated.unwrap_or_default();
        let is_walking = speed >= tilt.walking_from_m_s;
        let polar_rad = if is_walking { tilt.walking_deg } else { tilt.sitting_deg }.to_radians();
        if self.is_upright() { Held::Upright(polar_rad) } else { Held::TowardsFace(polar_rad) }
    }

    /// The orientation of a user's receiver: the reported one, if there is one, or else that of a
    /// user with this heading (a unit vector, or zero while unknown) and speed in m/s.
    pub fn of(&self, report: Option<&OrientationReport>, user: u32, (heading, speed): (&Vec3, f64)) -> Orientation {
        reported(report, user).unwrap_or_else(|| self.held(None, speed).facing(heading))
    }
}

/// The orientation of a user's receiver in a report.
pub(crate) fn reported(report: Option<&OrientationReport>, user: u32) -> Option<Orientation> {
    let entry = report?.users.iter().find(|entry| entry.user == user)?;
    Orientation::from_quaternion(entry.quaternion.map(f64::from)).ok()
}

impl Held {
    /// How a receiver leans that depends on the heading of its user.
    pub fn lean(self) -> Option<Lean> {
        match self {
            Self::TowardsFace(polar_rad) => Some(Lean { polar_rad, reported: [0.0; 2], correlation: 0.0 }),
            Self::Reported(lean) if lean.correlation < KNOWN => Some(lean),
            Self::Reported(_) | Self::Upright(_) => None,
        }
    }

    /// The orientation for a heading: a unit vector, or zero while unknown.
    pub fn facing(self, heading: &Vec3) -> Orientation {
        match self {
            Self::Reported(lean) => of_normal(&lean.normal(heading)),
            Self::TowardsFace(polar_rad) if *heading != Vec3::zeros() => {
                Orientation::from_polar_azimuth(polar_rad, (-heading.y).atan2(-heading.x))
            }
            Self::TowardsFace(_) | Self::Upright(_) => Orientation::UPRIGHT,
        }
    }
}

/// The smallest rotation that gives a device this normal.
fn of_normal(normal: &Vec3) -> Orientation {
    Orientation::from_polar_azimuth(normal.z.clamp(-1.0, 1.0).acos(), normal.y.atan2(normal.x))
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Stamp, UserOrientation};

    use super::*;

    const TILT: AssumedTilt = AssumedTilt { walking_deg: 30.0, sitting_deg: 60.0, walking_from_m_s: 0.1 };

    #[test]
    fn the_device_of_a_user_is_tilted_towards_the_face() {
        let posture = Posture::new(Some(TILT));
        let walking = posture.of(None, 7, (&Vec3::x(), 1.0)).normal();
        assert!((walking - Vec3::new(-0.5, 0.0, 0.75_f64.sqrt())).norm() < 1e-12, "{walking:?}");
        let sitting = posture.of(None, 7, (&Vec3::y(), 0.05)).normal();
        assert!((sitting - Vec3::new(0.0, -0.75_f64.sqrt(), 0.5)).norm() < 1e-12, "{sitting:?}");
    }

    #[test]
    fn an_unknown_heading_or_no_assumption_leaves_the_receiver_upright_and_a_report_has_priority() {
        let posture = Posture::new(Some(TILT));
        assert_eq!(posture.of(None, 7, (&Vec3::zeros(), 1.0)), Orientation::UPRIGHT);
        assert_eq!(Posture::default().of(None, 7, (&Vec3::x(), 1.0)), Orientation::UPRIGHT);
        let users = vec![UserOrientation { user: 7, quaternion: [1.0, 0.0, 0.0, 0.0] }];
        let report = OrientationReport { stamp: Stamp::default(), users };
        assert_eq!(posture.of(Some(&report), 7, (&Vec3::x(), 1.0)), Orientation::UPRIGHT);
        assert_ne!(posture.of(Some(&report), 8, (&Vec3::x(), 1.0)), Orientation::UPRIGHT);
    }

    /// The evidence of a user after so many measurements of this ratio.
    fn evidence(measurements: usize, log_ratio: f64) -> TiltEvidence {
        let mut evidence = TiltEvidence::default();
        (0..measurements).for_each(|_| evidence.handle_log_ratio(log_ratio));
        evidence
    }

    #[test]
    fn several_measurements_of_one_user_show_tilted_receivers_and_other_users_refute_them() {
        let mut posture = Posture::default();
        posture.decide([evidence(2, 50.0)].into_iter());
        assert!(posture.is_upright(), "one measurement counts little, however clear it is");
        posture.decide([evidence(9, 50.0)].into_iter());
        assert!(!posture.is_upright());
        posture.decide([evidence(1000, 1.0), evidence(9, -0.4)].into_iter());
        assert!(posture.is_upright());
    }

    #[test]
    fn a_recorded_ratio_beyond_its_bounds_is_no_evidence() {
        assert!([f64::NAN, 5.0].iter().all(|log_ratio| !TiltEvidence(*log_ratio).is_sound()));
        assert!(evidence(99, 1.0).is_sound());
    }
}
