//! One array of the simulated room: its announcements, and its emergency stop on disk.

use heliostat_array::latch::Latch;
use heliostat_array::moment::Moment;
use heliostat_array::stop_record::with_record_problem;
use heliostat_driver::stop_record::{StopLog, StopRecord};
use heliostat_proto::{ArrayState, Stamp};
use heliostat_room::SimulatedRoom;

use crate::error::NodeError;
use crate::session::RoomSession;

/// What was published of an array.
pub(crate) struct ArrayNode {
    index: usize,
    telemetry_sequence: u64,
    capabilities_sequence: u64,
    safety_sequence: u64,
    stops_sequence: u64,
    /// The emergency stop on disk.
    record: Option<StopRecord>,
    /// The state in the last telemetry, and whether the mirrors had executed a stop.
    published_state: (ArrayState, bool),
    /// The latch in the last reports, and whether the mirrors had executed it; `None` before the first.
    published_latch: Option<(Latch, bool)>,
    stop_log: StopLog,
    /// Name of the room, for the log.
    room_name: String,
}

impl ArrayNode {
    pub fn new(index: usize, record: Option<StopRecord>, room_name: String) -> Self {
        Self {
            index,
            telemetry_sequence: 0,
            capabilities_sequence: 0,
            safety_sequence: 0,
            stops_sequence: 0,
            record,
            published_state: (ArrayState::Parked, false),
            published_latch: None,
            stop_log: StopLog::default(),
            room_name,
        }
    }

    /// Records the emergency stop, before telemetry reports it; `again` repeats a write that
    /// failed.
    pub fn keep_latch(&mut self, room: &SimulatedRoom, again: bool) {
        let Some(record) = &mut self.record else { return };
        if let Err(error) = record.keep(room.array(self.index).latch(), again) {
            tracing::error!("{error}");
        }
    }

    /// Why the present stop is not on the disk.
    pub fn record_problem(&self) -> Option<&str> {
        self.record.as_ref().and_then(StopRecord::problem)
    }

    /// Whether the present stop is on the disk; `None` where it is not kept.
    pub fn is_recorded(&self) -> Option<bool> {
        self.record.as_ref().map(|record| record.problem().is_none())
    }

    /// Whether the latch, or what the mirrors have executed of it, differs from the last reports.
    pub fn has_new_latch(&self, room: &SimulatedRoom) -> bool {
        let (latch, is_executed) = (room.array(self.index).latch(), room.device_stopped(self.index));
        self.published_latch.as_ref().is_none_or(|published| published.0 != *latch || published.1 != is_executed)
    }

    /// Publishes telemetry when it is `due`, or when the array's state has changed.
    pub fn publish_telemetry(
        &mut self,
        room: &mut SimulatedRoom,
        session: &mut RoomSession,
        (now, due): (Moment, bool),
    ) -> Result<(), NodeError> {
        let state = (room.array(self.index).state(), room.device_stopped(self.index));
        if !due && state == self.published_state {
            return Ok(());
        }
        self.published_state = state;
        let stamp = next_stamp(&mut self.telemetry_sequence, session, now);
        session.array(self.index).publish_telemetry(&room.telemetry(self.index, stamp)).map_err(NodeError::from)
    }

    pub fn publish_capabilities(
        &mut self,
        room: &SimulatedRoom,
        session: &mut RoomSession,
        now: Moment,
    ) -> Result<(), NodeError> {
        let stamp = next_stamp(&mut self.capabilities_sequence, session, now);
        Ok(session.array(self.index).publish_capabilities(&room.capabilities(self.index, stamp))?)
    }

    /// Publishes the safety report and the stop report.
    pub fn publish_safety(
        &mut self,
        room: &SimulatedRoom,
        session: &mut RoomSession,
        now: Moment,
    ) -> Result<(), NodeError> {
        let stamp = next_stamp(&mut self.safety_sequence, session, now);
        let latch = room.array(self.index).latch();
        if self.published_latch.as_ref().is_some_and(|published| published.0 != *latch) {
            self.stop_log.change(&self.room_name, latch);
        }
        self.published_latch = Some((latch.clone(), room.device_stopped(self.index)));
        session.array(self.index).publish_safety(&room.safety(self.index, stamp))?;
        let stamp = next_stamp(&mut self.stops_sequence, session, now);
        let stops = with_record_problem(room.stops(self.index, stamp), self.record_problem());
        Ok(session.array(self.index).publish_stops(&stops)?)
    }
}

fn next_stamp(sequence: &mut u64, session: &RoomSession, now: Moment) -> Stamp {
    *sequence += 1;
    session.stamp(*sequence, now.room_ns)
}
