//! How much one measurement adds to the earlier ones of the same user.
//!
//! The expected gain of a user has errors of the believed place, of the heading, and of the models
//! of body and receiver. While the user stays, these errors persist, so that reports of one place
//! are not independent. A series of correlated measurements is worth a smaller effective number of
//! independent ones (Bayley and Hammersley, "The effective number of independent observations in
//! an autocorrelated time series", 1946). The logarithm of each likelihood is scaled by that share.

/// Distance in m after which the errors are others: a fraction of a cell of the map of obstacles.
const CORRELATED_M: f64 = 0.05;

/// Time in s after which they are others at the same place: a few turns of a standing user.
const CORRELATED_S: f64 = 5.0;

/// Share of an independent measurement as which one counts, from 0 to 1, where the last one was
/// `interval_s` earlier and the user moves at this speed in m/s.
///
/// min(1, v t / d + t / T) with the distance d and the time T above.
pub(super) fn independent_share(speed_m_s: f64, interval_s: f64) -> f64 {
    (interval_s * (speed_m_s / CORRELATED_M + 1.0 / CORRELATED_S)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_who_stays_counts_once_within_the_correlation_time_at_any_rate() {
        for rate_hz in [1.0, 10.0, 100.0] {
            let within = CORRELATED_S * rate_hz * independent_share(0.0, 1.0 / rate_hz);
            assert!((within - 1.0).abs() < 1e-12, "{rate_hz} Hz: {within}");
        }
    }

    #[test]
    fn a_walk_counts_more_than_a_stay_and_never_more_than_once() {
        let [stays, strolls, walks] = [0.0, 0.3, 1.2].map(|speed| independent_share(speed, 0.1));
        assert!(stays < 0.1 * strolls && strolls < walks, "{stays} {strolls} {walks}");
        assert_eq!(walks, 1.0);
        assert_eq!(independent_share(0.0, f64::INFINITY), 1.0);
    }
}
