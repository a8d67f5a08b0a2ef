//! Sessions from outside: peers, routers and their keys.

mod access;
mod building;
mod common;
mod refusals;
mod router;
mod two_sessions;
