//! Tasks and closed loops from outside.

mod light;
mod task;
