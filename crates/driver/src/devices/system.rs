//! What boards need of the operating system: serial ports, and a wait for a device that a stop ends.

#[cfg_attr(unix, path = "system/unix.rs")]
#[cfg_attr(not(unix), path = "system/other.rs")]
mod platform;

pub(super) use platform::{Stream, WakeUp, is_serial_port, open_serial, speeds, wait};

/// Whether boards are driven here.
pub(crate) const IS_SUPPORTED: bool = cfg!(unix);

/// What a wait for a device waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ready {
    /// It has sent bytes.
    Read,
    /// It accepts bytes.
    Write,
}
