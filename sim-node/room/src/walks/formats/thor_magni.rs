//! The columns of THÖR-MAGNI: bodies with a centroid or with markers.
//!
//! A body whose name begins with `Helmet_` is a pedestrian; robots and carried objects are not
//! read. A body has the columns `NAME Centroid_X` and `NAME Centroid_Y`, and for each marker
//! `NAME - 1 X` and so on. An empty cell, `NaN`, and zeros in all coordinates mean that the point was
//! not tracked in this frame. The rotation matrices (`R0` to `R8`) are not read: the axes of a helmet are not
//! documented with the columns.

use std::collections::BTreeMap;

use crate::walks::rows::{Receive, Row, RowRefusal, number, refusal};

/// Places of the columns x and y of one centroid or marker.
type Point = [usize; 2];

/// Where a pedestrian's position stands.
struct Body {
    name: String,
    /// The centroid, or all markers.
    points: Vec<Point>,
}

/// All pedestrians of a file.
pub(super) struct Bodies {
    time: usize,
    columns: usize,
    bodies: Vec<Body>,
}

impl Bodies {
    /// The pedestrians whom the row of column names lists; `None` without any.
    pub(super) fn of(names: &[&str]) -> Option<Self> {
        let places: BTreeMap<&str, usize> = names.iter().enumerate().map(|(index, name)| (*name, index)).collect();
        let time = *places.get("Time")?;
        let mut found: BTreeMap<&str, (Vec<Point>, Vec<Point>)> = BTreeMap::new();
        for (name, x) in places.iter().filter(|(name, _)| name.starts_with("Helmet_")) {
            // "Helmet_1 Centroid_X" or "Helmet_1 - 2 X".
            let (Some(part), Some((body, rest))) = (name.strip_suffix('X'), name.split_once(' ')) else { continue };
            let Some(y) = places.get(format!("{part}Y").as_str()) else { continue };
            let (centroids, markers) = found.entry(body).or_default();
            match rest {
                "Centroid_X" => centroids.push([*x, *y]),
                marker if marker.starts_with("- ") => markers.push([*x, *y]),
                _ => {}
            }
        }
        let body = |(name, (centroids, markers)): (&str, (Vec<Point>, Vec<Point>))| {
            let points = if centroids.is_empty() { markers } else { centroids };
            (!points.is_empty()).then(|| Body { name: name.to_owned(), points })
        };
        let bodies: Vec<Body> = found.into_iter().filter_map(body).collect();
        (!bodies.is_empty()).then_some(Self { time, columns: names.len(), bodies })
    }

    /// Passes on the position of each pedestrian in a frame.
    pub(super) fn rows(&self, line: u64, cells: &[&str], receive: Receive<'_>) {
        let (found, expected) = (cells.len(), self.columns);
        if found != expected {
            return receive(Err(refusal(line, format!("number of columns {found}: expected {expected}, as named"))));
        }
        let time_s = match number(line, "Time", cells[self.time]) {
            Ok(time_s) => time_s,
            Err(refusal) => return receive(Err(refusal)),
        };
        for body in &self.bodies {
            let row = |at_m| Row { line, time_s, pedestrian: body.name.clone(), at_m, heading_rad: None };
            if let Some(position) = body.position_m(line, cells).transpose() {
                receive(position.map(row));
            }
        }
    }
}

impl Body {
    /// The mean of the tracked points; `None` where none is tracked.
    fn position_m(&self, line: u64, cells: &[&str]) -> Result<Option<[f64; 2]>, RowRefusal> {
        let (mut sum_mm, mut count) = ([0.0; 2], 0.0);
        for columns in &self.points {
            let point = columns.map(|index| cells[index]);
            if point.iter().any(|cell| cell.is_empty() || cell.eq_ignore_ascii_case("nan")) {
                continue;
            }
            let at_mm = [number(line, &self.name, point[0])?, number(line, &self.name, point[1])?];
            // The older THÖR writes zeros for a lost marker.
            if at_mm == [0.0, 0.0] {
                continue;
            }
            for (sum, coordinate) in sum_mm.iter_mut().zip(at_mm) {
                *sum += coordinate;
            }
            count += 1.0;
        }
        Ok((count > 0.0).then(|| sum_mm.map(|sum| sum / count / 1000.0)))
    }
}
