//! Errors and panics as Python exceptions.

use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// A refusal of a value that the caller gave.
pub fn refused(reason: impl Display) -> PyErr {
    PyValueError::new_err(reason.to_string())
}

/// An exception of a function of the caller in words, with the place in its file where that is known.
pub fn failure(py: Python<'_>, error: &PyErr) -> String {
    let place = || -> PyResult<String> {
        let place_of = py.import("heliostat._failure")?.getattr("place_of")?;
        place_of.call1((error.traceback(py),))?.extract()
    };
    // Without a place the exception alone says what has failed.
    format!("{error}{}", place().unwrap_or_default())
}

/// Runs `work`; a panic becomes a `RuntimeError` instead of an abort.
pub fn guarded<T>(work: impl FnOnce() -> Result<T, PyErr>) -> Result<T, PyErr> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Err(PyRuntimeError::new_err(format!("internal error: {text}; please report it")))
    })
}
