//! The live page in a browser while processes die, stop, restart and refuse, and what its pictures do.
//!
//! Room, controller and server of the page are processes of their own, so that each can be killed
//! alone. Effects are read from the page, because the page is what must not deceive.
//!
//! - [`setting`]: the processes and the browser.
//! - [`deaths`]: processes that die; [`orders`]: orders that take effect, wait or are refused.
//! - [`explained`]: what the parts of the page mean.
//! - [`notes`]: what is wrong and lasts, with what to do; [`layout`]: what covers, shrinks or hides what.
//! - [`steady`]: what keeps its place, and what waits for the first figures.
//! - [`outages`]: how long users were below the minimum rate.
//! - [`phone`]: what a phone shows.
//! - [`tabs`]: several tabs of one browser.
//! - [`view`]: what the page draws and says about a running room.

mod deaths;
mod explained;
mod layout;
mod notes;
mod orders;
mod outages;
mod phone;
mod setting;
mod steady;
mod tabs;
mod view;
