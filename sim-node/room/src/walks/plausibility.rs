//! What is unusual about the walks of a file: the signs of a wrong unit, rate or order of columns.
//!
//! Users walk at 1.0 to 1.6 m/s (Weidmann, Transporttechnik der Fussgänger, 1993: mean 1.34 m/s,
//! standard deviation 0.26 m/s).

use crate::walks::figures::{SpeedFigures, bounds, percentile, speeds};
use crate::walks::tracks::{Collected, Track};

/// Medians of the speed in m/s that need no warning. Users who stand most of the time lower the median.
const SPEED_M_S: [f64; 2] = [0.2, 1.7];

/// A larger 95th percentile in m/s is no walk and no run.
const FAST_M_S: f64 = 5.0;

/// Fewer positions than this in most tracks are no walks.
const POSITIONS_MIN: f64 = 4.0;

/// Intervals in s that a tracker or an annotation has.
const INTERVAL_S: [f64; 2] = [5e-4, 5.0];

/// Extents in m of a floor.
const EXTENT_M: [f64; 2] = [0.1, 1000.0];

/// A larger share of refused rows needs a warning.
const REFUSED_SHARE: f64 = 0.1;

/// Above this share of refused rows the file is not what its format says.
const REFUSED_SHARE_MAX: f64 = 0.5;

/// One sentence for each sign that a file was read in a wrong unit, rate or order of columns.
pub fn warnings(collected: &Collected) -> Vec<String> {
    let tracks = &collected.tracks;
    let found = [interval(collected), positions(collected), extent(tracks), speed(tracks), refused(collected)];
    found.into_iter().flatten().collect()
}

/// Whether more than half of the rows were refused.
pub fn is_mostly_refused(collected: &Collected) -> bool {
    refused_share(collected) > REFUSED_SHARE_MAX
}

fn refused_share(collected: &Collected) -> f64 {
    let counts = collected.counts;
    let all = counts.kept + counts.refused + counts.out_of_range + counts.cropped + counts.beyond;
    counts.refused as f64 / all.max(1) as f64
}

fn refused(collected: &Collected) -> Option<String> {
    let share = refused_share(collected);
    (share > REFUSED_SHARE).then(|| format!("{:.0} % of the rows were refused: check the format", 100.0 * share))
}

/// The usual interval of one pedestrian, with the unit that would make it usual.
fn interval(collected: &Collected) -> Option<String> {
    let usual_s = percentile(&mut collected.intervals_s.clone(), 0.5)?;
    if (INTERVAL_S[0]..=INTERVAL_S[1]).contains(&usual_s) {
        return None;
    }
    let fits = |unit_s: f64| (INTERVAL_S[0]..=INTERVAL_S[1]).contains(&(usual_s * unit_s));
    let unit = [("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)].into_iter().find(|(_, unit_s)| fits(*unit_s));
    Some(match unit {
        Some((name, _)) => format!("the usual interval of a pedestrian is {usual_s:.4} s: are the times in {name}?"),
        None => {
            format!("the usual interval of a pedestrian is {usual_s:.6} s: check the unit of time or the frame rate")
        }
    })
}

fn positions(collected: &Collected) -> Option<String> {
    let mut counts: Vec<f64> = collected.tracks.iter().map(|track| track.points.len() as f64).collect();
    let usual = percentile(&mut counts, 0.5).filter(|count| *count < POSITIONS_MIN)?;
    let (count, pedestrians) = (usual as u64, collected.pedestrians);
    Some(format!("{pedestrians} pedestrians, most with {count} positions in a track: are the columns swapped?"))
}

fn extent(tracks: &[Track]) -> Option<String> {
    let area = bounds(tracks)?;
    let extent_m = (0..2).map(|axis| area.max_m[axis] - area.min_m[axis]).fold(0.0, f64::max);
    let is_usual = (EXTENT_M[0]..=EXTENT_M[1]).contains(&extent_m);
    (!is_usual).then(|| format!("the positions span {extent_m:.3} m: check their unit"))
}

fn speed(tracks: &[Track]) -> Option<String> {
    let SpeedFigures { median_m_s: median, p95_m_s: fast } = speeds(tracks)?;
    if fast > FAST_M_S {
        return Some(format!(
            "1 of 20 steps is faster than {fast:.1} m/s: are lost points in the file, as zeros or as a large number?"
        ));
    }
    let is_usual = (SPEED_M_S[0]..=SPEED_M_S[1]).contains(&median);
    (!is_usual).then(|| {
        format!("median speed {median:.2} m/s, while users walk at 1.0 to 1.6 m/s: check frame rate, units and columns")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::walks::rows::Row;
    use crate::walks::tracks::{Collector, Kept};

    /// Warnings of one walk along x.
    fn of(rows: usize, interval_s: f64, step_m: f64) -> Vec<String> {
        let mut collector = Collector::new(Kept::default());
        for index in 0..rows {
            let time_s = interval_s * index as f64;
            let at_m = [step_m * index as f64, 0.0];
            collector.add(Ok(Row { line: 1, time_s, pedestrian: "a".into(), at_m, heading_rad: None }));
        }
        warnings(&collector.finish())
    }

    #[test]
    fn a_usual_walk_has_no_warning() {
        for interval_s in [0.01, 0.04, 0.4] {
            assert_eq!(of(200, interval_s, 1.2 * interval_s), Vec::<String>::new(), "{interval_s}");
        }
    }

    #[test]
    fn wrong_units_rates_and_columns_are_named() {
        for (rows, interval_s, step_m, expected) in [
            (50, 400.0, 0.48, "are the times in ms?"),
            (50, 4e5, 0.48, "are the times in us?"),
            (50, 4e8, 0.48, "are the times in ns?"),
            (50, 1e-5, 0.48, "check the unit of time"),
            (50, 0.4, 480.0, "the positions span 23520.000 m"),
            (50, 0.24, 0.48, "median speed 2.00 m/s"),
            (3, 0.4, 0.48, "are the columns swapped?"),
        ] {
            let found = of(rows, interval_s, step_m);
            assert!(found.iter().any(|warning| warning.contains(expected)), "{expected}: {found:?}");
        }
    }
}
