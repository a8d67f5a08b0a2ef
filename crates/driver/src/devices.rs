//! Drivers for hardware: boards with two-axis mirrors, and their combination into one array.
//!
//! - [`board`]: the trait for one kind of board.
//! - [`board_link`]: the thread and the connection of one board; [`interrupt`]: a stop that does not
//!   wait for a device.
//! - [`playzerx`]: one mirror of a PlayzerX on a serial port, open loop.
//! - [`servo_board`]: a microcontroller board with a protocol of text lines.
//! - [`port`]: serial ports and sockets, behind one type.
//! - `system`: serial ports and the wait for a device, which differ between operating systems.
//! - [`wall`]: boards and their channels as one array.

pub mod board;
pub mod board_link;
pub mod interrupt;
pub mod playzerx;
pub mod port;
pub mod servo_board;
pub(crate) mod system;
pub mod wall;
