//! How the users of a belief hold their receivers, and where those who do so face.

use heliostat_channel::{Orientation, Vec3};
use heliostat_proto::OrientationReport;

use crate::belief::{Belief, heading::Heading, posture, signed_s, track::Track};

/// Up to this speed in m/s the velocity shows little of the heading.
const SLOW_M_S: f64 = 0.25;

impl Belief {
    /// Takes an accepted orientation report. Does not allocate.
    pub fn handle_orientation(&mut self, report: &OrientationReport) {
        let time_ns = report.stamp.time_ns;
        let ahead_s = signed_s(time_ns, self.last_ns);
        for track in self.tracks.present_mut() {
            let Some(orientation) = posture::reported(Some(report), track.user) else { continue };
            let [u, v] = track.motion.estimate(ahead_s).velocity_m_s;
            let heading = (&mut track.heading, &self.directions);
            track.device.handle((time_ns, &orientation.normal()), u.hypot(v), &self.devices, heading);
        }
    }

    /// How a user with this heading (a unit vector, or zero while unknown) and speed in m/s holds
    /// the receiver, at a time in s after the last report of positions.
    pub fn orientation(&self, user: u32, ahead_s: f64, (heading, speed): (&Vec3, f64)) -> Orientation {
        let time_ns = self.last_ns.saturating_add_signed((ahead_s * 1e9) as i64);
        let device = self.tracks.find(user).map(|track| &track.device);
        let lean = device.and_then(|device| device.lean(time_ns, speed, &self.devices));
        self.posture.held(lean, speed).facing(heading)
    }

    /// Decides how users hold their receivers, by the evidence of all who are remembered.
    pub(super) fn decide_posture(&mut self) {
        let was_upright = self.posture.is_upright();
        self.posture.decide(self.tracks.all().iter().map(|track| track.tilt));
        if self.posture.is_upright() != was_upright {
            // The headings so far are those by gains of other receivers.
            self.tracks.all_mut().iter_mut().for_each(|track| track.heading = Heading::default());
        }
    }

    /// The heading of a user with this speed. That of a slow user who tilts the receiver is the
    /// most probable one: measured gains are often as probable at a second heading, and between the
    /// two the receiver would face elsewhere.
    pub(super) fn heading(&self, track: &Track, speed: f64) -> Vec3 {
        let mean = track.heading.mean(&self.directions);
        if self.posture.is_upright() || speed > SLOW_M_S {
            return mean;
        }
        mean.norm() * track.heading.mode(&self.directions)
    }
}
