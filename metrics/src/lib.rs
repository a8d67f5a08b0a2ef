//! What a process tells those who operate it: metrics on a page that a scraper fetches, and logs.
//!
//! - [`Page`]: counters, gauges and histograms of one moment, written in the OpenMetrics text format.
//! - [`Exporter`]: serves the newest page under `/metrics`, on a thread of its own. Whoever decides never waits for it: pages are made by
//!   the loop that makes status reports.
//! - [`LogArgs`]: logs to standard error, as text or as JSON.

mod exporter;
mod log;
mod page;

pub use exporter::{Exporter, MetricsArgs, MetricsError};
pub use log::{LogArgs, LogFormat};
pub use page::{Histogram, Page};
