//! A serial port or a socket, read line by line, without a wait that has no bound.
//!
//! A stop does not wait for the answer to an earlier line: [`Interrupt`] wakes a port that waits,
//! and the port writes the board's stop line at once.

use std::io::ErrorKind;
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::{Duration, Instant};

use heliostat_array::device::DeviceError;

use crate::devices::interrupt::Interrupt;
use crate::devices::system::{self, Ready, Stream};

/// Timeout of a socket connection.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);

/// Timeout of a write.
const WRITE_LIMIT: Duration = Duration::from_millis(500);

/// Time between two repetitions of a first question.
const REPEAT: Duration = Duration::from_secs(1);

/// A device that sends for longer than this without an answer to the first question is refused. Some
/// print for a second or two when they start.
const TALK_LIMIT: Duration = Duration::from_secs(3);

/// A device that has sent nothing for this time has no more to say.
const QUIET: Duration = Duration::from_millis(250);

/// The same after a stop that the port wrote among repeated questions: the longest time to its answer.
const QUIET_AFTER_STOP: Duration = Duration::from_secs(3);

/// Largest length of a line in bytes.
const LINE_MAX: usize = 64 * 1024;

/// The address of a device: `serial:/dev/ttyUSB0`, `serial:/dev/ttyUSB0@115200` or `tcp:HOST:PORT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A serial port and its speed in baud.
    Serial {
        /// Path of the port.
        path: String,
        /// Speed in baud.
        baud: u32,
    },
    /// A host and a port.
    Tcp(String),
}

impl Address {
    /// Parses an address; `baud` is the default speed of a serial port. Each address that parses can be
    /// opened when its device is there.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str, baud: u32) -> Result<Self, String> {
        let invalid = || format!("invalid address \"{text}\": expected serial:PATH, serial:PATH@BAUD or tcp:HOST:PORT");
        match text.split_once(':') {
            Some(("serial", port)) => {
                let (path, speed) = port.rsplit_once('@').map_or((port, None), |(path, speed)| (path, Some(speed)));
                if path.is_empty() || path.contains('\0') {
                    return Err(invalid());
                }
                let is_known = |baud: &u32| system::speeds().any(|known| known == *baud);
                let baud = match speed {
                    Some(speed) => speed.parse().ok().filter(is_known).ok_or_else(|| {
                        let known: Vec<String> = system::speeds().map(|baud| baud.to_string()).collect();
                        format!("invalid speed \"{speed}\" in \"{text}\": expected one of {} baud", known.join(", "))
                    })?,
                    None => baud,
                };
                if std::fs::metadata(path).is_ok_and(|found| !system::is_serial_port(&found)) {
                    return Err(format!(
                        "\"{path}\" is a file or a folder: expected a serial port, for example /dev/ttyUSB0"
                    ));
                }
                Ok(Self::Serial { path: path.to_owned(), baud })
            }
            Some(("tcp", at)) => {
                let (host, port) = at.rsplit_once(':').filter(|(host, _)| !host.is_empty()).ok_or_else(invalid)?;
                if port.parse::<u16>().is_ok_and(|port| port != 0) {
                    Ok(Self::Tcp(format!("{host}:{port}")))
                } else {
                    Err(format!("invalid port \"{port}\" in \"{text}\": expected a number from 1 to 65535"))
                }
            }
            _ => Err(invalid()),
        }
    }

    /// Opens it. When `interrupt` asks for a stop, the port writes `stop_line`; if it already does,
    /// this is the first line.
    ///
    /// # Errors
    /// [`DeviceError`] with the error of the operating system, and what to do where it is known.
    pub fn open(&self, interrupt: &Arc<Interrupt>, stop_line: &'static [u8]) -> Result<Port, DeviceError> {
        let failed = |problem: &dyn ToString| DeviceError::new(self.to_string(), problem.to_string());
        let stream: Box<dyn Stream> = match self {
            Self::Serial { path, baud } => {
                Box::new(system::open_serial(path, *baud).map_err(|error| failed(&with_advice(&error)))?)
            }
            Self::Tcp(host) => {
                let mut found = host.to_socket_addrs().map_err(|error| failed(&error))?;
                let address = found.next().ok_or_else(|| failed(&"unknown host: check the name in the address"))?;
                let stream = TcpStream::connect_timeout(&address, CONNECT_LIMIT);
                let stream = stream.map_err(|error| failed(&with_advice(&error)))?;
                let set = stream.set_nodelay(true).and_then(|()| stream.set_nonblocking(true));
                set.map_err(|error| failed(&error))?;
                Box::new(stream)
            }
        };
        // Without data a serial port reads 0 bytes; a socket reads 0 bytes when it is closed.
        let ends = matches!(self, Self::Tcp(_));
        let interrupt = Arc::clone(interrupt);
        let (name, pending) = (self.to_string(), Vec::new());
        let mut port = Port { stream, ends, name, pending, interrupt, stop_line, stops: 0, unanswered: 0 };
        port.write_stop()?;
        Ok(port)
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Serial { path, baud } => write!(f, "serial:{path}@{baud}"),
            Self::Tcp(host) => write!(f, "tcp:{host}"),
        }
    }
}

/// Why a device cannot be opened, with what to do where it is known.
fn with_advice(error: &std::io::Error) -> String {
    let advice = match error.kind() {
        ErrorKind::NotFound => "connect the device, or correct its address",
        ErrorKind::PermissionDenied => "give this process the right to use the port, for example by the group dialout",
        ErrorKind::ResourceBusy => {
            "end the process that uses the port, for example another driver, or correct the address of one of both"
        }
        ErrorKind::ConnectionRefused => "start the program that listens there, or correct the address",
        _ => return error.to_string(),
    };
    format!("{error}; {advice}")
}

/// An open connection to a device.
pub struct Port {
    stream: Box<dyn Stream>,
    /// Whether a read of 0 bytes means that the device closed the connection.
    ends: bool,
    name: String,
    /// Bytes read beyond the last line.
    pending: Vec<u8>,
    interrupt: Arc<Interrupt>,
    stop_line: &'static [u8],
    /// The number of the stop that was written last.
    stops: u64,
    /// Stop lines that were written out of turn; the device answers them later.
    unanswered: usize,
}

/// The port of a device.
///
/// # Errors
/// [`DeviceError`] while the device is not connected.
pub fn connected<'a>(port: &'a mut Option<Port>, address: &Address) -> Result<&'a mut Port, DeviceError> {
    port.as_mut().ok_or_else(|| DeviceError::new(address.to_string(), "not connected"))
}

impl Port {
    /// Writes all bytes; a stop that was ordered before goes first.
    ///
    /// # Errors
    /// [`DeviceError`] if the device is disconnected or does not accept them in time.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        if bytes == self.stop_line {
            self.stops = self.interrupt.ordered();
        } else {
            self.write_stop()?;
        }
        self.write_bytes(bytes)
    }

    /// Writes a line that moves mirrors, unless a stop was ordered; returns whether it was written.
    ///
    /// # Errors
    /// As [`Port::write`].
    pub fn write_motion(&mut self, bytes: &[u8]) -> Result<bool, DeviceError> {
        let is_stopped = self.write_stop()?;
        if !is_stopped {
            self.write_bytes(bytes)?;
        }
        Ok(!is_stopped)
    }

    /// The next line without its end; waits for it at most `limit`.
    ///
    /// # Errors
    /// [`DeviceError`] if none arrives in time, or the device is disconnected.
    pub fn line(&mut self, limit: Duration) -> Result<String, DeviceError> {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(line) = self.received_line() {
                return Ok(line);
            }
            if Instant::now() >= deadline || self.pending.len() > LINE_MAX {
                return Err(self.no_answer(limit));
            }
            self.fill(deadline)?;
        }
    }

    /// Asks a device that was just opened, until it answers: it may start because it was opened, and
    /// then loses what it receives and prints lines of its own. The port stays open meanwhile.
    ///
    /// Returns the first line that is an answer, or the last other line at the end of `limit`.
    ///
    /// # Errors
    /// [`DeviceError`] if no line arrives in time, the device is disconnected, or it sends without end.
    pub fn greet(
        &mut self,
        question: &[u8],
        limit: Duration,
        is_answer: impl Fn(&str) -> bool,
    ) -> Result<String, DeviceError> {
        let begun = Instant::now();
        let (mut repeat_at, mut sent_at, mut talks_since) = (begun, begun, begun);
        // The answers to stops before the first question come before its answer.
        let expected = std::mem::take(&mut self.unanswered);
        let (mut asked, mut others, mut other) = (0, 0, None);
        loop {
            while let Some(line) = self.received_line() {
                if !is_answer(&line) {
                    (others, other) = (others + 1, Some(line));
                    continue;
                }
                if asked > 1 || others > expected {
                    self.settle()?;
                }
                return Ok(line);
            }
            let now = Instant::now();
            if now >= begun + limit || self.pending.len() > LINE_MAX {
                return other.ok_or_else(|| self.no_answer(limit));
            }
            if now >= repeat_at {
                self.write(question)?;
                (asked, repeat_at) = (asked + 1, now + REPEAT);
            }
            if self.fill(repeat_at.min(now + QUIET))? > 0 {
                let now = Instant::now();
                if now.duration_since(sent_at) > QUIET {
                    talks_since = now;
                }
                sent_at = now;
                if now.duration_since(talks_since) > TALK_LIMIT {
                    return Err(self.endless());
                }
            }
        }
    }

    /// Discards what arrives until the device has no more to say, so that no earlier line counts as the
    /// answer to a later question.
    fn settle(&mut self) -> Result<(), DeviceError> {
        let pause = |stops| if stops > 0 { QUIET_AFTER_STOP } else { QUIET };
        let begun = Instant::now();
        let mut quiet_at = begun + pause(self.unanswered);
        while Instant::now() < quiet_at {
            if begun.elapsed() > TALK_LIMIT + pause(self.unanswered) {
                return Err(self.endless());
            }
            let stops = self.unanswered;
            if self.fill(quiet_at)? > 0 || self.unanswered > stops {
                quiet_at = Instant::now() + pause(self.unanswered);
            }
        }
        self.pending.clear();
        self.unanswered = 0;
        Ok(())
    }

    /// Discards lines that arrived before the next question: they cannot be its answer. Answers to stops
    /// that are still to come stay.
    ///
    /// # Errors
    /// [`DeviceError`] if the device is disconnected.
    pub fn discard_early(&mut self) -> Result<(), DeviceError> {
        if self.unanswered == 0 {
            self.read()?;
            self.pending.clear();
        }
        Ok(())
    }

    /// The first complete line among the bytes received so far.
    fn received_line(&mut self) -> Option<String> {
        let end = self.pending.iter().position(|byte| *byte == b'\n')?;
        let line: Vec<u8> = self.pending.drain(..=end).collect();
        Some(String::from_utf8_lossy(&line).trim().to_owned())
    }

    fn no_answer(&self, limit: Duration) -> DeviceError {
        let limit = limit.as_millis();
        let found = match self.pending.len() {
            0 => format!("no answer within {limit} ms"),
            bytes => format!("no line within {limit} ms, but {bytes} bytes without an end"),
        };
        // A device at another speed often takes no line of the host for one, and is silent.
        let speed = if self.name.starts_with("serial:") { ", and the speed of the port" } else { "" };
        DeviceError::new(&self.name, format!("{found}: check the address and the power of the device{speed}"))
    }

    fn endless(&self) -> DeviceError {
        let problem = "sends without a question: expected a device that answers lines; disconnect it";
        DeviceError::new(&self.name, problem)
    }

    /// Takes the number of stop lines that were written out of turn and not yet answered; the caller reads
    /// their answers.
    pub fn take_unanswered(&mut self) -> usize {
        std::mem::take(&mut self.unanswered)
    }

    /// Reads the available bytes, and waits for them until a time at the latest; returns their
    /// number. An interrupt ends the wait.
    fn fill(&mut self, until: Instant) -> Result<usize, DeviceError> {
        self.wait(Ready::Read, until)?;
        self.write_stop()?;
        self.read()
    }

    /// Reads the available bytes without waiting; returns their number.
    fn read(&mut self) -> Result<usize, DeviceError> {
        let mut bytes = [0; 1024];
        match self.stream.read(&mut bytes) {
            Ok(0) if self.ends => Err(DeviceError::new(&self.name, "the device closed the connection")),
            Ok(count) => {
                self.pending.extend_from_slice(&bytes[..count]);
                Ok(count)
            }
            Err(error) if is_transient(&error) => Ok(0),
            Err(error) => Err(DeviceError::new(&self.name, error)),
        }
    }

    /// Writes the stop line if a stop was ordered since it was written last; returns whether it did.
    fn write_stop(&mut self) -> Result<bool, DeviceError> {
        let ordered = self.interrupt.ordered();
        let is_due = ordered > self.stops;
        if is_due {
            self.stops = ordered;
            self.unanswered += 1;
            self.write_bytes(self.stop_line)?;
        }
        Ok(is_due)
    }

    fn write_bytes(&mut self, mut bytes: &[u8]) -> Result<(), DeviceError> {
        let deadline = Instant::now() + WRITE_LIMIT;
        while !bytes.is_empty() {
            match self.stream.write(bytes) {
                Ok(0) => return Err(DeviceError::new(&self.name, "the device closed the connection")),
                Ok(count) => bytes = &bytes[count..],
                Err(error) if !is_transient(&error) => return Err(DeviceError::new(&self.name, error)),
                Err(_) if Instant::now() >= deadline => {
                    let problem = format!("does not accept bytes within {} ms", WRITE_LIMIT.as_millis());
                    return Err(DeviceError::new(&self.name, problem));
                }
                Err(_) => self.wait(Ready::Write, deadline)?,
            }
        }
        Ok(())
    }

    /// Waits until the device is ready, an interrupt arrives or the time has come.
    fn wait(&self, ready: Ready, until: Instant) -> Result<(), DeviceError> {
        let left = until.saturating_duration_since(Instant::now());
        let waited = system::wait(&*self.stream, self.interrupt.wake_up(), ready, left);
        waited.map_err(|problem| DeviceError::new(&self.name, problem))
    }
}

fn is_transient(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(all(test, unix))]
mod tests {
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn a_device_that_cannot_be_opened_is_named_with_what_to_do() {
        let folder = tempfile::tempdir().expect("a folder");
        let absent = folder.path().join("ttyUSB0");
        let closed = TcpListener::bind("127.0.0.1:0").and_then(|bound| bound.local_addr()).expect("a free port");
        for (text, advice) in [
            (format!("serial:{}", absent.display()), "connect the device, or correct its address"),
            (format!("tcp:{closed}"), "start the program that listens there, or correct the address"),
        ] {
            let interrupt = Arc::new(Interrupt::new().expect("an interrupt"));
            let address = Address::parse(&text, 115_200).expect("an address");
            let error = address.open(&interrupt, b"stop\n").err().expect("no device is there").to_string();
            assert!(error.contains(&text) && error.ends_with(advice), "{error}");
        }
    }

    #[test]
    fn a_device_that_does_not_answer_is_named_with_what_to_check() {
        let silent = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let address = format!("tcp:{}", silent.local_addr().expect("bound"));
        let interrupt = Arc::new(Interrupt::new().expect("an interrupt"));
        let mut port =
            Address::parse(&address, 115_200).expect("an address").open(&interrupt, b"stop\n").expect("open");
        for (name, advice) in [
            (address.as_str(), ": check the address and the power of the device"),
            ("serial:/dev/ttyUSB0@9600", ": check the address and the power of the device, and the speed of the port"),
        ] {
            name.clone_into(&mut port.name);
            let error = port.line(Duration::ZERO).expect_err("it is silent").to_string();
            assert_eq!(error, format!("{name}: no answer within 0 ms{advice}"));
        }
    }
}
