//! How long a message counts as current.

use std::time::Duration;

/// A message older than this is not displayed as current.
pub const EXPIRY: Duration = Duration::from_secs(3);
