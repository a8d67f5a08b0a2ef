//! The joint fit between two spots: its start, its checks and its end.

use nalgebra::DMatrix;

use super::{Session, Stage};
use crate::fit::{self, Data, Estimate, Reading};
use crate::grid::{Expected, Grid};
use crate::optics::{LED, OFFSET, PLACE, Quantities, RAISE, nominal_at};
use crate::outcome::{self, Outcome};
use crate::parameters::Spot;
use crate::probes::{LIT_SHARE, State};

/// Mean square of a mirror's residuals at a spot above which they do not fit.
const BAD_SQUARE: f64 = 6.0;

/// Readings from which on a mirror at a spot is judged.
pub(super) const JUDGED_READINGS: usize = 3;

/// Share of the mirrors at a spot that do not fit, from which on the spot is at fault.
pub(super) const BAD_SPOT_SHARE: f64 = 0.4;

/// Difference in rad from which on a second search replaces an offset: 0.3 degrees.
const MOVED_RAD: f64 = fit::STEP_MAX_RAD;

/// Extent of the second search in prior standard deviations.
const SEARCH_SPREAD: f64 = 1.3;

/// Step in m of the derivatives of an aim.
const AIM_STEP_M: f64 = 1e-4;

impl Session {
    /// The quantities of a mirror's light at a spot, by the present estimate.
    pub(super) fn quantities(&self, (mirror, spot): (usize, usize)) -> Quantities {
        match &self.estimate {
            Some(estimate) if spot < estimate.layout.spots() => {
                self.data(&self.readings).quantities(&estimate.layout, &estimate.values, (mirror, spot))
            }
            _ => nominal_at(self.spots[spot].tracked_m, self.spots[spot].height_m),
        }
    }

    pub(super) fn data<'a>(&'a self, readings: &'a [Reading]) -> Data<'a> {
        Data { optics: &self.optics, prior: &self.setup.prior, spots: &self.spots, readings }
    }

    /// Adds the latest spots to the estimate, at the places that the tracker reports.
    pub(super) fn extend_estimate(&mut self) {
        self.estimate = Some(self.extended(self.estimate.as_ref()));
    }

    /// An estimate with the spots that it lacks, at the places that the tracker reports; the latest spot
    /// is placed again.
    pub(super) fn extended(&self, known: Option<&Estimate>) -> Estimate {
        let data = self.data(&[]);
        let layout = data.layout();
        let prior = layout.prior(&self.setup.prior, &self.spots);
        let mut values: Vec<f64> = prior.iter().map(|(mean, _)| *mean).collect();
        let mut covariance = DMatrix::from_diagonal(&nalgebra::DVector::from_iterator(
            prior.len(),
            prior.iter().map(|(_, spread)| spread * spread),
        ));
        let latest = self.spots.len() - 1;
        if let Some(known) = known {
            values = layout.carried(&known.layout, &known.values, values);
            let order = layout.known_in(&known.layout);
            for (row, from_row) in order.iter().enumerate() {
                for (column, from_column) in order.iter().enumerate() {
                    if let (Some(from_row), Some(from_column)) = (from_row, from_column) {
                        covariance[(row, column)] = known.covariance[(*from_row, *from_column)];
                    }
                }
            }
        }
        let first = known.map_or(0, |known| known.layout.spots()).min(latest);
        for (spot, axis) in (first..=latest).flat_map(|spot| [(spot, 0), (spot, 1)]) {
            let (place, shift) = (layout.place(spot, axis), layout.shift(axis));
            values[place] = self.spots[spot].tracked_m[axis] + values[shift];
            for index in 0..layout.len() {
                covariance[(place, index)] = covariance[(shift, index)];
                covariance[(index, place)] = covariance[(index, shift)];
            }
            covariance[(place, place)] = covariance[(shift, shift)] + self.spots[spot].tracked_deviation_m.powi(2);
        }
        Estimate { layout, values, covariance, residuals: Vec::new() }
    }

    /// Standard deviation of roll and yaw at which a mirror's light is centred on a spot, in rad.
    pub(super) fn aim_deviation(&self, pair: (usize, usize)) -> [f64; 2] {
        match &self.estimate {
            Some(estimate) => self.aim_deviation_by(estimate, pair),
            None => [self.setup.prior.offset_rad; 2],
        }
    }

    /// The same by another estimate.
    pub(super) fn aim_deviation_by(&self, estimate: &Estimate, (mirror, spot): (usize, usize)) -> [f64; 2] {
        let led = self.spots[spot].led;
        let places = [0, 1].map(|axis| Some(estimate.layout.place(spot, axis)));
        let quantities = self.data(&[]).quantities(&estimate.layout, &estimate.values, (mirror, spot));
        aim_deviation(&self.optics, estimate, (mirror, led), &quantities, places)
    }

    /// Whether a mirror has shown light.
    pub(super) fn is_known(&self, mirror: usize) -> bool {
        self.lit_pairs().iter().any(|(lit, _)| *lit == mirror)
    }

    /// The pairs of mirror and spot that have shown light.
    pub(super) fn lit_pairs(&self) -> Vec<(usize, usize)> {
        let mut peaks = std::collections::BTreeMap::new();
        let mut lit = Vec::new();
        for Reading { mirror, spot, gain, .. } in &self.readings {
            let pair = (*mirror, *spot);
            let peak = *peaks.entry(pair).or_insert_with(|| {
                let mut quantities = self.quantities(pair);
                quantities[OFFSET..OFFSET + 4].fill(0.0);
                self.data(&[]).peak(&quantities, pair)
            });
            if *gain > LIT_SHARE * peak && !lit.contains(&pair) {
                lit.push(pair);
            }
        }
        lit.sort_unstable();
        lit
    }

    /// Fits all parameters to the readings of pairs that showed light, and removes what does not fit.
    pub(super) fn fit(&mut self) {
        if self.spots.is_empty() {
            return;
        }
        if self.estimate.as_ref().is_none_or(|estimate| estimate.layout.spots() != self.spots.len()) {
            self.extend_estimate();
        }
        if self.is_refinement() {
            self.jobs.clear();
            self.compare_with_former();
        } else {
            self.start_offsets();
        }
        let mut lit = self.lit_pairs();
        self.fit_pairs(&lit);
        let bad = self.bad_pairs(&lit);
        if self.search_again(&bad) {
            lit = self.lit_pairs();
            self.fit_pairs(&lit);
        }
        let bad = self.bad_pairs(&lit);
        // Most mirrors at one spot: the spot is at fault.
        for spot in 0..self.spots.len() {
            let count = |pairs: &[(usize, usize)]| pairs.iter().filter(|(_, of)| *of == spot).count();
            let (all, failed) = (count(&lit), count(&bad));
            if all >= JUDGED_READINGS && failed as f64 > BAD_SPOT_SHARE * all as f64 && !self.rejected.contains(&spot) {
                self.rejected.push(spot);
            }
        }
        let good: Vec<(usize, usize)> =
            lit.iter().copied().filter(|pair| !bad.contains(pair) && !self.rejected.contains(&pair.1)).collect();
        if good.len() < lit.len() {
            self.fit_pairs(&good);
        }
    }

    /// Offsets of mirrors that were located for the first time start at the means of their grids.
    fn start_offsets(&mut self) {
        let known: Vec<usize> = self.lit_pairs().iter().map(|(mirror, _)| *mirror).collect();
        let Some(estimate) = &mut self.estimate else { return };
        for (mirror, job) in self.jobs.iter().enumerate().filter(|(_, job)| job.state != State::Excluded) {
            if !known.contains(&mirror) {
                continue;
            }
            let (mean, _) = job.grid.moments();
            for (axis, mean) in mean.iter().enumerate() {
                estimate.values[estimate.layout.offset(mirror, axis)] += mean;
            }
        }
        self.jobs.clear();
    }

    fn fit_pairs(&mut self, pairs: &[(usize, usize)]) {
        let used: Vec<Reading> =
            self.readings.iter().filter(|reading| pairs.contains(&(reading.mirror, reading.spot))).copied().collect();
        let Some(estimate) = &self.estimate else { return };
        let fitted = fit::fit(self.data(&used), estimate.values.clone());
        self.estimate = Some(fitted);
    }

    /// The pairs whose readings do not fit.
    fn bad_pairs(&self, pairs: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let Some(estimate) = &self.estimate else { return Vec::new() };
        let data = self.data(&[]);
        let is_bad = |pair: &(usize, usize)| {
            let quantities = data.quantities(&estimate.layout, &estimate.values, *pair);
            let peak = data.peak(&quantities, *pair);
            let (mut sum, mut count) = (0.0, 0);
            for reading in self.readings.iter().filter(|reading| (reading.mirror, reading.spot) == *pair) {
                let gain = self.optics.mirror_gain((pair.0, self.spots[pair.1].led), reading.command, &quantities);
                let residual = (reading.gain - gain) / data.deviation(pair.1, gain, peak);
                // One spoiled reading among good ones is the loss function's affair.
                sum += residual.powi(2).min(4.0 * BAD_SQUARE);
                count += 1;
            }
            count >= JUDGED_READINGS && sum > BAD_SQUARE * f64::from(count as u32)
        };
        pairs.iter().copied().filter(is_bad).collect()
    }

    /// Searches mirrors that do not fit on a grid of all their offsets; whether any has moved.
    fn search_again(&mut self, bad: &[(usize, usize)]) -> bool {
        let mut mirrors: Vec<usize> = bad.iter().map(|(mirror, _)| *mirror).collect();
        mirrors.dedup();
        let mut has_moved = false;
        for mirror in mirrors {
            let mut grid = Grid::normal([0.0; 2], [SEARCH_SPREAD * self.setup.prior.offset_rad; 2]);
            for reading in self.readings.iter().filter(|reading| reading.mirror == mirror) {
                let pair = (mirror, reading.spot);
                let (data, quantities) = (self.data(&[]), self.quantities(pair));
                let (led, peak) = (self.spots[reading.spot].led, data.peak(&quantities, pair));
                grid.observe(reading.gain, peak.max(f64::MIN_POSITIVE), |offset| {
                    let mut at = quantities;
                    at[OFFSET..OFFSET + 2].copy_from_slice(&offset);
                    let gain = self.optics.mirror_gain((mirror, led), reading.command, &at);
                    Expected { gain, deviation: data.deviation(reading.spot, gain, peak) }
                });
            }
            let (mean, _) = grid.moments();
            let Some(estimate) = &mut self.estimate else { return has_moved };
            for (axis, mean) in mean.into_iter().enumerate() {
                let value = &mut estimate.values[estimate.layout.offset(mirror, axis)];
                if (mean - *value).abs() > MOVED_RAD {
                    *value = mean;
                    has_moved = true;
                }
            }
        }
        has_moved
    }

    /// The commanded angles of a mirror in the verification.
    pub(super) fn verified_aim(&self, mirror: usize, is_calibrated: bool) -> [f64; 2] {
        let spot = self.spots.len() - 1;
        let Spot { tracked_m, height_m, led, .. } = self.spots[spot];
        let mut quantities = nominal_at(tracked_m, height_m);
        if is_calibrated && self.is_known(mirror) {
            quantities = self.quantities((mirror, spot));
        } else if !is_calibrated && let Some(before) = self.before() {
            quantities = self.data(&[]).quantities(&before.layout, &before.values, (mirror, spot));
        }
        let aim = self.optics.aim((mirror, led), &quantities).unwrap_or_default();
        self.within([0, 1].map(|axis| aim[axis] - quantities[OFFSET + axis]))
    }

    /// Makes the estimate of a complete place, and goes on to the next place of the setup.
    pub(super) fn end_place(&mut self, place: usize) {
        self.fit();
        self.go_to(place + 1);
    }

    /// Awaits the receiver at a place of the setup. A refinement without a change has nothing to verify.
    pub(super) fn go_to(&mut self, place: usize) {
        self.stage = Stage::Await(place);
        let has_change = self.changes.iter().any(|change| change.turned_deg.is_some());
        if self.is_refinement() && place >= self.setup.spots.len() && !has_change {
            self.end();
        }
    }

    /// The end: the result of everything.
    pub(super) fn end(&mut self) {
        self.stage = Stage::Ended;
        let Some(estimate) = &self.estimate else { return };
        let lit = self.lit_pairs();
        let bad = self.bad_pairs(&lit);
        let spots: Vec<usize> = (0..self.spots.len()).collect();
        let input = outcome::Input {
            optics: &self.optics,
            estimate,
            spots: &self.spots,
            places: &self.places,
            verification: &self.verification,
            rejected: &self.rejected,
            changes: &self.changes,
            lit: &lit,
            bad: &bad,
            unusable: &self.setup.unusable,
            readings: self.readings.len(),
            grouped: self.readings.iter().filter(|reading| self.spots[reading.spot].group > 1).count(),
            noise: (self.noise.count > 0.0).then(|| {
                [self.noise.position_square, self.noise.velocity_square].map(|sum| (sum / self.noise.count).sqrt())
            }),
            channel_noise: crate::stand::median(
                &spots.iter().map(|spot| self.spots[*spot].noise_relative).collect::<Vec<_>>(),
            ),
        };
        self.outcome = Some(Outcome::of(&input));
    }
}

/// Standard deviation of roll and yaw at which a mirror's light is centred on a place, in rad, by an
/// estimate. `places`: the parameters that are the place's coordinates.
pub fn aim_deviation(
    optics: &crate::optics::Optics,
    estimate: &Estimate,
    (mirror, led): (usize, usize),
    quantities: &Quantities,
    places: [Option<usize>; 2],
) -> [f64; 2] {
    let layout = &estimate.layout;
    let mut parameters: Vec<(usize, usize)> = [0, 1, 2].map(|axis| (LED + axis, layout.led(led, axis))).to_vec();
    parameters.push((RAISE, layout.raise()));
    for (axis, place) in places.into_iter().enumerate() {
        // A place in the tracker's frame moves with its shift.
        parameters.push((PLACE + axis, place.unwrap_or(layout.shift(axis))));
    }
    let mut gradients: Vec<(usize, [f64; 2])> = Vec::new();
    for (quantity, parameter) in parameters {
        let moved = |step: f64| {
            let mut at = *quantities;
            at[quantity] += step;
            optics.aim((mirror, led), &at).unwrap_or_default()
        };
        let (up, down) = (moved(AIM_STEP_M), moved(-AIM_STEP_M));
        gradients.push((parameter, [0, 1].map(|axis| (up[axis] - down[axis]) / (2.0 * AIM_STEP_M))));
    }
    [0, 1].map(|axis| {
        let own = (layout.offset(mirror, axis), -1.0);
        let row = || std::iter::once(own).chain(gradients.iter().map(|(parameter, slope)| (*parameter, slope[axis])));
        let mut variance = 0.0;
        for (a, slope_a) in row() {
            for (b, slope_b) in row() {
                variance += slope_a * slope_b * estimate.covariance[(a, b)];
            }
        }
        variance.max(1e-10).sqrt()
    })
}
