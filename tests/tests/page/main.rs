//! Rooms in operation, with the live page in a browser. One binary, because the limit of open
//! browsers counts those of one process.

mod arrays;
mod belief;
mod demo;
mod states;
