//! What tracks hold: extent, rate and speeds.

use crate::walks::tracks::{Rectangle, Track, TrackPoint};

/// Least time in s over which a speed is measured: the interval of the usual annotations. Over a
/// shorter one the noise of a tracker appears as speed.
pub(super) const SPEED_SPAN_S: f64 = 0.4;

/// Median and 95th percentile of the speeds in m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedFigures {
    /// Median.
    pub median_m_s: f64,
    /// 95th percentile.
    pub p95_m_s: f64,
}

/// The bounding box of all points; `None` without a point.
pub fn bounds(tracks: &[Track]) -> Option<Rectangle> {
    let mut points = tracks.iter().flat_map(|track| &track.points).map(|point| point.at_m);
    let first = points.next()?;
    let start = Rectangle { min_m: first, max_m: first };
    Some(points.fold(start, |area, at_m| Rectangle {
        min_m: [0, 1].map(|axis| area.min_m[axis].min(at_m[axis])),
        max_m: [0, 1].map(|axis| area.max_m[axis].max(at_m[axis])),
    }))
}

/// Time from the first to the last sample of all tracks in s.
pub fn duration_s(tracks: &[Track]) -> f64 {
    let start = tracks.iter().map(Track::start_s).fold(f64::INFINITY, f64::min);
    let end = tracks.iter().map(Track::end_s).fold(f64::NEG_INFINITY, f64::max);
    (end - start).max(0.0)
}

/// Samples a second: one over the median interval; `None` without two samples of a track.
pub fn rate_hz(tracks: &[Track]) -> Option<f64> {
    let pairs = tracks.iter().flat_map(|track| track.points.windows(2));
    let mut intervals: Vec<f64> = pairs.map(|pair| pair[1].time_s - pair[0].time_s).collect();
    percentile(&mut intervals, 0.5).map(|interval_s| 1.0 / interval_s)
}

/// The speeds over at least 0.4 s; `None` where no track is as long.
pub fn speeds(tracks: &[Track]) -> Option<SpeedFigures> {
    let mut all = Vec::new();
    tracks.iter().for_each(|track| add_speeds(&track.points, &mut all));
    let median_m_s = percentile(&mut all, 0.5)?;
    Some(SpeedFigures { median_m_s, p95_m_s: percentile(&mut all, 0.95)? })
}

fn add_speeds(points: &[TrackPoint], speeds: &mut Vec<f64>) {
    let Some(mut from) = points.first() else { return };
    for to in points {
        let span_s = to.time_s - from.time_s;
        // Times are decimal fractions: 0.4 s may be a little less.
        if span_s > 0.999 * SPEED_SPAN_S {
            speeds.push((to.at_m[0] - from.at_m[0]).hypot(to.at_m[1] - from.at_m[1]) / span_s);
            from = to;
        }
    }
}

/// The nearest-rank percentile; `None` of no values.
pub(super) fn percentile(values: &mut [f64], share: f64) -> Option<f64> {
    let rank = (share * values.len() as f64).ceil() as usize;
    let index = rank.max(1).checked_sub(1).filter(|index| *index < values.len())?;
    Some(*values.select_nth_unstable_by(index, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A walk along y, `step_m` in each of the intervals.
    fn walk(interval_s: f64, steps_m: &[f64]) -> Track {
        let mut point = TrackPoint { time_s: 10.0, at_m: [1.0, 0.0], heading_rad: None };
        let mut points = vec![point];
        for step_m in steps_m {
            point.time_s += interval_s;
            point.at_m[1] += step_m;
            points.push(point);
        }
        Track { pedestrian: "a".to_owned(), points }
    }

    #[test]
    fn figures_are_of_all_tracks() {
        let steps: Vec<f64> = (1..=20).map(|step| 0.04 * f64::from(step)).collect();
        let tracks = [walk(0.4, &steps), walk(0.4, &[])];
        let speeds = speeds(&tracks).expect("speeds");
        assert!((speeds.median_m_s - 1.0).abs() < 1e-9 && (speeds.p95_m_s - 1.9).abs() < 1e-9, "{speeds:?}");
        assert!((rate_hz(&tracks).expect("a rate") - 2.5).abs() < 1e-9);
        assert!((duration_s(&tracks) - 8.0).abs() < 1e-9);
        let area = bounds(&tracks).expect("points");
        assert_eq!((area.min_m, area.max_m[0]), ([1.0, 0.0], 1.0));
        assert_eq!((bounds(&[]), duration_s(&[]), rate_hz(&[])), (None, 0.0, None));
    }

    #[test]
    fn the_noise_of_a_fast_tracker_is_no_speed() {
        let noise: Vec<f64> = (0..400).map(|step| if step % 2 == 0 { 0.002 } else { -0.002 }).collect();
        let speeds = speeds(&[walk(0.01, &noise)]).expect("speeds");
        assert!(speeds.p95_m_s < 0.02, "{speeds:?}");
    }
}
