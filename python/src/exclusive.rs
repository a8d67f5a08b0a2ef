//! A value that one thread uses at a time, in a process that may fork.
//!
//! A fork copies a lock as it is. If another thread of the parent holds it then, no thread of the
//! child ever unlocks it. The holder's process is therefore known: a lock of the parent is refused
//! in the child, in place of a wait without end.

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// Time between two attempts to take the value.
const PAUSE: Duration = Duration::from_micros(20);

/// Waits for a lock, also after a panic of another thread.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A value with the process that uses it now.
#[derive(Debug)]
pub struct Exclusive<T> {
    /// 0 while no thread uses the value.
    process: AtomicU32,
    /// Locked by a thread only while its process stands above.
    value: Mutex<T>,
}

impl<T> Exclusive<T> {
    pub fn new(value: T) -> Self {
        Self { process: AtomicU32::new(0), value: Mutex::new(value) }
    }

    /// The value for this thread; waits for other threads of this process.
    ///
    /// # Errors
    /// `RuntimeError` where a thread of the parent used the value during the fork.
    pub fn hold(&self) -> PyResult<Held<'_, T>> {
        let own = std::process::id();
        loop {
            match self.process.compare_exchange(0, own, Ordering::Acquire, Ordering::Relaxed) {
                Ok(_) => {
                    let value = lock(&self.value);
                    return Ok(Held { value: Some(value), process: &self.process });
                }
                Err(holder) if holder == own => std::thread::sleep(PAUSE),
                Err(_) => {
                    return Err(PyRuntimeError::new_err(
                        "another thread used this object when the process was forked: make a new one in the forked \
                         process, or start workers with the method \"spawn\"",
                    ));
                }
            }
        }
    }
}

/// The value, until this is dropped.
pub struct Held<'a, T> {
    value: Option<MutexGuard<'a, T>>,
    process: &'a AtomicU32,
}

impl<T> Drop for Held<'_, T> {
    fn drop(&mut self) {
        self.value = None;
        self.process.store(0, Ordering::Release);
    }
}

impl<T> Deref for Held<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.value.as_ref().expect("present until the drop")
    }
}

impl<T> DerefMut for Held<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        self.value.as_mut().expect("present until the drop")
    }
}
