//! The controller process from outside.

mod node;
mod publication;
#[path = "../../../decide/tests/decide/support.rs"]
#[allow(dead_code)]
mod support;
