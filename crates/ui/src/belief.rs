//! Where the controller believes a user to be, as drawn.

use heliostat_channel::floor_normal::{principal_axes, squared_radius};
use heliostat_proto::{BeliefReport, Nanos, UserBelief};
use serde::Serialize;

/// Probability that the ellipse holds the position, if it is normally distributed.
const PROBABILITY: f64 = 0.95;

/// A belief is moved at its velocity to the time of the drawn users, by this time at most, in s.
const MOVED_MAX_S: f64 = 0.5;

/// The ellipse that holds a user's position by the controller's belief, and the heading.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Belief {
    /// Centre: x and y in m.
    pub at_m: [f64; 2],
    /// Semi-axes in m, the longer one first.
    pub semi_axes_m: [f64; 2],
    /// Angle between the x axis and the first semi-axis in rad.
    pub angle_rad: f64,
    /// Mean heading vector along x and y: its direction is the heading, its length the certainty.
    pub heading: [f64; 2],
}

impl Belief {
    /// The belief of a report about a user, at the time of the drawn users.
    pub(crate) fn of(report: &BeliefReport, user: u32, drawn_ns: Nanos) -> Option<Self> {
        let belief = report.users.iter().find(|belief| belief.user == user)?;
        let moved_s = (drawn_ns as i128 - report.holds_ns as i128) as f64 * 1e-9;
        Some(Self::at(belief, moved_s.clamp(-MOVED_MAX_S, MOVED_MAX_S)))
    }

    fn at(belief: &UserBelief, moved_s: f64) -> Self {
        let (deviations_m, angle_rad) = principal_axes([belief.xx_m2, belief.xy_m2, belief.yy_m2].map(f64::from));
        let radius = squared_radius(PROBABILITY).sqrt();
        let certainty = f64::from(belief.heading_certainty);
        let (sin, cos) = f64::from(belief.heading_rad).sin_cos();
        let at_m = [0, 1].map(|axis| {
            millimetres(f64::from(belief.position_m[axis]) + moved_s * f64::from(belief.velocity_m_s[axis]))
        });
        Self {
            at_m,
            semi_axes_m: deviations_m.map(|deviation| millimetres(radius * deviation)),
            angle_rad: millimetres(angle_rad),
            heading: [certainty * cos, certainty * sin].map(millimetres),
        }
    }
}

/// Rounds to thousandths.
fn millimetres(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ellipse_has_the_axes_of_the_covariance() {
        // Standard deviations 0.2 m along 30 degrees and 0.1 m across.
        let (sin, cos) = 30f64.to_radians().sin_cos();
        let (along, across) = (0.04, 0.01);
        let user = UserBelief {
            user: 4,
            position_m: [1.0, 2.0, 0.9],
            velocity_m_s: [0.5, 0.0],
            xx_m2: (along * cos * cos + across * sin * sin) as f32,
            xy_m2: ((along - across) * sin * cos) as f32,
            yy_m2: (along * sin * sin + across * cos * cos) as f32,
            heading_rad: std::f32::consts::FRAC_PI_2,
            heading_certainty: 0.5,
            ..UserBelief::default()
        };
        let report = BeliefReport { holds_ns: 1_000_000_000, users: vec![user], ..BeliefReport::default() };
        let belief = Belief::of(&report, 4, 900_000_000).expect("a user of the report");
        // The square root of the 95 % quantile 5.991.
        assert_eq!(belief.semi_axes_m, [0.49, 0.245]);
        assert_eq!((belief.at_m, belief.angle_rad, belief.heading), ([0.95, 2.0], 0.524, [0.0, 0.5]));
        assert_eq!(Belief::of(&report, 5, 900_000_000), None);
        assert_eq!(Belief::of(&report, 4, 0).map(|belief| belief.at_m), Some([0.75, 2.0]), "moved by 0.5 s at most");
    }
}
