//! Rooms in operation, with the live page in a browser. One binary, because a turn of a test is one among those of a
//! process.

mod arrays;
mod belief;
mod demo;
mod states;
