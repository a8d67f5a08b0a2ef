//! The trait for one kind of board.

use heliostat_array::device::DeviceError;
use heliostat_proto::AxisLimits;

/// Hardware with channels of two axes each. Angles are mechanical, in rad, roll first.
pub trait Board: Send {
    /// Number of mirrors.
    fn channels(&self) -> usize;

    /// Maker and model.
    fn model(&self) -> &'static str;

    /// The limits of each axis of the hardware.
    fn axis(&self) -> AxisLimits;

    /// Whether it measures angles.
    fn measures(&self) -> bool;

    /// Opens the connection and initialises the board.
    ///
    /// # Errors
    /// [`DeviceError`] if no device answers, or another kind of device.
    fn connect(&mut self) -> Result<(), DeviceError>;

    /// Turns all its mirrors, at once if the hardware can do that.
    ///
    /// # Errors
    /// [`DeviceError`] if the board did not accept the angles.
    fn set(&mut self, angles: &[[f64; 2]]) -> Result<(), DeviceError>;

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
