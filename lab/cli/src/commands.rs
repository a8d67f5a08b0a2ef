//! One module for each command, and what several of them share.

pub mod bench;
pub mod calibrate;
mod drawn_room;
pub mod eval;
mod json_command;
pub mod map;
pub mod report;
pub mod trace;
