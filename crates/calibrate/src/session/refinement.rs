//! A refinement: a session that starts from the readings of a complete calibration, and finds out which
//! mirrors have turned in their mounts since then.
//!
//! The readings at new spots are compared with the former estimate, mirror by mirror. A mirror has
//! changed if its light is off by more than [`CHANGED_RAD`] and by more than [`SIGNIFICANT`] standard
//! deviations. Its former readings no longer count. If most mirrors have changed at one spot, then the
//! spot, an LED or the tracker is at fault, and the spot is rejected.

use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use serde::Serialize;

use super::fitting::{BAD_SPOT_SHARE, JUDGED_READINGS};
use super::{Log, Session, SetupError, Stage};
use crate::fit::Estimate;
use crate::grid::{Expected, Grid};
use crate::optics::OFFSET;
use crate::outcome::Measured;
use crate::stand::median;

/// Expected change of a mirror in rad on each axis, for its search: 0.4 degrees.
pub(super) const DRIFT_RAD: f64 = 0.4 * std::f64::consts::PI / 180.0;

/// Least change in rad that counts: 0.15 degrees, to which a mirror is located.
const CHANGED_RAD: f64 = 0.15 * std::f64::consts::PI / 180.0;

/// Standard deviations that a change has to exceed.
const SIGNIFICANT: f64 = 3.0;

/// Median difference in rad between the corrections in use and those of the readings, above which they
/// do not belong together: 0.1 degrees.
const SAME_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// The place of a spot of the former calibration.
pub(crate) const FORMER_PLACE: usize = usize::MAX;

/// What is known from the complete calibration.
#[derive(Clone, Debug)]
pub(super) struct Former {
    estimate: Estimate,
    spots: usize,
    /// The mirrors that showed light.
    known: Vec<usize>,
}

/// A mirror that has changed since the former calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// Index of the mirror.
    pub mirror: usize,
    /// How far its roll and yaw have turned in degrees; absent where it shows no light any more.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turned_deg: Option<[Measured; 2]>,
}

impl Session {
    /// Starts from the log of a complete calibration and from the corrections that it gave, before the
    /// first report.
    ///
    /// # Errors
    /// [`SetupError::OtherLog`]; [`SetupError::Incomplete`] for a log without readings;
    /// [`SetupError::OtherCorrections`] for corrections that the readings do not give.
    pub fn refine(&mut self, former: Log, corrections: &CalibrationFile) -> Result<(), SetupError> {
        if former.readings.is_empty() {
            return Err(SetupError::Incomplete);
        }
        self.take(former)?;
        self.extend_estimate();
        let start = self.offsets_of(corrections);
        if let Some(estimate) = &mut self.estimate {
            estimate.values[..start.len()].copy_from_slice(&start);
        }
        self.fit();
        self.places.fill(FORMER_PLACE);
        self.stage = Stage::Await(0);
        let Some(estimate) = self.estimate.clone() else { return Err(SetupError::Incomplete) };
        let known: Vec<usize> = (0..self.optics.centres.len()).filter(|mirror| self.is_known(*mirror)).collect();
        let differences: Vec<f64> = known
            .iter()
            .flat_map(|mirror| [2 * mirror, 2 * mirror + 1])
            .map(|parameter| (estimate.values[parameter] - start[parameter]).abs())
            .collect();
        if known.is_empty() || median(&differences) > SAME_RAD {
            return Err(SetupError::OtherCorrections);
        }
        self.former = Some(Former { estimate, spots: self.spots.len(), known });
        Ok(())
    }

    /// Whether a log is one of this session: with the same former calibration, or with none.
    pub(super) fn is_refined_in(&self, log: &Log) -> bool {
        let former = self.former_spots();
        log.former == former && log.spots.get(..former) == self.spots.get(..former)
    }

    /// Spots of the former calibration.
    pub(super) fn former_spots(&self) -> usize {
        self.former.as_ref().map_or(0, |former| former.spots)
    }

    /// Whether this session is a refinement.
    pub(super) fn is_refinement(&self) -> bool {
        self.former.is_some()
    }

    /// Whether a mirror showed light in the former calibration.
    fn was_known(&self, mirror: usize) -> bool {
        self.former.as_ref().is_some_and(|former| former.known.contains(&mirror))
    }

    /// The mirrors that have changed, once the session is a refinement and has ended.
    pub fn changes(&self) -> &[Change] {
        &self.changes
    }

    /// The offset of each axis in rad for which these are the corrections.
    fn offsets_of(&self, corrections: &CalibrationFile) -> Vec<f64> {
        let offset = |of: &AxisCorrections, mirror: usize| {
            let pair = of.offset_deg.get(mirror).zip(of.gain.get(mirror));
            pair.map_or(0.0, |(offset, gain)| -offset.to_radians() / gain)
        };
        let mirrors = 0..self.optics.centres.len();
        mirrors.flat_map(|mirror| [&corrections.roll, &corrections.yaw].map(|of| offset(of, mirror))).collect()
    }

    /// The former estimate with the new spots.
    pub(super) fn before(&self) -> Option<Estimate> {
        self.former.as_ref().map(|former| self.extended(Some(&former.estimate)))
    }

    /// Finds the mirrors that have changed, and starts the next fit from them.
    pub(super) fn compare_with_former(&mut self) {
        let first = self.former_spots();
        let Some(before) = self.before().filter(|_| self.spots.len() > first) else { return };
        self.estimate = Some(before.clone());
        for spot in first..self.spots.len() {
            let found = self.turned_at(&before, &[spot]);
            let changed = found.iter().filter(|(_, turned)| is_change(turned)).count();
            let is_at_fault = found.len() >= JUDGED_READINGS && changed as f64 > BAD_SPOT_SHARE * found.len() as f64;
            if is_at_fault && !self.rejected.contains(&spot) {
                self.rejected.push(spot);
            }
        }
        let spots: Vec<usize> = (first..self.spots.len()).filter(|spot| !self.rejected.contains(spot)).collect();
        let lit: Vec<(usize, [Measured; 2])> = self.turned_at(&before, &spots);
        self.changes.clear();
        for mirror in 0..self.optics.centres.len() {
            let probed = self.readings.iter().filter(|of| of.mirror == mirror && spots.contains(&of.spot)).count();
            let turned = lit.iter().find(|(of, _)| *of == mirror).map(|(_, turned)| *turned);
            match turned {
                Some(turned) if is_change(&turned) => {
                    let turned_deg = turned.map(|Measured { value, deviation }| Measured {
                        value: value.to_degrees(),
                        deviation: deviation.to_degrees(),
                    });
                    self.changes.push(Change { mirror, turned_deg: Some(turned_deg) });
                    if let Some(estimate) = &mut self.estimate {
                        for (axis, turned) in turned.iter().enumerate() {
                            estimate.values[estimate.layout.offset(mirror, axis)] += turned.value;
                        }
                    }
                }
                None if probed >= JUDGED_READINGS && self.was_known(mirror) => {
                    self.changes.push(Change { mirror, turned_deg: None })
                }
                _ => {}
            }
        }
        let changed: Vec<usize> = self.changes.iter().map(|change| change.mirror).collect();
        let mut kept = Vec::with_capacity(self.readings.len());
        // The times are those of the latest readings, which all stay.
        kept.extend(self.readings.iter().filter(|of| of.spot >= first || !changed.contains(&of.mirror)).copied());
        self.readings = kept;
    }

    /// Opens the mirrors once more that seem to have changed at the present spot, unless the spot seems to be
    /// at fault; whether there are any. A late command spoils readings, but hardly twice.
    pub(super) fn confirm_changes(&mut self) -> bool {
        let Some(before) = self.before() else { return false };
        let found = self.turned_at(&before, &[self.spots.len() - 1]);
        let changed: Vec<usize> =
            found.iter().filter(|(_, turned)| is_change(turned)).map(|(mirror, _)| *mirror).collect();
        if changed.len() as f64 > BAD_SPOT_SHARE * found.len() as f64 {
            return false;
        }
        changed.into_iter().filter(|mirror| self.jobs[*mirror].confirm()).count() > 0
    }

    /// How far the light of each mirror that shows some at these spots is off the former estimate, in rad.
    fn turned_at(&self, before: &Estimate, spots: &[usize]) -> Vec<(usize, [Measured; 2])> {
        let mut lit: Vec<usize> =
            self.lit_pairs().iter().filter(|(_, spot)| spots.contains(spot)).map(|(mirror, _)| *mirror).collect();
        lit.dedup();
        let data = self.data(&[]);
        let turned = |mirror: usize| {
            let mut grid: Option<(Grid, [f64; 2])> = None;
            for reading in self.readings.iter().filter(|of| of.mirror == mirror && spots.contains(&of.spot)) {
                let pair = (mirror, reading.spot);
                let quantities = data.quantities(&before.layout, &before.values, pair);
                let (led, peak) = (self.spots[reading.spot].led, data.peak(&quantities, pair));
                let (grid, _) = grid.get_or_insert_with(|| {
                    let known = self.aim_deviation_by(before, pair);
                    (Grid::normal([0.0; 2], known.map(|deviation| deviation.hypot(DRIFT_RAD))), known)
                });
                grid.observe(reading.gain, peak.max(f64::MIN_POSITIVE), |[roll, yaw]| {
                    let mut at = quantities;
                    at[OFFSET] += roll;
                    at[OFFSET + 1] += yaw;
                    let gain = self.optics.mirror_gain((mirror, led), reading.command, &at);
                    Expected { gain, deviation: data.deviation(reading.spot, gain, peak) }
                });
            }
            let (grid, known) = grid?;
            let (mean, deviation) = grid.moments();
            let turned =
                [0, 1].map(|axis| Measured { value: mean[axis], deviation: deviation[axis].hypot(known[axis]) });
            Some((mirror, turned))
        };
        lit.into_iter().filter_map(turned).collect()
    }
}

fn is_change(turned: &[Measured; 2]) -> bool {
    turned.iter().any(|axis| axis.value.abs() > CHANGED_RAD.max(SIGNIFICANT * axis.deviation))
}
