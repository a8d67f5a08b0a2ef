//! The contract from outside: bytes, keys and refusals.

mod common;
mod controller_refusals;
mod fuzz;
mod golden;
mod keys;
mod number_refusals;
mod python;
mod refusals;
mod reuse;
