//! From payloads to published commands: passes inputs to the core of the room, and records stage
//! times.
//!
//! There is one decision loop per room, behind a mutex. Two threads decide for reports:
//!
//! - the transport's callback, which needs no other thread to be woken. While it decides, further
//!   payloads wait in the transport, and the oldest report gets the first decision;
//! - the room's thread ([`run`]), which empties the [receive queue](super::receive_queue) before it
//!   decides. A tick that a newer one supersedes then costs no decision. This thread also warms up
//!   the caches for a slow policy (see [cache warmer](super::cache_warmer)).
//!
//! [`PayloadHandler::handle`] chooses. The callback decides if it can. It queues the payload for
//! the room's thread in four cases: the queue is not empty, another thread holds the lock, the
//! payload came right after the last decision, or it is a position report and the room's thread
//! keeps the caches warm. After a report has waited long for that thread, the last case is left out
//! for a while. The main thread holds the lock to act on missing reports, to exchange stage times
//! and to copy counters; callbacks hold it to pass on liveliness, stop orders and capabilities if it
//! is free (see `announcements.rs`); the thread of policy swaps holds it to
//! replace the policy.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use heliostat_core::{
    core::{Stage, Timing},
    policy::Policy,
    refusal::Stream,
    room_core::{Answered, Handled, Input, InputChannel, InputKey, RoomCore},
};
use heliostat_proto::Nanos;
use heliostat_service::clock::utc_ns;

use super::{
    announcements::Announcements,
    cache_warmer::{Action, CacheWarmer},
    locks::{lock, try_lock},
    receive_queue::{ReceiveQueue, Wake},
    transport::Transport,
};
use crate::report::stage_times::{StageStamps, StageTimes};

/// A report that arrives within this time after a decision indicates a backlog. The callback then
/// queues it for the room's thread.
const BACKLOG_GAP: Duration = Duration::from_micros(50);

/// The decision loop of one room.
pub struct DecisionLoop {
    /// The core of the room.
    pub room: RoomCore,
    /// Stage times since the status loop last took them.
    pub times: StageTimes,
    /// The same of policies that were replaced since then, each with the policy's name.
    pub former_times: Vec<(String, StageTimes)>,
    transport: Transport,
    warmer: CacheWarmer,
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
    /// `deadline` is late. It warms up no caches.
    pub fn new(room: RoomCore, transport: Transport, deadline: Duration) -> Self {
        Self {
            room,
            times: StageTimes::new(),
            former_times: Vec::new(),
            transport,
            warmer: CacheWarmer::new(false),
            due: None,
            deadline,
            was_late: false,
            last_decision: None,
            times_from_tick: 0,
        }
    }

    /// Whether the room's thread warms up the caches for a slow policy.
    pub fn warming_up(mut self, warms_up: bool) -> Self {
        self.warmer = CacheWarmer::new(warms_up);
        self
    }

    /// The statistics of times begin with the report of this tick.
    pub fn timed_from(mut self, tick: u64) -> Self {
        self.times_from_tick = tick;
        self
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
            self.warmer.on_report(entered);
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
        match timing {
            Timing::InTime => self.warmer.on_decision(ended - started, ended),
            Timing::Late => self.warmer.on_late_decision(ended),
        }
        self.last_decision = Some(ended);
        self.room.publish_state(&mut self.transport);
    }

    /// Replaces the policy, and returns the former one. `fresh` is empty: the times of the former
    /// policy are kept apart.
    pub fn replace_policy(&mut self, policy: Box<dyn Policy>, fresh: StageTimes) -> Handled {
        let times = std::mem::replace(&mut self.times, fresh);
        self.former_times.push((self.room.controller().policy_name().to_owned(), times));
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

    /// Cache warm-ups so far.
    pub fn cache_warm_ups(&self) -> u64 {
        self.warmer.warm_ups()
    }

    /// Whether a callback has to queue a payload for the room's thread.
    fn is_for_thread(&self, stream: Stream, entered: Instant) -> bool {
        let is_kept_warm = stream == Stream::Users && self.warmer.is_worthwhile();
        let is_backlog = self.last_decision.is_some_and(|ended| entered.saturating_duration_since(ended) < BACKLOG_GAP);
        is_kept_warm || is_backlog
    }

    /// Repeats the last decision without a command.
    fn warm_cache(&mut self) {
        let started = Instant::now();
        self.room.warm_cache();
        self.warmer.on_warm_up(started.elapsed());
    }

    /// A decision is late if its predicted latency exceeds the deadline: the waiting time plus the
    /// mean duration of earlier decisions. Two consecutive decisions are never late, so that the
    /// policy decides again. In lockstep the room waits.
    fn timing(&mut self, waited: Duration) -> Timing {
        let predicted = waited + self.warmer.expected_decision();
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
        match free.filter(|held| !held.is_for_thread(channel.stream, entered)) {
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

/// The room's thread: decides for the reports in the queue, and warms up the caches in between.
/// Ends when the queue is closed.
pub fn run(handler: &PayloadHandler) {
    let PayloadHandler { decision_loop, queue, announcements, .. } = handler;
    loop {
        let action = lock(decision_loop).warmer.next_action(Instant::now());
        match action {
            Action::Wait(limit) => match queue.wait(limit) {
                Wake::Closed => return,
                Wake::TimedOut => {}
                Wake::Filled => {
                    let mut decision_loop = lock(decision_loop);
                    announcements.settle_in(&mut decision_loop);
                    drain(queue, &mut decision_loop);
                }
            },
            Action::WarmUp if queue.has_arrival() => lock(decision_loop).warmer.on_arrival(),
            Action::WarmUp => {
                // A thread that holds the lock is deciding, which warms more than a cache warm-up.
                if let Some(mut decision_loop) = try_lock(decision_loop) {
                    decision_loop.warm_cache();
                }
            }
            Action::Spin(until) => queue.spin(until),
        }
        announcements.settle();
    }
}

/// Handles all waiting payloads, then decides for the newest tick.
fn drain(queue: &ReceiveQueue, decision_loop: &mut DecisionLoop) {
    decision_loop.warmer.on_arrival();
    while let Some(arrival) = queue.pop() {
        if arrival.channel.stream == Stream::Users {
            decision_loop.warmer.on_wait(arrival.entered.elapsed());
        }
        decision_loop.handle_report(arrival.channel, &arrival.payload, arrival.entered);
        queue.recycle(arrival.payload);
    }
    decision_loop.decide();
}
