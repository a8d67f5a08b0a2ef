//! The decision core from outside: reports in, decisions out.

mod actor_files;
mod allocations;
mod arrays;
mod beliefs;
mod deadlines;
mod decisions;
mod dense;
mod dense_graphs;
mod epochs;
mod memory;
mod motion_beliefs;
mod observations;
mod obstacle_maps;
mod policies;
mod reports;
mod room_core;
mod several_leds;
mod standby;
mod support;
mod tilted_receivers;
mod users;
