//! How a user holds the device, by orientation reports.
//!
//! A report shows the device's normal at the time of its measurement, and the normal is needed some
//! time later. Its horizontal part u follows a stationary process. The mean is the horizontal part
//! of a normal that is tilted towards the face of a user with the heading h, a unit vector:
//!
//! E u(t + s) = -sin(polar) h + r(s) (u(t) + sin(polar) h), r(s) = 0.05^(s / coherence time).
//!
//! The polar angle is that of the reported normals in the mean, apart for a user who walks and for
//! one who does not. An old report therefore changes nothing but these means.
//!
//! A device that is tilted towards the face shows the heading by the azimuth of its normal. N
//! reports of this process count as N (1 - r) / (1 + r) independent ones (Bayley and Hammersley,
//! 1946).
//!
//! Source of the process: Soltani, Purwita, Zeng, Haas and Safari, "Modeling the random orientation
//! of mobile devices", IEEE Trans. Commun. 67(3), 2019.

use heliostat_channel::Vec3;
use heliostat_proto::Nanos;
use heliostat_scenario::{AssumedTilt, Scenario, UserOrientation};
use serde::{Deserialize, Serialize};

use crate::belief::heading::{HEADINGS, Heading};

/// Standard deviation of the azimuth of a held device in rad: 3.7 and 10 degrees (Soltani et al., 2019),
/// and half a step between two headings.
pub(super) const AZIMUTH_SPREAD_RAD: f64 = 0.13;

/// Standard deviation in rad of a normal for other reasons: that of a device which is held upright.
const SWAY_RAD: f64 = 0.05;

/// Probability that a device is not tilted towards the face.
const ELSEWHERE: f64 = 0.02;

/// Number of independent measurements after which a mean forgets the earlier ones.
const MEASUREMENTS_MAX: f64 = 30.0;

/// The settings that the belief about devices depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeviceSettings {
    /// Speed in m/s from which a user walks.
    walking_from_m_s: f64,
    /// Standard deviation of a reported rotation about each axis in rad.
    noise_rad: f64,
}

impl DeviceSettings {
    pub fn new(scenario: &Scenario) -> Self {
        let AssumedTilt { walking_from_m_s, .. } = scenario.control.tilt.unwrap_or_default();
        let noise_deg = scenario.streams.orientation.as_ref().map_or(0.0, |stream| stream.noise_deg);
        Self { walking_from_m_s, noise_rad: noise_deg.to_radians() }
    }
}

/// The polar angle of a device in the mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct MeanPolar {
    /// Square of the length of the normal's horizontal part, without the noise of the reports.
    sine_squared: f64,
    /// Number of independent measurements.
    measurements: f64,
}

/// A reported normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Reported {
    time_ns: Nanos,
    horizontal: [f64; 2],
}

/// What orientation reports have shown of one user's device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Device {
    /// Of a user who sits or stands, and of one who walks.
    means: [MeanPolar; 2],
    last: Option<Reported>,
}

/// The normal of a device whose user has a heading: between the last reported one and that of a
/// device tilted towards the face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lean {
    /// Mean polar angle in rad.
    pub polar_rad: f64,
    /// Horizontal part of the reported normal.
    pub reported: [f64; 2],
    /// Correlation with the reported normal, from 0 to 1.
    pub correlation: f64,
}

impl Device {
    /// Takes a reported normal (a unit vector) of a user with this speed in m/s, and what it shows
    /// of the heading.
    pub fn handle(
        &mut self,
        (time_ns, normal): (Nanos, &Vec3),
        speed: f64,
        settings: &DeviceSettings,
        (heading, directions): (&mut Heading, &[Vec3; HEADINGS]),
    ) {
        let walks = usize::from(speed >= settings.walking_from_m_s);
        let correlation = self.last.map_or(0.0, |last| correlation(walks, (time_ns, last.time_ns)));
        let independent = (1.0 - correlation) / (1.0 + correlation);
        let horizontal = [normal.x, normal.y];
        self.last = Some(Reported { time_ns, horizontal });
        let noise = settings.noise_rad.powi(2);
        self.means[walks].handle((normal.x.powi(2) + normal.y.powi(2) - 2.0 * noise).max(-1.0), independent);
        let sine = self.means[walks].sine();
        let variance = (sine * AZIMUTH_SPREAD_RAD).powi(2) + noise + SWAY_RAD.powi(2);
        heading.handle_likelihood(&likelihood(horizontal.map(|part| part * sine / variance), independent, directions));
    }

    /// The device at a time, of a user with this speed in m/s; `None` without a report.
    pub fn lean(&self, time_ns: Nanos, speed: f64, settings: &DeviceSettings) -> Option<Lean> {
        let last = self.last?;
        let walks = usize::from(speed >= settings.walking_from_m_s);
        // A user who has just begun or ceased to walk.
        let mean = [self.means[walks], self.means[1 - walks]].into_iter().find(|mean| mean.measurements > 0.0)?;
        let correlation = correlation(walks, (time_ns, last.time_ns));
        Some(Lean { polar_rad: mean.sine().asin(), reported: last.horizontal, correlation })
    }

    /// Whether a recorded state holds possible values.
    pub fn is_sound(&self) -> bool {
        let is_mean = |mean: &MeanPolar| {
            (-1.0..=1.0).contains(&mean.sine_squared) && (0.0..=MEASUREMENTS_MAX).contains(&mean.measurements)
        };
        self.means.iter().all(is_mean)
            && self.last.is_none_or(|last| last.horizontal.iter().all(|part| part.abs() <= 1.0 + 1e-9))
    }
}

impl MeanPolar {
    fn handle(&mut self, sine_squared: f64, independent: f64) {
        let all = self.measurements + independent;
        if all > 0.0 {
            self.sine_squared += independent / all * (sine_squared - self.sine_squared);
            self.measurements = all.min(MEASUREMENTS_MAX);
        }
    }

    fn sine(&self) -> f64 {
        self.sine_squared.clamp(0.0, 1.0).sqrt()
    }
}

impl Lean {
    /// The device's normal for a heading: a unit vector, or zero while unknown.
    pub fn normal(&self, heading: &Vec3) -> Vec3 {
        let Self { polar_rad, reported: [x, y], correlation } = *self;
        let mean = -polar_rad.sin() * heading;
        let horizontal = mean + correlation * (Vec3::new(x, y, 0.0) - mean);
        let length = horizontal.norm().min(1.0);
        Vec3::new(horizontal.x, horizontal.y, (1.0 - length * length).sqrt())
    }
}

/// Autocorrelation of the angles between two times.
fn correlation(walks: usize, (one_ns, other_ns): (Nanos, Nanos)) -> f64 {
    let coherence_s = UserOrientation::COHERENCE_S[walks];
    UserOrientation::AT_COHERENCE_TIME.powf(one_ns.abs_diff(other_ns) as f64 * 1e-9 / coherence_s)
}

/// Likelihood of each heading, relative to an unknown one: a von Mises distribution whose
/// concentration is the length of `away`, which points away from the face.
fn likelihood(away: [f64; 2], independent: f64, directions: &[Vec3; HEADINGS]) -> [f64; HEADINGS] {
    let concentration = away[0].hypot(away[1]);
    let density =
        directions.each_ref().map(|heading| (-away[0] * heading.x - away[1] * heading.y - concentration).exp());
    let mean = density.iter().sum::<f64>() / HEADINGS as f64;
    density.map(|density| ((1.0 - ELSEWHERE) * density / mean + ELSEWHERE).powf(independent))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::heading;

    const SETTINGS: DeviceSettings = DeviceSettings { walking_from_m_s: 0.1, noise_rad: 0.0 };

    /// The normal of a device tilted by this angle towards the face of a user who faces +x.
    fn towards_face(polar_rad: f64) -> Vec3 {
        Vec3::new(-polar_rad.sin(), 0.0, polar_rad.cos())
    }

    /// A device after reports of such normals at these speeds in m/s, 0.1 s apart, and the heading.
    fn reported(settings: &DeviceSettings, reports: &[(f64, f64)]) -> (Device, Heading) {
        let (mut device, mut heading) = (Device::default(), Heading::default());
        for (index, (polar_rad, speed)) in reports.iter().enumerate() {
            let directions = &heading::directions();
            let report = (100_000_000 * index as u64, &towards_face(*polar_rad));
            device.handle(report, *speed, settings, (&mut heading, directions));
        }
        (device, heading)
    }

    #[test]
    fn a_report_counts_by_the_autocorrelation_of_its_age() {
        let (device, _) = reported(&SETTINGS, &[(0.6, 0.0); 5]);
        for (after_s, expected) in [(0.0, 1.0), (0.373, 0.05), (0.746, 0.0025)] {
            let time_ns = 400_000_000 + (after_s * 1e9) as u64;
            let lean = device.lean(time_ns, 0.0, &SETTINGS).unwrap();
            assert!((lean.correlation - expected).abs() < 1e-6, "{after_s}: {lean:?}");
            assert!((lean.polar_rad - 0.6).abs() < 1e-9);
            // The user has turned since.
            let mean = Vec3::new(0.0, -0.6_f64.sin(), 0.0);
            let horizontal = mean + expected * (towards_face(0.6) - mean);
            let normal = lean.normal(&Vec3::y());
            assert!((normal - horizontal).xy().norm() < 1e-6 && (normal.norm() - 1.0).abs() < 1e-9, "{normal:?}");
        }
    }

    #[test]
    fn users_who_walk_and_who_do_not_have_a_polar_angle_each() {
        let (device, _) = reported(&SETTINGS, &[(0.7, 0.0), (0.5, 1.0), (0.7, 0.0), (0.5, 1.0)]);
        let polar_rad = |speed: f64| device.lean(0, speed, &SETTINGS).unwrap().polar_rad;
        assert!((polar_rad(0.0) - 0.7).abs() < 1e-9 && (polar_rad(1.0) - 0.5).abs() < 1e-9);
        let (seated, _) = reported(&SETTINGS, &[(0.7, 0.0)]);
        assert!((seated.lean(0, 1.0, &SETTINGS).unwrap().polar_rad - 0.7).abs() < 1e-9);
        assert_eq!(Device::default().lean(0, 1.0, &SETTINGS), None);
    }

    #[test]
    fn the_azimuth_of_a_tilted_device_shows_the_heading_and_that_of_a_noisy_upright_one_does_not() {
        let directions = heading::directions();
        let (_, heading) = reported(&SETTINGS, &[(0.6, 0.0); 10]);
        assert!(heading.mean(&directions).x > 0.98, "{:?}", heading.mean(&directions));
        let noisy = DeviceSettings { noise_rad: 0.05, ..SETTINGS };
        let (_, heading) = reported(&noisy, &[(0.05, 0.0); 10]);
        assert!(heading.mean(&directions).norm() < 0.1, "{:?}", heading.mean(&directions));
    }

    #[test]
    fn many_reports_of_one_moment_count_little_more_than_one() {
        let directions = heading::directions();
        let (mut device, mut heading) = (Device::default(), Heading::default());
        let mut certainty_after = |time_ns: u64| {
            device.handle((time_ns, &towards_face(0.6)), 0.0, &SETTINGS, (&mut heading, &directions));
            heading.mean(&directions).norm()
        };
        let once = certainty_after(0);
        let repeated = (0..100).map(|_| certainty_after(0)).fold(0.0, f64::max);
        assert!((repeated - once).abs() < 1e-9, "{repeated} {once}");
        assert!(certainty_after(100_000_000) > once + 1e-3);
    }

    #[test]
    fn a_recorded_state_beyond_its_bounds_is_not_sound() {
        let (device, _) = reported(&SETTINGS, &[(0.6, 0.0); 3]);
        assert!(device.is_sound());
        let mean = MeanPolar { sine_squared: f64::NAN, measurements: 1.0 };
        assert!(!Device { means: [mean; 2], ..device }.is_sound());
        let last = Some(Reported { time_ns: 0, horizontal: [2.0, 0.0] });
        assert!(!Device { last, ..device }.is_sound());
    }
}
