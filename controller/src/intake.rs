//! Who decides, and when: the callback that brought a report, or the room's own thread.
//!
//! In the callback no thread has to be woken, but what comes while it decides waits in the transport, unseen, and the oldest is answered first. So when reports
//! come faster than they are answered, callbacks only put payloads into a queue for the thread. It holds at most `CAPACITY`; beyond it the oldest is shed. The thread
//! takes all that waits before it answers, so that a tick which a newer one has replaced costs no decision.
//!
//! Between reports the thread may rehearse, which keeps code and data in the caches of the processor that decides. A policy that takes long gains more by that
//! than waking the thread costs, so it decides there too.

use std::{
    collections::VecDeque,
    fmt,
    ops::RangeInclusive,
    str::FromStr,
    sync::{
        Condvar, Mutex, MutexGuard, PoisonError, TryLockError,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use crate::desk::Desk;
use heliostat_decide::refusal::Stream;

/// Most payloads that wait.
const CAPACITY: usize = 64;

/// A buffer that has grown beyond this, in bytes, is not kept for the next payload.
const BUFFER_MAX: usize = 1 << 16;

/// A report that comes sooner than this after the last decision had been waiting for its end: reports come faster than they are answered.
const BREATH: Duration = Duration::from_micros(50);

/// One after the other before an expected report: the first brings code and data back, the second finds them.
const REHEARSALS: u32 = 2;

/// Rehearsals without an expected report end this long after the last decision.
const REHEARSE_FOR: Duration = Duration::from_millis(300);

/// Between two looks whether rehearsals are worth it again.
const IDLE: Duration = Duration::from_millis(50);

/// Pauses between rehearsals that may be asked for.
const PAUSES: RangeInclusive<Duration> = Duration::from_micros(50)..=Duration::from_secs(1);

/// Where a room's decisions are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Place {
    /// In the callback; on the room's own thread when reports come faster than they are answered, or a slow policy is kept warm
    Auto,
    /// In the callback that brings the report, on the transport's thread; what comes too fast waits in the transport
    Callback,
    /// On a thread of the room's own
    Thread,
}

/// When the room's thread rehearses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeepWarm {
    /// Never.
    Off,
    /// Before each report, so as to be done when it is expected.
    Expected,
    /// Again and again while no report comes, with this pause in between.
    Every(Duration),
}

impl FromStr for KeepWarm {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "off" | "0" => return Ok(Self::Off),
            "expected" => return Ok(Self::Expected),
            _ => {}
        }
        let pause = text.parse().ok().map(Duration::from_micros);
        let pause = pause.filter(|pause| PAUSES.contains(pause));
        pause.map(Self::Every).ok_or_else(|| "wanted off, expected, or a pause of 50 to 1000000 us".into())
    }
}

impl fmt::Display for KeepWarm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("off"),
            Self::Expected => f.write_str("expected"),
            Self::Every(pause) => write!(f, "{}", pause.as_micros()),
        }
    }
}

/// How a room's decisions are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deciding {
    /// Where.
    pub place: Place,
    /// When they are rehearsed.
    pub keep_warm: KeepWarm,
}

impl Deciding {
    /// The same in a process that serves so many rooms: where there are others, their decisions keep the caches warm, and rehearsals would take their time.
    pub fn among(self, rooms: usize) -> Self {
        let crowded = rooms > 1 && self.keep_warm == KeepWarm::Expected;
        Self { keep_warm: if crowded { KeepWarm::Off } else { self.keep_warm }, ..self }
    }

    /// Whether a room needs a thread of its own.
    pub fn has_thread(self) -> bool {
        self.place != Place::Callback || matches!(self.keep_warm, KeepWarm::Every(_))
    }
}

impl Default for Deciding {
    fn default() -> Self {
        Self { place: Place::Auto, keep_warm: KeepWarm::Expected }
    }
}

/// What one callback brought.
struct Arrival {
    stream: Stream,
    payload: Vec<u8>,
    entered: Instant,
}

/// Payloads that wait for the room's thread.
#[derive(Default)]
pub struct Intake {
    queue: Mutex<Queue>,
    filled: Condvar,
    /// Whether it was filled or closed since the last wait; can be read without holding up who fills it.
    stirred: AtomicBool,
}

#[derive(Default)]
struct Queue {
    waiting: VecDeque<Arrival>,
    spare: Vec<Vec<u8>>,
    shed: u64,
    closed: bool,
}

/// Why a wait ended.
enum Woken {
    Filled,
    TimedOut,
    Closed,
}

impl Intake {
    /// Puts a payload into the queue.
    fn push(&self, stream: Stream, payload: &[u8], entered: Instant) {
        let mut queue = lock(&self.queue);
        let oldest = if queue.waiting.len() == CAPACITY { queue.waiting.pop_front() } else { None };
        queue.shed += u64::from(oldest.is_some());
        let mut buffer = oldest.map(|arrival| arrival.payload).or_else(|| queue.spare.pop()).unwrap_or_default();
        buffer.clear();
        buffer.extend_from_slice(payload);
        queue.waiting.push_back(Arrival { stream, payload: buffer, entered });
        self.stirred.store(true, Ordering::Relaxed);
        drop(queue);
        self.filled.notify_one();
    }

    /// Handles a payload at once, if the callback that brought it may decide; otherwise the room's thread is left to.
    pub fn handle(&self, deciding: Deciding, desk: &Mutex<Desk>, stream: Stream, payload: &[u8], entered: Instant) {
        let at_once = match deciding.place {
            Place::Callback => Some(lock(desk)),
            Place::Thread => None,
            // The thread holds the desk while it works through the queue, so nothing overtakes what waits.
            Place::Auto if self.has_waiting() => None,
            Place::Auto => try_lock(desk).filter(|desk| {
                let warm =
                    stream == Stream::Users && deciding.keep_warm == KeepWarm::Expected && desk.gains_by_rehearsal();
                !(warm || desk.decided_within(BREATH, entered))
            }),
        };
        match at_once {
            Some(mut desk) => {
                desk.take(stream, payload, entered);
                desk.answer();
            }
            None => self.push(stream, payload, entered),
        }
    }

    /// Payloads that were shed because too many waited.
    pub fn shed(&self) -> u64 {
        lock(&self.queue).shed
    }

    /// Ends [`attend`].
    pub fn close(&self) {
        lock(&self.queue).closed = true;
        self.stirred.store(true, Ordering::Relaxed);
        self.filled.notify_one();
    }

    fn wait(&self, limit: Option<Duration>) -> Woken {
        let mut queue = lock(&self.queue);
        self.stirred.store(false, Ordering::Relaxed);
        loop {
            if queue.closed {
                return Woken::Closed;
            }
            if !queue.waiting.is_empty() {
                return Woken::Filled;
            }
            let Some(limit) = limit else {
                queue = self.filled.wait(queue).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            let (again, timeout) = self.filled.wait_timeout(queue, limit).unwrap_or_else(PoisonError::into_inner);
            queue = again;
            if timeout.timed_out() && queue.waiting.is_empty() && !queue.closed {
                return Woken::TimedOut;
            }
        }
    }

    fn is_stirred(&self) -> bool {
        self.stirred.load(Ordering::Relaxed)
    }

    /// Waits without giving the processor up to idling, which would let its caches go cold, but gives it to whoever else is ready to run.
    fn stay_awake(&self, until: Instant) {
        while !self.is_stirred() && Instant::now() < until {
            std::thread::yield_now();
        }
    }

    fn has_waiting(&self) -> bool {
        !lock(&self.queue).waiting.is_empty()
    }

    fn pop(&self) -> Option<Arrival> {
        lock(&self.queue).waiting.pop_front()
    }

    fn give_back(&self, buffer: Vec<u8>) {
        if buffer.capacity() <= BUFFER_MAX {
            lock(&self.queue).spare.push(buffer);
        }
    }
}

/// The room's thread: answers what is in the intake, and rehearses while nothing is. Ends when the intake is closed.
pub fn attend(desk: &Mutex<Desk>, intake: &Intake, keep_warm: KeepWarm) {
    // Where the callback decides nothing fills the intake, and the rehearsals begin by themselves.
    let mut pause = match keep_warm {
        KeepWarm::Off | KeepWarm::Expected => None,
        KeepWarm::Every(pause) => Some(pause),
    };
    loop {
        match intake.wait(pause) {
            Woken::Closed => return,
            Woken::Filled => {
                let mut desk = lock(desk);
                while let Some(arrival) = intake.pop() {
                    desk.take(arrival.stream, &arrival.payload, arrival.entered);
                    intake.give_back(arrival.payload);
                }
                desk.answer();
                pause = match keep_warm {
                    KeepWarm::Off => None,
                    KeepWarm::Expected => desk.until_rehearsals(REHEARSALS, Instant::now()),
                    KeepWarm::Every(pause) => Some(pause),
                };
            }
            Woken::TimedOut => {
                pause = match keep_warm {
                    KeepWarm::Off => None,
                    KeepWarm::Expected => {
                        (0..REHEARSALS).take_while(|_| !intake.is_stirred()).for_each(|_| rehearse(desk));
                        let until = lock(desk).awake_until(Instant::now());
                        intake.stay_awake(until);
                        None
                    }
                    KeepWarm::Every(pause) => {
                        let worth_it = lock(desk).decided_within(REHEARSE_FOR, Instant::now());
                        if worth_it {
                            rehearse(desk);
                        }
                        Some(if worth_it { pause } else { IDLE })
                    }
                };
            }
        }
    }
}

/// Rehearses, unless another holds the desk: then a decision is being made, which warms more than a rehearsal would.
fn rehearse(desk: &Mutex<Desk>) {
    if let Some(mut desk) = try_lock(desk) {
        desk.rehearse();
    }
}

/// What is behind these locks is whole between any two of its operations, so a panic elsewhere does not spoil it.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The same, unless another holds it.
pub fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    match mutex.try_lock() {
        Ok(guard) => Some(guard),
        Err(TryLockError::Poisoned(guard)) => Some(guard.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_is_shed_and_order_is_kept() {
        let intake = Intake::default();
        let now = Instant::now();
        for index in 0..CAPACITY as u32 + 3 {
            intake.push(Stream::Users, &index.to_le_bytes(), now);
        }
        assert_eq!(intake.shed(), 3);
        for index in 3..CAPACITY as u32 + 3 {
            assert_eq!(intake.pop().unwrap().payload, index.to_le_bytes());
        }
        assert!(intake.pop().is_none());
    }

    #[test]
    fn buffers_are_used_again_unless_they_are_huge() {
        let intake = Intake::default();
        let mut buffer = Vec::with_capacity(1000);
        let place = buffer.as_ptr();
        buffer.push(1);
        intake.give_back(buffer);
        intake.give_back(Vec::with_capacity(2 * BUFFER_MAX));
        intake.push(Stream::Channel, b"abc", Instant::now());
        let arrival = intake.pop().unwrap();
        assert_eq!((arrival.payload.as_slice(), arrival.payload.as_ptr()), (&b"abc"[..], place));
        intake.push(Stream::Channel, b"abc", Instant::now());
        assert!(intake.pop().unwrap().payload.capacity() < BUFFER_MAX);
    }

    #[test]
    fn what_passes_through_is_not_allocated_anew() {
        let intake = Intake::default();
        let pass = || {
            (0..3).for_each(|_| intake.push(Stream::Users, &[7; 300], Instant::now()));
            while let Some(arrival) = intake.pop() {
                intake.give_back(arrival.payload);
            }
        };
        pass();
        pass();
        assert_eq!(allocation_counter::measure(pass).count_total, 0);
    }

    #[test]
    fn when_to_keep_warm_is_read_as_it_is_written() {
        let every = |us| KeepWarm::Every(Duration::from_micros(us));
        for keep_warm in [KeepWarm::Off, KeepWarm::Expected, every(50), every(1_000_000)] {
            assert_eq!(keep_warm.to_string().parse(), Ok(keep_warm));
        }
        for wrong in ["49", "1000001", "-1", "often", ""] {
            assert!(wrong.parse::<KeepWarm>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn rooms_that_share_a_process_rehearse_only_when_told() {
        let expected = Deciding::default();
        assert_eq!((expected.among(1).keep_warm, expected.among(2).keep_warm), (KeepWarm::Expected, KeepWarm::Off));
        let every = Deciding { keep_warm: KeepWarm::Every(Duration::from_millis(1)), ..expected };
        assert_eq!(every.among(2), every);
    }

    #[test]
    fn who_stays_awake_sees_what_comes() {
        let (intake, soon) = (Intake::default(), Instant::now() + Duration::from_millis(1));
        intake.stay_awake(soon);
        assert!(Instant::now() >= soon, "nothing came");
        let late = Instant::now() + Duration::from_secs(60);
        std::thread::scope(|scope| {
            scope.spawn(|| intake.push(Stream::Users, &[1], Instant::now()));
            intake.stay_awake(late);
        });
        assert!(Instant::now() < late, "it did not look");
    }

    #[test]
    fn a_closed_intake_lets_go_of_who_waits() {
        let intake = Intake::default();
        std::thread::scope(|scope| {
            scope.spawn(|| intake.close());
            assert!(matches!(intake.wait(None), Woken::Closed));
        });
    }
}
