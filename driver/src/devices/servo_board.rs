//! A board that understands lines of text: servos, steppers, galvanometers behind a microcontroller, over a serial port or a socket.
//!
//! The protocol is ours; `driver/reference/servo_board.ino` is a board in about 60 lines. Numbers are whole urad, mechanical, roll
//! before yaw, mirrors in order. The host speaks, the board answers each line with one line, ended by a newline:
//!
//! | host | board | meaning |
//! | --- | --- | --- |
//! | `hello` | `heliostat 1 MIRRORS MIN MAX FEEDBACK` | version 1, mirrors, limits of both axes, 1 where it measures |
//! | `set R0 Y0 R1 Y1 ...` | `ok` | turn all mirrors at once |
//! | `get` | `at R0 Y0 R1 Y1 ...` | where they are |
//! | `stop` | `ok` | stay where they are, at once |
//!
//! A board that cannot do what it is told answers `error` and why. It stops by itself when no line came for a second.

use std::fmt::Write as _;
use std::time::Duration;

use heliostat_proto::AxisLimits;

use crate::devices::Board;
use crate::devices::port::{Address, Port};
use heliostat_array::device::DeviceError;

/// Speed of a serial port unless told otherwise, in baud.
pub const BAUD: u32 = 115_200;

/// How long an answer is waited for.
const ANSWER_LIMIT: Duration = Duration::from_millis(500);

/// A board opened by a microcontroller's reset needs this long for its first answer.
const HELLO_LIMIT: Duration = Duration::from_secs(3);

/// urad in a rad.
const URAD: f64 = 1e6;

/// One board.
pub struct ServoBoard {
    address: Address,
    channels: usize,
    axis: AxisLimits,
    measures: bool,
    port: Option<Port>,
    line: String,
}

impl ServoBoard {
    /// The board at an address, of which so many mirrors and these limits are expected; a board that says otherwise is refused when it
    /// is connected.
    pub fn new(address: Address, channels: usize, axis: AxisLimits, measures: bool) -> Self {
        Self { address, channels, axis, measures, port: None, line: String::new() }
    }

    /// One line to the board, one line back.
    fn ask(&mut self, line: &str, limit: Duration) -> Result<String, DeviceError> {
        let failed = |problem: String| DeviceError::new(self.address.to_string(), problem);
        let port = self.port.as_mut().ok_or_else(|| failed("not connected".into()))?;
        port.write(line.as_bytes())?;
        let answer = port.line(limit)?;
        match answer.strip_prefix("error") {
            Some(why) => Err(failed(format!("the board refuses `{}`:{why}", line.trim_end()))),
            None => Ok(answer),
        }
    }

    fn confirm(&mut self, line: &str) -> Result<(), DeviceError> {
        match self.ask(line, ANSWER_LIMIT)? {
            answer if answer == "ok" => Ok(()),
            answer => Err(DeviceError::new(self.address.to_string(), format!("answered {answer:?}: wanted ok"))),
        }
    }

    fn check_hello(&self, answer: &str) -> Result<(), String> {
        let words: Vec<&str> = answer.split_whitespace().collect();
        let ["heliostat", "1", mirrors, min, max, feedback] = words[..] else {
            return Err(format!("answered hello with {answer:?}: wanted heliostat 1 MIRRORS MIN MAX FEEDBACK"));
        };
        if mirrors.parse() != Ok(self.channels) {
            return Err(format!("has {mirrors} mirrors: the configuration says {}", self.channels));
        }
        let urad = |text: &str| text.parse().map(|urad: f64| urad / URAD).unwrap_or(f64::NAN);
        let (min, max) = (urad(min), urad(max));
        let (wanted_min, wanted_max) = (f64::from(self.axis.min_rad), f64::from(self.axis.max_rad));
        // NaN, of a word that is no number, is refused here too.
        if !(min <= wanted_min + 1.0 / URAD && max >= wanted_max - 1.0 / URAD) {
            let degrees = [min, max, wanted_min, wanted_max].map(f64::to_degrees);
            let [min, max, wanted_min, wanted_max] = degrees;
            return Err(format!(
                "turns from {min:.2} to {max:.2} degrees: the configuration wants {wanted_min:.2} to {wanted_max:.2}"
            ));
        }
        if self.measures && feedback != "1" {
            return Err("does not measure: the configuration says that it does".into());
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

    fn connect(&mut self) -> Result<(), DeviceError> {
        self.port = None;
        let mut port = self.address.open()?;
        port.drain()?;
        self.port = Some(port);
        let answer = self.ask("hello\n", HELLO_LIMIT)?;
        self.check_hello(&answer).map_err(|problem| DeviceError::new(self.address.to_string(), problem))
    }

    fn set(&mut self, angles: &[[f64; 2]]) -> Result<(), DeviceError> {
        let mut line = std::mem::take(&mut self.line);
        line.clear();
        line.push_str("set");
        for angle in angles.iter().flatten() {
            // A string takes any text.
            let _ = write!(line, " {}", (angle * URAD).round() as i64);
        }
        line.push('\n');
        let done = self.confirm(&line);
        self.line = line;
        done
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
                let problem = format!("answered get with {answer:?}: wanted at and {} numbers", 2 * angles.len());
                Err(DeviceError::new(self.address.to_string(), problem))
            }
        }
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.confirm("stop\n")
    }
}
