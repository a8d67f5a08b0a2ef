//! The file that describes an array of real hardware: its boards, their addresses, and the mirror
//! of each channel.

use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use heliostat_files::from_toml;
use heliostat_proto::{AxisLimits, MAX_MIRRORS, ValidityClock};
use heliostat_service::input;
use serde::de::{Error, Unexpected};
use serde::{Deserialize, Deserializer};

use crate::devices::playzerx::{self, PlayzerX};
use crate::devices::port::Address;
use crate::devices::servo_board::{self, ServoBoard};
use crate::devices::system;
use crate::devices::wall::{Layout, Mounted, Wall};

/// The file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Rows of mirrors; row 0 is the lowest.
    #[serde(deserialize_with = "side")]
    pub rows: usize,
    /// Columns of mirrors; mirror index = row * columns + column.
    #[serde(deserialize_with = "side")]
    pub columns: usize,
    /// Part of the range of the hardware, on either side, that is reserved for the corrections of a
    /// calibration.
    #[serde(default)]
    pub calibration_reserve_deg: f64,
    /// Time for which the mirrors hold after the validity of a command ended, before they park.
    #[serde(default = "park_after_ms")]
    pub park_after_ms: u32,
    /// Count validity from the arrival of a command: for a host whose clock is not synchronised.
    #[serde(default)]
    pub validity_from_arrival: bool,
    /// The hardware.
    pub boards: Vec<BoardConfig>,
}

/// One board.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum BoardConfig {
    /// A Mirrorcle PlayzerX.
    Playzerx {
        /// Its address.
        address: String,
        /// Mechanical angle at the largest and smallest code.
        range_deg: f64,
        /// Sample rate at which the device applies its queue.
        #[serde(default = "sample_rate_hz")]
        sample_rate_hz: u32,
        /// The index of its mirror.
        mirrors: Vec<usize>,
    },
    /// A board with a protocol of text lines.
    ServoBoard {
        /// Its address.
        address: String,
        /// Smallest mechanical angle of both axes.
        min_deg: f64,
        /// Largest mechanical angle of both axes.
        max_deg: f64,
        /// Maximum angular speed; 0 if unknown.
        #[serde(default)]
        slew_deg_per_s: f64,
        /// Settling time of a small step; 0 if unknown.
        #[serde(default)]
        settling_ms: f64,
        /// Smallest step; 0 if unknown.
        #[serde(default)]
        resolution_deg: f64,
        /// Whether it measures angles.
        #[serde(default)]
        measures: bool,
        /// The indices of its mirrors, in the order of the channels.
        mirrors: Vec<usize>,
    },
}

/// A number of rows or columns.
fn side<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    let found = i64::deserialize(deserializer)?;
    let side = usize::try_from(found).ok().filter(|side| (1..=MAX_MIRRORS).contains(side));
    let expected = format!("a whole number from 1 to {MAX_MIRRORS}");
    side.ok_or_else(|| D::Error::invalid_value(Unexpected::Signed(found), &expected.as_str()))
}

fn park_after_ms() -> u32 {
    1000
}

fn sample_rate_hz() -> u32 {
    1000
}

impl Config {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read, or a key that is unknown, missing or of another type, with its
    /// line.
    pub fn load(file: &Path) -> Result<Self> {
        let text = input::read(file)?;
        from_toml(&text).with_context(|| format!("in {}", file.display()))
    }

    /// The array that the file describes; no device is opened yet.
    ///
    /// # Errors
    /// Boards, addresses or mirrors that do not fit together, or that no device can have.
    pub fn wall(&self) -> Result<Wall> {
        let reserve = self.calibration_reserve_deg;
        ensure!(reserve >= 0.0, "invalid calibration_reserve_deg {reserve}: expected 0 or more");
        for (index, board) in self.boards.iter().enumerate() {
            ensure!(
                !self.boards[..index].iter().any(|other| other.port() == board.port()),
                "two boards have the address \"{}\": expected one board with all its mirrors, or another address",
                board.port()
            );
        }
        let layout = Layout {
            rows: self.rows,
            columns: self.columns,
            reserve_rad: self.calibration_reserve_deg.to_radians(),
            park_after_ms: self.park_after_ms,
            clock: if self.validity_from_arrival { ValidityClock::Arrival } else { ValidityClock::SourceTime },
        };
        let boards = self.boards.iter().map(BoardConfig::mount).collect::<Result<_>>()?;
        Wall::new(layout, boards).map_err(|problem| anyhow!(problem))
    }
}

impl BoardConfig {
    /// The address without a speed.
    fn port(&self) -> &str {
        match self {
            Self::Playzerx { address, .. } | Self::ServoBoard { address, .. } => {
                address.rsplit_once('@').map_or(address, |(port, _)| port)
            }
        }
    }

    fn mount(&self) -> Result<Mounted> {
        ensure!(system::IS_SUPPORTED, "{}: this kind of device needs Linux or macOS", self.port());
        let address = |text: &str, baud| Address::parse(text, baud).map_err(|problem| anyhow!(problem));
        Ok(match self {
            Self::Playzerx { address: at, range_deg, sample_rate_hz, mirrors } => {
                let device = PlayzerX::new(address(at, playzerx::BAUD)?, range_deg.to_radians(), *sample_rate_hz);
                let device = device.map_err(|problem| anyhow!("{at}: {problem}"))?;
                Mounted::new(Box::new(device), mirrors.clone())
            }
            Self::ServoBoard {
                address: at,
                min_deg,
                max_deg,
                slew_deg_per_s,
                settling_ms,
                resolution_deg,
                measures,
                mirrors,
            } => {
                ensure!(
                    min_deg < max_deg,
                    "{at}: min_deg = {min_deg} and max_deg = {max_deg}: expected min_deg below max_deg, for example -30 and 30"
                );
                ensure!(
                    *min_deg >= -90.0 && *max_deg <= 90.0,
                    "{at}: min_deg = {min_deg} and max_deg = {max_deg}: expected angles from -90 to 90"
                );
                for (key, value) in [
                    ("slew_deg_per_s", slew_deg_per_s),
                    ("settling_ms", settling_ms),
                    ("resolution_deg", resolution_deg),
                ] {
                    ensure!(
                        value.is_finite() && *value >= 0.0,
                        "{at}: invalid {key} {value}: expected 0 or more; 0 states that it is unknown"
                    );
                }
                ensure!(
                    *resolution_deg <= max_deg - min_deg,
                    "{at}: invalid resolution_deg {resolution_deg}: expected at most {}, the range from min_deg to max_deg",
                    max_deg - min_deg
                );
                let radians = |degrees: &f64| degrees.to_radians() as f32;
                let axis = AxisLimits {
                    min_rad: radians(min_deg),
                    max_rad: radians(max_deg),
                    slew_rad_s: radians(slew_deg_per_s),
                    settling_s: (settling_ms * 1e-3) as f32,
                    resolution_rad: radians(resolution_deg),
                };
                let at = address(at, servo_board::BAUD)?;
                Mounted::new(Box::new(ServoBoard::new(at, mirrors.len(), axis, *measures)), mirrors.clone())
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use heliostat_array::device::Device;

    use super::*;

    const TWO_BOARDS: &str = r#"
        rows = 1
        columns = 3
        calibration_reserve_deg = 1.0
        [[boards]]
        kind = "playzerx"
        address = "serial:/dev/ttyACM0"
        range_deg = 5.0
        mirrors = [2]
        [[boards]]
        kind = "servo-board"
        address = "tcp:127.0.0.1:9000"
        min_deg = -20.0
        max_deg = 30.0
        mirrors = [1, 0]
    "#;

    fn wall(text: &str) -> Result<Wall> {
        from_toml::<Config>(text)?.wall()
    }

    #[test]
    fn boards_become_one_array_with_their_common_capabilities() {
        let capabilities = wall(TWO_BOARDS).unwrap().capabilities();
        assert_eq!((capabilities.rows, capabilities.columns), (1, 3));
        assert!((capabilities.roll.max_rad - 4_f32.to_radians()).abs() < 1e-6, "5 degrees less the reserve");
        assert_eq!(capabilities.hardware, "Mirrorcle PlayzerX, servo board");
    }

    #[test]
    fn an_address_that_can_never_be_opened_is_refused_when_the_file_is_read() {
        let problem = |to: &str| {
            let refused = wall(&TWO_BOARDS.replace("serial:/dev/ttyACM0", to)).err();
            format!("{:#}", refused.unwrap_or_else(|| panic!("{to} was accepted")))
        };
        assert!(problem("usb:1").contains("expected serial:PATH"));
        for (address, expected) in [
            ("serial:", "expected serial:PATH"),
            ("serial:@9600", "expected serial:PATH"),
            ("serial:/dev/ttyACM0@250000", "invalid speed \"250000\""),
            ("serial:/dev/ttyACM0@0", "9600, 19200, 38400, 57600, 115200"),
            ("serial:/dev/ttyACM0@fast", "invalid speed \"fast\""),
            ("serial:/dev/ttyACM0@", "invalid speed \"\""),
            ("serial:.", "expected a serial port"),
            ("tcp:127.0.0.1", "expected serial:PATH"),
            ("tcp::9000", "expected serial:PATH"),
            ("tcp:127.0.0.1:0", "invalid port \"0\""),
            ("tcp:127.0.0.1:70000", "expected a number from 1 to 65535"),
            ("tcp:[::1]:", "invalid port"),
        ] {
            let found = problem(address);
            assert!(found.contains(expected), "{address}: {found}");
        }
        for address in ["serial:/dev/ttyACM0@57600", "serial:ttyACM0", "tcp:[::1]:9001", "tcp:board.local:9000"] {
            wall(&TWO_BOARDS.replace("serial:/dev/ttyACM0", address))
                .unwrap_or_else(|error| panic!("{address}: {error:#}"));
        }
    }

    #[test]
    fn errors_name_the_board_or_mirror_that_does_not_fit() {
        let problem = |from: &str, to: &str| format!("{:#}", wall(&TWO_BOARDS.replace(from, to)).err().expect(to));
        assert!(problem("mirrors = [2]", "mirrors = [1]").contains("mirror 1 is turned by 2 channels"));
        let turned = problem("min_deg = -20.0", "min_deg = 40.0");
        assert!(turned.contains("127.0.0.1:9000: min_deg = 40 and max_deg = 30: expected min_deg below"), "{turned}");
        assert!(problem("mirrors = [2]", "mirrors = [7]").contains("unknown mirror 7"));
        assert!(problem("mirrors = [2]", "mirrors = [2, 2]").contains("1 channel but 2 mirrors"));
        assert!(problem("columns = 3", "columns = 4").contains("mirror 3 is turned by 0 channels"));
        assert!(
            problem("calibration_reserve_deg = 1.0", "calibration_reserve_deg = -1.0").contains("expected 0 or more")
        );
        assert!(problem("max_deg = 30.0", "max_deg = nan").contains("expected min_deg below"));
        for (from, to) in [("min_deg = -20.0", "min_deg = -400.0"), ("max_deg = 30.0", "max_deg = 1e6")] {
            let beyond = problem(from, to);
            assert!(beyond.contains("127.0.0.1:9000: min_deg = ") && beyond.contains("from -90 to 90"), "{beyond}");
        }
        let coarse = problem("max_deg = 30.0", "max_deg = 30.0\nresolution_deg = 100.0");
        assert!(coarse.contains("127.0.0.1:9000: invalid resolution_deg 100: expected at most 50"), "{coarse}");
        for key in ["slew_deg_per_s", "settling_ms", "resolution_deg"] {
            for value in ["-1.0", "nan", "inf"] {
                let refused = problem("max_deg = 30.0", &format!("max_deg = 30.0\n{key} = {value}"));
                assert!(refused.contains(&format!("127.0.0.1:9000: invalid {key}")), "{refused}");
            }
        }
        let same = problem("tcp:127.0.0.1:9000", "serial:/dev/ttyACM0@115200");
        assert!(same.contains("two boards have the address \"serial:/dev/ttyACM0\""), "{same}");
        assert!(problem("range_deg", "range_degrees").contains("range_degrees"));
        assert!(problem("range_deg = 5.0", "range_deg = 0.5").contains("no range is left"));
    }

    #[test]
    fn a_value_of_another_type_is_named_with_its_line_its_key_and_in_words() {
        let of =
            |from: &str, to: &str| from_toml::<Config>(&TWO_BOARDS.replace(from, to)).expect_err("refused").to_string();
        let range = of("range_deg = 5.0", "range_deg = \"five\"");
        assert_eq!(range, "line 8: boards.0.range_deg: invalid type: string \"five\", expected a number");
        for (rows, found) in [("-1", "`-1`"), ("0", "`0`"), ("16385", "`16385`")] {
            let rows = of("rows = 1", &format!("rows = {rows}"));
            let expected = format!("rows: invalid value: integer {found}, expected a whole number from 1 to 16384");
            assert_eq!(rows.split_once(": ").map(|(_, rest)| rest), Some(expected.as_str()), "{rows}");
        }
        let missing = of("max_deg = 30.0", "");
        // Boards of another kind have no such key.
        assert_eq!(missing, "line 5: boards: missing field `max_deg`");
    }

    /// The keys of a table, from the refusal of a key that it does not have.
    fn keys(text: &str) -> Vec<String> {
        let refusal = from_toml::<Config>(text).expect_err("a key is unknown").to_string();
        let (_, known) = refusal.split_once("expected one of ").expect("the refusal names the keys");
        known.split(", ").map(|key| key.trim_matches('`').to_owned()).collect()
    }

    #[test]
    fn the_guide_has_every_key_of_the_file() {
        let guide = include_str!("../../../docs/drivers.md");
        let (_, section) = guide.split_once("\n## A file\n").expect("the guide has the section");
        let section = section.split("\n## ").next().unwrap_or_default();
        let documented = |table: &str| -> Vec<&str> {
            let rows = section.lines().filter_map(|line| line.strip_prefix("| `")?.split_once("` | "));
            rows.filter(|(_, row)| row.starts_with(table)).map(|(key, _)| key).collect()
        };
        let board = |kind: &str| keys(&format!("rows = 1\ncolumns = 1\n[[boards]]\nkind = \"{kind}\"\nx = 1"));
        for (table, mut known) in
            [("file", keys("x = 1")), ("`playzerx`", board("playzerx")), ("`servo-board`", board("servo-board"))]
        {
            let mut listed = if table == "file" { Vec::new() } else { documented("both") };
            known.retain(|key| key != "boards");
            listed.extend(documented(table));
            listed.sort_unstable();
            known.sort_unstable();
            assert_eq!(listed, known, "{table}");
        }
    }
}
