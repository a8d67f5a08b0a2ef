//! The live page, the stop switch and the view from outside.

mod page;
mod stop_switch;
mod view;
