//! Moves and scales walks onto the floor of a room.

use thiserror::Error;

use crate::walks::figures::bounds;
use crate::walks::tracks::Track;
use crate::world::walker::Floor;

/// How walks are scaled to a floor; all but `None` also centre their bounding box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Fit {
    /// Centred; smaller where they do not fit.
    Shrink,
    /// Centred; as large as fits.
    Fill,
    /// Centred; as large as fits along x and along y, which changes shapes.
    Stretch,
    /// Positions are in the room frame, and stay as they are.
    None,
}

/// How walks were moved: room = factor (recorded - centre).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Factor on x and y.
    pub factor: [f64; 2],
    /// The recorded point at the middle of the room, in m.
    pub centre_m: [f64; 2],
}

/// Why walks cannot be placed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlacementError {
    /// The margin leaves no floor.
    #[error(
        "invalid margin {margin_m} m: expected 0 or more, and less than half of the floor, {length_x_m} m x {length_y_m} m"
    )]
    Margin {
        /// The margin in m.
        margin_m: f64,
        /// Extent of the floor along x in m.
        length_x_m: f64,
        /// Extent of the floor along y in m.
        length_y_m: f64,
    },
    /// Positions that are used as they are lie outside the room.
    #[error(
        "the positions reach from ({:.2}, {:.2}) to ({:.2}, {:.2}): expected points within {length_x_m} m x \
         {length_y_m} m, centred on the origin",
        min_m[0], min_m[1], max_m[0], max_m[1]
    )]
    Outside {
        /// Least x and y in m.
        min_m: [f64; 2],
        /// Largest x and y in m.
        max_m: [f64; 2],
        /// Extent of the floor along x in m.
        length_x_m: f64,
        /// Extent of the floor along y in m.
        length_y_m: f64,
    },
}

/// Places the users' tracks on a floor, with a margin to the walls.
///
/// # Errors
/// [`PlacementError`] for a margin without a floor, and for positions outside it that are used as
/// they are.
pub fn place(users: &mut [Track], floor: &Floor, fit: Fit, margin_m: f64) -> Result<Placement, PlacementError> {
    let (length_x_m, length_y_m) = (floor.length_x_m, floor.length_y_m);
    let free_m = [length_x_m, length_y_m].map(|length| length - 2.0 * margin_m);
    if !(margin_m >= 0.0 && free_m.iter().all(|length| *length > 0.0)) {
        return Err(PlacementError::Margin { margin_m, length_x_m, length_y_m });
    }
    let Some(area) = bounds(users) else { return Ok(Placement { factor: [1.0; 2], centre_m: [0.0; 2] }) };
    if fit == Fit::None {
        let [inside_min, inside_max] = [area.min_m, area.max_m].map(|[x, y]| floor.contains(x, y));
        return if inside_min && inside_max {
            Ok(Placement { factor: [1.0; 2], centre_m: [0.0; 2] })
        } else {
            Err(PlacementError::Outside { min_m: area.min_m, max_m: area.max_m, length_x_m, length_y_m })
        };
    }
    let largest = [0, 1].map(|axis| free_m[axis] / (area.max_m[axis] - area.min_m[axis]));
    let placement = Placement {
        factor: factors(largest, fit),
        centre_m: [0, 1].map(|axis| 0.5 * (area.min_m[axis] + area.max_m[axis])),
    };
    for point in users.iter_mut().flat_map(|user| &mut user.points) {
        point.at_m = [0, 1].map(|axis| placement.factor[axis] * (point.at_m[axis] - placement.centre_m[axis]));
        point.heading_rad = point.heading_rad.map(|heading| placement.turned(heading));
    }
    Ok(placement)
}

/// The factors on x and y, from the largest that fit; infinite ones are of a box without extent.
fn factors(largest: [f64; 2], fit: Fit) -> [f64; 2] {
    let finite = |factor: f64| if factor.is_finite() { factor } else { 1.0 };
    let both = finite(largest[0].min(largest[1]));
    match fit {
        Fit::Shrink => [both.min(1.0); 2],
        Fit::Fill => [both; 2],
        Fit::Stretch => largest.map(finite),
        Fit::None => [1.0; 2],
    }
}

impl Placement {
    /// A heading after the scaling, which turns it where the factors differ.
    fn turned(&self, heading_rad: f64) -> f64 {
        if self.factor[0] == self.factor[1] {
            return heading_rad;
        }
        (self.factor[1] * heading_rad.sin()).atan2(self.factor[0] * heading_rad.cos())
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_4;

    use super::*;
    use crate::walks::tracks::TrackPoint;

    const FLOOR: Floor = Floor { length_x_m: 5.0, length_y_m: 3.0 };

    fn walk(corners: &[[f64; 2]]) -> Vec<Track> {
        let point = |(time_s, at_m): (f64, &[f64; 2])| TrackPoint { time_s, at_m: *at_m, heading_rad: Some(FRAC_PI_4) };
        let times = [0.0, 1.0, 2.0, 3.0];
        vec![Track { pedestrian: "a".to_owned(), points: times.into_iter().zip(corners).map(point).collect() }]
    }

    fn placed(fit: Fit, corners: &[[f64; 2]]) -> (Vec<Track>, Placement) {
        let mut users = walk(corners);
        let placement = place(&mut users, &FLOOR, fit, 0.5).expect("it fits");
        (users, placement)
    }

    #[test]
    fn a_large_walk_is_centred_and_shrunk_within_the_margin_and_a_small_one_keeps_its_scale() {
        let (users, placement) = placed(Fit::Shrink, &[[10.0, 10.0], [18.0, 14.0]]);
        assert_eq!((placement.factor, placement.centre_m), ([0.5; 2], [14.0, 12.0]));
        assert_eq!(users[0].points[1].at_m, [2.0, 1.0]);
        let (users, placement) = placed(Fit::Shrink, &[[10.0, 10.0], [11.0, 10.0]]);
        assert_eq!((placement.factor, users[0].points[1].at_m), ([1.0; 2], [0.5, 0.0]));
        let (users, _) = placed(Fit::Fill, &[[10.0, 10.0], [11.0, 10.0]]);
        assert_eq!(users[0].points[1].at_m, [2.0, 0.0]);
    }

    #[test]
    fn stretching_fills_both_sides_and_turns_headings() {
        let (users, placement) = placed(Fit::Stretch, &[[0.0, 0.0], [4.0, 1.0]]);
        assert_eq!((placement.factor, users[0].points[1].at_m), ([1.0, 2.0], [2.0, 1.0]));
        assert!((users[0].points[1].heading_rad.expect("a heading") - 2.0_f64.atan()).abs() < 1e-12);
        let (users, _) = placed(Fit::Stretch, &[[7.0, 7.0], [7.0, 7.0]]);
        assert_eq!(users[0].points[1].at_m, [0.0, 0.0]);
    }

    #[test]
    fn positions_that_are_used_as_they_are_must_lie_in_the_room() {
        let (users, _) = placed(Fit::None, &[[-2.5, 1.5], [0.0, 0.0]]);
        assert_eq!(users[0].points[0].at_m, [-2.5, 1.5]);
        let outside = place(&mut walk(&[[0.0, 1.6], [0.0, 0.0]]), &FLOOR, Fit::None, 0.0).expect_err("outside");
        assert!(outside.to_string().contains("(0.00, 1.60): expected points within 5 m x 3 m"), "{outside}");
        for margin_m in [-0.1, 1.5, f64::NAN] {
            let refused = place(&mut walk(&[[0.0, 0.0]]), &FLOOR, Fit::Shrink, margin_m).expect_err("no floor");
            assert!(refused.to_string().starts_with("invalid margin"), "{refused}");
        }
    }
}
