//! The processes of a room, each as an operator, a device or a hostile neighbour sees it.

mod absent_driver;
mod arrivals;
mod building;
mod closed_loop;
mod containers;
#[path = "../../../controller/core/tests/core/dense_graphs.rs"]
#[allow(dead_code)]
mod dense_graphs;
mod drivers;
mod epochs;
mod foreign_peers;
mod geometry;
mod hostile_files;
mod hostile_orders;
mod invalid_payloads;
mod lockstep;
mod metrics;
mod network;
mod one_process;
mod other_scenarios;
mod policies;
mod recording;
mod restarts;
mod rooms;
mod running_recordings;
mod safety;
mod security;
#[path = "../../../crates/driver/tests/driver/servo_board.rs"]
mod servo_board;
mod stops;
mod terminal;
mod trackers;
