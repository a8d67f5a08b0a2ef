//! The thread and the connection of one board: it takes angles and stops without a wait, and keeps
//! what the board measured last.
//!
//! ```text
//!   caller:  set, stop, request      board thread:  connect -> stop -> set -> read -> check
//!         \___________ [`Mail`] ___________/          (each with a bounded wait)
//! ```
//!
//! The thread reads the order of a stop before each `set`. A stop that arrives while it waits for an
//! answer is written at once, see [`Interrupt`]. While a stop is in force, the first line of each new
//! connection is the stop.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use heliostat_array::device::{DeviceError, Waker};
use heliostat_service::locks::{lock, unpoisoned};

use crate::devices::board::Board;
use crate::devices::interrupt::Interrupt;

/// First pause before a reconnection; it doubles with each failure of a board that has not worked for
/// [`STEADY`] since it was connected.
const PAUSE_MIN: Duration = Duration::from_millis(100);

/// After a board has worked for this time since it was connected, the pauses begin again.
const STEADY: Duration = Duration::from_secs(1);

/// Longest pause before a reconnection.
const PAUSE_MAX: Duration = Duration::from_secs(2);

/// The same while a stop is in force.
const PAUSE_MAX_STOPPED: Duration = Duration::from_millis(500);

/// Time after which a stopped board gets the stop again: the answer shows that it is still there, and one
/// that has restarted meanwhile is stopped too.
const STOP_AGAIN: Duration = Duration::from_millis(500);
/// A connected board that has not been called for this time is asked whether it still answers. With
/// the timeout of an answer, a lost board is noticed within a second.
const IDLE: Duration = Duration::from_millis(300);

/// What the caller asks of a board, and what its thread has learned.
#[derive(Debug, Default)]
struct Mail {
    /// The latest angles, with a number that counts them.
    target: (u64, Vec<[f64; 2]>),
    /// A stop is in force: no angles are sent.
    is_stopped: bool,
    /// The number of the stop that the board has executed on its present connection.
    executed: u64,
    is_read_due: bool,
    /// The angles that the board measured last on its present connection.
    measured: Option<Vec<[f64; 2]>>,
    is_up: bool,
    connections: u64,
    /// The last failure.
    problem: Option<DeviceError>,
    is_closed: bool,
    waker: Option<Waker>,
}

#[derive(Debug, Default)]
struct Mailbox {
    mail: Mutex<Mail>,
    filled: Condvar,
}

/// One board, with a thread of its own.
pub struct BoardLink {
    mailbox: Arc<Mailbox>,
    interrupt: Arc<Interrupt>,
    /// Until its thread is started.
    board: Option<Box<dyn Board>>,
}

/// A call of the board that is due.
enum Call {
    Connect,
    Stop(u64),
    Set(u64, Vec<[f64; 2]>),
    Read,
    Check,
}

impl BoardLink {
    /// A link to a board; [`BoardLink::start`] connects it.
    ///
    /// # Errors
    /// The operating system provides no pair of sockets for the interrupt.
    pub fn new(mut board: Box<dyn Board>) -> std::io::Result<Self> {
        let interrupt = Arc::new(Interrupt::new()?);
        board.attach(Arc::clone(&interrupt));
        Ok(Self { mailbox: Arc::default(), interrupt, board: Some(board) })
    }

    /// Starts the thread of the board, if it does not run yet.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn start(&mut self) -> Result<(), DeviceError> {
        let Some(board) = self.board.take() else { return Ok(()) };
        let name = board.model();
        let link = LinkThread {
            mailbox: Arc::clone(&self.mailbox),
            interrupt: Arc::clone(&self.interrupt),
            board,
            pause: Duration::ZERO,
            failed_at: Instant::now(),
            connected_at: Instant::now(),
            called_at: Instant::now(),
            applied: 0,
            stopped_at: Instant::now(),
        };
        let thread = std::thread::Builder::new().name("board".into()).spawn(move || link.run());
        thread.map(drop).map_err(|error| DeviceError::new(name, error))
    }

    /// The board turns to these angles as soon as it can; later angles replace them. They end a stop.
    pub fn set(&self, angles: &[[f64; 2]]) {
        let mut mail = self.mailbox.lock();
        mail.target.0 += 1;
        mail.target.1.clear();
        mail.target.1.extend_from_slice(angles);
        mail.is_stopped = false;
        self.mailbox.filled.notify_one();
    }

    /// The board stops as soon as it can, and receives no angles until [`BoardLink::set`].
    pub fn stop(&self) {
        let mut mail = self.mailbox.lock();
        // One that the board has not answered yet is not repeated: each line would delay the answer.
        let is_pending = mail.is_stopped && mail.executed < self.interrupt.ordered();
        mail.is_stopped = true;
        if !is_pending {
            // Under the lock: no `set` is taken between the two.
            self.interrupt.order();
        }
        self.mailbox.filled.notify_one();
    }

    /// Asks for a measurement.
    pub fn request(&self) {
        self.mailbox.lock().is_read_due = true;
        self.mailbox.filled.notify_one();
    }

    /// Whether the board has executed the last stop, and answers.
    ///
    /// # Errors
    /// Why it does not answer.
    pub fn has_stopped(&self) -> Result<bool, DeviceError> {
        let mail = self.mailbox.lock();
        match &mail.problem {
            Some(problem) if !mail.is_up => Err(problem.clone()),
            _ => Ok(mail.is_up && mail.is_stopped && mail.executed == self.interrupt.ordered()),
        }
    }

    /// Writes the angles that the board measured last; false if there are none.
    pub fn measured(&self, into: &mut [[f64; 2]]) -> bool {
        let mail = self.mailbox.lock();
        let measured = mail.measured.as_ref().filter(|angles| angles.len() == into.len());
        measured.map(|angles| into.copy_from_slice(angles)).is_some()
    }

    /// Whether the board answers, and its last failure.
    pub fn state(&self) -> (bool, Option<DeviceError>) {
        let mail = self.mailbox.lock();
        (mail.is_up, mail.problem.clone())
    }

    /// How often the board was connected.
    pub fn connections(&self) -> u64 {
        self.mailbox.lock().connections
    }

    /// Sets what the thread calls after each change of its state.
    pub fn set_waker(&self, waker: Waker) {
        self.mailbox.lock().waker = Some(waker);
    }
}

impl Drop for BoardLink {
    fn drop(&mut self) {
        // The thread ends after its present call, which is bounded; the caller does not wait.
        self.mailbox.lock().is_closed = true;
        self.mailbox.filled.notify_one();
    }
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, Mail> {
        // Each change of the mail is complete before the lock is released.
        lock(&self.mail)
    }
}

/// What is left of a pause before the next connection; a stop in force shortens the pause.
fn pause_left(pause: Duration, is_stopped: bool, since_failure: Duration) -> Duration {
    let longest = if is_stopped { PAUSE_MAX_STOPPED } else { PAUSE_MAX };
    pause.min(longest).saturating_sub(since_failure)
}

/// The pause after a failure of a board that has worked for a time since it was connected, after the last
/// pause.
fn pause_after(last: Duration, worked: Duration) -> Duration {
    if worked >= STEADY { PAUSE_MIN } else { (2 * last).clamp(PAUSE_MIN, PAUSE_MAX) }
}

struct LinkThread {
    mailbox: Arc<Mailbox>,
    interrupt: Arc<Interrupt>,
    board: Box<dyn Board>,
    /// The pause before the next connection, and when it began. A stop shortens it.
    pause: Duration,
    failed_at: Instant,
    /// When the board was connected last.
    connected_at: Instant,
    /// When the last call ended.
    called_at: Instant,
    /// The number of the angles that were sent last on the present connection.
    applied: u64,
    /// When the board executed a stop last.
    stopped_at: Instant,
}

impl LinkThread {
    fn run(mut self) {
        while let Some(call) = self.next_call() {
            let done = match &call {
                Call::Connect => self.board.connect().map(|()| true),
                Call::Stop(_) => self.board.stop().map(|()| true),
                Call::Set(_, angles) => self.board.set(angles),
                Call::Read => self.read().map(|()| true),
                Call::Check => self.board.check().map(|()| true),
            };
            self.called_at = Instant::now();
            self.note(&call, done);
        }
    }

    /// Waits for the next call; `None` when the link is closed.
    fn next_call(&self) -> Option<Call> {
        let mut mail = self.mailbox.lock();
        loop {
            if mail.is_closed {
                return None;
            }
            let wait = if !mail.is_up {
                let wait = pause_left(self.pause, mail.is_stopped, self.failed_at.elapsed());
                if wait == Duration::ZERO {
                    return Some(Call::Connect);
                }
                wait
            } else if mail.is_stopped && mail.executed < self.interrupt.ordered() {
                return Some(Call::Stop(self.interrupt.ordered()));
            } else if !mail.is_stopped && mail.target.0 > self.applied {
                return Some(Call::Set(mail.target.0, mail.target.1.clone()));
            } else if mail.is_read_due && self.board.measures() {
                mail.is_read_due = false;
                return Some(Call::Read);
            } else {
                let again = match mail.is_stopped {
                    true => STOP_AGAIN.saturating_sub(self.stopped_at.elapsed()),
                    false => Duration::MAX,
                };
                let wait = again.min(IDLE.saturating_sub(self.called_at.elapsed()));
                match (again == Duration::ZERO, wait == Duration::ZERO) {
                    (true, _) => return Some(Call::Stop(self.interrupt.ordered())),
                    (false, true) => return Some(Call::Check),
                    (false, false) => wait,
                }
            };
            mail = unpoisoned(self.mailbox.filled.wait_timeout(mail, wait)).0;
        }
    }

    fn read(&mut self) -> Result<(), DeviceError> {
        let mut angles = vec![[0.0; 2]; self.board.channels()];
        self.board.read(&mut angles)?;
        self.mailbox.lock().measured = Some(angles);
        Ok(())
    }

    /// Notes the result of a call; false for one in place of which the port wrote a stop.
    fn note(&mut self, call: &Call, done: Result<bool, DeviceError>) {
        let mut mail = self.mailbox.lock();
        match (call, done) {
            (_, Err(problem)) => {
                let worked = if mail.is_up { self.connected_at.elapsed() } else { Duration::ZERO };
                self.pause = pause_after(self.pause, worked);
                self.failed_at = Instant::now();
                (mail.is_up, mail.measured, mail.executed) = (false, None, 0);
                mail.problem = Some(problem);
            }
            (Call::Connect, Ok(_)) => {
                (mail.is_up, mail.executed) = (true, 0);
                mail.connections += 1;
                self.connected_at = Instant::now();
                self.applied = 0;
            }
            (Call::Stop(number), Ok(_)) => {
                self.stopped_at = Instant::now();
                mail.executed = *number;
            }
            (Call::Set(number, _), Ok(is_sent)) => {
                // Angles that a stop has displaced are due again if they are still valid after it.
                if is_sent {
                    self.applied = *number;
                }
            }
            (Call::Read | Call::Check, Ok(_)) => return,
        }
        let waker = mail.waker.clone().filter(|_| !matches!(call, Call::Set(..)) || !mail.is_up);
        drop(mail);
        if let Some(waker) = waker {
            waker.wake();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_until_a_board_has_worked_for_a_while() {
        let soon = STEADY - Duration::from_millis(1);
        assert_eq!(pause_after(Duration::ZERO, Duration::ZERO), PAUSE_MIN);
        assert_eq!(pause_after(PAUSE_MIN, soon), 2 * PAUSE_MIN);
        assert_eq!(pause_after(PAUSE_MAX, soon), PAUSE_MAX);
        assert_eq!(pause_after(PAUSE_MAX, STEADY), PAUSE_MIN);
    }

    #[test]
    fn a_stop_shortens_a_pause_that_has_begun() {
        let since = Duration::from_millis(600);
        assert_eq!(pause_left(PAUSE_MAX, false, since), PAUSE_MAX - since);
        assert_eq!(pause_left(PAUSE_MAX, true, since), Duration::ZERO);
        assert_eq!(pause_left(PAUSE_MIN, true, Duration::ZERO), PAUSE_MIN);
    }
}
