//! How a user holds the receiver, by the latest orientation report.

use heliostat_channel::Orientation;
use heliostat_proto::OrientationReport;

/// The orientation of a user; a receiver that the report lacks faces up, as every receiver without a
/// report.
pub(crate) fn orientation_of(report: Option<&OrientationReport>, user: u32) -> Orientation {
    let entry = report.and_then(|report| report.users.iter().find(|entry| entry.user == user));
    entry
        .and_then(|entry| Orientation::from_quaternion(entry.quaternion.map(f64::from)).ok())
        .unwrap_or(Orientation::UPRIGHT)
}
