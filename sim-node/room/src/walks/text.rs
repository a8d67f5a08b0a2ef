//! The CSV text that [`crate::world::trace`] plays.

use std::fmt::Write;

use crate::walks::tracks::{Track, TrackPoint};
use crate::world::walker::Floor;

/// Resolution of positions in m, and of times in s.
const STEP: f64 = 1e-4;
/// Least time in s between two positions of a user that the text keeps apart, whatever their rounding.
pub const APART_S: f64 = 2.0 * STEP;
/// Resolution of headings in degrees.
const HEADING_STEP_DEG: f64 = 1e-2;

/// Writes the users' tracks as a recorded walk, user 0 first in the order of `users`.
///
/// Positions and times have a resolution of 1e-4 m and 1e-4 s, headings of 0.01 degrees. A position
/// outside the floor is moved to its edge. The column `heading_deg` is written where every point
/// has a heading.
pub fn trace_text(users: &[Track], floor: &Floor) -> String {
    let points = users.iter().enumerate().flat_map(|(user, track)| track.points.iter().map(move |point| (user, point)));
    let mut rows: Vec<(usize, &TrackPoint)> = points.collect();
    rows.sort_by(|a, b| a.1.time_s.total_cmp(&b.1.time_s));
    let has_headings = rows.iter().all(|(_, point)| point.heading_rad.is_some());
    let mut text = String::from(if has_headings { "time,user,x,y,heading_deg\n" } else { "time,user,x,y\n" });
    for (user, point) in rows {
        let half = [0.5 * floor.length_x_m, 0.5 * floor.length_y_m];
        let [x, y] = [0, 1].map(|axis| rounded(point.at_m[axis], STEP).clamp(-half[axis], half[axis]));
        let time = rounded(point.time_s, STEP);
        write!(text, "{time},{user},{x},{y}").expect("a text grows");
        if let Some(heading) = point.heading_rad.filter(|_| has_headings) {
            write!(text, ",{}", rounded(heading.to_degrees().rem_euclid(360.0), HEADING_STEP_DEG))
                .expect("a text grows");
        }
        text.push('\n');
    }
    text
}

/// A value rounded to a multiple of a decimal step, with the shortest decimal form.
fn rounded(value: f64, step: f64) -> f64 {
    let per_unit = (1.0 / step).round();
    // Adding zero removes the sign of a negative zero.
    (value * per_unit).round() / per_unit + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::trace::Trace;

    const FLOOR: Floor = Floor { length_x_m: 16.0 / 3.0, length_y_m: 3.0 };

    fn user(points: &[(f64, [f64; 2], Option<f64>)]) -> Track {
        let point = |(time_s, at_m, heading_rad): &(f64, [f64; 2], Option<f64>)| TrackPoint {
            time_s: *time_s,
            at_m: *at_m,
            heading_rad: *heading_rad,
        };
        Track { pedestrian: "a".to_owned(), points: points.iter().map(point).collect() }
    }

    #[test]
    fn the_text_is_a_recorded_walk_even_at_the_edge_of_the_floor() {
        let edge = 0.5 * FLOOR.length_x_m;
        let users = [
            user(&[(0.0, [edge, -0.00001], None), (1.0 / 3.0, [0.1 + 0.2, 1.6], None)]),
            user(&[(0.0, [1.0, 1.0], Some(0.0)), (2.0, [1.0, 1.0], None)]),
        ];
        let text = trace_text(&users, &FLOOR);
        assert!(Trace::parse(&text, 2, &FLOOR).is_ok(), "{text}");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!((lines[0], lines[3]), ("time,user,x,y", "0.3333,0,0.3,1.5"));
        assert_eq!(lines[2], "0,1,1,1");
    }

    #[test]
    fn headings_are_written_where_every_point_has_one() {
        let text = trace_text(&[user(&[(0.0, [0.0; 2], Some(-0.5)), (1.0, [1.0, 0.0], Some(7.0))])], &FLOOR);
        assert_eq!(text, "time,user,x,y,heading_deg\n0,0,0,0,331.35\n1,0,1,0,41.07\n");
        assert!(Trace::parse(&text, 1, &FLOOR).is_ok());
    }
}
