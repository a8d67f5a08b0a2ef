//! A serial port or a socket, read line by line, without a wait that has no bound.
//!
//! A stop does not wait for the answer to an earlier line: [`Interrupt`] wakes a port that waits,
//! and the port writes the board's stop line at once.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use heliostat_array::device::DeviceError;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{self, BaudRate, SetArg, SpecialCharacterIndices};

use crate::devices::interrupt::Interrupt;

/// Timeout of a socket connection.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);

/// Timeout of a write.
const WRITE_LIMIT: Duration = Duration::from_millis(500);

/// A device that sends for longer than this without a question is refused.
const DRAIN_LIMIT: Duration = Duration::from_millis(200);

/// A device that has sent nothing for this time has no more to say.
const DRAIN_PAUSE: Duration = Duration::from_millis(20);

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
    /// Parses an address; `baud` is the default speed of a serial port.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str, baud: u32) -> Result<Self, String> {
        let expected = "expected serial:PATH, serial:PATH@BAUD or tcp:HOST:PORT";
        match text.split_once(':') {
            Some(("serial", path)) if !path.is_empty() => match path.rsplit_once('@') {
                None => Ok(Self::Serial { path: path.to_owned(), baud }),
                Some((path, speed)) => {
                    let baud =
                        speed.parse().map_err(|_| format!("invalid speed \"{speed}\" in \"{text}\": {expected}"))?;
                    Ok(Self::Serial { path: path.to_owned(), baud })
                }
            },
            Some(("tcp", host)) if host.contains(':') => Ok(Self::Tcp(host.to_owned())),
            _ => Err(format!("invalid address \"{text}\": {expected}")),
        }
    }

    /// Opens it. When `interrupt` asks for a stop, the port writes `stop_line`; if it already does,
    /// this is the first line.
    ///
    /// # Errors
    /// [`DeviceError`] with the error of the operating system.
    pub fn open(&self, interrupt: &Arc<Interrupt>, stop_line: &'static [u8]) -> Result<Port, DeviceError> {
        let failed = |problem: &dyn ToString| DeviceError::new(self.to_string(), problem.to_string());
        let stream: Box<dyn Stream> = match self {
            Self::Serial { path, baud } => Box::new(open_serial(path, *baud).map_err(|error| failed(&error))?),
            Self::Tcp(host) => {
                let mut found = host.to_socket_addrs().map_err(|error| failed(&error))?;
                let address = found.next().ok_or_else(|| failed(&"unknown host: check the name in the address"))?;
                let stream = TcpStream::connect_timeout(&address, CONNECT_LIMIT).map_err(|error| failed(&error))?;
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

/// Opens a serial port for raw bytes: eight bits, no parity, no flow control, no waiting.
fn open_serial(path: &str, baud: u32) -> std::io::Result<File> {
    let speed = SPEEDS.iter().find(|(known, _)| *known == baud).map(|(_, speed)| *speed);
    let known = || SPEEDS.map(|(baud, _)| baud.to_string()).join(", ");
    let speed = speed
        .ok_or_else(|| std::io::Error::other(format!("invalid speed of {baud} baud: expected one of {}", known())))?;
    let port = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags((OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits())
        .open(path)?;
    let mut settings = termios::tcgetattr(&port)?;
    termios::cfmakeraw(&mut settings);
    termios::cfsetspeed(&mut settings, speed)?;
    settings.control_chars[SpecialCharacterIndices::VMIN as usize] = 0;
    settings.control_chars[SpecialCharacterIndices::VTIME as usize] = 0;
    termios::tcsetattr(&port, SetArg::TCSANOW, &settings)?;
    Ok(port)
}

/// Speeds of a serial port in baud.
const SPEEDS: [(u32, BaudRate); 8] = [
    (9_600, BaudRate::B9600),
    (19_200, BaudRate::B19200),
    (38_400, BaudRate::B38400),
    (57_600, BaudRate::B57600),
    (115_200, BaudRate::B115200),
    (230_400, BaudRate::B230400),
    (460_800, BaudRate::B460800),
    (921_600, BaudRate::B921600),
];

trait Stream: Read + Write + Send + AsFd {}

impl<T: Read + Write + Send + AsFd> Stream for T {}

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
            if let Some(end) = self.pending.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = self.pending.drain(..=end).collect();
                return Ok(String::from_utf8_lossy(&line).trim().to_owned());
            }
            if Instant::now() >= deadline || self.pending.len() > LINE_MAX {
                return Err(DeviceError::new(&self.name, format!("no answer within {} ms", limit.as_millis())));
            }
            self.fill(deadline)?;
        }
    }

    /// Takes the number of stop lines that were written out of turn and not yet answered; the caller reads
    /// their answers.
    pub fn take_unanswered(&mut self) -> usize {
        std::mem::take(&mut self.unanswered)
    }

    /// Discards all bytes received so far.
    ///
    /// # Errors
    /// [`DeviceError`] if the device is disconnected, or sends without end.
    pub fn drain(&mut self) -> Result<(), DeviceError> {
        let deadline = Instant::now() + DRAIN_LIMIT;
        let mut quiet_at = Instant::now() + DRAIN_PAUSE;
        while Instant::now() < quiet_at {
            if Instant::now() >= deadline {
                let problem = "sends without a question: expected a device that answers lines; disconnect it";
                return Err(DeviceError::new(&self.name, problem));
            }
            if self.fill(quiet_at)? > 0 {
                quiet_at = Instant::now() + DRAIN_PAUSE;
            }
        }
        self.pending.clear();
        Ok(())
    }

    /// Reads the available bytes, and waits for them until a time at the latest; returns their
    /// number. An interrupt ends the wait.
    fn fill(&mut self, until: Instant) -> Result<usize, DeviceError> {
        self.wait(PollFlags::POLLIN, until)?;
        self.write_stop()?;
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
                Err(_) => self.wait(PollFlags::POLLOUT, deadline)?,
            }
        }
        Ok(())
    }

    /// Waits until the device is ready, an interrupt arrives or the time has come.
    fn wait(&self, ready: PollFlags, until: Instant) -> Result<(), DeviceError> {
        let left = until.saturating_duration_since(Instant::now());
        // Rounded up, so that no wait of less than a millisecond is a busy one.
        let left = PollTimeout::try_from(left + Duration::from_micros(999)).unwrap_or(PollTimeout::MAX);
        let mut descriptors =
            [PollFd::new(self.stream.as_fd(), ready), PollFd::new(self.interrupt.as_fd(), PollFlags::POLLIN)];
        match poll(&mut descriptors, left) {
            Ok(_) | Err(nix::errno::Errno::EINTR) => {
                self.interrupt.clear();
                Ok(())
            }
            Err(error) => Err(DeviceError::new(&self.name, error)),
        }
    }
}

fn is_transient(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
