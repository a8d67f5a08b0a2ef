//! From payloads to published commands: decodes, calls the core, passes commands to the sender, and
//! records stage times.
//!
//! There is one decision loop per room, behind a mutex. Two threads decide for reports:
//!
//! - the transport's callback, which needs no other thread to be woken. While it decides, further
//!   payloads wait in the transport, and the oldest report gets the first decision;
//! - the room's thread ([`run`]), which empties the [receive queue](super::receive_queue) before it
//!   decides. A tick that a newer one supersedes then costs no decision. This thread also warms up
//!   the caches for a slow policy (see [cache warmer](super::cache_warmer)).
//!
//! [`PayloadHandler::handle`] chooses. By default the callback decides. It queues the payload for
//! the room's thread in four cases: the queue is not empty, another thread holds the lock, the
//! payload came right after the last decision, or it is a position report and the room's thread
//! keeps the caches warm. After a report has waited long for that thread, the last case is left out
//! for a while. The main thread holds the lock to act on missing reports, to exchange stage times
//! and to copy counters; callbacks hold it to pass on liveliness, stop orders and capabilities; the
//! thread of policy swaps holds it to replace the policy.

mod message_buffers;

use std::{
    sync::{Arc, Mutex, MutexGuard},
    time::{Duration, Instant},
};

use heliostat_core::{
    core::{Controller, Decision, Due, Stage, Timing},
    inbox::Message,
    policy::Policy,
    refusal::{Refusal, Stream},
};
use heliostat_proto::{ArrayState, CodecError, Nanos};

use super::{
    cache_warmer::{Action, CacheWarmer, KeepWarm},
    command_sender::CommandSender,
    input_channel::InputChannel,
    locks::{lock, try_lock},
    receive_queue::{ReceiveQueue, Wake},
    room_clock::RoomClock,
    state_publisher::StatePublisher,
    stop_repeater::HeldStops,
};
use crate::report::stage_times::{StageStamps, StageTimes};
use message_buffers::MessageBuffers;

/// A report that arrives within this time after a decision indicates a backlog. The callback then
/// queues it for the room's thread.
const BACKLOG_GAP: Duration = Duration::from_micros(50);

/// Where a room's decisions are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum DecideIn {
    /// In the callback; on the room's thread during a backlog, while the room is busy, or if its
    /// caches are kept warm
    Auto,
    /// In the callback that receives the report, on the transport's thread; a backlog waits in the
    /// transport
    Callback,
    /// On the room's thread
    Thread,
}

/// Where decisions are made, and whether the caches are kept warm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecisionSettings {
    /// Where.
    pub decide_in: DecideIn,
    /// Whether the room's thread warms up the caches.
    pub keep_warm: KeepWarm,
    /// The statistics of times begin with the report of this tick.
    pub times_from_tick: u64,
}

impl DecisionSettings {
    /// The settings in a process of this number of rooms. The decisions of several rooms keep the
    /// caches warm, and cache warm-ups would delay them.
    pub fn among(self, rooms: usize) -> Self {
        Self { keep_warm: if rooms > 1 { KeepWarm::Off } else { self.keep_warm }, ..self }
    }

    /// Whether a room needs a thread.
    pub fn has_thread(self) -> bool {
        self.decide_in != DecideIn::Callback
    }
}

impl Default for DecisionSettings {
    fn default() -> Self {
        Self { decide_in: DecideIn::Auto, keep_warm: KeepWarm::Expected, times_from_tick: 0 }
    }
}

/// The decision loop of one room.
pub struct DecisionLoop {
    /// The decision core.
    pub controller: Controller,
    /// Stage times since the status loop last took them.
    pub times: StageTimes,
    /// The same of policies that were replaced since then, each with the policy's name.
    pub former_times: Vec<(String, StageTimes)>,
    clock: RoomClock,
    sender: CommandSender,
    stops: Arc<HeldStops>,
    warmer: CacheWarmer,
    states: StatePublisher,
    /// Decoded into, and swapped with the core's former reports.
    buffers: MessageBuffers,
    /// The stamps of the tick that is due.
    due: Option<StageStamps>,
    /// A decision whose predicted latency exceeds it is late.
    deadline: Duration,
    /// Whether the last decision was made without the policy.
    was_late: bool,
    last_decision: Option<Instant>,
    unsent: u64,
    superseded: u64,
    last_malformed: Option<CodecError>,
    times_from_tick: u64,
}

impl DecisionLoop {
    /// A loop around a core after its start-up warm-up. A decision whose predicted latency exceeds
    /// `deadline` is late. It warms up no caches.
    pub fn new(
        controller: Controller,
        clock: RoomClock,
        deadline: Duration,
        (sender, states): (CommandSender, StatePublisher),
        stops: Arc<HeldStops>,
    ) -> Self {
        Self {
            controller,
            times: StageTimes::new(),
            former_times: Vec::new(),
            clock,
            sender,
            stops,
            warmer: CacheWarmer::new(false),
            states,
            buffers: MessageBuffers::new(),
            due: None,
            deadline,
            was_late: false,
            last_decision: None,
            unsent: 0,
            superseded: 0,
            last_malformed: None,
            times_from_tick: 0,
        }
    }

    /// Applies the settings. In lockstep, which has no deadline, no caches are warmed up.
    pub fn with_settings(mut self, settings: DecisionSettings) -> Self {
        self.warmer = CacheWarmer::new(settings.keep_warm == KeepWarm::Expected && self.clock == RoomClock::Utc);
        self.times_from_tick = settings.times_from_tick;
        self
    }

    /// Decodes a payload and passes it to the core; `entered` is when its callback was entered.
    pub fn handle_payload(&mut self, channel: InputChannel, payload: &[u8], entered: Instant) {
        let mut stamps = StageStamps::start(entered);
        stamps.mark(Stage::Waited);
        let message = match self.buffers.decode(channel, payload) {
            Ok(message) => message,
            Err(error) => {
                self.controller.handle_malformed((channel.stream, channel.array), Refusal::from(&error));
                self.last_malformed = Some(error);
                return;
            }
        };
        if let Message::Telemetry(array, telemetry) = &message
            && *array < self.controller.arrays()
            && self.controller.admits_array(*array, telemetry.stamp.source)
        {
            let is_stopped = telemetry.state == ArrayState::Stopped;
            self.stops.handle_state(*array, telemetry.stamp.source, is_stopped);
        }
        let now = self.clock.at_arrival(message.stamp().time_ns);
        match self.controller.handle_message(now, message) {
            Due::Command => {
                self.warmer.on_report(entered);
                stamps.mark(Stage::Decoded);
                self.superseded += u64::from(self.due.replace(stamps).is_some());
            }
            Due::StaleCommand => {
                let decision = self.controller.poll_stale_command(now);
                self.unsent += u64::from(!self.sender.send(decision));
            }
            Due::Nothing => {}
        }
    }

    /// Decides for the newest tick that is due, if one is.
    pub fn decide(&mut self) {
        let Some(mut stamps) = self.due.take() else { return };
        let started = Instant::now();
        let timing = self.timing(stamps.waited(started));
        let now = self.clock.now();
        let decision = self.controller.poll_command(now, timing, &mut |stage| stamps.mark(stage));
        let measured_age_ns = match &decision {
            Decision::Move { command, age_ns, .. } if command.answers >= self.times_from_tick => Some(*age_ns),
            Decision::Move { .. } | Decision::Hold(_) => None,
        };
        let sent = self.sender.send(decision);
        stamps.mark(Stage::Published);
        self.unsent += u64::from(!sent);
        if let Some(age_ns) = measured_age_ns {
            self.times.record(&stamps, age_ns);
        }
        let ended = Instant::now();
        match timing {
            Timing::InTime => self.warmer.on_decision(ended - started, ended),
            Timing::Late => self.warmer.on_late_decision(ended),
        }
        self.last_decision = Some(ended);
        if timing == Timing::InTime {
            self.states.after_decision(&mut self.controller, now);
        }
    }

    /// Replaces the policy, and returns the former one. `fresh` is empty: the times of the former
    /// policy are kept apart.
    pub fn replace_policy(&mut self, policy: Box<dyn Policy>, fresh: StageTimes) -> Box<dyn Policy> {
        let times = std::mem::replace(&mut self.times, fresh);
        self.former_times.push((self.controller.policy_name().to_owned(), times));
        self.controller.replace_policy(policy)
    }

    /// Executes the action for the absence of position reports, if that is due.
    pub fn handle_timeout(&mut self) {
        if let Some(decision) = self.controller.poll_timeout_command(self.clock.now()) {
            self.unsent += u64::from(!self.sender.send(decision));
        }
    }

    /// Room time now.
    pub fn room_time_ns(&self) -> Nanos {
        self.clock.now()
    }

    /// Commands that the transport refused.
    pub fn unsent(&self) -> u64 {
        self.unsent
    }

    /// Ticks that a newer one superseded before a decision.
    pub fn superseded(&self) -> u64 {
        self.superseded
    }

    /// Cache warm-ups so far.
    pub fn cache_warm_ups(&self) -> u64 {
        self.warmer.warm_ups()
    }

    /// The error of the last payload that did not decode.
    pub fn last_malformed(&self) -> Option<&CodecError> {
        self.last_malformed.as_ref()
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
        self.controller.warm_cache();
        self.warmer.on_warm_up(started.elapsed());
    }

    /// A decision is late if its predicted latency exceeds the deadline: the waiting time plus the
    /// mean duration of earlier decisions. Two consecutive decisions are never late, so that the
    /// policy decides again. In lockstep the room waits.
    fn timing(&mut self, waited: Duration) -> Timing {
        let predicted = waited + self.warmer.expected_decision();
        let is_late = self.clock == RoomClock::Utc && !self.was_late && predicted > self.deadline;
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
    /// Where decisions are made.
    pub decide_in: DecideIn,
}

impl PayloadHandler {
    /// Handles a payload in the callback that was entered at `entered`.
    pub fn handle(&self, channel: InputChannel, payload: &[u8], entered: Instant) {
        let at_once: Option<MutexGuard<'_, DecisionLoop>> = match self.decide_in {
            DecideIn::Callback => Some(lock(&self.decision_loop)),
            DecideIn::Thread => None,
            // The room's thread drains the queue under the lock. A new payload therefore cannot
            // overtake a queued one.
            DecideIn::Auto if !self.queue.is_empty() => None,
            DecideIn::Auto => try_lock(&self.decision_loop).filter(|held| !held.is_for_thread(channel.stream, entered)),
        };
        match at_once {
            Some(mut decision_loop) => {
                decision_loop.handle_payload(channel, payload, entered);
                decision_loop.decide();
            }
            None => self.queue.push(channel, payload, entered),
        }
    }
}

/// The room's thread: decides for the reports in the queue, and warms up the caches in between.
/// Ends when the queue is closed.
pub fn run(decision_loop: &Mutex<DecisionLoop>, queue: &ReceiveQueue) {
    loop {
        let action = lock(decision_loop).warmer.next_action(Instant::now());
        match action {
            Action::Wait(limit) => match queue.wait(limit) {
                Wake::Closed => return,
                Wake::TimedOut => {}
                Wake::Filled => drain(queue, &mut lock(decision_loop)),
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
    }
}

/// Handles all waiting payloads, then decides for the newest tick.
fn drain(queue: &ReceiveQueue, decision_loop: &mut DecisionLoop) {
    decision_loop.warmer.on_arrival();
    while let Some(arrival) = queue.pop() {
        if arrival.channel.stream == Stream::Users {
            decision_loop.warmer.on_wait(arrival.entered.elapsed());
        }
        decision_loop.handle_payload(arrival.channel, &arrival.payload, arrival.entered);
        queue.recycle(arrival.payload);
    }
    decision_loop.decide();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_that_share_a_process_do_not_warm_up_caches() {
        let settings = DecisionSettings::default();
        let kept_warm = [1, 2].map(|rooms| settings.among(rooms).keep_warm);
        assert_eq!(kept_warm, [KeepWarm::Expected, KeepWarm::Off]);
    }

    #[test]
    fn only_decisions_in_the_callback_need_no_thread() {
        let has_thread = |decide_in| DecisionSettings { decide_in, ..DecisionSettings::default() }.has_thread();
        assert_eq!([DecideIn::Auto, DecideIn::Callback, DecideIn::Thread].map(has_thread), [true, false, true]);
    }
}
