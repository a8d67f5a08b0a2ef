//! Rows sorted by pedestrian: tracks without gaps.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use crate::walks::rows::{Row, RowRefusal};
use crate::walks::text::APART_S;

/// Positions that are kept unless another number is given: some 400 MB.
const POSITIONS_MAX: u64 = 5_000_000;

/// Largest number of intervals that are kept for the usual one.
const INTERVALS_MAX: usize = 10_000;

/// Largest number of refused rows that are named.
const REFUSALS_NAMED_MAX: usize = 1000;

/// One sample of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// Time in s.
    pub time_s: f64,
    /// Position in m.
    pub at_m: [f64; 2],
    /// Direction in which the pedestrian faces, in rad from +x towards +y.
    pub heading_rad: Option<f64>,
}

impl TrackPoint {
    /// The point at a time between this one and a later one: position by linear interpolation,
    /// heading along the shortest arc.
    pub fn interpolate(&self, later: &Self, time_s: f64) -> Self {
        let span_s = later.time_s - self.time_s;
        let share = if span_s > 0.0 { ((time_s - self.time_s) / span_s).clamp(0.0, 1.0) } else { 0.0 };
        let at_m = [0, 1].map(|axis| self.at_m[axis] + share * (later.at_m[axis] - self.at_m[axis]));
        let heading_rad = self.heading_rad.zip(later.heading_rad).map(|(a, b)| a + share * turn(a, b));
        Self { time_s, at_m, heading_rad }
    }
}

/// The shortest turn from one heading to another, from -pi to pi.
pub(super) fn turn(from_rad: f64, to_rad: f64) -> f64 {
    (to_rad - from_rad + PI).rem_euclid(TAU) - PI
}

/// The walk of one pedestrian, with ascending times and no long gap; it is not empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Name of the pedestrian in the file.
    pub pedestrian: String,
    /// Its samples.
    pub points: Vec<TrackPoint>,
}

impl Track {
    /// Time of the first sample in s.
    pub fn start_s(&self) -> f64 {
        self.points.first().map_or(0.0, |point| point.time_s)
    }

    /// Time of the last sample in s.
    pub fn end_s(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.time_s)
    }

    /// Time from the first to the last sample in s.
    pub fn duration_s(&self) -> f64 {
        self.end_s() - self.start_s()
    }

    /// The state at a time; before the first and after the last sample that of the nearest one.
    pub fn at(&self, time_s: f64) -> TrackPoint {
        let next = self.points.partition_point(|point| point.time_s <= time_s);
        let (before, after) = (self.points[next.saturating_sub(1)], self.points[next.min(self.points.len() - 1)]);
        TrackPoint { time_s, ..before.interpolate(&after, time_s) }
    }
}

/// A rectangle on the floor, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectangle {
    /// Least x and y.
    pub min_m: [f64; 2],
    /// Largest x and y.
    pub max_m: [f64; 2],
}

impl Rectangle {
    /// Whether a point lies in it or on its edge.
    pub fn contains(&self, at_m: [f64; 2]) -> bool {
        (0..2).all(|axis| (self.min_m[axis]..=self.max_m[axis]).contains(&at_m[axis]))
    }
}

/// Which rows are kept, and when a track ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kept {
    /// Factor on all positions, for files in other units.
    pub scale: f64,
    /// Least time in s after the first row.
    pub from_s: f64,
    /// Largest time in s after the first row.
    pub to_s: f64,
    /// Positions outside it end a track.
    pub crop: Option<Rectangle>,
    /// A longer time without a sample ends a track, in s.
    pub max_gap_s: f64,
    /// Largest number of positions that are kept.
    pub positions_max: u64,
}

impl Default for Kept {
    fn default() -> Self {
        Self {
            scale: 1.0,
            from_s: f64::NEG_INFINITY,
            to_s: f64::INFINITY,
            crop: None,
            max_gap_s: 1.0,
            positions_max: POSITIONS_MAX,
        }
    }
}

/// What became of the positions of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RowCounts {
    /// Positions in tracks.
    pub kept: u64,
    /// Rows that could not be used.
    pub refused: u64,
    /// Positions outside the time range.
    pub out_of_range: u64,
    /// Positions outside the crop.
    pub cropped: u64,
    /// Positions beyond the largest number.
    pub beyond: u64,
}

/// All that was read of a file.
#[derive(Clone, Debug, Default)]
pub struct Collected {
    /// The tracks, in the order of their first rows.
    pub tracks: Vec<Track>,
    /// What became of the positions.
    pub counts: RowCounts,
    /// Time of the first row in s.
    pub first_s: f64,
    /// Pedestrians of whom a row was read.
    pub pedestrians: usize,
    /// The first 1000 refused rows.
    pub refusals: Vec<RowRefusal>,
    /// The first intervals between two rows of one pedestrian in s, gaps included.
    pub intervals_s: Vec<f64>,
}

/// A pedestrian of whom a row was read.
#[derive(Clone, Copy, Debug)]
struct Pedestrian {
    last_s: f64,
    /// The track that the next row continues.
    track: Option<usize>,
}

/// Sorts rows by pedestrian.
#[derive(Clone, Debug)]
pub struct Collector {
    kept: Kept,
    first_s: Option<f64>,
    pedestrians: HashMap<String, Pedestrian>,
    collected: Collected,
}

impl Collector {
    /// No rows yet.
    pub fn new(kept: Kept) -> Self {
        Self { kept, first_s: None, pedestrians: HashMap::new(), collected: Collected::default() }
    }

    /// Adds a row, or counts and names a refused one.
    pub fn add(&mut self, row: Result<Row, RowRefusal>) {
        if let Err(refusal) = row.and_then(|row| self.add_row(row)) {
            self.collected.counts.refused += 1;
            if self.collected.refusals.len() < REFUSALS_NAMED_MAX {
                self.collected.refusals.push(refusal);
            }
        }
    }

    fn add_row(&mut self, row: Row) -> Result<(), RowRefusal> {
        let first_s = *self.first_s.get_or_insert(row.time_s);
        let before = self.pedestrians.get(&row.pedestrian).copied();
        let is_apart = |last_s: f64| row.time_s - last_s >= APART_S;
        if let Some(last_s) = before.map(|pedestrian| pedestrian.last_s).filter(|last_s| !is_apart(*last_s)) {
            let reason = format!(
                "time {} s of the pedestrian {} is not {APART_S} s after {last_s} s: expected ascending times for each \
                 pedestrian; sort the rows by time, and leave out repeated ones",
                row.time_s, row.pedestrian
            );
            return Err(RowRefusal { line: row.line, reason });
        }
        if let Some(last_s) = before.map(|pedestrian| pedestrian.last_s)
            && self.collected.intervals_s.len() < INTERVALS_MAX
        {
            self.collected.intervals_s.push(row.time_s - last_s);
        }
        let track = before
            .and_then(|pedestrian| pedestrian.track.filter(|_| row.time_s - pedestrian.last_s <= self.kept.max_gap_s));
        let at_m = row.at_m.map(|coordinate| coordinate * self.kept.scale);
        let point = TrackPoint { time_s: row.time_s, at_m, heading_rad: row.heading_rad };
        let counts = &mut self.collected.counts;
        let track = if !(self.kept.from_s..=self.kept.to_s).contains(&(row.time_s - first_s)) {
            counts.out_of_range += 1;
            None
        } else if self.kept.crop.is_some_and(|crop| !crop.contains(at_m)) {
            counts.cropped += 1;
            None
        } else if counts.kept == self.kept.positions_max {
            counts.beyond += 1;
            None
        } else {
            counts.kept += 1;
            Some(self.collected.put(track, &row.pedestrian, point))
        };
        self.pedestrians.insert(row.pedestrian, Pedestrian { last_s: row.time_s, track });
        Ok(())
    }

    /// All that was read.
    pub fn finish(self) -> Collected {
        Collected { first_s: self.first_s.unwrap_or(0.0), pedestrians: self.pedestrians.len(), ..self.collected }
    }
}

impl Collected {
    /// Adds a point to a track, or to a new one; the result is the track.
    fn put(&mut self, track: Option<usize>, pedestrian: &str, point: TrackPoint) -> usize {
        let index = track.unwrap_or_else(|| {
            self.tracks.push(Track { pedestrian: pedestrian.to_owned(), points: Vec::new() });
            self.tracks.len() - 1
        });
        self.tracks[index].points.push(point);
        index
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use crate::walks::text::trace_text;
    use crate::world::trace::Trace;
    use crate::world::walker::Floor;

    use super::*;

    fn row(line: u64, pedestrian: &str, time_s: f64, at_m: [f64; 2]) -> Result<Row, RowRefusal> {
        Ok(Row { line, time_s, pedestrian: pedestrian.to_owned(), at_m, heading_rad: None })
    }

    fn collect(kept: Kept, rows: &[(&str, f64, [f64; 2])]) -> Collected {
        let mut collector = Collector::new(kept);
        for (line, (pedestrian, time_s, at_m)) in (1..).zip(rows) {
            collector.add(row(line, pedestrian, *time_s, *at_m));
        }
        collector.finish()
    }

    #[test]
    fn a_gap_and_the_edge_of_a_crop_end_a_track() {
        let walk = [0.0, 0.5, 1.0, 2.5, 3.0].map(|time_s| ("a", time_s, [time_s, 0.0]));
        let starts = |kept| collect(kept, &walk).tracks.iter().map(Track::start_s).collect::<Vec<_>>();
        assert_eq!(starts(Kept::default()), [0.0, 2.5]);
        assert_eq!(starts(Kept { max_gap_s: 1.5, ..Kept::default() }), [0.0]);
        let crop = Some(Rectangle { min_m: [-1.0, -1.0], max_m: [0.6, 1.0] });
        let cropped = collect(Kept { crop, ..Kept::default() }, &walk);
        assert_eq!((cropped.tracks.len(), cropped.counts.kept, cropped.counts.cropped), (1, 2, 3));
        // A pedestrian who leaves the crop for less than the gap walked outside it: two tracks.
        let out_and_in = [("a", 0.0, [0.0, 0.0]), ("a", 0.2, [0.7, 0.0]), ("a", 0.4, [0.0, 0.0])];
        assert_eq!(collect(Kept { crop, ..Kept::default() }, &out_and_in).tracks.len(), 2);
    }

    #[test]
    fn times_that_go_back_are_refused_with_their_line() {
        let rows = [("a", 1.0, [0.0; 2]), ("b", 0.5, [0.0; 2]), ("a", 1.0, [0.0; 2]), ("a", 0.9, [0.0; 2])];
        let collected = collect(Kept::default(), &rows);
        let lines: Vec<u64> = collected.refusals.iter().map(|refusal| refusal.line).collect();
        assert_eq!((lines, collected.counts.refused, collected.pedestrians), (vec![3, 4], 2, 2));
        assert!(collected.refusals[0].reason.contains("time 1 s of the pedestrian a is not 0.0002 s after 1 s"));
    }

    #[test]
    fn positions_that_the_text_would_give_one_time_are_refused() {
        let rows = [("a", 0.004_71, [0.0; 2]), ("a", 0.004_74, [0.0; 2]), ("a", 1.0, [0.5, 0.0])];
        let collected = collect(Kept::default(), &rows);
        assert_eq!((collected.counts.kept, collected.counts.refused), (2, 1));
        let floor = Floor { length_x_m: 5.0, length_y_m: 5.0 };
        let text = trace_text(&collected.tracks, &floor);
        assert_eq!(Trace::problems(&text, 1, &floor), [], "{text}");
    }

    #[test]
    fn the_time_range_begins_at_the_first_row_and_the_scale_converts_units() {
        let walk: Vec<_> = (0..10).map(|index| ("a", 100.0 + 0.5 * f64::from(index), [1000.0, 0.0])).collect();
        let collected = collect(Kept { scale: 0.001, from_s: 1.0, to_s: 2.0, ..Kept::default() }, &walk);
        assert_eq!((collected.counts.kept, collected.counts.out_of_range), (3, 7));
        assert_eq!((collected.tracks[0].start_s(), collected.tracks[0].points[0].at_m), (101.0, [1.0, 0.0]));
        let counts = collect(Kept { positions_max: 4, ..Kept::default() }, &walk).counts;
        assert_eq!((counts.kept, counts.beyond), (4, 6));
    }

    #[test]
    fn headings_turn_along_the_shortest_arc() {
        let point = |time_s, heading| TrackPoint { time_s, at_m: [time_s, 0.0], heading_rad: Some(heading) };
        let track = Track { pedestrian: "a".to_owned(), points: vec![point(0.0, 3.0), point(1.0, -3.0)] };
        let heading = track.at(0.5).heading_rad.expect("a heading");
        assert!((heading.cos() + 1.0).abs() < 1e-12, "{heading}");
        let quarter = point(0.0, 0.0).interpolate(&point(1.0, FRAC_PI_2), 0.5);
        assert!((quarter.heading_rad.expect("a heading") - 0.5 * FRAC_PI_2).abs() < 1e-12);
        assert_eq!(track.at(9.0).at_m, [1.0, 0.0]);
    }
}
