//! The channel model from outside: gains, blockage, mirrors and solvers.

mod allocations;
mod arrays;
mod blocked_paths;
mod closed_forms;
mod common;
mod independent;
mod magnitudes;
mod magnitudes_sum_rate;
mod paper_equations;
mod properties;
mod reflection;
mod scene_reference;
mod solver;
mod solver_normals;
mod spill;
mod tilt;
