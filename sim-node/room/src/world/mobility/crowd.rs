//! All users of a room, on a common grid of instants.
//!
//! The models advance by a fixed step of 20 ms, and between two instants every user moves in a
//! straight line. A walk therefore does not depend on the time steps of the caller, also where
//! users act on each other. Users enter between two instants and begin to walk at the next one.
//!
//! In a mixture, each model has an interval of [0, 1) as long as its share. User n has the model
//! whose interval contains the fractional part of u + n g; u is uniform, and g is the golden ratio.
//! Every group of successive users then has the shares up to about one user. Entries with a number of users
//! have the first ones instead.

use heliostat_channel::Cylinder;
use heliostat_scenario::{MixtureShare, MobilityModel, Scenario, Users};

use crate::random::{self, Purpose, RoomRng};
use crate::world::mobility::gauss_markov::GaussMarkov;
use crate::world::mobility::member::{Alone, Member, Walk};
use crate::world::mobility::motion::{GRID_S, turned_by_share};
use crate::world::mobility::places::Places;
use crate::world::mobility::random_direction::RandomDirection;
use crate::world::mobility::random_waypoint::{RandomWaypoint, Waypoints};
use crate::world::mobility::seated::Seated;
use crate::world::mobility::separation::separate;
use crate::world::mobility::smooth_random::SmoothRandom;
use crate::world::mobility::social_force::{Pedestrian, SocialForce};
use crate::world::mobility::speeds::Speeds;
use crate::world::walker::Walker;

/// Fractional part of the golden ratio.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

/// Time in s by which a sum of time steps may miss an instant of the grid.
const ROUNDING_S: f64 = 1e-9;

/// All users of a room.
#[derive(Clone, Debug)]
pub struct Crowd {
    users: Users,
    waypoints: Waypoints,
    places: Places,
    forces: SocialForce,
    /// Radius in m of the disc for which a user of the social force model counts.
    radius_m: f64,
    /// Distance of a seat drawn at random from walls and obstacles in m: the body fits behind the
    /// receiver.
    seat_clearance_m: f64,
    /// Share of the angle to the heading of the model by which a user turns in one step.
    turn_share: f64,
    /// Place of user 0 on the scale of the shares of a mixture.
    mixture_start: f64,
    seed: u64,
    members: Vec<Member>,
    /// Time since the last instant of the grid in s.
    since_s: f64,
}

impl Crowd {
    /// The crowd of a scenario, without users.
    pub fn new(scenario: &Scenario, waypoints: Waypoints) -> Self {
        let (users, blockage) = (&scenario.users, &scenario.blockage);
        let lag_s = users.heading_lag_s;
        Self {
            users: users.clone(),
            waypoints,
            places: Places::new(waypoints.floor, &[]),
            forces: SocialForce::new(&users.social_force),
            radius_m: blockage.body_radius_m,
            seat_clearance_m: blockage.body_offset_m + blockage.body_radius_m,
            turn_share: if lag_s > 0.0 { -(-GRID_S / lag_s).exp_m1() } else { 1.0 },
            mixture_start: 0.0,
            seed: 0,
            members: Vec::new(),
            since_s: 0.0,
        }
    }

    /// Begins at time 0 with the users 0 to `users` - 1 among these obstacles.
    pub fn begin(&mut self, users: usize, seed: u64, obstacles: &[Cylinder]) {
        self.places = Places::new(self.waypoints.floor, obstacles);
        self.seed = seed;
        self.mixture_start = random::uniform(&mut random::stream(seed, Purpose::MobilityModel, 0));
        self.since_s = 0.0;
        self.members.clear();
        (0..users as u32).for_each(|id| self.enter(id));
        self.advance();
    }

    /// A user with a number that no earlier one had enters after the others.
    pub fn enter(&mut self, id: u32) {
        let member = self.member(id);
        self.members.push(member);
    }

    /// The user at this index leaves.
    pub fn leave(&mut self, index: usize) {
        self.members.remove(index);
    }

    /// Makes room for this number of users in all.
    pub fn reserve(&mut self, users: usize) {
        self.members.reserve(users.saturating_sub(self.members.len()));
    }

    /// Moves on by `dt_s` seconds.
    pub fn step(&mut self, dt_s: f64) {
        self.since_s += dt_s;
        while self.since_s >= GRID_S - ROUNDING_S {
            self.since_s -= GRID_S;
            self.advance();
        }
    }

    /// Writes the users' positions, headings and velocities; heights do not change.
    pub fn write(&self, walkers: &mut [Walker]) {
        let share = (self.since_s / GRID_S).max(0.0);
        self.members.iter().zip(walkers).for_each(|(member, walker)| member.motion_at(share).write(walker));
    }

    /// Writes the velocities of all users.
    pub fn write_velocities(&self, walkers: &mut [Walker]) {
        self.members.iter().zip(walkers).for_each(|(member, walker)| walker.velocity = member.velocity());
    }

    /// New walking speeds.
    pub fn set_speeds(&mut self, speeds: Speeds) {
        self.waypoints.speeds = speeds;
        self.members.iter_mut().for_each(|member| member.walk.set_speeds(speeds));
    }

    /// Computes the next instant of the grid.
    fn advance(&mut self) {
        for member in &mut self.members {
            member.from = member.to;
            if let Walk::Alone(walk) = &mut member.walk {
                walk.step();
                member.to = walk.motion();
            }
        }
        let mut is_coupled = false;
        for index in 0..self.members.len() {
            is_coupled |= self.step_in_crowd(index);
        }
        if is_coupled {
            separate(&mut self.members, &self.places, self.radius_m);
        }
        for member in &mut self.members {
            member.to.facing = turned_by_share(member.from.facing, member.to.facing, self.turn_share);
        }
    }

    /// Moves a user on whom other users act; returns whether this user is one.
    fn step_in_crowd(&mut self, index: usize) -> bool {
        let (before, rest) = self.members.split_at_mut(index);
        let Some((member, after)) = rest.split_first_mut() else { return false };
        let Walk::SocialForce(user) = &mut member.walk else { return false };
        let others = before.iter().chain(after.iter()).map(|other| &other.from);
        member.to = user.step(&self.forces, &member.from, others, &self.places);
        true
    }

    /// The model of a user.
    fn model_of(&self, id: u32) -> MobilityModel {
        match self.users.mobility {
            MobilityModel::Mixture => {
                self.entry_of(id).map_or(MobilityModel::RandomWaypoint, |entry| self.users.mixture[entry].mobility)
            }
            model => model,
        }
    }

    /// The index of the entry of a user in `users.mixture`; `None` outside a mixture.
    pub fn entry_of(&self, id: u32) -> Option<usize> {
        let mixture = if self.users.mobility == MobilityModel::Mixture { &self.users.mixture[..] } else { &[] };
        let place = (self.mixture_start + GOLDEN * f64::from(id)).fract();
        MixtureShare::index_of(mixture, id as usize, place)
    }

    fn member(&self, id: u32) -> Member {
        let mut rng = random::stream(self.seed, Purpose::Walk, id);
        let (users, waypoints) = (&self.users, &self.waypoints);
        let walk = match self.model_of(id) {
            MobilityModel::RandomDirection => {
                Alone::RandomDirection(RandomDirection::new(&users.random_direction, waypoints, rng))
            }
            MobilityModel::GaussMarkov => Alone::GaussMarkov(GaussMarkov::new(&users.gauss_markov, waypoints, rng)),
            MobilityModel::SmoothRandom => Alone::SmoothRandom(SmoothRandom::new(&users.smooth_random, waypoints, rng)),
            MobilityModel::Seated => {
                let at = self.seat(&mut rng);
                Alone::Seated(Seated::new(&users.seated, at, rng))
            }
            MobilityModel::SocialForce => return self.pedestrian(rng),
            MobilityModel::RandomWaypoint | MobilityModel::Mixture => {
                Alone::RandomWaypoint(RandomWaypoint::new(*waypoints, rng))
            }
        };
        let start = walk.motion();
        Member::new(Walk::Alone(walk), start)
    }

    fn pedestrian(&self, mut rng: RoomRng) -> Member {
        // Seats of the list may be taken by users who enter later.
        let seats = if self.users.mobility == MobilityModel::Mixture { self.users.seats_m.as_slice() } else { &[] };
        let taken = self.members.iter().map(|member| member.to.at).chain(seats.iter().copied());
        let at = self.places.draw(&mut rng, self.radius_m, taken, 2.0 * self.radius_m);
        let user = Pedestrian::new(&self.users.social_force, &self.waypoints, &self.places, rng);
        let start = user.start(at);
        Member::new(Walk::SocialForce(user), start)
    }

    /// The first free seat of the list; a place drawn at random where there is none.
    fn seat(&self, rng: &mut RoomRng) -> [f64; 2] {
        let taken = self.members.iter().map(|member| member.to.at);
        let free = self.users.seats_m.iter().find(|seat| taken.clone().all(|at| at != **seat));
        match free {
            Some(seat) => *seat,
            None => self.places.draw(rng, self.seat_clearance_m, taken, self.users.seated.spacing_m),
        }
    }
}
