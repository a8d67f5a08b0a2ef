//! The states of an array from outside, without a transport.

mod blocking_device;
mod bounds;
mod common;
mod kit;
mod rules;
mod station;
mod stops;
