//! The rules for the content and the time of a report.

use heliostat_proto::{
    CLOCK_LEAD_MAX_NS, ChannelReport, LedReport, Nanos, ObstacleReport, OrientationReport, Stamp, UserReport, UserState,
};
use heliostat_scenario::Scenario;

use crate::input::refusal::{Checked, Found, LeftOut, Refusal, UserValues};

/// How far outside the room a reported position may lie, in m: a tracker's noise may exceed a wall.
const OUTSIDE_MARGIN_M: f64 = 1.0;

/// What a scenario states about its reports.
#[derive(Clone, Debug)]
pub(super) struct Rules {
    half_x_m: f64,
    half_y_m: f64,
    height_m: f64,
    leds: usize,
    /// A report older than this is refused.
    age_max_ns: Nanos,
    /// An owner without an accepted report for this time can be replaced.
    pub source_timeout_ns: Nanos,
}

impl Rules {
    /// Those of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            half_x_m: scenario.room.length_x_m / 2.0,
            half_y_m: scenario.room.length_y_m / 2.0,
            height_m: scenario.room.height_m,
            leds: scenario.led.positions_m.len(),
            age_max_ns: scenario.control.report_age_max_ns(),
            source_timeout_ns: (scenario.control.source_timeout_ms * 1e6) as Nanos,
        }
    }

    /// Whether a report is too old at `now`.
    pub fn is_stale(&self, now: Nanos, stamp: &Stamp) -> bool {
        now.saturating_sub(stamp.time_ns) > self.age_max_ns
    }

    /// Checks the time of a report that arrived at `now`.
    pub fn check_time(&self, now: Nanos, stamp: &Stamp) -> Checked {
        let age_s = now.abs_diff(stamp.time_ns) as f64 / 1e9;
        if stamp.time_ns > now.saturating_add(CLOCK_LEAD_MAX_NS) {
            return Err((Refusal::FromFuture, Found::AgeS(-age_s)));
        }
        if self.is_stale(now, stamp) {
            return Err((Refusal::Stale, Found::AgeS(age_s)));
        }
        Ok(())
    }

    /// Checks the users of a report, and that at least one of several entries is usable.
    pub fn check_users(&self, report: &UserReport) -> Checked {
        check_distinct(report.users.iter().map(|user| user.user))?;
        let mut entries = report.users.iter().map(|user| (user, self.check_user(user)));
        match entries.next() {
            Some((user, Err(first))) if entries.all(|(_, entry)| entry.is_err()) => {
                Err((first, Found::User(LeftOut::new(user, first))))
            }
            _ => Ok(()),
        }
    }

    /// Checks position, speed and minimum rate of one user.
    pub fn check_user(&self, user: &UserState) -> Result<(), Refusal> {
        let [x, y, z] = user.position_m.map(f64::from);
        let is_inside = x.abs() <= self.half_x_m + OUTSIDE_MARGIN_M
            && y.abs() <= self.half_y_m + OUTSIDE_MARGIN_M
            && (-OUTSIDE_MARGIN_M..=self.height_m).contains(&z);
        if !is_inside {
            return Err(Refusal::OutsideRoom);
        }
        plausible(UserValues::from(user).are_possible())
    }

    /// Checks the users and the LEDs of a report: each LED must be one of the scenario.
    pub fn check_leds(&self, report: &LedReport) -> Checked {
        check_distinct(report.users.iter().map(|user| user.user))?;
        let is_led = |led: u32| (led as usize) < self.leds;
        Ok(plausible(
            report.users.iter().all(|user| user.serving.is_none_or(is_led))
                && report.gains.iter().all(|gain| is_led(gain.led) && is_gain(gain.los_gain)),
        )?)
    }
}

/// Each user may appear once. The codec bounds the number of entries.
fn check_distinct(ids: impl Iterator<Item = u32> + Clone) -> Checked {
    let is_repeated = |(index, id): &(usize, u32)| ids.clone().take(*index).any(|earlier| earlier == *id);
    match ids.clone().enumerate().find(is_repeated) {
        Some((_, id)) => Err((Refusal::DuplicateUser, Found::Twice(id))),
        None => Ok(()),
    }
}

pub(super) fn check_orientation(report: &OrientationReport) -> Checked {
    check_distinct(report.users.iter().map(|user| user.user))
}

pub(super) fn check_channel(report: &ChannelReport) -> Checked {
    check_distinct(report.users.iter().map(|user| user.user))?;
    match report.users.iter().find(|user| !is_gain(user.los_gain)) {
        Some(user) => Err((Refusal::Implausible, Found::Gain { user: user.user, los_gain: user.los_gain })),
        None => Ok(()),
    }
}

/// A gain is the received share of the transmitted light.
fn is_gain(gain: f32) -> bool {
    (0.0..=1.0).contains(&gain)
}

pub(super) fn check_obstacles(report: &ObstacleReport) -> Checked {
    Ok(plausible(report.obstacles.iter().all(|obstacle| obstacle.radius_m >= 0.0 && obstacle.height_m >= 0.0))?)
}

fn plausible(holds: bool) -> Result<(), Refusal> {
    if holds { Ok(()) } else { Err(Refusal::Implausible) }
}
