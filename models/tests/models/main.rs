//! Learned policies from outside: the dense engine, and the trial of actors.

mod dense;
#[path = "../../../controller/core/tests/core/dense_graphs.rs"]
#[allow(dead_code)]
mod dense_graphs;
#[path = "../../../controller/core/tests/core/support.rs"]
#[allow(dead_code)]
mod support;
mod trials;
