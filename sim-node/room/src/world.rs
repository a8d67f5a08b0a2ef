//! Users, obstacles and the channel between them, without the motion of the mirrors.
//!
//! Training steps a world directly; `SimulatedRoom` steps it together with the mirrors. All random
//! numbers come from the seed, one stream for each purpose ([`crate::random`]), so that a change of
//! one setting does not change the rest. [`World::step`] does not allocate.
//!
//! - [`arrivals`]: when users enter and leave.
//! - [`walker`]: the floor and one user's receiver.
//! - [`mobility`], [`trace`]: models of movement and recorded walks.
//! - [`orientation`]: how the users hold their receivers.
//! - [`obstacles`]: the hard-core process.

use heliostat_channel::{ChannelError, ChannelModel, Cylinder, Orientation, Scene, Vec3};
use heliostat_scenario::{Blockage, MobilityModel, Scenario, Spreads};
use thiserror::Error;

use self::arrivals::{Arrivals, Change, Turnover};
use self::mobility::places::distance_m;
use self::mobility::{Mobility, MobilityError, Speeds, Waypoints};
use self::obstacles::{HardCore, ObstacleError};
use self::orientation::Orientations;
use self::trace::{Trace, TraceError};
use self::walker::{Floor, Walker};
use crate::mismatch::{TrueBody, true_room};
use crate::random::{self, Purpose};

pub mod arrivals;
pub mod mobility;
pub mod obstacles;
pub mod orientation;
pub mod trace;
pub mod walker;

/// Why a world cannot be made from a scenario.
#[derive(Debug, Error)]
pub enum WorldError {
    /// The scenario describes no valid channel.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The walking speeds are not valid.
    #[error(transparent)]
    Mobility(#[from] MobilityError),
    /// The obstacles cannot be placed.
    #[error(transparent)]
    Obstacles(#[from] ObstacleError),
    /// The scenario names a recorded walk, and the caller did not pass its text.
    #[error("users.trace: {path}: no text of this recorded walk: expected the caller to pass it")]
    TraceExpected {
        /// The file that the scenario names.
        path: String,
    },
    /// The recorded walk is not valid.
    #[error("users.trace: {path}: {reason}")]
    Trace {
        /// The file.
        path: String,
        /// What is wrong, with the line.
        reason: TraceError,
    },
}

/// The room at one instant.
#[derive(Clone, Debug)]
pub struct World {
    model: ChannelModel,
    waypoints: Waypoints,
    hard_core: HardCore,
    blockage: Blockage,
    /// Seats of the scenario, which stay free of obstacles.
    seats_m: Vec<[f64; 2]>,
    /// Spreads of the users' true bodies around those of `blockage`.
    spreads: Spreads,
    mobility: Mobility,
    seed: u64,
    /// Number of users at the start.
    users: usize,
    /// `None`: the users stay.
    arrivals: Option<Arrivals>,
    settings: Option<heliostat_scenario::Arrivals>,
    /// Numbers of the users, in the order of entry as all lists of users.
    ids: Vec<u32>,
    /// A receiver before its first step.
    start: Walker,
    walkers: Vec<Walker>,
    orientations: Orientations,
    /// How the users hold their receivers, with the true tilt of each.
    held: Vec<Orientation>,
    positions: Vec<Vec3>,
    /// The users' true bodies.
    bodies: Vec<TrueBody>,
    /// Obstacles first, then one body for each user when bodies block.
    blockers: Vec<Cylinder>,
    obstacles: usize,
    /// Number of users, counted from the first present, whose direct path is off.
    forced_users: usize,
    forced: Vec<bool>,
    min_rate_bps: Vec<f64>,
    /// Minimum rates of the users at the start; those who enter have them in turn.
    min_rates_bps: Vec<f64>,
    scene: Scene,
    time_s: f64,
}

impl World {
    /// The world of a scenario.
    ///
    /// `seed` replaces the scenario's own seed; `trace` is the text of the file `users.trace`.
    ///
    /// # Errors
    /// [`WorldError`] for a scenario whose channel, speeds, obstacles or recorded walk are not
    /// valid.
    pub fn new(scenario: &Scenario, trace: Option<&str>, seed: u64) -> Result<Self, WorldError> {
        let model = true_room(scenario, seed).channel_model()?;
        let floor = Floor { length_x_m: scenario.room.length_x_m, length_y_m: scenario.room.length_y_m };
        let speeds = Speeds::new(scenario.users.speed_min_m_s, scenario.users.speed_max_m_s)?;
        let waypoints = Waypoints { floor, speeds, pause_mean_s: scenario.users.pause_mean_s };
        let users = scenario.users.count;
        let mobility = match &scenario.users.trace {
            Some(path) => Mobility::Trace(parse_trace(path, trace, users, &floor)?),
            None => Mobility::new(scenario, waypoints),
        };
        let blockage = scenario.blockage.clone();
        let has_seats = scenario.users.trace.is_none()
            && matches!(scenario.users.mobility, MobilityModel::Seated | MobilityModel::Mixture);
        let start = Vec3::new(0.0, 0.0, scenario.receiver.height_m);
        let mut world = Self {
            scene: Scene::new(&model, users),
            model,
            waypoints,
            hard_core: HardCore::new(blockage.obstacles_per_m2, blockage.obstacle_min_distance_m)?,
            mobility,
            seed,
            seats_m: if has_seats { scenario.users.seats_m.clone() } else { Vec::new() },
            users,
            arrivals: None,
            settings: scenario.users.arrivals.clone(),
            ids: Vec::new(),
            start: Walker { position: start, direction: [1.0, 0.0], velocity: [0.0, 0.0] },
            walkers: Vec::new(),
            orientations: Orientations::new(&scenario.users),
            held: Vec::new(),
            positions: Vec::new(),
            bodies: Vec::new(),
            blockers: Vec::new(),
            obstacles: 0,
            spreads: scenario.mismatch.spreads(),
            forced_users: blockage.forced_users,
            forced: Vec::new(),
            min_rate_bps: Vec::new(),
            min_rates_bps: scenario.min_rate_bps(),
            time_s: 0.0,
            blockage,
        };
        world.begin(seed);
        Ok(world)
    }

    /// All problems of the text of a scenario's recorded walk.
    pub fn trace_problems(scenario: &Scenario, text: &str) -> Vec<TraceError> {
        let floor = Floor { length_x_m: scenario.room.length_x_m, length_y_m: scenario.room.length_y_m };
        Trace::problems(text, scenario.users.count, &floor)
    }

    /// Restarts at time 0 with another seed: new walks and new obstacles in the same room.
    ///
    /// A recorded walk continues.
    pub fn restart(&mut self, seed: u64) {
        self.time_s = 0.0;
        self.begin(seed);
    }

    /// Duration of the recorded walk in s; `None` for a random walk.
    pub fn recording_s(&self) -> Option<f64> {
        match &self.mobility {
            Mobility::Trace(trace) => Some(trace.duration_s()),
            Mobility::RandomWaypoint { .. } | Mobility::Crowd(_) => None,
        }
    }

    /// Continues a recorded walk at this time in s, which may be negative or beyond its end since
    /// it repeats; no effect on a random walk.
    pub fn seek_recording(&mut self, time_s: f64) {
        if let Mobility::Trace(trace) = &mut self.mobility {
            trace.seek(time_s);
            self.refresh();
        }
    }

    /// Places the users of the start and the obstacles.
    fn begin(&mut self, seed: u64) {
        self.seed = seed;
        self.arrivals = self.settings.as_ref().map(|settings| Arrivals::new(settings, self.users, seed));
        self.place_obstacles(seed);
        self.mobility.begin(self.users, seed, &self.blockers);
        // Once for the largest number of users, so that later changes do not allocate.
        let most = self.settings.as_ref().map_or(self.users, |settings| settings.max_users.max(self.users));
        for users in [most, self.users] {
            self.ids.clear();
            self.ids.extend(0..users as u32);
            self.resize_lists();
        }
        self.mobility.reserve(most);
        self.mobility.write(&mut self.walkers);
        self.orientations.begin(seed, &self.walkers, most, |id| self.mobility.entry_of(id));
        self.refresh();
    }

    /// Advances by `dt_s` seconds and updates the scene.
    pub fn step(&mut self, dt_s: f64) {
        self.advance(dt_s);
        self.refresh();
    }

    /// Advances by `dt_s` seconds without an update of the scene; [`World::refresh`] does that.
    pub fn advance(&mut self, dt_s: f64) {
        let mut left_s = dt_s;
        while let Some(node_s) = self.orientations.next_node_s().filter(|node_s| *node_s < self.time_s + left_s) {
            let until_s = (node_s - self.time_s).max(0.0);
            self.walk(until_s);
            left_s -= until_s;
            self.mobility.write_velocities(&mut self.walkers);
            self.orientations.pass_node(&self.walkers);
        }
        self.walk(left_s);
    }

    /// Moves the users, and lets them enter and leave.
    fn walk(&mut self, dt_s: f64) {
        let mut moved_to_s = self.time_s;
        self.time_s += dt_s;
        let is_crowd = self.mobility.is_crowd();
        if !is_crowd {
            self.mobility.step(dt_s);
        }
        let mut changed = false;
        while let Some(change) = self.arrivals.as_mut().and_then(|arrivals| arrivals.next_change(self.time_s)) {
            changed = true;
            if is_crowd {
                self.mobility.step(change.at_s() - moved_to_s);
                moved_to_s = change.at_s();
            }
            match change {
                Change::Enter { at_s, id } => {
                    self.mobility.enter(id, self.time_s - at_s);
                    self.orientations.enter(id, self.mobility.entry_of(id));
                    self.ids.push(id);
                }
                Change::Leave { index, .. } => {
                    self.mobility.leave(index);
                    self.orientations.leave(index);
                    self.ids.remove(index);
                }
            }
        }
        if is_crowd {
            self.mobility.step(self.time_s - moved_to_s);
        }
        if changed {
            self.resize_lists();
        }
    }

    /// Gives the lists of users the length of `ids`; [`World::refresh`] fills the others.
    fn resize_lists(&mut self) {
        let users = self.ids.len();
        self.walkers.resize(users, self.start);
        self.positions.resize(users, self.start.position);
        self.forced.clear();
        self.forced.extend((0..users).map(|user| user < self.forced_users));
        let rates = &self.min_rates_bps;
        self.min_rate_bps.clear();
        self.min_rate_bps.extend(self.ids.iter().map(|id| rates[*id as usize % rates.len()]));
        self.bodies.clear();
        let body = |id: &u32| TrueBody::draw(&self.blockage, &self.spreads, (self.seed, *id));
        self.bodies.extend(self.ids.iter().map(body));
        if self.blockage.bodies {
            self.blockers.truncate(self.obstacles);
            let origin = Vec3::zeros();
            self.blockers.extend(self.bodies.iter().map(|body| body.shape.behind(&origin, &origin)));
        }
        self.scene.resize(users);
    }

    /// Updates positions, blockers and scene.
    pub fn refresh(&mut self) {
        self.mobility.write(&mut self.walkers);
        for (position, walker) in self.positions.iter_mut().zip(&self.walkers) {
            *position = walker.position;
        }
        let bodies = self.blockers[self.obstacles..].iter_mut().zip(&self.bodies);
        for ((cylinder, body), walker) in bodies.zip(&self.walkers) {
            let [x, y] = walker.direction;
            *cylinder = body.shape.behind(&walker.position, &Vec3::new(x, y, 0.0));
        }
        self.orientations.hold(self.time_s, &self.walkers);
        self.held.clear();
        let tilted = |(body, held): (&TrueBody, &Orientation)| body.tilt.then(held);
        self.held.extend(self.bodies.iter().zip(self.orientations.held()).map(tilted));
        self.scene.update_turned(&self.model, &self.positions, &self.held, &self.blockers, &self.forced);
    }

    /// The users' numbers, in the order of entry, as all lists of users. No number is used twice.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// The users who entered and left; `None` where the users stay.
    pub fn turnover(&self) -> Option<Turnover> {
        self.arrivals.as_ref().map(Arrivals::turnover)
    }

    /// The users' receivers: positions, headings and velocities.
    pub fn users(&self) -> &[Walker] {
        &self.walkers
    }

    /// The orientations of the users' receivers: those of the devices, with the true tilt of each
    /// receiver in its device.
    pub fn orientations(&self) -> &[Orientation] {
        &self.held
    }

    /// How the users hold their devices, which a sensor in the device can measure.
    pub fn device_orientations(&self) -> &[Orientation] {
        self.orientations.held()
    }

    /// Positions of the users' receivers in m.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Everything that blocks light: the obstacles, then the users' bodies.
    pub fn blockers(&self) -> &[Cylinder] {
        &self.blockers
    }

    /// The obstacles.
    pub fn obstacles(&self) -> &[Cylinder] {
        &self.blockers[..self.obstacles]
    }

    /// For each user, whether the direct path is forced off.
    pub fn forced(&self) -> &[bool] {
        &self.forced
    }

    /// Each user's minimum rate in bit/s.
    pub fn min_rate_bps(&self) -> &[f64] {
        &self.min_rate_bps
    }

    /// The channel at this instant.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The room's equipment.
    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// Seconds since the start.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Forces the direct paths of the first `users` users off and those of the others on, from the
    /// next refresh on.
    pub fn set_forced(&mut self, users: usize) {
        self.forced_users = users;
        for (user, forced) in self.forced.iter_mut().enumerate() {
            *forced = user < users;
        }
    }

    /// New walking speeds in m/s; no effect on a recorded walk.
    ///
    /// # Errors
    /// [`MobilityError`] for speeds that are not valid; the old speeds remain.
    pub fn set_speed(&mut self, min_m_s: f64, max_m_s: f64) -> Result<(), MobilityError> {
        self.waypoints.speeds = Speeds::new(min_m_s, max_m_s)?;
        self.mobility.set_speeds(self.waypoints.speeds);
        Ok(())
    }

    /// Minimum and maximum walking speed in m/s.
    pub fn speeds_m_s(&self) -> [f64; 2] {
        self.waypoints.speeds.bounds_m_s()
    }

    /// Sets the transmitted power in W; returns false, without a change, for a value that is not
    /// positive.
    pub fn set_power(&mut self, power_w: f64) -> bool {
        let valid = power_w.is_finite() && power_w > 0.0;
        if valid {
            self.model.budget.power_w = power_w;
        }
        valid
    }

    fn place_obstacles(&mut self, seed: u64) {
        let blockage = &self.blockage;
        let points = self.hard_core.sample(&self.waypoints.floor, &mut random::stream(seed, Purpose::Obstacles, 0));
        let cylinder = |at: [f64; 2], radius_m, height_m| Cylinder { x_m: at[0], y_m: at[1], radius_m, height_m };
        let clearance_m = blockage.obstacle_radius_m + blockage.body_offset_m + blockage.body_radius_m;
        let is_off_seats = |at: &[f64; 2]| self.seats_m.iter().all(|seat| distance_m(*at, *seat) >= clearance_m);
        let points = points.into_iter().filter(is_off_seats);
        self.blockers.clear();
        self.blockers.extend(points.map(|at| cylinder(at, blockage.obstacle_radius_m, blockage.obstacle_height_m)));
        self.obstacles = self.blockers.len();
    }
}

fn parse_trace(path: &str, text: Option<&str>, users: usize, floor: &Floor) -> Result<Trace, WorldError> {
    let text = text.ok_or_else(|| WorldError::TraceExpected { path: path.to_owned() })?;
    Trace::parse(text, users, floor).map_err(|reason| WorldError::Trace { path: path.to_owned(), reason })
}
