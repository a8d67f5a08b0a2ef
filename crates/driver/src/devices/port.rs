//! A serial port or a socket, read line by line.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::fs::OpenOptionsExt;
use std::time::{Duration, Instant};

use heliostat_array::device::DeviceError;
use nix::fcntl::OFlag;
use nix::sys::termios::{self, BaudRate, SetArg, SpecialCharacterIndices};

/// Timeout of a socket connection.
const CONNECT_LIMIT: Duration = Duration::from_secs(2);

/// Timeout of a write to a socket.
const WRITE_LIMIT: Duration = Duration::from_millis(500);

/// Timeout of one read of a socket; a line may need several reads.
const READ_SLICE: Duration = Duration::from_millis(20);

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

    /// Opens it.
    ///
    /// # Errors
    /// [`DeviceError`] with the error of the operating system.
    pub fn open(&self) -> Result<Port, DeviceError> {
        let failed = |problem: &dyn ToString| DeviceError::new(self.to_string(), problem.to_string());
        let stream: Box<dyn Stream> = match self {
            Self::Serial { path, baud } => Box::new(open_serial(path, *baud).map_err(|error| failed(&error))?),
            Self::Tcp(host) => {
                let mut found = host.to_socket_addrs().map_err(|error| failed(&error))?;
                let address = found.next().ok_or_else(|| failed(&"unknown host: check the name in the address"))?;
                let stream = TcpStream::connect_timeout(&address, CONNECT_LIMIT).map_err(|error| failed(&error))?;
                let set = stream
                    .set_nodelay(true)
                    .and_then(|()| stream.set_read_timeout(Some(READ_SLICE)))
                    .and_then(|()| stream.set_write_timeout(Some(WRITE_LIMIT)));
                set.map_err(|error| failed(&error))?;
                Box::new(stream)
            }
        };
        // Without data a serial port reads 0 bytes and a socket times out; a socket reads 0 bytes
        // when it is closed.
        let ends = matches!(self, Self::Tcp(_));
        Ok(Port { stream, ends, name: self.to_string(), pending: Vec::new() })
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

/// Opens a serial port for raw bytes: eight bits, no parity, no flow control, reads of at most 0.1
/// s.
fn open_serial(path: &str, baud: u32) -> std::io::Result<File> {
    let speed = SPEEDS.iter().find(|(known, _)| *known == baud).map(|(_, speed)| *speed);
    let known = || SPEEDS.map(|(baud, _)| baud.to_string()).join(", ");
    let speed = speed
        .ok_or_else(|| std::io::Error::other(format!("invalid speed of {baud} baud: expected one of {}", known())))?;
    let port = OpenOptions::new().read(true).write(true).custom_flags(OFlag::O_NOCTTY.bits()).open(path)?;
    let mut settings = termios::tcgetattr(&port)?;
    termios::cfmakeraw(&mut settings);
    termios::cfsetspeed(&mut settings, speed)?;
    settings.control_chars[SpecialCharacterIndices::VMIN as usize] = 0;
    settings.control_chars[SpecialCharacterIndices::VTIME as usize] = 1;
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

trait Stream: Read + Write + Send {}

impl<T: Read + Write + Send> Stream for T {}

/// An open connection to a device.
pub struct Port {
    stream: Box<dyn Stream>,
    /// Whether a read of 0 bytes means that the device closed the connection.
    ends: bool,
    name: String,
    /// Bytes read beyond the last line.
    pending: Vec<u8>,
}

impl Port {
    /// Writes all bytes.
    ///
    /// # Errors
    /// [`DeviceError`] if the device is disconnected or does not accept them.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        let written = self.stream.write_all(bytes).and_then(|()| self.stream.flush());
        written.map_err(|error| DeviceError::new(&self.name, error))
    }

    /// The next line without its end; waits for it at most `limit`.
    ///
    /// # Errors
    /// [`DeviceError`] if no line arrives in time, or the device is disconnected.
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
            self.fill()?;
        }
    }

    /// Discards all bytes received so far.
    ///
    /// # Errors
    /// [`DeviceError`] if the device is disconnected.
    pub fn drain(&mut self) -> Result<(), DeviceError> {
        while self.fill()? > 0 {}
        self.pending.clear();
        Ok(())
    }

    /// Reads the available bytes, with a short wait; returns their number.
    fn fill(&mut self) -> Result<usize, DeviceError> {
        let mut bytes = [0; 1024];
        match self.stream.read(&mut bytes) {
            Ok(0) if self.ends => Err(DeviceError::new(&self.name, "the device closed the connection")),
            Ok(count) => {
                self.pending.extend_from_slice(&bytes[..count]);
                Ok(count)
            }
            Err(error)
                if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
            {
                Ok(0)
            }
            Err(error) => Err(DeviceError::new(&self.name, error)),
        }
    }
}
