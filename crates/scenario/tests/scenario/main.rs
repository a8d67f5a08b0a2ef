//! Scenarios from outside: files, geometry and arrays.

mod arrays;
mod files;
mod geometry;
