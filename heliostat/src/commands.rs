//! One module a command.

pub mod bench;
pub mod demo;
pub mod eval;
pub mod link;
pub mod map;
pub mod scenario;
