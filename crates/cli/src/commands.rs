//! One module for each command, and what several of them share.

pub mod bench;
pub(crate) mod calibrate;
pub mod completions;
pub(crate) mod config;
pub(crate) mod controller;
pub(crate) mod demo;
pub(crate) mod doctor;
mod ending;
mod join;
pub(crate) mod keys;
pub(crate) mod link;
pub mod mirrors;
mod moved;
mod number_table;
pub(crate) mod scenario;
pub(crate) mod status;
pub(crate) mod stop;
pub(crate) mod ui;

pub(crate) use moved::advice;
