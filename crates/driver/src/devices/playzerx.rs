//! A Mirrorcle PlayzerX on its USB serial port: one mirror, open loop.
//!
//! Every frame is `p l`, a code, the length of the frame, data, and a newline. A sample contains x
//! and y as 12-bit numbers, 0 to 4095 for -1 to +1 of the mirror's range, in three bytes: low eight
//! bits of x; high four bits of x and low four of y; high eight bits of y. The device applies
//! queued samples at the sample rate and does not acknowledge them, so no angle is measured. Only a
//! ping is answered, with the line `pl-ok`; it follows each stop.
//!
//! Here x is yaw and y is roll. With an empty queue the device holds the last sample.
//!
//! Source: the manufacturer's page "PlayzerX USB Serial Protocol".

use std::sync::Arc;
use std::time::Duration;

use heliostat_array::device::DeviceError;
use heliostat_proto::AxisLimits;

use crate::devices::board::{self, Board};
use crate::devices::interrupt::Interrupt;
use crate::devices::port::{Address, Port, connected};

/// Default speed of the port in baud; it has no effect on USB.
pub const BAUD: u32 = 460_800;

/// Largest code of an axis.
const CODE_MAX: f64 = 4095.0;

/// Sample rates of the device in Hz.
const SAMPLE_RATES: std::ops::RangeInclusive<u32> = 50..=50_000;

/// Timeout of the answer to the pings of a connection, and to one ping of a connected device.
const GREETING_LIMIT: Duration = Duration::from_secs(5);
const ANSWER_LIMIT: Duration = Duration::from_millis(500);

/// The answer to a ping.
const ALIVE: &str = "pl-ok";

/// The frame that clears the queue: the mirror holds the last sample.
const STOP: &[u8] = b"plc\x05\n";

/// One device.
pub struct PlayzerX {
    interrupt: Option<Arc<Interrupt>>,
    address: Address,
    range_rad: f64,
    sample_rate_hz: u32,
    port: Option<Port>,
}

impl PlayzerX {
    /// The device at an address; its largest code is `range_rad` (mechanical), its smallest the
    /// negative.
    ///
    /// # Errors
    /// A range or a sample rate that the device does not have.
    pub fn new(address: Address, range_rad: f64, sample_rate_hz: u32) -> Result<Self, String> {
        if !(range_rad > 0.0 && range_rad <= std::f64::consts::FRAC_PI_2) {
            return Err(format!("invalid range_deg {}: expected more than 0 and at most 90", range_rad.to_degrees()));
        }
        if !SAMPLE_RATES.contains(&sample_rate_hz) {
            return Err(format!("invalid sample_rate_hz {sample_rate_hz}: expected 50 to 50000"));
        }
        Ok(Self { interrupt: None, address, range_rad, sample_rate_hz, port: None })
    }

    fn port(&mut self) -> Result<&mut Port, DeviceError> {
        connected(&mut self.port, &self.address)
    }

    fn check_alive(&self, answer: &str) -> Result<(), DeviceError> {
        let problem =
            || format!("answered a ping with {answer:?}: expected \"{ALIVE}\"; connect a PlayzerX to this port");
        if answer == ALIVE { Ok(()) } else { Err(DeviceError::new(self.address.to_string(), problem())) }
    }
}

impl Board for PlayzerX {
    fn channels(&self) -> usize {
        1
    }

    fn model(&self) -> &'static str {
        "Mirrorcle PlayzerX"
    }

    fn axis(&self) -> AxisLimits {
        AxisLimits {
            min_rad: -self.range_rad as f32,
            max_rad: self.range_rad as f32,
            slew_rad_s: 0.0,
            settling_s: 0.0,
            resolution_rad: (2.0 * self.range_rad / CODE_MAX) as f32,
        }
    }

    fn measures(&self) -> bool {
        false
    }

    fn attach(&mut self, interrupt: Arc<Interrupt>) {
        self.interrupt = Some(interrupt);
    }

    /// Pings the device, selects USB and the sample rate, and clears its queue.
    fn connect(&mut self) -> Result<(), DeviceError> {
        self.port = None;
        let mut port = board::open(&self.address, &self.interrupt, STOP)?;
        let answer = port.greet(&frame(b'p', &[]), GREETING_LIMIT, |line| line == ALIVE)?;
        self.check_alive(&answer)?;
        let [low, middle, high, _] = self.sample_rate_hz.to_le_bytes();
        port.write(&frame(b'i', b"usb"))?;
        port.write(&frame(b'r', &[low, middle, high]))?;
        port.write(&frame(b'c', &[]))?;
        self.port = Some(port);
        Ok(())
    }

    fn check(&mut self) -> Result<(), DeviceError> {
        let port = self.port()?;
        // It does not answer stops.
        port.take_unanswered();
        port.discard_early()?;
        port.write(&frame(b'p', &[]))?;
        let answer = port.line(ANSWER_LIMIT)?;
        self.check_alive(&answer)
    }

    fn set(&mut self, angles: &[[f64; 2]]) -> Result<bool, DeviceError> {
        let [roll, yaw] = angles[0];
        let (x, y) = (code(yaw / self.range_rad), code(roll / self.range_rad));
        let sample = [(x & 0xff) as u8, ((x >> 8) << 4) as u8 | (y & 0x0f) as u8, (y >> 4) as u8];
        let port = self.port()?;
        port.write_motion(&frame(b'D', &sample))
    }

    fn read(&mut self, _angles: &mut [[f64; 2]]) -> Result<(), DeviceError> {
        Err(DeviceError::new(self.address.to_string(), "a PlayzerX does not measure"))
    }

    /// Clears the queue; the mirror holds the last sample. The answer to a ping shows that the device
    /// has read the frame before it.
    fn stop(&mut self) -> Result<(), DeviceError> {
        self.port()?.write(STOP)?;
        self.check()
    }
}

/// The code of an axis at a share of its range from -1 to 1.
fn code(share: f64) -> u16 {
    ((share.clamp(-1.0, 1.0) + 1.0) * 0.5 * CODE_MAX).round() as u16
}

/// A frame of the protocol.
fn frame(code: u8, data: &[u8]) -> Vec<u8> {
    let length = data.len() as u8 + 5;
    [b"pl", &[code, length][..], data, b"\n"].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_0_2048_and_4095_at_the_ends_and_the_middle() {
        assert_eq!([-1.0, 0.0, 1.0, 7.0].map(code), [0, 2048, 4095, 4095]);
    }

    #[test]
    fn frames_are_those_of_the_published_table() {
        assert_eq!(frame(b'p', &[]), b"plp\x05\n");
        assert_eq!(frame(b'c', &[]), STOP);
        assert_eq!(frame(b'i', b"usb"), b"pli\x08usb\n");
        assert_eq!(frame(b'r', &[0x10, 0x27, 0]), b"plr\x08\x10\x27\x00\n");
        assert_eq!(frame(b'D', &[1, 2, 3]), b"plD\x08\x01\x02\x03\n");
    }
}
