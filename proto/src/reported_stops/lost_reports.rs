//! The drivers that the controllers of a room report as lost: they left before this process looked.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use crate::enumerations::NodeKind;
use crate::lost_driver::LostDriver;
use crate::messages::NodeStatus;
use crate::sources::make_place;

/// A status is published twice a second. That of a controller without a token counts for this time.
const STATUS_AGE_MAX: Duration = Duration::from_millis(2500);

/// Arrival of a status, and the lost drivers in it.
type Report = (Duration, Vec<LostDriver>);

/// The controllers that are in the room, and the lost drivers in the last status of each.
#[derive(Clone, Debug, Default)]
pub(super) struct LostReports {
    controllers: BTreeSet<u64>,
    /// By the sources of the controllers.
    last: BTreeMap<u64, Report>,
}

impl LostReports {
    /// The token of a controller has appeared, or has ended.
    pub fn handle_controller(&mut self, source: u64, is_present: bool) {
        if is_present {
            self.controllers.insert(source);
        } else {
            self.controllers.remove(&source);
            self.last.remove(&source);
        }
    }

    /// Notes the status of a controller; returns the number of arrays that its lost drivers show.
    pub fn handle_status(&mut self, now: Duration, status: &NodeStatus) -> usize {
        if status.node != NodeKind::Controller {
            return 0;
        }
        let (source, controllers) = (status.stamp.source, &self.controllers);
        self.last.retain(|source, (at, _)| counts(controllers, *source, *at, now));
        if !make_place(&mut self.last, source, |source| controllers.contains(&source)) {
            return 0;
        }
        let lost = LostDriver::all_of(status);
        let arrays = lost.iter().map(|driver| driver.array + 1).max().unwrap_or_default();
        self.last.insert(source, (now, lost));
        arrays
    }

    /// The controllers that are in the room and have published no status yet.
    pub fn unheard(&self) -> Vec<u64> {
        self.controllers.iter().copied().filter(|source| !self.last.contains_key(source)).collect()
    }

    /// The lost drivers of an array; one that several controllers report comes several times.
    pub fn of(&self, array: usize, now: Duration) -> impl Iterator<Item = &LostDriver> {
        let reports = self.last.iter().filter(move |(source, (at, _))| counts(&self.controllers, **source, *at, now));
        let all = reports.flat_map(|(_, (_, lost))| lost);
        all.filter(move |driver| driver.array == array)
    }
}

/// Whether the status of a controller counts: while it is in the room, and for some time without a token.
fn counts(controllers: &BTreeSet<u64>, source: u64, at: Duration, now: Duration) -> bool {
    controllers.contains(&source) || now.saturating_sub(at) < STATUS_AGE_MAX
}
