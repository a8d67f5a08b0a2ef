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

use heliostat_channel::{ChannelModel, Orientation, Vec3, blockage::Cylinder};
use heliostat_proto::{
    ChannelReport, MAX_OBSTACLES, MAX_USERS, MirrorCommand, Nanos, Obstacle, OrientationReport, UserReport,
};
use heliostat_scenario::Scenario;

use crate::{
    belief::{Belief, Estimate, body::Body, heading::HEADING_KNOWN, posture::Posture},
    input::inbox::Inbox,
    observe::{
        observation::{Observation, RoomState},
        prediction::{Predicted, Prediction},
        slots::Slots,
    },
};

/// Below this speed in m/s a velocity does not show the direction that a user faces; half of the
/// slowest walk.
const WALKING_M_S: f64 = 0.05;

/// A velocity of more standard deviations than this shows the heading better than a distribution in
/// steps of 10 degrees.
const STRIDE_DEVIATIONS: f64 = 4.0;

/// Fills observations from the inbox; its buffers are reused and have room for [`MAX_USERS`] users.
#[derive(Clone)]
pub struct Observer {
    body: Option<Body>,
    prediction: Prediction,
    slots: Slots,
    /// The users of the report, in its order.
    reported: Vec<u32>,
    /// Unit vectors in the floor plane; zero while unknown.
    headings: Vec<Vec3>,
    former_headings: Vec<Vec3>,
    positions: Vec<Vec3>,
    orientations: Vec<Orientation>,
    posture: Posture,
    velocities: Vec<Vec3>,
    /// Probability that the direct path is clear past all but bodies, where it is believed.
    direct_clear: Vec<Option<f64>>,
    min_rate_bps: Vec<f64>,
    los_gain: Vec<f64>,
    /// A measured gain up to this one is that of a blocked path.
    detectable_gain: f64,
    blockers: Vec<Cylinder>,
    /// Probability that the path to each column of mirrors is clear.
    unobstructed: Vec<f64>,
    /// All false: blockage of unknown cause shows in measured gains.
    forced: Vec<bool>,
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
        Self {
            body: Body::new(&scenario.blockage),
            prediction: Prediction::new(scenario, model),
            slots: Slots::default(),
            reported: Vec::with_capacity(MAX_USERS),
            headings: Vec::with_capacity(MAX_USERS),
            former_headings: Vec::with_capacity(MAX_USERS),
            positions: Vec::with_capacity(MAX_USERS),
            orientations: Vec::with_capacity(MAX_USERS),
            posture: Posture::new(scenario.control.tilt),
            velocities: Vec::with_capacity(MAX_USERS),
            direct_clear: Vec::with_capacity(MAX_USERS),
            min_rate_bps: Vec::with_capacity(MAX_USERS),
            los_gain: Vec::with_capacity(MAX_USERS),
            detectable_gain: scenario.streams.channel.detectable_gain(),
            blockers: Vec::with_capacity(MAX_OBSTACLES + MAX_USERS),
            unobstructed: vec![1.0; model.mirrors.columns()],
            forced: Vec::with_capacity(MAX_USERS),
        }
    }

    /// Extends the prediction by the settling time of the mirrors, in s, where users are predicted.
    pub fn set_settling(&mut self, settling_s: f64) {
        self.prediction.set_settling(settling_s);
    }

    /// Takes an accepted position report. Call it once for each, before [`observe`](Self::observe).
    pub fn handle_users(&mut self, report: &UserReport) {
        self.prediction.handle_users(report);
    }

    /// Takes an accepted orientation report. Call it once for each.
    pub fn handle_orientation(&mut self, report: &OrientationReport) {
        self.prediction.handle_orientation(report);
    }

    /// Takes the accepted channel report of the inbox. Call it once for each.
    pub fn handle_channel(&mut self, model: &ChannelModel, inbox: &Inbox) {
        let Some(report) = inbox.last_channel() else { return };
        self.place_obstacles(inbox);
        self.prediction.handle_channel(model, report, inbox.leds(), &self.blockers, inbox.unusable());
    }

    /// Notes a command that was given.
    pub fn handle_command(&mut self, command: &MirrorCommand) {
        self.prediction.handle_command(command);
    }

    /// The belief of the filter; absent where `control.belief` is another one.
    pub fn belief(&self) -> Option<&Belief> {
        self.prediction.belief()
    }

    /// The directions in which the users of the last observation face, in its order: unit vectors
    /// in the floor plane, zero while unknown.
    pub fn headings(&self) -> &[Vec3] {
        &self.headings
    }

    /// From a decision to the middle of its command's time in force, for which users are predicted,
    /// in s: half of the interval between reports, and the settling time of the mirrors.
    pub fn lead_s(&self) -> f64 {
        self.prediction.lead_s()
    }

    /// Discards the users, and the directions that they face.
    pub fn forget(&mut self) {
        self.prediction.forget();
        self.slots.clear();
        self.headings.clear();
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
        let age_s = now.saturating_sub(report.stamp.time_ns) as f64 * 1e-9;
        self.place_users(report, age_s);
        let held = inbox.orientation(now);
        self.orientations.clear();
        let users = self.slots.ids().iter().zip(self.headings.iter().zip(&self.velocities));
        self.orientations.extend(users.map(|(user, (heading, velocity))| {
            let motion = (heading, velocity.norm());
            let believed = self.prediction.orientation(*user, age_s, motion);
            believed.unwrap_or_else(|| self.posture.of(held, *user, motion))
        }));
        let is_tilted = self.orientations.iter().any(|held| *held != Orientation::UPRIGHT);
        self.place_blockers(inbox);
        into.set_state(
            model,
            &RoomState {
                tick: report.tick,
                positions: &self.positions,
                orientations: is_tilted.then_some(&self.orientations[..]),
                velocities: &self.velocities,
                min_rate_bps: &self.min_rate_bps,
                blockers: &self.blockers,
                forced: &self.forced,
                measured_los_gain: None,
            },
        );
        into.ids.copy_from_slice(self.slots.ids());
        self.apply_belief(model, into);
        Some(match inbox.channel(now) {
            Some(channel) => self.take_gains(channel, into),
            None => LosSource::Modelled,
        })
    }

    /// Gives slots to the users of a report, and fills the lists of the slots.
    fn place_users(&mut self, report: &UserReport, age_s: f64) {
        let Self { prediction, slots, reported, headings, former_headings, .. } = self;
        reported.clear();
        reported.extend(report.users.iter().map(|user| user.user));
        if slots.assign(reported) {
            former_headings.clone_from(headings);
            headings.clear();
            headings.extend(slots.former().iter().map(|slot| slot.map_or(Vec3::zeros(), |slot| former_headings[slot])));
        }
        self.positions.clear();
        self.velocities.clear();
        self.direct_clear.clear();
        self.min_rate_bps.clear();
        self.forced.clear();
        for (slot, id) in slots.ids().iter().enumerate() {
            let same_place = report.users.get(slot).filter(|user| user.user == *id);
            let Some(user) = same_place.or_else(|| report.users.iter().find(|user| user.user == *id)) else { continue };
            let Predicted { position, velocity, estimate } = prediction.predict(user, age_s);
            self.positions.push(position);
            self.velocities.push(velocity);
            self.direct_clear.push(estimate.map(|estimate| estimate.direct_clear));
            match estimate {
                Some(estimate) => headings[slot] = direction(&estimate),
                None if velocity.norm() > WALKING_M_S => headings[slot] = velocity.normalize(),
                None => {}
            }
            self.min_rate_bps.push(f64::from(user.min_rate_bps));
            self.forced.push(false);
        }
    }

    /// Applies what the filter believes about unreported obstacles and covered detectors: a direct
    /// path that is probably blocked counts as blocked, and a steering gain is multiplied by the
    /// probability that the path is clear.
    fn apply_belief(&mut self, model: &ChannelModel, into: &mut Observation) {
        let Some(belief) = self.prediction.belief() else { return };
        for (user, (position, clear)) in self.positions.iter().zip(&self.direct_clear).enumerate() {
            if clear.is_some_and(|clear| clear < 0.5) {
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
            let same_place = channel.users.get(slot).filter(|entry| entry.user == *id);
            match same_place.or_else(|| channel.users.iter().find(|entry| entry.user == *id)) {
                Some(entry) if f64::from(entry.los_gain) > self.detectable_gain => *gain = f64::from(entry.los_gain),
                Some(_) => *gain = 0.0,
                None => unmeasured += 1,
            }
        }
        if unmeasured > 0 && unmeasured == self.los_gain.len() {
            return LosSource::Modelled;
        }
        match self.prediction.belief() {
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

    fn place_blockers(&mut self, inbox: &Inbox) {
        self.place_obstacles(inbox);
        let Some(body) = self.body else { return };
        let facing = self.headings.iter().zip(&self.positions).filter(|(heading, _)| **heading != Vec3::zeros());
        self.blockers.extend(facing.map(|(heading, position)| body.behind(position, heading)));
    }

    fn place_obstacles(&mut self, inbox: &Inbox) {
        self.blockers.clear();
        let obstacles = inbox.obstacles().into_iter().flat_map(|report| &report.obstacles);
        self.blockers.extend(obstacles.map(cylinder));
    }
}

/// The cylinder of a surveyed obstacle.
fn cylinder(obstacle: &Obstacle) -> Cylinder {
    Cylinder {
        x_m: f64::from(obstacle.x_m),
        y_m: f64::from(obstacle.y_m),
        radius_m: f64::from(obstacle.radius_m),
        height_m: f64::from(obstacle.height_m),
    }
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
