//! How users hold their receivers: as reported, or else as users usually do.
//!
//! A walking user tilts a device towards the face, whose direction is opposite to the heading.
//! Without an assumption, for an unknown heading, and for a user who does not walk, an unreported
//! receiver faces up.

use heliostat_channel::{Orientation, Vec3};
use heliostat_proto::OrientationReport;
use heliostat_scenario::AssumedTilt;

/// The assumption about unreported receivers; `None`: they face up.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Posture {
    assumed: Option<AssumedTilt>,
}

impl Posture {
    /// The assumption of a scenario.
    pub fn new(assumed: Option<AssumedTilt>) -> Self {
        Self { assumed }
    }

    /// Whether every receiver without a report faces up.
    pub fn is_upright(&self) -> bool {
        self.assumed.is_none()
    }

    /// The orientation of a user's receiver: the reported one, if there is one, or else that of a
    /// user with this heading (a unit vector, or zero while unknown) and speed in m/s.
    pub fn of(&self, report: Option<&OrientationReport>, user: u32, (heading, speed): (&Vec3, f64)) -> Orientation {
        let entry = report.and_then(|report| report.users.iter().find(|entry| entry.user == user));
        let reported = entry.and_then(|entry| Orientation::from_quaternion(entry.quaternion.map(f64::from)).ok());
        reported.unwrap_or_else(|| self.usual(heading, speed))
    }

    fn usual(&self, heading: &Vec3, speed: f64) -> Orientation {
        match self.assumed {
            Some(tilt) if speed >= tilt.walking_from_m_s && *heading != Vec3::zeros() => {
                Orientation::from_polar_azimuth(tilt.walking_deg.to_radians(), (-heading.y).atan2(-heading.x))
            }
            _ => Orientation::UPRIGHT,
        }
    }
}

#[cfg(test)]
mod tests {
    use heliostat_proto::{Stamp, UserOrientation};

    use super::*;

    const TILT: AssumedTilt = AssumedTilt { walking_deg: 30.0, walking_from_m_s: 0.1 };

    #[test]
    fn the_device_of_a_walking_user_is_tilted_towards_the_face() {
        let posture = Posture::new(Some(TILT));
        let walking = posture.of(None, 7, (&Vec3::x(), 1.0)).normal();
        assert!((walking - Vec3::new(-0.5, 0.0, 0.75_f64.sqrt())).norm() < 1e-12, "{walking:?}");
        assert_eq!(posture.of(None, 7, (&Vec3::y(), 0.05)), Orientation::UPRIGHT, "a user who stands");
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
}
