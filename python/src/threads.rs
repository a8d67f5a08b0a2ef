//! The threads on which several environments step, for each thread of Python and each process.
//!
//! A forked process has none of the threads of its parent, so that it would wait for them without
//! end. Each process therefore starts threads of its own when it first needs them. The pool belongs
//! to the calling thread: no lock of another thread can be left locked by a fork.

use std::cell::RefCell;
use std::rc::Rc;

use heliostat_environment::thread_count::{THREADS_VARIABLE, check_thread_variable};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Threads, and the process that started them.
struct Threads {
    process: u32,
    /// Present until the drop.
    pool: Option<Rc<ThreadPool>>,
}

impl Threads {
    fn start() -> PyResult<Self> {
        check_thread_variable(std::env::var(THREADS_VARIABLE).ok().as_deref()).map_err(PyValueError::new_err)?;
        let pool = ThreadPoolBuilder::new().build().map_err(|error| {
            PyRuntimeError::new_err(format!("the threads of the environments cannot start: {error}"))
        })?;
        Ok(Self { process: std::process::id(), pool: Some(Rc::new(pool)) })
    }

    fn are_here(&self) -> bool {
        self.process == std::process::id()
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        // The pool of a parent stays in memory: to end it would wake threads that do not exist here.
        if !self.are_here() {
            std::mem::forget(self.pool.take());
        }
    }
}

thread_local! {
    static THREADS: RefCell<Option<Threads>> = const { RefCell::new(None) };
}

/// Runs work whose parallel parts use all cores.
pub fn on_all_cores<T: Send>(work: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    let pool = THREADS.with_borrow_mut(|threads| {
        if threads.as_ref().is_none_or(|threads| !threads.are_here()) {
            *threads = Some(Threads::start()?);
        }
        let pool = threads.as_ref().and_then(|threads| threads.pool.clone());
        pool.ok_or_else(|| PyRuntimeError::new_err("the threads of the environments have ended"))
    })?;
    pool.install(work)
}
