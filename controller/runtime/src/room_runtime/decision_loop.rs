//! From payloads to published commands: passes inputs to the core of the room, and records stage
//! times.
//!
//! There is one decision loop per room, behind a mutex. Two threads decide for reports:
//!
//! - the transport's callback, which needs no other thread to be woken. While it decides, further
//!   payloads wait in the transport, and the oldest report gets the first decision;
//! - the room's thread ([`run`]), which empties the [receive queue](super::receive_queue) before it
//!   decides. A tick that a newer one supersedes then costs no decision.
//!
//! [`PayloadHandler::handle`] chooses. The callback decides if it can. It queues the payload for
//! the room's thread in three cases: the queue is not empty, another thread holds the lock, or the
//! payload came right after the last decision. The main thread holds the lock to act on missing
//! reports, to exchange stage times and to copy counters; callbacks hold it to pass on liveliness,
//! stop orders and capabilities if it is free (see `announcements.rs`); the thread of policy swaps
//! holds it to replace the policy.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_core::{
    core::{Stage, Timing},
    policy::Policy,
    room_core::{Answered, Handled, Input, InputChannel, InputKey, RoomCore},
};
use heliostat_proto::Nanos;
use heliostat_service::clock::utc_ns;
use heliostat_service::locks::{lock, try_lock};

use super::{announcements::Announcements, receive_queue::ReceiveQueue, transport::Transport};
use crate::report::stage_times::{StageStamps, StageTimes};

/// A report that arrives within this time after a decision indicates a backlog. The callback then
/// queues it for the room's thread.
const BACKLOG_GAP: Duration = Duration::from_micros(50);

/// Share of the newest decision in the mean duration: alpha of RFC 6298, section 2.
const NEWEST_SHARE: f64 = 0.125;

/// The decision loop of one room.
pub struct DecisionLoop {
    /// The core of the room.
    pub room: RoomCore,
    /// Stage times since the status loop last took them.
    pub times: StageTimes,
    /// The same of policies that were replaced since then, each with the policy's name.
    pub former_times: Vec<(String, StageTimes)>,
    transport: Transport,
    /// Exponentially weighted mean duration of the policy's decisions, by which the next one is
    /// predicted; none before the first.
    mean_decision: Option<Duration>,
    /// The stamps of the tick that is due.
    due: Option<StageStamps>,
    /// A decision whose predicted latency exceeds it is late.
    deadline: Duration,
    /// Whether the last decision was made without the policy.
    was_late: bool,
    last_decision: Option<Instant>,
    times_from_tick: u64,
}

impl DecisionLoop {
    /// A loop around a core after its start-up warm-up. A decision whose predicted latency exceeds
    /// `deadline` is late. The statistics of times begin with the report of the tick `times_from_tick`.
    pub fn new(room: RoomCore, transport: Transport, deadline: Duration, times_from_tick: u64) -> Self {
        Self {
            room,
            times: StageTimes::default(),
            former_times: Vec::new(),
            transport,
            mean_decision: None,
            due: None,
            deadline,
            was_late: false,
            last_decision: None,
            times_from_tick,
        }
    }

    /// Passes an input to the core now.
    pub fn handle(&mut self, input: Input<'_>) -> Handled {
        self.room.handle(utc_ns(), input, &mut self.transport)
    }

    /// Passes a report to the core; `entered` is when its callback was entered.
    pub fn handle_report(&mut self, channel: InputChannel, payload: &[u8], entered: Instant) {
        let mut stamps = StageStamps::start(entered);
        stamps.mark(Stage::Waited);
        let handled = self.handle(Input::Payload { key: InputKey::Report(channel), bytes: payload });
        if let Handled::DecisionDue = handled {
            stamps.mark(Stage::Decoded);
            self.due = Some(stamps);
        }
    }

    /// Decides for the newest tick that is due, if one is.
    pub fn decide(&mut self) {
        let Some(mut stamps) = self.due.take() else { return };
        let started = Instant::now();
        let timing = self.timing(stamps.waited(started));
        let mut mark = |stage| stamps.mark(stage);
        let answered = self.room.decide(utc_ns(), timing, &mut mark, &mut self.transport);
        if let Some(Answered { tick, age_ns }) = answered
            && tick >= self.times_from_tick
        {
            self.times.record(&stamps, age_ns);
        }
        let ended = Instant::now();
        if timing == Timing::InTime {
            let took = ended - started;
            self.mean_decision = Some(
                self.mean_decision.map_or(took, |mean| mean.mul_f64(1.0 - NEWEST_SHARE) + took.mul_f64(NEWEST_SHARE)),
            );
        }
        self.last_decision = Some(ended);
        self.room.publish_state(&mut self.transport);
    }

    /// Replaces the policy, and returns the former one. `fresh` is empty: the times of the former
    /// policy are kept apart.
    pub fn replace_policy(&mut self, policy: Box<dyn Policy>, fresh: StageTimes) -> Handled {
        let times = std::mem::replace(&mut self.times, fresh);
        self.former_times.push((self.room.controller().policy().name().to_owned(), times));
        self.handle(Input::Policy(policy))
    }

    /// Room time now.
    pub fn room_time_ns(&self) -> Nanos {
        self.room.room_time_ns(utc_ns())
    }

    /// Commands that the transport refused.
    pub fn unsent(&self) -> u64 {
        self.transport.unsent()
    }

    /// Whether a payload came right after the last decision.
    fn is_backlog(&self, entered: Instant) -> bool {
        self.last_decision.is_some_and(|ended| entered.saturating_duration_since(ended) < BACKLOG_GAP)
    }

    /// A decision is late if its predicted latency exceeds the deadline: the waiting time plus the
    /// mean duration of earlier decisions. Two consecutive decisions are never late, so that the
    /// policy decides again. In lockstep the room waits.
    fn timing(&mut self, waited: Duration) -> Timing {
        let predicted = waited + self.mean_decision.unwrap_or_default();
        let is_late = !self.room.is_lockstep() && !self.was_late && predicted > self.deadline;
        self.was_late = is_late;
        if is_late { Timing::Late } else { Timing::InTime }
    }
}

/// The entry of payloads: decides in the callback, or queues the payload for the room's thread.
#[derive(Clone)]
pub struct PayloadHandler {
    /// The loop that decides.
    pub decision_loop: Arc<Mutex<DecisionLoop>>,
    /// The queue of the room's thread.
    pub queue: Arc<ReceiveQueue>,
    /// What waits for the loop.
    pub announcements: Announcements,
}

impl PayloadHandler {
    /// Handles a payload in the callback that was entered at `entered`.
    pub fn handle(&self, channel: InputChannel, payload: &[u8], entered: Instant) {
        // The room's thread drains the queue under the lock. A new payload therefore cannot overtake a queued
        // one.
        let free = if self.queue.is_empty() { try_lock(&self.decision_loop) } else { None };
        match free.filter(|held| !held.is_backlog(entered)) {
            Some(mut decision_loop) => {
                self.announcements.settle_in(&mut decision_loop);
                decision_loop.handle_report(channel, payload, entered);
                decision_loop.decide();
                drop(decision_loop);
                self.announcements.settle();
            }
            None => self.queue.push(channel, payload, entered),
        }
    }
}

/// The room's thread: decides for the reports in the queue. Ends when the queue is closed.
pub fn run(handler: &PayloadHandler) {
    let PayloadHandler { decision_loop, queue, announcements, .. } = handler;
    while queue.wait() {
        let mut held = lock(decision_loop);
        announcements.settle_in(&mut held);
        drain(queue, &mut held);
        drop(held);
        announcements.settle();
    }
}

/// Handles all waiting payloads, then decides for the newest tick.
fn drain(queue: &ReceiveQueue, decision_loop: &mut DecisionLoop) {
    while let Some(arrival) = queue.pop() {
        decision_loop.handle_report(arrival.channel, &arrival.payload, arrival.entered);
        queue.recycle(arrival.payload);
    }
    decision_loop.decide();
}
