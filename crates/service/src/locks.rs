//! Locks that survive a panic of another thread.
//!
//! The data behind each lock is consistent between any two operations, so a panic elsewhere does
//! not invalidate it.

use std::{
    sync::{LockResult, Mutex, MutexGuard, PoisonError, TryLockError},
    time::{Duration, Instant},
};

/// Pause between two attempts of [`lock_within`].
const RETRY_INTERVAL: Duration = Duration::from_micros(100);

/// The guard of a lock or of a wait, also after a panic of another thread.
pub fn unpoisoned<T>(result: LockResult<T>) -> T {
    result.unwrap_or_else(PoisonError::into_inner)
}

/// Waits for the lock.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    unpoisoned(mutex.lock())
}

/// The lock, unless another thread holds it.
pub fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    match mutex.try_lock() {
        Ok(guard) => Some(guard),
        Err(TryLockError::Poisoned(guard)) => Some(guard.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}

/// The lock, if it becomes free within `limit`.
pub fn lock_within<T>(mutex: &Mutex<T>, limit: Duration) -> Option<MutexGuard<'_, T>> {
    let deadline = Instant::now() + limit;
    loop {
        match try_lock(mutex) {
            None if Instant::now() < deadline => std::thread::sleep(RETRY_INTERVAL),
            guard => return guard,
        }
    }
}
