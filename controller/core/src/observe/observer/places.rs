//! Places that a policy predicts by the last reports about each user.

use heliostat_channel::Vec3;

use super::{Correct, Correctable, Observer};
use crate::observe::walk_history::WalkHistory;

impl Observer {
    /// Keeps the last reports by which a policy predicts places, or does not. Allocates where it
    /// begins; no effect where it continues.
    pub fn keep_walks(&mut self, keeps: bool) {
        if keeps != self.walks.is_some() {
            self.walks = keeps.then(WalkHistory::default);
        }
    }

    /// The last reports and the rows of the last observation; absent where the policy predicts no
    /// places.
    pub fn walks(&self) -> Option<&WalkHistory> {
        self.walks.as_ref()
    }

    /// Lets the policy predict the places, which replace those of the belief.
    pub(super) fn predict_places(&mut self, age_s: f64, predict: Correct<'_>) {
        let Some(walks) = &mut self.walks else { return };
        walks.begin();
        let lead_s = age_s + self.prediction.lead_s();
        for (user, position) in self.slots.ids().iter().zip(&self.positions) {
            walks.add((*user, [position.x, position.y]), lead_s, self.prediction.half_room_m());
        }
        predict(Correctable::Places(walks));
        for (position, [x, y]) in self.positions.iter_mut().zip(walks.places_m()) {
            *position = self.prediction.within_room(Vec3::new(*x, *y, position.z));
        }
    }
}
