//! From reports to an observation: reported values are copied, the others are inferred.
//!
//! Bodies are inferred: a user stands behind the device, opposite to the direction of walking. A
//! user who has not walked yet has no body. Obstacles are those of the latest survey. Measured
//! gains of the direct path replace modelled gains, because they include blockage that no survey
//! reports.
//!
//! Where receivers report their orientation, the gains are those of the receivers as they were held
//! last, or as the filter expects them from the reports; the others are as `control.tilt` assumes.
//!
//! Users may come and go with every report, in any order. A user is known by its number: reports
//! about positions and about gains are matched by it, and it keeps its index in the observation as
//! long as possible ([`Slots`]). A user without a measured gain has the modelled one, and a
//! measured gain of an unknown user is ignored.
//!
//! `control.belief` says where the users are while the command is in force: at their reported
//! positions (`none`), further on at their reported velocity (`constant-velocity`), or where a
//! filter of all reports predicts them (`filter`, [`belief`](crate::belief)). The prediction covers
//! the age of the report, the settling time of the mirrors, and half of the interval until the next
//! report. No user is predicted to leave the room.
//!
//! With the filter, measured gains show headings and unreported obstacles. The gain of the direct
//! path is then that of the model at the predicted place, or 0 where it is blocked: by the latest
//! measurement where all obstacles are reported, and otherwise by what the filter believes.

mod beliefs;
pub mod memory;

use heliostat_channel::{Body, ChannelModel, Orientation, Vec3, blockage::Cylinder};
use heliostat_proto::{
    ChannelReport, MAX_OBSTACLES, MAX_USERS, MirrorCommand, Nanos, OrientationReport, UserReport, UserState,
};
use heliostat_scenario::{self as scenario, Scenario, WALKING_M_S};

use crate::{
    belief::{Belief, Estimate, heading::HEADING_KNOWN, posture::Posture},
    input::inbox::Inbox,
    observe::{
        lead::Lead,
        observation::Observation,
        slots::{Slots, entry_of},
    },
};

/// A velocity of more standard deviations than this shows the heading better than a distribution in
/// steps of 10 degrees.
const STRIDE_DEVIATIONS: f64 = 4.0;

/// Fills observations from the inbox; its buffers are reused and have room for [`MAX_USERS`] users.
#[derive(Clone)]
pub struct Observer {
    body: Option<Body>,
    half_room_m: [f64; 2],
    lead: Lead,
    /// Whether users are predicted at their reported velocities.
    is_extrapolating: bool,
    /// The filter of all reports; absent where `control.belief` is another one.
    belief: Option<Belief>,
    posture: Posture,
    /// A measured gain up to this one is that of a blocked path.
    detectable_gain: f64,
    slots: Slots,
    /// What is known of the user in each slot.
    seen: Vec<Seen>,
    /// The same before the slots changed.
    former: Vec<Seen>,
    orientations: Vec<Orientation>,
    los_gain: Vec<f64>,
    blockers: Vec<Cylinder>,
    /// Probability that the path to each column of mirrors is clear.
    unobstructed: Vec<f64>,
    /// All false: blockage of unknown cause shows in measured gains.
    forced: Vec<bool>,
}

/// What is known of a user besides the observation.
#[derive(Clone, Copy, Default)]
struct Seen {
    /// Unit vector in the floor plane; zero while unknown.
    heading: Vec3,
    /// Probability that the direct path is clear past all but bodies, where it is believed.
    direct_clear: Option<f64>,
}

/// Where the gains of the direct paths came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LosSource {
    /// A channel report; of the users whom it lacks, the model.
    Measured {
        /// The number of those users.
        unmeasured: usize,
    },
    /// The model, because there is no channel report of acceptable age, or it lacks every user.
    Modelled,
}

impl Observer {
    /// An observer of a scenario's room.
    pub fn new(scenario: &Scenario, model: &ChannelModel) -> Self {
        let is_filter = scenario.control.belief == scenario::Belief::Filter;
        Self {
            body: scenario.blockage.body(),
            half_room_m: [scenario.room.length_x_m / 2.0, scenario.room.length_y_m / 2.0],
            lead: Lead::new(1.0 / scenario.streams.positions.rate_hz),
            is_extrapolating: scenario.control.belief == scenario::Belief::ConstantVelocity,
            belief: is_filter.then(|| Belief::new(scenario, model, MAX_USERS)),
            posture: Posture::new(scenario.control.tilt),
            detectable_gain: scenario.streams.channel.detectable_gain(),
            slots: Slots::default(),
            seen: Vec::with_capacity(MAX_USERS),
            former: Vec::with_capacity(MAX_USERS),
            orientations: Vec::with_capacity(MAX_USERS),
            los_gain: Vec::with_capacity(MAX_USERS),
            blockers: Vec::with_capacity(MAX_OBSTACLES + MAX_USERS),
            unobstructed: vec![1.0; model.mirrors.columns()],
            forced: Vec::with_capacity(MAX_USERS),
        }
    }

    /// Extends the prediction by the settling time of the mirrors, in s, where users are predicted.
    pub fn set_settling(&mut self, settling_s: f64) {
        self.lead.settling_s = settling_s;
        if let Some(belief) = &mut self.belief {
            belief.set_settling(settling_s);
        }
    }

    /// Takes an accepted position report. Call it once for each, before [`observe`](Self::observe).
    pub fn handle_users(&mut self, report: &UserReport) {
        self.lead.handle_users(report.stamp.time_ns);
        if let Some(belief) = &mut self.belief {
            belief.handle_users(report);
        }
    }

    /// Takes an accepted orientation report. Call it once for each.
    pub fn handle_orientation(&mut self, report: &OrientationReport) {
        if let Some(belief) = &mut self.belief {
            belief.handle_orientation(report);
        }
    }

    /// Takes the accepted channel report of the inbox. Call it once for each.
    pub fn handle_channel(&mut self, model: &ChannelModel, inbox: &Inbox) {
        let Some(report) = inbox.last_channel() else { return };
        place_obstacles(&mut self.blockers, inbox);
        if let Some(belief) = &mut self.belief {
            belief.handle_channel(model, report, inbox.leds(), &self.blockers, inbox.unusable());
        }
    }

    /// Notes a command that was given.
    pub fn handle_command(&mut self, command: &MirrorCommand) {
        if let Some(belief) = &mut self.belief {
            belief.handle_command(command);
        }
    }

    /// The belief of the filter; absent where `control.belief` is another one.
    pub fn belief(&self) -> Option<&Belief> {
        self.belief.as_ref()
    }

    /// The direction in which the user in a slot of the last observation faces: a unit vector in the
    /// floor plane, zero while unknown.
    pub fn heading(&self, slot: usize) -> Vec3 {
        self.seen.get(slot).map_or(Vec3::zeros(), |seen| seen.heading)
    }

    /// From a decision to the middle of its command's time in force, for which users are predicted,
    /// in s: half of the interval between reports, and the settling time of the mirrors.
    pub fn lead_s(&self) -> f64 {
        self.lead.ahead_s(0.0)
    }

    /// Discards the users, and the directions that they face, since another source reports from now on.
    pub fn forget(&mut self) {
        self.lead.forget();
        if let Some(belief) = &mut self.belief {
            belief.forget();
        }
        self.slots.clear();
        self.seen.clear();
    }

    /// Fills an observation from the latest reports at `now`; `None` without a position report.
    ///
    /// Does not allocate.
    pub fn observe(
        &mut self,
        model: &ChannelModel,
        inbox: &Inbox,
        now: Nanos,
        into: &mut Observation,
    ) -> Option<LosSource> {
        let report = inbox.users()?;
        self.place_users(report, inbox.orientation(now), age_s(report, now), into);
        self.place_blockers(inbox, &into.positions);
        let Self { orientations, blockers, forced, .. } = self;
        if orientations.iter().any(|held| *held != Orientation::UPRIGHT) {
            into.scene.update_turned(model, &into.positions, orientations, blockers, forced);
        } else {
            into.scene.update(model, &into.positions, blockers, forced);
        }
        self.apply_belief(model, into);
        Some(match inbox.channel(now) {
            Some(channel) => self.take_gains(channel, into),
            None => LosSource::Modelled,
        })
    }

    /// Gives slots to the users of a report, which has this age in s, and predicts them.
    fn place_users(
        &mut self,
        report: &UserReport,
        held: Option<&OrientationReport>,
        age_s: f64,
        into: &mut Observation,
    ) {
        if self.slots.assign(report.users.iter().map(|user| user.user)) {
            std::mem::swap(&mut self.seen, &mut self.former);
            self.seen.clear();
            let former = |slot: &Option<usize>| slot.map_or(Seen::default(), |slot| self.former[slot]);
            self.seen.extend(self.slots.former().iter().map(former));
        }
        into.tick = report.tick;
        into.resize(self.slots.ids().len());
        into.ids.copy_from_slice(self.slots.ids());
        self.forced.resize(into.users(), false);
        self.orientations.clear();
        for (slot, id) in into.ids.iter().enumerate() {
            let Some(user) = entry_of(&report.users, slot, *id, |user| user.user) else { continue };
            let estimate = self.estimate(*id, age_s);
            let (position, velocity) = match &estimate {
                Some(estimate) => (estimate.position, estimate.velocity),
                None => self.extrapolate(user, age_s),
            };
            let seen = &mut self.seen[slot];
            match &estimate {
                Some(estimate) => seen.heading = direction(estimate),
                None if velocity.norm() > WALKING_M_S => seen.heading = velocity.normalize(),
                None => {}
            }
            seen.direct_clear = estimate.map(|estimate| estimate.direct_clear);
            (into.positions[slot], into.velocities[slot]) = (position, velocity);
            into.min_rate_bps[slot] = f64::from(user.min_rate_bps);
            let motion = (&seen.heading, velocity.norm());
            self.orientations.push(match &self.belief {
                Some(belief) => belief.orientation(*id, self.lead.ahead_s(age_s), motion),
                None => self.posture.of(held, *id, motion),
            });
        }
    }

    /// The belief about a user of the last report, which has this age in s, within the room; absent
    /// without a filter.
    fn estimate(&self, user: u32, age_s: f64) -> Option<Estimate> {
        let estimate = self.belief.as_ref()?.estimate(user, self.lead.ahead_s(age_s))?;
        Some(Estimate { position: self.within_room(estimate.position), ..estimate })
    }

    /// Position in m and velocity in m/s by a report, which has this age in s, without a filter.
    fn extrapolate(&self, user: &UserState, age_s: f64) -> (Vec3, Vec3) {
        let position = Vec3::from_iterator(user.position_m.map(f64::from));
        let [x, y] = user.velocity_m_s.map(f64::from);
        let velocity = Vec3::new(x, y, 0.0);
        if self.is_extrapolating {
            (self.within_room(position + velocity * self.lead.ahead_s(age_s)), velocity)
        } else {
            (position, velocity)
        }
    }

    fn within_room(&self, position: Vec3) -> Vec3 {
        let [half_x, half_y] = self.half_room_m;
        Vec3::new(position.x.clamp(-half_x, half_x), position.y.clamp(-half_y, half_y), position.z)
    }

    /// Applies what the filter believes about unreported obstacles and covered detectors: a direct
    /// path that is probably blocked counts as blocked, and a steering gain is multiplied by the
    /// probability that the path is clear.
    fn apply_belief(&mut self, model: &ChannelModel, into: &mut Observation) {
        let Some(belief) = &self.belief else { return };
        for (user, (position, seen)) in into.positions.iter().zip(&self.seen).enumerate() {
            if seen.direct_clear.is_some_and(|clear| clear < 0.5) {
                into.scene.set_los_blocked(user, true);
            }
            if belief.unobstructed(position, &mut self.unobstructed) {
                into.scene.weigh_columns(model, user, &self.unobstructed);
            }
        }
    }

    /// Replaces each user's modelled gain by the measured one, where there is one. A gain that the
    /// receivers cannot tell from their noise is that of a blocked path.
    fn take_gains(&mut self, channel: &ChannelReport, into: &mut Observation) -> LosSource {
        self.los_gain.clear();
        self.los_gain.extend_from_slice(into.scene.los_gain());
        let mut unmeasured = 0;
        for (slot, (id, gain)) in self.slots.ids().iter().zip(&mut self.los_gain).enumerate() {
            match entry_of(&channel.users, slot, *id, |entry| entry.user) {
                Some(entry) if f64::from(entry.los_gain) > self.detectable_gain => *gain = f64::from(entry.los_gain),
                Some(_) => *gain = 0.0,
                None => unmeasured += 1,
            }
        }
        if unmeasured > 0 && unmeasured == self.los_gain.len() {
            return LosSource::Modelled;
        }
        match &self.belief {
            None => into.scene.set_los_gain(&self.los_gain),
            Some(belief) if belief.knows_obstacles() => {
                for (user, gain) in self.los_gain.iter().enumerate() {
                    into.scene.set_los_blocked(user, *gain <= 0.0);
                }
            }
            Some(_) => {}
        }
        LosSource::Measured { unmeasured }
    }

    fn place_blockers(&mut self, inbox: &Inbox, positions: &[Vec3]) {
        place_obstacles(&mut self.blockers, inbox);
        let Some(body) = self.body else { return };
        let facing = self.seen.iter().zip(positions).filter(|(seen, _)| seen.heading != Vec3::zeros());
        self.blockers.extend(facing.map(|(seen, position)| body.behind(position, &seen.heading)));
    }
}

/// Replaces the cylinders by those of the surveyed obstacles.
fn place_obstacles(blockers: &mut Vec<Cylinder>, inbox: &Inbox) {
    blockers.clear();
    let obstacles = inbox.obstacles().into_iter().flat_map(|report| &report.obstacles);
    blockers.extend(obstacles.map(Cylinder::from));
}

/// Age in s of a report at `now`.
fn age_s(report: &UserReport, now: Nanos) -> f64 {
    now.saturating_sub(report.stamp.time_ns) as f64 * 1e-9
}

/// The direction of a believed heading: that of a walk at this speed, and otherwise the mean one,
/// unless it is unknown.
fn direction(estimate: &Estimate) -> Vec3 {
    let (certainty, speed) = (estimate.heading.norm(), estimate.velocity.norm());
    if speed > WALKING_M_S.max(STRIDE_DEVIATIONS * estimate.velocity_var_m2_s2.sqrt()) {
        estimate.velocity / speed
    } else if certainty > HEADING_KNOWN {
        estimate.heading / certainty
    } else {
        Vec3::zeros()
    }
}
