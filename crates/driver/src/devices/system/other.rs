//! Systems without Unix terminals and sockets: no stop can end the wait for a device there, so boards are
//! refused, see [`super::IS_SUPPORTED`]. There is no [`WakeUp`], so nothing that needs one is called.

use std::fs::{File, Metadata};
use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

use super::Ready;

pub fn speeds() -> impl Iterator<Item = u32> {
    std::iter::empty()
}

pub fn is_serial_port(_: &Metadata) -> bool {
    false
}

pub fn open_serial(_: &str, _: u32) -> io::Result<File> {
    Err(ErrorKind::Unsupported.into())
}

pub trait Stream: Read + Write + Send {}

impl<T: Read + Write + Send> Stream for T {}

#[derive(Debug)]
pub enum WakeUp {}

impl WakeUp {
    pub fn new() -> io::Result<Self> {
        Err(ErrorKind::Unsupported.into())
    }

    pub fn wake(&self) {
        match *self {}
    }
}

pub fn wait(_: &dyn Stream, wake_up: &WakeUp, _: Ready, _: Duration) -> Result<(), String> {
    match *wake_up {}
}
