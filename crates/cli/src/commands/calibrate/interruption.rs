//! The end of a calibration on request or after its time, also while an estimate computes: that of many mirrors takes
//! minutes.

use std::path::Path;
use std::time::{Duration, Instant};

use heliostat_service::Stop;
use heliostat_service::exit::{FAILURE, INTERRUPTED};
use heliostat_service::output::error;

/// Time for an orderly end: the last readings are saved, and the mirrors are given back.
const END_WITHIN: Duration = Duration::from_secs(3);

/// Time between two looks whether the calibration has ended by itself.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// What an interrupted calibration keeps, and how it goes on.
pub fn advice(readings: Option<&Path>) -> String {
    format!("interrupted: no result is written; {}", kept(readings))
}

/// What is kept of a calibration without a result, and how it goes on.
pub fn kept(readings: Option<&Path>) -> String {
    match readings {
        Some(file) => format!("{} keeps the readings, and the same command continues from them", file.display()),
        None => "no readings are kept; with --readings FILE the same command could continue".into(),
    }
}

/// Ends the process some seconds after a request to end, or after its time, unless this value is dropped before.
#[derive(Debug)]
pub struct Watchdog {
    is_over: Stop,
}

impl Watchdog {
    /// Watches for the request, and for the end of the time. The caller saves the readings before each estimate.
    pub fn start(stop: &Stop, limit: Option<Duration>, readings: Option<&Path>) -> Self {
        let (stop, is_over, advice) = (stop.clone(), Stop::default(), advice(readings));
        let over = is_over.clone();
        std::thread::spawn(move || {
            if is_late(&stop, &over, limit, END_WITHIN) {
                error("calibrate", &advice);
                // As of a calibration that its time ends between two estimates.
                let code = if stop.is_requested() { INTERRUPTED } else { FAILURE };
                std::process::exit(code.into());
            }
        });
        Self { is_over }
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.is_over.request();
    }
}

/// Waits for a request to end, at most until the limit; whether the calibration is still not over some time later.
fn is_late(stop: &Stop, over: &Stop, limit: Option<Duration>, within: Duration) -> bool {
    let begun = Instant::now();
    let is_in_time = || limit.is_none_or(|limit| begun.elapsed() < limit);
    while is_in_time() && !stop.wait_for(LOOK_EVERY) {
        if over.is_requested() {
            return false;
        }
    }
    !over.wait_for(within)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_request_or_a_limit_that_an_estimate_outlasts_ends_the_process() {
        let requested = || {
            let stop = Stop::default();
            stop.request();
            stop
        };
        let short = Duration::from_millis(1);
        assert!(is_late(&requested(), &Stop::default(), None, short));
        assert!(!is_late(&requested(), &requested(), None, short));
        assert!(!is_late(&Stop::default(), &requested(), None, short), "it has ended by itself");
        assert!(is_late(&Stop::default(), &Stop::default(), Some(Duration::ZERO), short));
        assert!(!is_late(&Stop::default(), &requested(), Some(Duration::ZERO), short), "it has ended in time");
    }

    #[test]
    fn the_advice_names_the_file_or_the_missing_flag() {
        assert!(advice(Some(Path::new("readings.json"))).contains("readings.json keeps the readings"));
        assert!(advice(None).contains("with --readings FILE"));
    }
}
