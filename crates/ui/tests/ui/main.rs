//! The live page and the stop switch from outside.

mod page;
mod stop_switch;
