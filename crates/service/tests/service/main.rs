//! What a process offers from outside: its HTTP server, and its end by signals.

mod http;
mod signals;
