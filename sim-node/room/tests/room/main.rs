//! The simulated room from outside: users, mirrors and reports.

mod actuator;
mod mobility;
mod orientation;
mod reports;
mod world;
