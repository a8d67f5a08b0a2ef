//! What a controller reports: stage times, the final summary, and metrics.

pub mod metrics;
pub mod stage_times;
pub mod summary;
