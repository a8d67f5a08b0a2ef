//! What is remembered of one user.

use heliostat_channel::Vec3;
use heliostat_proto::{Nanos, UserState};
use heliostat_scenario::Walk;
use serde::{Deserialize, Serialize};

use crate::belief::{
    covered::Covered,
    device::{Device, DeviceSettings},
    expected::HeldPlace,
    heading::{HEADINGS, Heading},
    height::Height,
    motion::Motion,
    posture::{Posture, TiltEvidence},
};

/// Three reports show the noise if the longer of the two intervals between them is at most this many
/// times the shorter one: jitter of a tracker is within it, and a few lost reports are not.
const UNEQUAL_INTERVALS: f64 = 3.0;

/// A user's reports, motion and heading.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Track {
    pub user: u32,
    pub motion: Motion,
    pub height: Height,
    pub heading: Heading,
    pub covered: Covered,
    /// The last two reported positions, the later one first, with the time between them in s.
    pub earlier: [Option<Place>; 2],
    pub reported_velocity: Option<[f64; 2]>,
    pub tilt: TiltEvidence,
    pub device: Device,
}

/// A reported position.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Place {
    pub at_m: [f64; 2],
    pub time_ns: Nanos,
}

impl Track {
    /// Whether a recorded one holds possible values.
    pub fn is_sound(&self) -> bool {
        let Self { motion, height, covered, tilt, device, .. } = self;
        motion.is_sound() && height.is_sound() && covered.is_sound() && tilt.is_sound() && device.is_sound()
    }

    pub fn new(user: u32, priors: &Walk, known_obstacles: bool) -> Self {
        let (motion, height, heading) = (Motion::new(priors), Height::default(), Heading::default());
        let covered = if known_obstacles { Covered::KNOWN_OBSTACLES } else { Covered::UNKNOWN_OBSTACLES };
        let (tilt, device) = (TiltEvidence::default(), Device::default());
        Self { user, motion, height, heading, covered, earlier: [None; 2], reported_velocity: None, tilt, device }
    }

    /// Place of the receiver, and how it is held, at a time in ns and in s after the last report.
    pub fn held_place(
        &self,
        (time_ns, ahead_s): (Nanos, f64),
        (posture, settings): (&Posture, &DeviceSettings),
        directions: &[Vec3; HEADINGS],
    ) -> HeldPlace {
        let motion = self.motion.estimate(ahead_s);
        let [x, y] = motion.position_m;
        let [u, v] = motion.velocity_m_s;
        let heading = self.heading.known(directions).unwrap_or_default();
        let position = Vec3::new(x, y, self.height.mean_m());
        let speed = u.hypot(v);
        let held = posture.held(self.device.lean(time_ns, speed, settings), speed);
        HeldPlace { position, held, heading }
    }

    /// The square of the deviation of the middle one of three reports from the line through the others,
    /// and the variance of one axis of it as a multiple of that of a report. `None` where the intervals
    /// differ too much, and for a user with fewer than two reports before this one.
    ///
    /// e = x1 - a x0 - b x2 with a = h2 / (h1 + h2) and b = h1 / (h1 + h2) for the intervals h1 and
    /// h2, so that var e = (1 + a^2 + b^2) s^2 on a straight walk for noise s.
    pub fn interpolation_error(&self, user: &UserState, time_ns: Nanos) -> Option<(f64, f64)> {
        let [Some(last), Some(before)] = self.earlier else { return None };
        let later = time_ns.saturating_sub(last.time_ns) as f64;
        let earlier = last.time_ns.saturating_sub(before.time_ns) as f64;
        let shorter = later.min(earlier);
        if shorter <= 0.0 || later.max(earlier) > UNEQUAL_INTERVALS * shorter {
            return None;
        }
        let (of_before, of_now) = (later / (earlier + later), earlier / (earlier + later));
        let [x, y, _] = user.position_m.map(f64::from);
        let error = |now: f64, axis: usize| last.at_m[axis] - of_before * before.at_m[axis] - of_now * now;
        let (across, along) = (error(x, 0), error(y, 1));
        Some((across * across + along * along, 1.0 + of_before * of_before + of_now * of_now))
    }

    /// Time of the last report with this user.
    pub fn seen_ns(&self) -> Option<Nanos> {
        self.earlier[0].map(|place| place.time_ns)
    }

    pub fn remember(&mut self, user: &UserState, time_ns: Nanos) {
        let [x, y, _] = user.position_m.map(f64::from);
        self.earlier = [Some(Place { at_m: [x, y], time_ns }), self.earlier[0]];
        self.reported_velocity = reported_velocity(user);
    }
}

/// The velocity of a report, where it is known: by the contract two zeros stand for an unknown one, also
/// of a user who stands.
pub(super) fn reported_velocity(user: &UserState) -> Option<[f64; 2]> {
    (user.velocity_m_s != [0.0; 2]).then(|| user.velocity_m_s.map(f64::from))
}
