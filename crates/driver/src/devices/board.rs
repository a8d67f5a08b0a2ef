//! The trait for one kind of board.

use std::sync::Arc;

use heliostat_array::device::DeviceError;
use heliostat_proto::AxisLimits;

use crate::devices::interrupt::Interrupt;
use crate::devices::port::{Address, Port};

/// Hardware with channels of two axes each. Angles are mechanical, in rad, roll first.
///
/// All calls come from one thread of the board, and each returns within a bounded time.
pub trait Board: Send {
    /// Number of mirrors.
    fn channels(&self) -> usize;

    /// Maker and model.
    fn model(&self) -> &'static str;

    /// The limits of each axis of the hardware.
    fn axis(&self) -> AxisLimits;

    /// Whether it measures angles.
    fn measures(&self) -> bool;

    /// Sets the interrupt that ends its waits; called once, before the first connection.
    fn attach(&mut self, interrupt: Arc<Interrupt>);

    /// Opens the connection and initialises the board. A stop that the interrupt has ordered is its
    /// first line, before it is known which device answers.
    ///
    /// # Errors
    /// [`DeviceError`] if no device answers, or another kind of device.
    fn connect(&mut self) -> Result<(), DeviceError>;

    /// Asks a connected board that has nothing else to do whether it still answers. Nothing moves.
    ///
    /// # Errors
    /// [`DeviceError`] if it does not answer, or another device does.
    fn check(&mut self) -> Result<(), DeviceError>;

    /// Turns all its mirrors, at once if the hardware can do that. False if a stop that was ordered
    /// meanwhile was sent in place of the angles.
    ///
    /// # Errors
    /// [`DeviceError`] if the board did not accept the angles.
    fn set(&mut self, angles: &[[f64; 2]]) -> Result<bool, DeviceError>;

    /// Reads the measured angles; called only if it measures.
    ///
    /// # Errors
    /// [`DeviceError`] if it does not answer.
    fn read(&mut self, angles: &mut [[f64; 2]]) -> Result<(), DeviceError>;

    /// Stops all motion.
    ///
    /// # Errors
    /// [`DeviceError`] if the motion may not have stopped.
    fn stop(&mut self) -> Result<(), DeviceError>;
}

/// Opens the port of a board.
pub(crate) fn open(
    address: &Address,
    interrupt: &Option<Arc<Interrupt>>,
    stop_line: &'static [u8],
) -> Result<Port, DeviceError> {
    let failed = |problem: &dyn ToString| DeviceError::new(address.to_string(), problem.to_string());
    let interrupt = interrupt.as_ref().ok_or_else(|| failed(&"the board has no thread"))?;
    address.open(interrupt, stop_line)
}
