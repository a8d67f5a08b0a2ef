//! The central unit: from reports about a room to mirror angles, within the deadline.
//!
//! A position report arrives; the [`inbox`] takes it or refuses it by name; the [`observer`] brings the latest of each stream
//! into one [`observation`]; a [`policy`] proposes angles; [`safety`] brings them within limits; the command leaves. All of that
//! is [`core`], which is sans-I/O: it reads no clock, opens nothing, logs nothing, waits for nothing.
//!
//! It knows nothing of simulators: a real room that speaks the contract takes their place without a change here.

pub mod core;
pub mod inbox;
pub mod observation;
pub mod observer;
pub mod policy;
pub mod refused;
pub mod safety;
