//! Rooms in operation, with the live page in a browser. The limit of open browsers is one of this process.

mod arrays;
mod belief;
mod calibration;
mod demo;
mod states;
