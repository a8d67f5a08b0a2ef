//! The area without direct light behind a cylinder, at the height of the detectors.
//!
//! A cylinder between an LED and a horizontal plane blocks the convex hull of two discs: its own,
//! and the projection of its top from the LED onto the plane. The hull is clipped to the room.

use heliostat_channel::Vec3;
use heliostat_channel::blockage::Cylinder;

/// Corners of the polygon for a disc.
const CORNERS: usize = 16;
/// A top at or above the LED blocks an infinite area; the projection is limited to this multiple of
/// the LED's height.
const FARTHEST: f64 = 20.0;

/// Half the room's extents along x and y in m.
pub type HalfExtents = (f64, f64);

/// Corners of the blocked area in the plane `height_m` above the floor, counter-clockwise; empty if
/// there is none in the room.
pub fn blocked_area(cylinder: &Cylinder, led: &Vec3, height_m: f64, room: HalfExtents) -> Vec<[f64; 2]> {
    if cylinder.height_m <= height_m || led.z <= height_m {
        return Vec::new();
    }
    let below_led = (led.z - cylinder.height_m).max(led.z / FARTHEST);
    let magnification = (led.z - height_m) / below_led;
    let projected = |axis: f64, led: f64| led + (axis - led) * magnification;
    let top = (projected(cylinder.x_m, led.x), projected(cylinder.y_m, led.y));
    let mut points = disc((cylinder.x_m, cylinder.y_m), cylinder.radius_m);
    points.extend(disc(top, cylinder.radius_m * magnification));
    clip(hull(points), room)
}

fn disc((x, y): (f64, f64), radius: f64) -> Vec<[f64; 2]> {
    let corner = |index: usize| {
        let (sin, cos) = (std::f64::consts::TAU * index as f64 / CORNERS as f64).sin_cos();
        [x + radius * cos, y + radius * sin]
    };
    (0..CORNERS).map(corner).collect()
}

/// Convex hull by Andrew's monotone chain.
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut hull = chain(points.iter());
    hull.extend(chain(points.iter().rev()));
    hull
}

/// The chain with left turns only, without its last point.
fn chain<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Vec<[f64; 2]> {
    let mut chain: Vec<[f64; 2]> = Vec::new();
    for point in points {
        while let [.., a, b] = chain[..]
            && (b[0] - a[0]) * (point[1] - a[1]) <= (b[1] - a[1]) * (point[0] - a[0])
        {
            chain.pop();
        }
        chain.push(*point);
    }
    chain.pop();
    chain
}

/// The part of a convex polygon inside the room, by the Sutherland-Hodgman algorithm.
fn clip(mut polygon: Vec<[f64; 2]>, (half_x, half_y): HalfExtents) -> Vec<[f64; 2]> {
    for (axis, sign, limit) in [(0, 1.0, half_x), (0, -1.0, half_x), (1, 1.0, half_y), (1, -1.0, half_y)] {
        let beyond = |point: &[f64; 2]| sign * point[axis] - limit;
        let mut inside = Vec::with_capacity(polygon.len() + 1);
        for (index, from) in polygon.iter().enumerate() {
            let to = &polygon[(index + 1) % polygon.len()];
            let (a, b) = (beyond(from), beyond(to));
            if a <= 0.0 {
                inside.push(*from);
            }
            if (a < 0.0 && b > 0.0) || (a > 0.0 && b < 0.0) {
                let share = a / (a - b);
                inside.push([from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]);
            }
        }
        polygon = inside;
    }
    polygon
}

#[cfg(test)]
mod tests {
    use heliostat_channel::blockage::blocks;

    use super::*;

    const ROOM: HalfExtents = (2.5, 2.5);

    fn led() -> Vec3 {
        Vec3::new(0.2, -0.1, 3.0)
    }

    fn inside(polygon: &[[f64; 2]], x: f64, y: f64) -> bool {
        !polygon.is_empty()
            && (0..polygon.len()).all(|index| {
                let (a, b) = (polygon[index], polygon[(index + 1) % polygon.len()]);
                (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
            })
    }

    #[test]
    fn the_drawn_area_is_the_area_that_the_channel_model_blocks() {
        let cylinder = Cylinder::new(0.8, 0.6, 0.25, 1.75).expect("a cylinder");
        let polygon = blocked_area(&cylinder, &led(), 0.85, ROOM);
        let (mut blocked_points, mut differ, steps) = (0, 0, 50);
        for (ix, iy) in (0..steps).flat_map(|ix| (0..steps).map(move |iy| (ix, iy))) {
            let at = |index: i32| -2.5 + 5.0 * (f64::from(index) + 0.5) / f64::from(steps);
            let blocked = blocks(&cylinder, &led(), &Vec3::new(at(ix), at(iy), 0.85));
            blocked_points += usize::from(blocked);
            differ += usize::from(blocked != inside(&polygon, at(ix), at(iy)));
        }
        // The polygon for a disc has sixteen corners: only points at the rim may differ.
        assert!(blocked_points > 50 && differ * 20 <= blocked_points, "{differ} of {blocked_points} differ");
    }

    #[test]
    fn areas_end_at_the_walls_and_low_cylinders_block_none() {
        let tall = Cylinder::new(2.2, 0.0, 0.25, 3.5).expect("a cylinder");
        let polygon = blocked_area(&tall, &led(), 0.85, ROOM);
        assert!(polygon.len() >= 3);
        assert!(polygon.iter().flatten().all(|value| value.abs() <= 2.5 + 1e-9), "{polygon:?}");
        let low = Cylinder::new(1.0, 0.0, 0.25, 0.5).expect("a cylinder");
        assert!(blocked_area(&low, &led(), 0.85, ROOM).is_empty());
    }
}
