//! The other processes with the mirrors of a driver in Python: `heliostat_array::others`, with its calling order.

use std::sync::Mutex;

use heliostat_array::others::{Others as Rules, RoomTaken as Taken};
use pyo3::create_exception;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

use crate::error::guarded;
use crate::exclusive::lock;
use crate::wire;

create_exception!(heliostat, RoomTaken, PyException, "Another process has the mirrors; the text names it.");

/// The tokens of other processes with the same mirrors. Times are monotonic, in ns; any thread may call it.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Others(Mutex<Rules>);

impl Others {
    fn with<T>(&self, work: impl FnOnce(&mut Rules) -> Result<T, Taken>) -> PyResult<T> {
        let mut rules = lock(&self.0);
        guarded(|| work(&mut rules).map_err(|taken| RoomTaken::new_err(taken.to_string())))
    }
}

#[pymethods]
impl Others {
    #[new]
    fn new(room: &str, source: u64) -> PyResult<Self> {
        Ok(Self(Mutex::new(Rules::new(wire::room(room)?.to_string(), source))))
    }

    /// Notes that a token has appeared or disappeared.
    fn note(&self, token: &str, is_alive: bool, now_ns: u64) -> PyResult<()> {
        self.with(|rules| {
            rules.note(token, is_alive, now_ns);
            Ok(())
        })
    }

    /// Number of processes that are there.
    #[getter]
    fn count(&self) -> PyResult<u64> {
        self.with(|rules| Ok(rules.count()))
    }

    /// Raises `RoomTaken` if another process is there.
    fn check_free(&self) -> PyResult<()> {
        self.with(|rules| rules.check_free())
    }

    /// Notes that the own token is declared now; raises `RoomTaken` if another one has appeared since the begin.
    fn announce(&self, now_ns: u64) -> PyResult<()> {
        self.with(|rules| rules.announce(now_ns))
    }

    /// The notes and the problems since the last check; raises `RoomTaken` if this process has to end.
    fn check(&self, now_ns: u64) -> PyResult<(Vec<String>, Vec<String>)> {
        self.with(|rules| rules.check(now_ns).map(|findings| (findings.notes, findings.problems)))
    }
}
