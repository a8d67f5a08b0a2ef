//! A refinement: a session that starts from the readings of a complete calibration, and finds out which
//! mirrors have turned in their mounts since then.
//!
//! The readings at new spots are compared with the former estimate, mirror by mirror. A mirror has
//! changed if its light is off by more than [`CHANGED_RAD`] and by more standard deviations than
//! [`significant_among`] all mirrors, and if the later half of its readings alone confirms the earlier half. Its
//! former readings no longer count. A mirror that is off by [`SUSPECT`] standard deviations is measured again. If
//! most mirrors are suspect at one spot, then the spot, an LED or the tracker is at fault, and the spot is rejected.

use heliostat_array::calibration_file::{AxisCorrections, CalibrationFile};
use serde::Serialize;

use super::fitting::{BAD_SPOT_SHARE, JUDGED_READINGS};
use super::{Log, Session, SetupError, Stage};
use crate::fit::{Estimate, Reading};
use crate::grid::{Expected, Grid, likelihood};
use crate::optics::{OFFSET, Quantities};
use crate::outcome::Measured;
use crate::stand::median;

/// Expected change of a mirror in rad on each axis, for its search: 0.4 degrees.
pub(super) const DRIFT_RAD: f64 = 0.4 * std::f64::consts::PI / 180.0;

/// Least change in rad that counts: 0.15 degrees, to which a mirror is located.
const CHANGED_RAD: f64 = 0.15 * std::f64::consts::PI / 180.0;

/// Standard deviations beyond which a mirror alone is suspect.
const SUSPECT: f64 = 3.0;

/// Largest probability that noise alone makes any of the mirrors a changed one.
const FALSE_ALARM: f64 = 0.05;

/// Logarithm of the ratio of likelihoods, with a change and without, from which on readings confirm it.
const CONFIRMED: f64 = 1.0;

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
    /// [`SetupError::OtherLog`]; [`SetupError::Field`]; [`SetupError::Incomplete`] for a log without readings;
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

    /// The mirrors that have changed, by the complete spots of a refinement.
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
            let changed = found.iter().filter(|(_, turned)| is_off(turned, SUSPECT)).count();
            let is_at_fault = found.len() >= JUDGED_READINGS && changed as f64 > BAD_SPOT_SHARE * found.len() as f64;
            if is_at_fault && !self.rejected.contains(&spot) {
                self.rejected.push(spot);
            }
        }
        let spots: Vec<usize> = (first..self.spots.len()).filter(|spot| !self.rejected.contains(spot)).collect();
        let lit: Vec<(usize, [Measured; 2])> = self.turned_at(&before, &spots);
        let significant = significant_among(lit.len());
        self.changes.clear();
        for mirror in 0..self.optics.centres.len() {
            let probed = self.readings.iter().filter(|of| of.mirror == mirror && spots.contains(&of.spot)).count();
            let turned = lit.iter().find(|(of, _)| *of == mirror).map(|(_, turned)| *turned);
            match turned {
                Some(turned) if is_off(&turned, significant) && self.is_confirmed(&before, mirror, &spots) => {
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

    /// Opens the mirrors again that seem to have changed at the present spot, until further readings confirm
    /// it, unless the spot seems to be at fault; whether there are any.
    pub(super) fn confirm_changes(&mut self) -> bool {
        let Some(before) = self.before() else { return false };
        let spot = self.spots.len() - 1;
        let found = self.turned_at(&before, &[spot]);
        let changed: Vec<usize> =
            found.iter().filter(|(_, turned)| is_off(turned, SUSPECT)).map(|(mirror, _)| *mirror).collect();
        if changed.len() as f64 > BAD_SPOT_SHARE * found.len() as f64 {
            return false;
        }
        let is_open =
            |mirror: &usize| !self.jobs[*mirror].is_measured_again() || !self.is_confirmed(&before, *mirror, &[spot]);
        let open: Vec<usize> = changed.into_iter().filter(is_open).collect();
        open.into_iter().filter(|mirror| self.jobs[*mirror].confirm()).count() > 0
    }

    /// Whether the later half of a mirror's readings at each of these spots is more likely with the change that
    /// the earlier half shows than without. A late command spoils readings, but hardly those of both halves alike.
    fn is_confirmed(&self, before: &Estimate, mirror: usize, spots: &[usize]) -> bool {
        let (mut earlier, mut later) = (Vec::new(), Vec::new());
        for spot in spots {
            let of = self.readings.iter().filter(|of| (of.mirror, of.spot) == (mirror, *spot));
            let of: Vec<&Reading> = of.collect();
            let (first, second) = of.split_at(of.len().div_ceil(2));
            earlier.extend_from_slice(first);
            later.extend_from_slice(second);
        }
        let Some(turned) = self.turned_by(before, earlier.into_iter()) else { return false };
        let turned = turned.map(|axis| axis.value);
        let support = |reading: &Reading| {
            let compared = self.compared(before, reading);
            (compared.likelihood(turned) / compared.likelihood([0.0; 2])).ln()
        };
        later.into_iter().map(support).sum::<f64>() > CONFIRMED
    }

    /// How far the light of each mirror that shows some at these spots is off the former estimate, in rad.
    fn turned_at(&self, before: &Estimate, spots: &[usize]) -> Vec<(usize, [Measured; 2])> {
        let mut lit: Vec<usize> =
            self.lit_pairs().iter().filter(|(_, spot)| spots.contains(spot)).map(|(mirror, _)| *mirror).collect();
        lit.dedup();
        let turned = |mirror: usize| {
            let of = self.readings.iter().filter(|of| of.mirror == mirror && spots.contains(&of.spot));
            Some((mirror, self.turned_by(before, of)?))
        };
        lit.into_iter().filter_map(turned).collect()
    }

    /// The same by these readings of one mirror; `None` without any.
    fn turned_by<'a>(&self, before: &Estimate, readings: impl Iterator<Item = &'a Reading>) -> Option<[Measured; 2]> {
        let mut grid: Option<(Grid, [f64; 2])> = None;
        for reading in readings {
            let compared = self.compared(before, reading);
            let (grid, _) = grid.get_or_insert_with(|| {
                let known = self.aim_deviation_by(before, (reading.mirror, reading.spot));
                (Grid::normal([0.0; 2], known.map(|deviation| deviation.hypot(DRIFT_RAD))), known)
            });
            grid.observe(reading.gain, compared.peak, |turned| compared.expected(turned));
        }
        let (grid, known) = grid?;
        let (mean, deviation) = grid.moments();
        Some([0, 1].map(|axis| Measured { value: mean[axis], deviation: deviation[axis].hypot(known[axis]) }))
    }

    fn compared<'a>(&'a self, before: &Estimate, reading: &'a Reading) -> Compared<'a> {
        let (data, pair) = (self.data(&[]), (reading.mirror, reading.spot));
        let quantities = data.quantities(&before.layout, &before.values, pair);
        let peak = data.peak(&quantities, pair).max(f64::MIN_POSITIVE);
        Compared { session: self, reading, quantities, peak }
    }
}

/// A reading beside the former estimate.
struct Compared<'a> {
    session: &'a Session,
    reading: &'a Reading,
    /// The quantities of its light by the former estimate.
    quantities: Quantities,
    peak: f64,
}

impl Compared<'_> {
    /// The light of the mirror if its roll and yaw have turned by this in rad.
    fn expected(&self, [roll, yaw]: [f64; 2]) -> Expected {
        let Self { session, reading, quantities, peak } = self;
        let mut at = *quantities;
        at[OFFSET] += roll;
        at[OFFSET + 1] += yaw;
        let led = session.spots[reading.spot].led;
        let gain = session.optics.mirror_gain((reading.mirror, led), reading.command, &at);
        Expected { gain, deviation: session.data(&[]).deviation(reading.spot, gain, *peak) }
    }

    fn likelihood(&self, turned: [f64; 2]) -> f64 {
        likelihood(self.reading.gain, self.peak, self.expected(turned))
    }
}

/// Standard deviations that a change has to exceed among this many mirrors.
///
/// A normal error exceeds b standard deviations with a probability of at most exp(-b^2 / 2) (Chernoff's bound), and
/// the probabilities of both axes of all mirrors add up to [`FALSE_ALARM`] at most (Bonferroni's inequality).
fn significant_among(mirrors: usize) -> f64 {
    let axes = 2.0 * mirrors.max(1) as f64;
    (2.0 * (axes / FALSE_ALARM).ln()).sqrt()
}

/// Whether an axis is off by an angle that counts, and by this many standard deviations.
fn is_off(turned: &[Measured; 2], deviations: f64) -> bool {
    turned.iter().any(|axis| axis.value.abs() > CHANGED_RAD.max(deviations * axis.deviation))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A uniform number in (0, 1] of a linear congruential generator.
    fn uniform(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((*state >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }

    /// Two axes with normal errors (Box and Muller) of a mirror that has not turned.
    fn unturned(state: &mut u64, deviation: f64) -> [Measured; 2] {
        let (radius, angle) = ((-2.0 * uniform(state).ln()).sqrt(), std::f64::consts::TAU * uniform(state));
        [angle.cos(), angle.sin()].map(|part| Measured { value: deviation * radius * part, deviation })
    }

    #[test]
    fn noise_alone_seldom_makes_any_of_100_mirrors_a_changed_one() {
        // So large that the least angle of a change is no help.
        let deviation = CHANGED_RAD;
        let mut state = 20_261_127;
        let mut share = |deviations: f64| {
            let rooms = 1000;
            let has_alarm = |_: &i32| (0..100).any(|_| is_off(&unturned(&mut state, deviation), deviations));
            f64::from((0..rooms).filter(has_alarm).count() as u32) / f64::from(rooms)
        };
        let (alone, among) = (share(SUSPECT), share(significant_among(100)));
        assert!(among <= FALSE_ALARM && alone > 0.2, "{among} of the rooms, {alone} with the bound for one mirror");
    }

    #[test]
    fn a_turn_beyond_all_noise_is_a_change_among_1000_mirrors() {
        let turned = |deg: f64| [deg, 0.0].map(|deg| Measured { value: deg.to_radians(), deviation: 0.001 });
        assert!(is_off(&turned(0.4), significant_among(1000)) && !is_off(&turned(0.2), significant_among(1000)));
    }
}
