//! The search of a spot that few mirrors light: the tracker reports it where it is not.
//!
//! The mirrors whose offsets are known best are turned to the likeliest place. One by one they give readings for the
//! fit too. Where single mirrors are too weak, all of them are lit at once: their light adds up, the noise does not.

use super::groups::Probe;
use super::timing::Purpose;
use super::{Session, Stage};
use crate::fit::Reading;
use crate::grid::{Expected, Grid};
use crate::optics::{OFFSET, PLACE};
use crate::probes::State;

/// Prior standard deviation in m of a spot that is searched.
const SEARCH_M: f64 = 0.3;

/// Mirrors by which a spot is searched one by one; as many as in a group where they are lit at once.
const SEARCH_MIRRORS: usize = 8;

/// Most readings of a search.
const SEARCH_MAX: u32 = 60;

/// Standard deviation in m at which a searched spot is found.
const FOUND_M: f64 = 0.05;

/// Half of the light's extent in m on the plane of the receiver.
const FOOTPRINT_M: [f64; 2] = [0.15, 0.12];

/// Noise at the edge of a mirror's light, which its own deviation blurs, as a share of its largest gain.
const BLUR_SHARE: f64 = 0.15;

/// A search of the present spot.
#[derive(Clone, Debug)]
pub(super) struct Search {
    /// The place of the spot.
    grid: Grid,
    readings: u32,
    /// The mirrors by which it is searched.
    mirrors: Vec<usize>,
}

impl Session {
    /// Searches the present spot, since few mirrors light it.
    pub(super) fn begin_search(&mut self, place: usize) {
        let spot = self.spots.len() - 1;
        let at = self.quantities((0, spot));
        let mut grid = Grid::normal([at[PLACE], at[PLACE + 1]], [SEARCH_M; 2]);
        for Reading { mirror, command, gain, .. } in self.readings.iter().filter(|reading| reading.spot == spot) {
            self.observe_place(&mut grid, &[(*mirror, *command)], *gain, self.spots[spot].noise_gain);
        }
        self.search = Some(Search { grid, readings: 0, mirrors: self.search_mirrors() });
        self.stage = Stage::Locate(place);
    }

    /// The mirrors by which a spot is searched: those whose offsets are known best.
    fn search_mirrors(&self) -> Vec<usize> {
        let spot = self.spots.len() - 1;
        let mut mirrors: Vec<(f64, usize)> = (0..self.jobs.len())
            .filter(|mirror| self.jobs[*mirror].state != State::Excluded && self.is_known(*mirror))
            .map(|mirror| {
                let [roll, yaw] = self.aim_deviation((mirror, spot));
                (roll.hypot(yaw), mirror)
            })
            .collect();
        mirrors.sort_by(|a, b| a.0.total_cmp(&b.0));
        mirrors.into_iter().take(SEARCH_MIRRORS.max(self.group())).map(|(_, mirror)| mirror).collect()
    }

    /// The next command of the search; `None` where no mirror can be turned to the likeliest place.
    pub(super) fn plan_search(&self) -> Option<Purpose> {
        let Search { grid, readings, .. } = self.search.as_ref()?;
        let (mut target, _) = grid.best_window(FOOTPRINT_M);
        let (mean, deviation) = grid.moments();
        if self.group() > 1 && deviation.iter().all(|deviation| *deviation < FOOTPRINT_M[0]) {
            // The lights of many mirrors are flat where they overlap: their edges show where the place is.
            let axis = usize::from(deviation[1] > deviation[0]);
            let side = [1.0, -1.0][*readings as usize % 2];
            target = mean;
            target[axis] += side * FOOTPRINT_M[axis];
        }
        (!self.search_probes(target, *readings).is_empty()).then_some(Purpose::Locate(target, *readings))
    }

    /// The mirrors that are lit at a place in this turn of the search, with their angles.
    pub(super) fn search_probes(&self, target: [f64; 2], turn: u32) -> Vec<Probe> {
        let Some(Search { mirrors, .. }) = &self.search else { return Vec::new() };
        let spot = self.spots.len() - 1;
        let probe = |mirror: &usize| {
            let mut quantities = self.quantities((*mirror, spot));
            quantities[PLACE..PLACE + 2].copy_from_slice(&target);
            let aim = self.optics.aim((*mirror, self.spots[spot].led), &quantities)?;
            let command = [0, 1].map(|axis| aim[axis] - quantities[OFFSET + axis]);
            Some((*mirror, self.within(command)))
        };
        if self.group() > 1 {
            return mirrors.iter().filter_map(probe).collect();
        }
        mirrors.get(turn as usize % mirrors.len().max(1)).and_then(probe).into_iter().collect()
    }

    /// Applies a reading of mirrors that are lit together to the place of the spot.
    fn observe_place(&self, grid: &mut Grid, probes: &[Probe], gain: f64, noise_gain: f64) {
        let spot = self.spots.len() - 1;
        let led = self.spots[spot].led;
        let known: Vec<_> = probes.iter().map(|(mirror, _)| self.quantities((*mirror, spot))).collect();
        let peaks = probes.iter().map(|(mirror, _)| self.jobs[*mirror].peak);
        let (peak, squares) = peaks.fold((0.0, 0.0), |(sum, squares), peak| (sum + peak, squares + peak * peak));
        let blur = BLUR_SHARE * f64::sqrt(squares);
        let noise = (self.spots[spot].noise_relative, noise_gain);
        grid.observe(gain, peak, |[x, y]| {
            let light = probes.iter().zip(&known).map(|((mirror, command), quantities)| {
                let mut at = *quantities;
                (at[PLACE], at[PLACE + 1]) = (x, y);
                self.optics.mirror_gain((*mirror, led), *command, &at)
            });
            let gain: f64 = light.sum();
            Expected { gain, deviation: crate::fit::deviation(noise, gain, peak).hypot(blur) }
        });
    }

    /// A reading of the search, of these mirrors.
    pub(super) fn handle_search(&mut self, place: usize, probes: &[Probe], gain: f64) {
        let Some(mut search) = self.search.take() else { return };
        let noise_gain = if self.group() > 1 { self.own_noise() } else { self.spots[self.spots.len() - 1].noise_gain };
        self.observe_place(&mut search.grid, probes, gain, noise_gain);
        search.readings += 1;
        let (mean, deviation) = search.grid.moments();
        if deviation.iter().all(|deviation| *deviation < FOUND_M) {
            self.is_located = true;
            if let Some(spot) = self.spots.last_mut() {
                spot.tracked_m = mean;
                spot.tracked_deviation_m = FOUND_M;
            }
            self.extend_estimate();
            self.stage = Stage::Probe(place);
            self.open_jobs();
        } else if search.readings >= SEARCH_MAX {
            self.reject_spot(place);
        } else {
            self.search = Some(search);
        }
    }

    /// Leaves the present spot without its readings: the receiver is not where the tracker says.
    pub(super) fn reject_spot(&mut self, place: usize) {
        let spot = self.spots.len() - 1;
        self.rejected.push(spot);
        self.readings.retain(|reading| reading.spot != spot);
        self.times.clear();
        self.jobs.clear();
        self.complete_place(place);
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_room::Room;
    use super::*;

    #[test]
    fn a_spot_in_weak_light_is_searched_with_many_mirrors_at_once() {
        let mut room = Room::new(1.0);
        room.step_until(Session::is_estimate_due);
        room.know_offsets();
        room.session.stage = Stage::Await(1);
        room.tracker_error_m = [0.4, 0.0];
        room.step_until(|session| matches!(session.stage(), Stage::Locate(_)));
        assert_eq!((room.session.group(), room.turned()), (31, 31));
        room.step_until(|session| !matches!(session.stage(), Stage::Locate(_)));
        assert_eq!((room.session.stage(), room.session.is_located), (Stage::Probe(1), true));
        let found = room.session.spots[1].tracked_m;
        let error = crate::stand::distance(found, [room.exact[PLACE], room.exact[PLACE + 1]]);
        assert!(error < 0.1, "{error} m");
    }
}
