//! What is unusual about the walks of a file: the signs of a wrong unit, rate or order of columns.
//!
//! Users walk at 1.0 to 1.6 m/s (Weidmann, Transporttechnik der Fussgänger, 1993: mean 1.34 m/s,
//! standard deviation 0.26 m/s).

use std::f64::consts::{PI, TAU};

use crate::walks::figures::{SPEED_SPAN_S, SpeedFigures, bounds, percentile, speeds};
use crate::walks::tracks::{Collected, Track, turn};

/// Speeds in m/s of users who walk.
const SPEED_M_S: [f64; 2] = [0.2, 1.7];

/// A smaller 95th percentile in m/s is of users who stand or sit. The median may be smaller: users who stand most of the
/// time lower it.
const SLOW_M_S: f64 = 0.1;

/// A larger 95th percentile in m/s is no walk and no run.
const FAST_M_S: f64 = 5.0;

/// Fewer positions than this in most tracks are no walks.
const POSITIONS_MIN: f64 = 4.0;

/// Intervals in s that a tracker or an annotation has.
const INTERVAL_S: [f64; 2] = [5e-4, 5.0];

/// Extents in m of a floor.
const EXTENT_M: [f64; 2] = [0.1, 1000.0];

/// The largest heading in rad that a file in rad shows where its numbers are read as degrees: a complete turn.
const HEADING_IN_RAD: f64 = 1.001 * TAU * PI / 180.0;

/// A larger median angle in rad between facing and walking is no heading of users who walk.
const SIDEWAYS_RAD: f64 = 0.5;

/// A larger share of refused rows needs a warning.
const REFUSED_SHARE: f64 = 0.1;

/// Above this share of refused rows the file is not what its format says.
const REFUSED_SHARE_MAX: f64 = 0.5;

/// One sentence for each sign that a file was read in a wrong unit, rate or order of columns.
pub fn warnings(collected: &Collected) -> Vec<String> {
    let tracks = &collected.tracks;
    let of_positions = [interval(collected), positions(collected), extent(tracks)];
    of_positions.into_iter().chain([speed(tracks), headings(tracks), refused(collected)]).flatten().collect()
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
    let fits = |unit_m: f64| (SPEED_M_S[0]..=SPEED_M_S[1]).contains(&(median * unit_m));
    // A few lost points do not make the median as fast.
    let unit = [("cm", 0.01), ("mm", 0.001)].into_iter().find(|(_, unit_m)| median > FAST_M_S && fits(*unit_m));
    if let Some((name, unit_m)) = unit {
        return Some(format!(
            "median speed {median:.1} m/s, while users walk at 1.0 to 1.6 m/s: are the positions in {name}? Use --scale {unit_m}"
        ));
    }
    if fast > FAST_M_S {
        return Some(format!(
            "1 of 20 steps is faster than {fast:.1} m/s: are lost points in the file, as zeros or as a large number?"
        ));
    }
    if fast < SLOW_M_S {
        return Some(format!(
            "19 of 20 steps are slower than {fast:.2} m/s: if users walk in this file, check frame rate, units and columns"
        ));
    }
    (median > SPEED_M_S[1]).then(|| {
        format!("median speed {median:.2} m/s, while users walk at 1.0 to 1.6 m/s: check frame rate, units and columns")
    })
}

/// Headings in rad, read as degrees: all are near 0, and users walk elsewhere.
fn headings(tracks: &[Track]) -> Option<String> {
    let mut deviations_rad = Vec::new();
    for track in tracks {
        let mut from = track.points.first()?;
        for to in &track.points {
            if to.heading_rad?.abs() > HEADING_IN_RAD {
                return None;
            }
            let [x_m, y_m] = [0, 1].map(|axis| to.at_m[axis] - from.at_m[axis]);
            let span_s = to.time_s - from.time_s;
            if span_s > 0.999 * SPEED_SPAN_S {
                let walks = x_m.hypot(y_m) > SPEED_M_S[0] * span_s;
                deviations_rad.extend(from.heading_rad.filter(|_| walks).map(|own| turn(own, y_m.atan2(x_m)).abs()));
                from = to;
            }
        }
    }
    percentile(&mut deviations_rad, 0.5).filter(|usual_rad| *usual_rad > SIDEWAYS_RAD)?;
    Some("all headings are within 6.3 degrees of +x, and users walk in other directions: are they in rad?".into())
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

    /// In a room of slow users, and of users who stand most of the time.
    #[test]
    fn slow_users_are_no_sign_of_a_wrong_unit_and_users_who_do_not_walk_are() {
        assert_eq!(of(200, 0.1, 0.016), Vec::<String>::new());
        let found = of(200, 0.1, 0.005);
        assert!(found.len() == 1 && found[0].contains("if users walk in this file, check frame rate"), "{found:?}");
    }

    #[test]
    fn headings_in_rad_that_were_read_as_degrees_are_named() {
        // A walk on a circle at 1 m/s, facing forwards, with this factor on the headings.
        let of = |factor: f64| {
            let mut collector = Collector::new(Kept::default());
            for index in 0..100 {
                let time_s = 0.1 * f64::from(index);
                let heading = time_s.rem_euclid(TAU);
                let row = Row {
                    line: 1,
                    time_s,
                    pedestrian: "a".into(),
                    at_m: [heading.sin(), -heading.cos()],
                    heading_rad: Some(factor * heading),
                };
                collector.add(Ok(row));
            }
            warnings(&collector.finish())
        };
        assert_eq!(of(1.0), Vec::<String>::new());
        let found = of(PI / 180.0);
        assert!(found.len() == 1 && found[0].ends_with("are they in rad?"), "{found:?}");
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
            (50, 0.4, 48.0, "are the positions in cm? Use --scale 0.01"),
            (50, 0.4, 480.0, "are the positions in mm? Use --scale 0.001"),
            (50, 0.4, 4.8, "are lost points in the file"),
            (3, 0.4, 0.48, "are the columns swapped?"),
        ] {
            let found = of(rows, interval_s, step_m);
            assert!(found.iter().any(|warning| warning.contains(expected)), "{expected}: {found:?}");
        }
    }
}
