//! A microcontroller board for servos, steppers or galvanometers, with a protocol of text lines
//! over a serial port or a socket.
//!
//! docs/servo-board.md defines the protocol; `crates/driver/reference/servo_board.ino` and
//! `examples/servo_board.py` implement the board's side.
//! Numbers are integers in urad, mechanical, roll before yaw, mirrors in order. The board answers
//! each line of the host with one line, terminated by a newline:
//!
//! | host | board | meaning |
//! | --- | --- | --- |
//! | `hello` | `heliostat 1 MIRRORS MIN MAX FEEDBACK` | version 1, mirrors, limits of both axes, 1 if it measures; at the start until it is answered, and while nothing else is sent |
//! | `set R0 Y0 R1 Y1 ...` | `ok` | turn all mirrors at once |
//! | `get` | `at R0 Y0 R1 Y1 ...` | the measured angles |
//! | `stop` | `ok` | stop all motion at once |
//!
//! A board that cannot execute a line answers `error` and the reason. It stops all motion when it
//! has received no line for a second.

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

use heliostat_array::device::DeviceError;
use heliostat_proto::AxisLimits;

use crate::devices::board::{self, Board};
use crate::devices::interrupt::Interrupt;
use crate::devices::port::{Address, Port, connected};

/// Default speed of a serial port in baud.
pub const BAUD: u32 = 115_200;

/// Timeout of an answer.
const ANSWER_LIMIT: Duration = Duration::from_millis(500);

/// Timeout of the first answer: opening the port may reset the microcontroller, and a boot loader
/// discards what it receives.
const HELLO_LIMIT: Duration = Duration::from_secs(10);

/// Timeout of the answer to a stop.
const STOP_LIMIT: Duration = Duration::from_secs(3);

/// The line that asks a board what it is, with which its answer begins, and the line that stops it.
const HELLO: &str = "hello\n";
const HELLO_ANSWER: &str = "heliostat";
const STOP: &str = "stop\n";

/// urad per rad.
const URAD: f64 = 1e6;

/// One board.
pub struct ServoBoard {
    interrupt: Option<Arc<Interrupt>>,
    address: Address,
    channels: usize,
    axis: AxisLimits,
    measures: bool,
    port: Option<Port>,
    line: String,
}

impl ServoBoard {
    /// The board at an address, with the configured mirrors and limits; a board that reports others
    /// is refused when it is connected.
    pub fn new(address: Address, channels: usize, axis: AxisLimits, measures: bool) -> Self {
        Self { interrupt: None, address, channels, axis, measures, port: None, line: String::new() }
    }

    /// Sends one line to the board and returns its answer. The answers to stops that the port wrote
    /// before come first.
    fn ask(&mut self, line: &str, limit: Duration) -> Result<String, DeviceError> {
        let port = self.port()?;
        port.discard_early()?;
        port.write(line.as_bytes())?;
        self.answer(line, limit)
    }

    fn port(&mut self) -> Result<&mut Port, DeviceError> {
        connected(&mut self.port, &self.address)
    }

    /// The answer to the line that was written last.
    fn answer(&mut self, line: &str, limit: Duration) -> Result<String, DeviceError> {
        let port = self.port()?;
        let stops = port.take_unanswered();
        // A slow board may answer a repeated `hello` only now.
        let is_late = |answer: &str| answer.starts_with(HELLO_ANSWER) && line != HELLO;
        let mut next = |limit| -> Result<String, DeviceError> {
            loop {
                let answer = port.line(limit)?;
                if !is_late(&answer) {
                    return Ok(answer);
                }
            }
        };
        for _ in 0..stops {
            next(STOP_LIMIT)?;
        }
        let answer = next(limit)?;
        match answer.strip_prefix("error") {
            Some(why) => {
                let problem = format!("the board refused `{}`:{why}", line.trim_end());
                Err(DeviceError::new(self.address.to_string(), problem))
            }
            None => Ok(answer),
        }
    }

    fn check_ok(&self, answer: &str) -> Result<(), DeviceError> {
        let problem = || format!("answered {answer:?}: expected ok");
        if answer == "ok" { Ok(()) } else { Err(DeviceError::new(self.address.to_string(), problem())) }
    }

    /// Refuses the answer to `hello` of a board that does not fit the configuration.
    fn fits(&self, answer: &str) -> Result<(), DeviceError> {
        self.check_hello(answer).map_err(|problem| DeviceError::new(self.address.to_string(), problem))
    }

    fn check_hello(&self, answer: &str) -> Result<(), String> {
        let words: Vec<&str> = answer.split_whitespace().collect();
        let ["heliostat", "1", mirrors, min, max, feedback] = words[..] else {
            let speed = if answer.is_ascii() { "" } else { "; check the speed of the port" };
            return Err(format!(
                "answered hello with {answer:?}: expected heliostat 1 MIRRORS MIN MAX FEEDBACK{speed}"
            ));
        };
        if mirrors.parse() != Ok(self.channels) {
            return Err(format!("has {mirrors} mirrors: expected {}, as configured", self.channels));
        }
        let urad = |text: &str| text.parse().map(|urad: f64| urad / URAD).unwrap_or(f64::NAN);
        let (min, max) = (urad(min), urad(max));
        let (expected_min, expected_max) = (f64::from(self.axis.min_rad), f64::from(self.axis.max_rad));
        // NaN, from a word that is not a number, is refused here too.
        if !(min <= expected_min + 1.0 / URAD && max >= expected_max - 1.0 / URAD) {
            let degrees = [min, max, expected_min, expected_max].map(f64::to_degrees);
            let [min, max, expected_min, expected_max] = degrees;
            return Err(format!(
                "turns from {min:.2} to {max:.2} degrees: expected at least {expected_min:.2} to {expected_max:.2}, as configured"
            ));
        }
        if self.measures && feedback != "1" {
            return Err("does not measure: expected feedback 1, because `measures` is true in the configuration".into());
        }
        Ok(())
    }
}

impl Board for ServoBoard {
    fn channels(&self) -> usize {
        self.channels
    }

    fn model(&self) -> &'static str {
        "servo board"
    }

    fn axis(&self) -> AxisLimits {
        self.axis
    }

    fn measures(&self) -> bool {
        self.measures
    }

    fn attach(&mut self, interrupt: Arc<Interrupt>) {
        self.interrupt = Some(interrupt);
    }

    fn connect(&mut self) -> Result<(), DeviceError> {
        self.port = None;
        let mut port = board::open(&self.address, &self.interrupt, STOP.as_bytes())?;
        let answer = port.greet(HELLO.as_bytes(), HELLO_LIMIT, |line| line.starts_with(HELLO_ANSWER))?;
        self.port = Some(port);
        self.fits(&answer)
    }

    fn check(&mut self) -> Result<(), DeviceError> {
        let answer = self.ask(HELLO, ANSWER_LIMIT)?;
        self.fits(&answer)
    }

    fn set(&mut self, angles: &[[f64; 2]]) -> Result<bool, DeviceError> {
        let mut line = std::mem::take(&mut self.line);
        line.clear();
        line.push_str("set");
        for angle in angles.iter().flatten() {
            // Writing to a string cannot fail.
            let _ = write!(line, " {}", (angle * URAD).round() as i64);
        }
        line.push('\n');
        let written = self.port().and_then(|port| {
            port.discard_early()?;
            port.write_motion(line.as_bytes())
        });
        let answer = match written {
            Ok(true) => self.answer(&line, ANSWER_LIMIT).and_then(|answer| self.check_ok(&answer)).map(|()| true),
            // A stop was ordered: these angles are not sent.
            Ok(false) => Ok(false),
            Err(problem) => Err(problem),
        };
        self.line = line;
        answer
    }

    fn read(&mut self, angles: &mut [[f64; 2]]) -> Result<(), DeviceError> {
        let answer = self.ask("get\n", ANSWER_LIMIT)?;
        let numbers = answer.strip_prefix("at").map(|rest| {
            rest.split_whitespace().map(str::parse::<i64>).collect::<Result<Vec<_>, _>>().unwrap_or_default()
        });
        match numbers {
            Some(numbers) if numbers.len() == 2 * angles.len() => {
                for (angle, urad) in angles.iter_mut().flatten().zip(numbers) {
                    *angle = urad as f64 / URAD;
                }
                Ok(())
            }
            _ => {
                let problem = format!("answered get with {answer:?}: expected at and {} numbers", 2 * angles.len());
                Err(DeviceError::new(self.address.to_string(), problem))
            }
        }
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        let answer = self.ask(STOP, STOP_LIMIT)?;
        self.check_ok(&answer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_that_is_no_text_names_the_speed_of_the_port() {
        let board = ServoBoard::new(Address::Tcp("127.0.0.1:1".into()), 1, AxisLimits::default(), false);
        let refusal = |answer: &str| board.check_hello(answer).expect_err("no answer of a board");
        assert!(refusal("\u{fffd}\u{fffd}0").ends_with("FEEDBACK; check the speed of the port"));
        assert!(refusal("hello").ends_with("FEEDBACK"));
    }
}
