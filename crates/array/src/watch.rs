//! What a kit asks its caller before each movement: the time, and whether a stop waits.

use std::fmt;
use std::sync::Arc;

use crate::content::Content;
use crate::moment::Moment;

/// Which of the messages that wait are stops for the array.
pub type IsStop<'a> = &'a dyn Fn(&Content) -> bool;

/// The clock of the caller, and the messages that have arrived for the array and wait.
///
/// A call of a device can block. Meanwhile a stop arrives, and angles expire.
#[derive(Clone)]
pub struct Watch {
    clock: Arc<dyn Fn() -> Moment + Send + Sync>,
    has_stop: Arc<dyn Fn(IsStop<'_>) -> bool + Send + Sync>,
}

impl Watch {
    /// A watch of a clock, and of a queue such as [`Arrivals`](crate::arrivals::Arrivals). Neither function may wait
    /// or call the kit.
    pub fn new(
        clock: impl Fn() -> Moment + Send + Sync + 'static,
        has_stop: impl Fn(IsStop<'_>) -> bool + Send + Sync + 'static,
    ) -> Self {
        Self { clock: Arc::new(clock), has_stop: Arc::new(has_stop) }
    }

    /// The present time.
    pub fn now(&self) -> Moment {
        (self.clock)()
    }

    /// Whether such a stop waits.
    pub fn has_stop(&self, is_stop: IsStop<'_>) -> bool {
        (self.has_stop)(is_stop)
    }
}

impl fmt::Debug for Watch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Watch")
    }
}
