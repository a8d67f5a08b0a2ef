//! The rate over the floor, for the heat map of the page.
//!
//! The channel model that gives the users' rates evaluates it at the present angles of the mirrors.
//! A map is computed when a page requests it, and is kept for a moment for all pages.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use heliostat_channel::{ChannelModel, LinkBudget, Scene, Vec3};
use heliostat_proto::NodeKind;
use heliostat_service::locks::lock;
use serde::Serialize;

use crate::View;

/// Points along the longer side of the room.
const POINTS: usize = 40;
/// A map of this age is sent again instead of a new one.
const KEPT: Duration = Duration::from_millis(700);

/// The rate of a receiver at points of a grid.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FloorMap {
    /// Points along x.
    pub columns: usize,
    /// Points along y.
    pub rows: usize,
    /// Rate at the height of the detectors in Mbit/s, row by row from the smallest x and y.
    pub rate_mbps: Vec<f64>,
    /// The rate at the end of the scale in Mbit/s: it only grows, so colours stay comparable.
    pub max_mbps: f64,
}

#[derive(Default)]
struct Kept {
    maps: [Option<(Instant, FloorMap)>; 2],
    /// The geometry of the scale, and its end in Mbit/s.
    scale: (String, f64),
}

/// Computes the maps of a view.
pub struct FloorMaps {
    view: Arc<View>,
    /// The last map with the mirrors, and the last one without.
    kept: Mutex<Kept>,
}

impl View {
    /// The link budget with the optical power that the room reports.
    pub(crate) fn budget(&self, model: &ChannelModel) -> LinkBudget {
        let received = self.received();
        let status = received.statuses.get(NodeKind::SimNode.name());
        let power = status.and_then(|(_, status)| status.gauge("power_w"));
        let mut budget = model.budget.clone();
        budget.power_w = power.filter(|watts| *watts > 0.0).unwrap_or(budget.power_w);
        budget
    }
}

impl FloorMaps {
    /// Maps of a view.
    pub fn new(view: Arc<View>) -> Self {
        Self { view, kept: Mutex::default() }
    }

    /// The current map; `None` if no report is recent.
    pub fn map(&self, with_mirrors: bool) -> Option<FloorMap> {
        if !self.view.received().has_users() {
            return None;
        }
        // The lock is held while computing, so that pages share one computation.
        let mut kept = lock(&self.kept);
        let slot = usize::from(with_mirrors);
        if let Some((_, map)) = kept.maps[slot].as_ref().filter(|(at, _)| at.elapsed() < KEPT) {
            return Some(map.clone());
        }
        let (geometry, mut map) = self.compute(with_mirrors);
        let so_far = if kept.scale.0 == geometry { kept.scale.1 } else { 0.0 };
        map.max_mbps = so_far.max(round_above(map.max_mbps));
        kept.scale = (geometry, map.max_mbps);
        kept.maps[slot] = Some((Instant::now(), map.clone()));
        Some(map)
    }

    /// The hash of the geometry, and the map with its largest rate.
    fn compute(&self, with_mirrors: bool) -> (String, FloorMap) {
        let now = self.view.optical_state();
        let (model, room, budget) = (&now.room.model, &now.room.scenario.room, self.view.budget(&now.room.model));
        let height_m = now.room.scenario.receiver.height_m;
        let longest = room.length_x_m.max(room.length_y_m);
        let points = |length: f64| ((POINTS as f64 * length / longest).round() as usize).max(1);
        let (columns, rows) = (points(room.length_x_m), points(room.length_y_m));
        let at = |index: usize, count: usize, length: f64| length * ((index as f64 + 0.5) / count as f64 - 0.5);
        let mut scene = Scene::new(model, 1);
        let mut gain = [0.0];
        let mut rate = |index: usize| {
            let point = Vec3::new(
                at(index % columns, columns, room.length_x_m),
                at(index / columns, rows, room.length_y_m),
                height_m,
            );
            scene.update(model, &[point], &now.blockers, &[false]);
            let sinr = if with_mirrors {
                scene.sinr(model, &now.angles, &mut gain);
                at_power_of(&budget, model, gain[0])
            } else {
                budget.sinr(scene.los_gain()[0])
            };
            hundredths(budget.rate_bps(sinr, now.users.max(1)) * 1e-6)
        };
        let rate_mbps: Vec<f64> = (0..columns * rows).map(&mut rate).collect();
        let max_mbps = rate_mbps.iter().copied().fold(0.0, f64::max);
        (now.room.id.clone(), FloorMap { columns, rows, rate_mbps, max_mbps })
    }
}

/// A SINR of the model's own power, at the power of a budget, which may differ from it.
pub(crate) fn at_power_of(budget: &LinkBudget, model: &ChannelModel, sinr: f64) -> f64 {
    sinr / model.budget.sinr(1.0) * budget.sinr(1.0)
}

/// The next of 1, 2, 5, 10, 20, 50 ... that is not below a rate.
fn round_above(rate: f64) -> f64 {
    if rate <= 0.0 {
        return 0.0;
    }
    let decade = 10_f64.powf(rate.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|step| step * decade).find(|step| *step >= rate).unwrap_or(10.0 * decade)
}

fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_the_scale_is_a_round_rate_above_the_largest() {
        for (rate, end) in [(0.0, 0.0), (0.3, 0.5), (1.0, 1.0), (13.7, 20.0), (20.1, 50.0), (51.0, 100.0)] {
            assert!((round_above(rate) - end).abs() < 1e-9, "{rate}: {}", round_above(rate));
        }
    }
}
