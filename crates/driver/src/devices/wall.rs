//! Several boards as one array: the assignment of channels to mirrors.
//!
//! Each board has a thread and a connection of its own, see [`BoardLink`]. No call of the wall waits
//! for a board. A board that does not answer is a fault of its mirrors, and the other boards follow,
//! park and stop.

use heliostat_array::device::{Device, DeviceError, Health, Waker};
use heliostat_array::moment::Moment;
use heliostat_channel::MirrorAngles;
use heliostat_proto::codec::Message;
use heliostat_proto::messages::fault;
use heliostat_proto::{AxisLimits, Capabilities, Feedback, MAX_MIRRORS, ValidityClock};
use heliostat_service::counted::counted;

use crate::devices::board::Board;
use crate::devices::board_link::BoardLink;

/// A board and the mirrors of its channels, in the order of the channels.
pub struct Mounted {
    /// The hardware.
    pub board: Box<dyn Board>,
    /// Index of the mirror at each channel.
    pub mirrors: Vec<usize>,
}

impl Mounted {
    /// A board and the indices of its mirrors.
    pub fn new(board: Box<dyn Board>, mirrors: Vec<usize>) -> Self {
        Self { board, mirrors }
    }
}

/// The properties of the complete array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Rows of mirrors.
    pub rows: usize,
    /// Columns of mirrors.
    pub columns: usize,
    /// Part of the range of the hardware, on either side, that is reserved for the corrections of a
    /// calibration, in rad.
    pub reserve_rad: f64,
    /// Time for which the mirrors hold after validity ended, in ms.
    pub park_after_ms: u32,
    /// The clock by which validity is counted.
    pub clock: ValidityClock,
}

/// A board behind its link.
struct Linked {
    link: BoardLink,
    model: &'static str,
    axis: AxisLimits,
    measures: bool,
    mirrors: Vec<usize>,
    angles: Vec<[f64; 2]>,
}

/// An array made of boards.
pub struct Wall {
    layout: Layout,
    boards: Vec<Linked>,
}

impl Wall {
    /// Combines boards; exactly one channel must turn each mirror of the layout.
    ///
    /// # Errors
    /// The board, channel or mirror that does not fit.
    pub fn new(layout: Layout, boards: Vec<Mounted>) -> Result<Self, String> {
        let count = layout.rows.saturating_mul(layout.columns);
        if !(1..=MAX_MIRRORS).contains(&count) {
            return Err(format!(
                "an array of {} x {} mirrors: expected 1 to {MAX_MIRRORS} mirrors",
                layout.rows, layout.columns
            ));
        }
        let mut turned = vec![0; count];
        for (index, Mounted { board, mirrors }) in boards.iter().enumerate() {
            if board.channels() != mirrors.len() {
                let (channels, mirrors) = (counted(board.channels(), "channel"), counted(mirrors.len(), "mirror"));
                return Err(format!(
                    "board {index} has {channels} but {mirrors}: expected as many mirrors as channels"
                ));
            }
            for mirror in mirrors {
                let unknown = || format!("board {index}: unknown mirror {mirror}: expected 0 to {}", count - 1);
                *turned.get_mut(*mirror).ok_or_else(unknown)? += 1;
            }
        }
        if let Some(mirror) = turned.iter().position(|channels| *channels != 1) {
            return Err(format!("mirror {mirror} is turned by {} channels: expected one", turned[mirror]));
        }
        let boards = boards.into_iter().map(Linked::new).collect::<Result<_, _>>();
        let wall = Self { layout, boards: boards.map_err(|error| format!("a board gets no connection: {error}"))? };
        let AxisLimits { min_rad, max_rad, .. } = wall.announced();
        // False too where one of them is not a number.
        let has_range = min_rad < max_rad;
        if !has_range {
            return Err("no range is left that all boards have: lower calibration_reserve_deg".into());
        }
        // The configuration has double precision, the announcement single.
        let announced = wall.capabilities().check();
        announced.map_err(|error| format!("a board has a value that the driver cannot announce: {error}"))?;
        Ok(wall)
    }

    /// The limits that all boards have in common.
    fn common(&self) -> AxisLimits {
        let axes: Vec<AxisLimits> = self.boards.iter().map(|board| board.axis).collect();
        let slowest = axes.iter().map(|axis| axis.slew_rad_s).filter(|slew| *slew > 0.0).reduce(f32::min);
        AxisLimits {
            min_rad: axes.iter().map(|axis| axis.min_rad).fold(f32::NEG_INFINITY, f32::max),
            max_rad: axes.iter().map(|axis| axis.max_rad).fold(f32::INFINITY, f32::min),
            slew_rad_s: slowest.unwrap_or(0.0),
            settling_s: axes.iter().map(|axis| axis.settling_s).fold(0.0, f32::max),
            resolution_rad: axes.iter().map(|axis| axis.resolution_rad).fold(0.0, f32::max),
        }
    }

    fn announced(&self) -> AxisLimits {
        let axis = self.common();
        let reserve = self.layout.reserve_rad as f32;
        AxisLimits { min_rad: axis.min_rad + reserve, max_rad: axis.max_rad - reserve, ..axis }
    }

    fn measures(&self) -> bool {
        self.boards.iter().all(|board| board.measures)
    }
}

impl Linked {
    fn new(Mounted { board, mirrors }: Mounted) -> std::io::Result<Self> {
        let (model, axis, measures) = (board.model(), board.axis(), board.measures());
        let angles = vec![[0.0; 2]; mirrors.len()];
        Ok(Self { link: BoardLink::new(board)?, model, axis, measures, mirrors, angles })
    }
}

impl Device for Wall {
    fn capabilities(&self) -> Capabilities {
        let mut models: Vec<&str> = self.boards.iter().map(|board| board.model).collect();
        models.dedup();
        let axis = self.announced();
        Capabilities {
            hardware: models.join(", "),
            driver: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
            rows: self.layout.rows as u32,
            columns: self.layout.columns as u32,
            roll: axis,
            yaw: axis,
            feedback: if self.measures() { Feedback::ClosedLoop } else { Feedback::OpenLoop },
            validity_clock: self.layout.clock,
            park_after_ms: self.layout.park_after_ms,
            park_rad: [0_f32.clamp(axis.min_rad, axis.max_rad); 2],
            ..Capabilities::default()
        }
    }

    fn travel_rad(&self) -> [[f64; 2]; 2] {
        let AxisLimits { min_rad, max_rad, .. } = self.common();
        [[min_rad, max_rad].map(f64::from); 2]
    }

    /// Starts the threads of the boards, which connect them and keep them connected.
    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.boards.iter_mut().try_for_each(|board| board.link.start())
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        for Linked { link, mirrors, angles: channels, .. } in &mut self.boards {
            for (channel, mirror) in channels.iter_mut().zip(mirrors) {
                *channel = [angles.roll[*mirror], angles.yaw[*mirror]];
            }
            link.set(channels);
        }
        Ok(())
    }

    fn request_measurement(&mut self) {
        self.boards.iter().for_each(|board| board.link.request());
    }

    /// The angles that all boards measured last; false while one of them does not answer.
    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        if !self.measures() {
            return Ok(false);
        }
        for Linked { link, mirrors, angles, .. } in &mut self.boards {
            if !link.measured(angles) {
                return Ok(false);
            }
            for ([roll, yaw], mirror) in angles.iter().zip(mirrors) {
                (into.roll[*mirror], into.yaw[*mirror]) = (*roll, *yaw);
            }
        }
        Ok(true)
    }

    /// The mirrors of boards that do not answer are broken.
    fn health(&mut self, _now: Moment) -> Result<Health, DeviceError> {
        let mut health = Health::default();
        for Linked { link, mirrors, .. } in &self.boards {
            let (is_up, problem) = link.state();
            if !is_up {
                health.faults |= fault::LINK;
                health.broken.extend(mirrors.iter().map(|mirror| *mirror as u32));
                health.problem = problem.or(health.problem);
            }
        }
        health.broken.sort_unstable();
        Ok(health)
    }

    fn set_waker(&mut self, waker: Waker) {
        self.boards.iter().for_each(|board| board.link.set_waker(waker.clone()));
    }

    fn connections(&self) -> Option<u64> {
        Some(self.boards.iter().map(|board| board.link.connections()).sum())
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.boards.iter().for_each(|board| board.link.stop());
        Ok(())
    }

    /// Whether every board has stopped. The first that does not answer is named.
    fn has_stopped(&mut self) -> Result<bool, DeviceError> {
        self.boards.iter().try_fold(true, |all, board| Ok(board.link.has_stopped()? && all))
    }
}
