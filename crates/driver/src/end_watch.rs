//! Reports what keeps a driver from its end after the request to end.

use std::thread::Builder;
use std::time::Duration;

use heliostat_service::Stop;

/// Time from the request to the report, within which a driver ends that nothing blocks.
const GRACE: Duration = Duration::from_millis(300);

/// Time between two looks whether the driver has ended without a request.
const LOOK_EVERY: Duration = Duration::from_millis(200);

const KEPT: &str =
    "the driver ends when its device and the record of its stop answer; a second Ctrl-C or SIGTERM ends it at once";

/// A thread that logs once if a driver does not end soon after the request; until it is dropped.
pub struct EndWatch {
    over: Stop,
}

impl EndWatch {
    /// Watches a driver that ends when `stop` is requested.
    pub fn start(stop: &Stop) -> Self {
        let (stop, over) = (stop.clone(), Stop::default());
        let watched = over.clone();
        let watch = move || report_late_end(&stop, &watched, || tracing::warn!("{KEPT}"));
        // Without the thread only the report is missing.
        drop(Builder::new().name("end watch".into()).spawn(watch));
        Self { over }
    }
}

impl Drop for EndWatch {
    fn drop(&mut self) {
        self.over.request();
    }
}

/// Calls `report` if `over` is not requested soon after `stop`.
fn report_late_end(stop: &Stop, over: &Stop, report: impl FnOnce()) {
    while !stop.wait_for(LOOK_EVERY) {
        if over.is_requested() {
            return;
        }
    }
    if !over.wait_for(GRACE) {
        report();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driver_that_does_not_end_after_the_request_is_reported() {
        let reported = |stop: bool, over: bool| {
            let requests = [Stop::default(), Stop::default()];
            for (request, _) in requests.iter().zip([stop, over]).filter(|(_, is_made)| *is_made) {
                request.request();
            }
            let mut is_reported = false;
            report_late_end(&requests[0], &requests[1], || is_reported = true);
            is_reported
        };
        assert!(reported(true, false), "it is kept from its end");
        assert!(!reported(true, true), "it has ended");
        assert!(!reported(false, true), "it has ended without a request");
    }
}
