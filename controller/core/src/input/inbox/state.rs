//! What an inbox keeps from one message to the next, as a recording holds it.

use heliostat_proto::{ChannelReport, LedReport, ObstacleReport, OrientationReport, UserReport};
use heliostat_scenario::Scenario;
use serde::{Deserialize, Serialize};

use super::array::ArrayInbox;
use super::slot::{Owner, Slot};
use super::{Inbox, check_channel, check_obstacles, check_orientation};
use crate::input::{refusal::Stream, sequence::SequenceTrack};

/// Owners, latest reports and sequence numbers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InboxState {
    pub(super) room: Option<Owner>,
    /// The source of reports that left last; its delayed reports are refused.
    pub(super) lost_room: Option<u64>,
    pub(super) users: Slot<UserReport>,
    pub(super) channel: Slot<ChannelReport>,
    pub(super) obstacles: Slot<ObstacleReport>,
    pub(super) orientation: Slot<OrientationReport>,
    pub(super) leds: Slot<LedReport>,
    /// The sequence numbers of each stream about the room, in the order of [`Stream::ALL`].
    pub(super) tracks: [SequenceTrack; Stream::ALL.len()],
    /// The telemetry of each array.
    pub(super) arrays: Vec<ArrayInbox>,
}

impl InboxState {
    /// Without a report; memory for the largest ones.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let mut first = 0;
        let array = |mirrors: usize| {
            first += mirrors;
            ArrayInbox::new(first - mirrors, mirrors)
        };
        Self {
            room: None,
            lost_room: None,
            users: Slot { report: UserReport::buffer(), filled: false },
            channel: Slot { report: ChannelReport::buffer(), filled: false },
            obstacles: Slot::default(),
            orientation: Slot { report: OrientationReport::buffer(), filled: false },
            leds: Slot { report: LedReport::buffer(), filled: false },
            tracks: Default::default(),
            arrays: scenario.mirrors.arrays().iter().map(|array| array.rows * array.columns).map(array).collect(),
        }
    }

    /// Discards the reports about the room.
    pub(super) fn forget_room(&mut self) {
        self.users.forget();
        self.channel.forget();
        self.obstacles.forget();
        self.orientation.forget();
        self.leds.forget();
    }
}

impl Inbox {
    /// The present state, without the counters of refusals.
    pub fn state(&self) -> &InboxState {
        &self.state
    }

    /// Replaces the state; false, without a change, where it is not one of this scenario.
    pub fn restore(&mut self, state: &InboxState) -> bool {
        let fits = self.admits(state);
        if fits {
            self.state = state.clone();
            self.collect_unusable();
        }
        fits
    }

    /// Whether the arrays of a state are those of this inbox, and every report is one that it accepts.
    fn admits(&self, state: &InboxState) -> bool {
        let (arrays, own) = (&state.arrays, &self.state.arrays);
        let reports = [
            state.users.get().map(|report| self.rules.check_users(report)),
            state.channel.get().map(check_channel),
            state.obstacles.get().map(check_obstacles),
            state.orientation.get().map(check_orientation),
            state.leds.get().map(|report| self.rules.check_leds(report)),
        ];
        arrays.len() == own.len()
            && arrays.iter().zip(own).all(|(array, own)| own.admits(array))
            && reports.into_iter().flatten().all(|checked| checked.is_ok())
    }
}
