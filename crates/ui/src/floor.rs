//! The rate over the floor, for the heat map of the page.
//!
//! The channel model that gives the users' rates evaluates it at the present angles of the mirrors.
//! A map is computed when a page requests it, and is kept for a moment for all pages.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use heliostat_channel::{ChannelModel, LinkBudget, Scene, Vec3};
use heliostat_proto::NodeKind;
use serde::Serialize;

use crate::View;
use crate::scene::FrameBuilder;
use crate::view::Received;

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
    /// The largest rate of the map, in Mbit/s.
    pub max_mbps: f64,
}

/// Computes the maps of a view.
pub struct FloorMaps {
    view: Arc<View>,
    frames: FrameBuilder,
    /// The last map with the mirrors, and the last one without.
    kept: Mutex<[Option<(Instant, FloorMap)>; 2]>,
}

impl View {
    /// The link budget with the optical power that the room reports.
    pub(crate) fn budget(&self, model: &ChannelModel) -> LinkBudget {
        let received = self.received();
        let status = received.statuses.get(NodeKind::SimNode.name());
        let gauges = status.map_or(&[][..], |(_, status)| &status.gauges);
        let power = gauges.iter().find(|(name, _)| name == "power_w").map(|(_, watts)| *watts);
        let mut budget = model.budget.clone();
        budget.power_w = power.filter(|watts| *watts > 0.0).unwrap_or(budget.power_w);
        budget
    }

    /// Whether the positions of users are known.
    fn has_users(&self) -> bool {
        let received = self.received();
        Received::fresh(&received.truth).is_some() || Received::fresh(&received.users).is_some()
    }
}

impl FloorMaps {
    /// Maps of a view.
    pub fn new(view: Arc<View>) -> Self {
        Self { frames: FrameBuilder::new(Arc::clone(&view)), view, kept: Mutex::default() }
    }

    /// The current map; `None` if no report is recent.
    pub fn map(&self, with_mirrors: bool) -> Option<FloorMap> {
        if !self.view.has_users() {
            return None;
        }
        // The lock is held while computing, so that pages share one computation.
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = &mut kept[usize::from(with_mirrors)];
        if let Some((_, map)) = slot.as_ref().filter(|(at, _)| at.elapsed() < KEPT) {
            return Some(map.clone());
        }
        let map = self.compute(with_mirrors);
        *slot = Some((Instant::now(), map.clone()));
        Some(map)
    }

    fn compute(&self, with_mirrors: bool) -> FloorMap {
        let now = self.frames.optical_state();
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
                // Of the model's own power, which may differ from the present one.
                scene.sinr(model, &now.angles, &mut gain);
                gain[0] / model.budget.sinr(1.0) * budget.sinr(1.0)
            } else {
                budget.sinr(scene.los_gain()[0])
            };
            hundredths(budget.rate_bps(sinr, now.users.max(1)) * 1e-6)
        };
        let rate_mbps: Vec<f64> = (0..columns * rows).map(&mut rate).collect();
        let max_mbps = rate_mbps.iter().copied().fold(0.0, f64::max);
        FloorMap { columns, rows, rate_mbps, max_mbps }
    }
}

fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}
