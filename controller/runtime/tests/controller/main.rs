//! The controller process from outside.

mod node;
mod publication;
#[path = "../../../core/tests/core/support.rs"]
#[allow(dead_code)]
mod support;
