//! The disk with the record of the stop of an array; it outlives the process.

use std::cell::RefCell;
use std::rc::Rc;

use heliostat_array::latch::Latch;
use heliostat_array::stop_record::StopStore;
use rand::RngExt;

use crate::mutation::Mutation;
use crate::plan::DiskAfterCrash;
use crate::random::Rng;

/// A disk with one record.
#[derive(Debug, Default)]
pub(crate) struct Disk {
    text: Option<String>,
    /// How many faults make it full.
    pub full: u32,
    /// Whether the record says less than the process knew: the next start must be a stopped one.
    pub is_damaged: bool,
    mutation: Option<Mutation>,
}

/// A disk that the process and the harness share.
pub(crate) type SharedDisk = Rc<RefCell<Disk>>;

impl Disk {
    pub fn new(mutation: Option<Mutation>) -> SharedDisk {
        Rc::new(RefCell::new(Self { mutation, ..Self::default() }))
    }

    /// The process that wrote the record has crashed.
    pub fn crash(&mut self, disk: DiskAfterCrash, rng: &mut Rng) {
        match (disk, &mut self.text) {
            (DiskAfterCrash::Kept, _) => {}
            (DiskAfterCrash::Torn, Some(text)) if !text.trim_end().is_empty() => {
                let end = rng.random_range(0..text.trim_end().len());
                text.truncate((0..=end).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0));
                self.is_damaged = true;
            }
            (_, text) => {
                *text = None;
                self.is_damaged = true;
            }
        }
        if self.mutation == Some(Mutation::StopForgottenAtRestart) {
            self.text = Some(Latch::default().to_toml());
        }
    }
}

/// The record as the process sees it.
#[derive(Debug)]
pub(crate) struct SimDisk(pub SharedDisk);

impl StopStore for SimDisk {
    fn name(&self) -> String {
        "the disk".into()
    }

    fn read(&mut self) -> Result<Option<String>, String> {
        Ok(self.0.borrow().text.clone())
    }

    fn replace(&mut self, text: &str) -> Result<(), String> {
        let mut disk = self.0.borrow_mut();
        if disk.full > 0 {
            return Err("no space left on device".into());
        }
        disk.text = Some(text.to_owned());
        disk.is_damaged = false;
        Ok(())
    }

    fn empty(&mut self) -> Result<(), String> {
        let mut disk = self.0.borrow_mut();
        disk.is_damaged = true;
        if disk.mutation != Some(Mutation::StaleRecordAfterFullDisk) {
            disk.text = Some(String::new());
        }
        Ok(())
    }
}
