//! Unix: terminals, sockets and poll(2).

use std::fs::{File, Metadata, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{self, BaudRate, SetArg, SpecialCharacterIndices};

use super::Ready;

/// Speeds of a serial port in baud.
const SPEEDS: &[(u32, BaudRate)] = &[
    (9_600, BaudRate::B9600),
    (19_200, BaudRate::B19200),
    (38_400, BaudRate::B38400),
    (57_600, BaudRate::B57600),
    (115_200, BaudRate::B115200),
    (230_400, BaudRate::B230400),
];

/// Those of Linux only.
#[cfg(target_os = "linux")]
const MORE_SPEEDS: &[(u32, BaudRate)] = &[
    (460_800, BaudRate::B460800),
    (500_000, BaudRate::B500000),
    (576_000, BaudRate::B576000),
    (921_600, BaudRate::B921600),
    (1_000_000, BaudRate::B1000000),
    (1_152_000, BaudRate::B1152000),
    (1_500_000, BaudRate::B1500000),
    (2_000_000, BaudRate::B2000000),
    (2_500_000, BaudRate::B2500000),
    (3_000_000, BaudRate::B3000000),
    (3_500_000, BaudRate::B3500000),
    (4_000_000, BaudRate::B4000000),
];

#[cfg(not(target_os = "linux"))]
const MORE_SPEEDS: &[(u32, BaudRate)] = &[];

/// The speeds that a serial port can have, in baud.
pub fn speeds() -> impl Iterator<Item = u32> {
    known_speeds().map(|(baud, _)| baud)
}

fn known_speeds() -> impl Iterator<Item = (u32, BaudRate)> {
    SPEEDS.iter().chain(MORE_SPEEDS).copied()
}

/// Whether what a path names can be a serial port.
pub fn is_serial_port(found: &Metadata) -> bool {
    found.file_type().is_char_device()
}

/// Opens a serial port for raw bytes: eight bits, no parity, no flow control, no waiting. Until it is closed, this lock
/// keeps other drivers from it: their bytes would mix, and TIOCEXCL does not bind root.
pub fn open_serial(path: &str, baud: u32) -> io::Result<File> {
    let speed = known_speeds().find(|(known, _)| *known == baud).map(|(_, speed)| speed);
    let speed = speed.ok_or_else(|| io::Error::other(format!("unknown speed of {baud} baud")))?;
    let port = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags((OFlag::O_NOCTTY | OFlag::O_NONBLOCK).bits())
        .open(path)?;
    let mut settings = termios::tcgetattr(&port).map_err(|error| match error {
        Errno::ENOTTY => io::Error::other("it is no serial port; expected one, for example /dev/ttyUSB0"),
        other => other.into(),
    })?;
    // Some systems lock no device: the port works there too.
    if matches!(port.try_lock(), Err(TryLockError::WouldBlock)) {
        return Err(io::Error::new(io::ErrorKind::ResourceBusy, "another process has this port"));
    }
    termios::cfmakeraw(&mut settings);
    termios::cfsetspeed(&mut settings, speed)?;
    settings.control_chars[SpecialCharacterIndices::VMIN as usize] = 0;
    settings.control_chars[SpecialCharacterIndices::VTIME as usize] = 0;
    termios::tcsetattr(&port, SetArg::TCSANOW, &settings)?;
    Ok(port)
}

/// A serial port or a socket.
pub trait Stream: Read + Write + Send + AsFd {}

impl<T: Read + Write + Send + AsFd> Stream for T {}

/// Ends the wait of another thread; neither side waits for the other.
#[derive(Debug)]
pub struct WakeUp {
    wake: UnixStream,
    woken: UnixStream,
}

impl WakeUp {
    /// A wake-up that has not been used.
    ///
    /// # Errors
    /// The operating system provides no pair of sockets.
    pub fn new() -> io::Result<Self> {
        let (wake, woken) = UnixStream::pair()?;
        wake.set_nonblocking(true)?;
        woken.set_nonblocking(true)?;
        Ok(Self { wake, woken })
    }

    /// Ends the present or the next wait.
    pub fn wake(&self) {
        // A full buffer wakes the reader too.
        let _ = (&self.wake).write(&[0]);
    }

    /// Takes back all wake-ups so far.
    fn clear(&self) {
        let mut bytes = [0; 64];
        while (&self.woken).read(&mut bytes).is_ok_and(|count| count == bytes.len()) {}
    }
}

/// Waits until the device is ready, it is woken or the time has passed.
///
/// # Errors
/// The error of the operating system.
pub fn wait(stream: &dyn Stream, wake_up: &WakeUp, ready: Ready, limit: Duration) -> Result<(), String> {
    // Rounded up, so that no wait of less than a millisecond is a busy one.
    let limit = PollTimeout::try_from(limit + Duration::from_micros(999)).unwrap_or(PollTimeout::MAX);
    let ready = match ready {
        Ready::Read => PollFlags::POLLIN,
        Ready::Write => PollFlags::POLLOUT,
    };
    let mut descriptors = [PollFd::new(stream.as_fd(), ready), PollFd::new(wake_up.woken.as_fd(), PollFlags::POLLIN)];
    match poll(&mut descriptors, limit) {
        Ok(_) | Err(Errno::EINTR) => {
            wake_up.clear();
            Ok(())
        }
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsRawFd;

    #[test]
    fn a_device_that_is_no_terminal_is_named() {
        let error = super::open_serial("/dev/null", 9_600).expect_err("no terminal");
        assert!(error.to_string().starts_with("it is no serial port; expected one"), "{error}");
    }

    #[test]
    fn a_port_has_one_user_until_it_is_closed() {
        let terminal = nix::pty::openpty(None, None).expect("a pseudo-terminal");
        let path = std::fs::read_link(format!("/proc/self/fd/{}", terminal.slave.as_raw_fd())).expect("its path");
        let path = path.to_str().expect("a path of letters");
        let first = super::open_serial(path, 9_600).expect("it is free");
        let error = super::open_serial(path, 9_600).expect_err("it is in use");
        assert_eq!(error.to_string(), "another process has this port");
        drop(first);
        super::open_serial(path, 9_600).expect("it is free again");
    }
}
