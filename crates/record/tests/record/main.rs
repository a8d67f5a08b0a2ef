//! Recordings from outside: their files, and the messages that are recorded.

mod accepted_messages;
mod file;
