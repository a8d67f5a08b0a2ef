//! The latest messages of a room, and which of several senders is displayed.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use heliostat_bus::Presence;
use heliostat_channel::Vec3;
use heliostat_proto::{
    BeliefReport, ChannelReport, MirrorTelemetry, NodeKind, NodeStatus, ObstacleReport, RoomGeometry, RoomTruth,
    UserReport, make_place,
};
use heliostat_scenario::WALKING_M_S;
use heliostat_service::clock::utc_ns;

use crate::array_reports::ArrayReports;
use crate::controllers::{ControllerFigures, Controllers, Role, controller_name};
use crate::expiry::EXPIRY;
use crate::latency::{Histogram, Window};
use crate::problems::Problems;
use crate::rooms::Rooms;
use crate::shown_room::{AnnouncedController, Announcements};
use crate::sums::PastSum;
use crate::telemetry_ages::TelemetryAges;

/// Time span of the chart of sum rates.
const HISTORY: Duration = Duration::from_secs(90);
/// Time between two points of that chart.
const HISTORY_STEP: Duration = Duration::from_millis(200);

/// Time without positions after which the reports of another source are displayed: a controller follows it too.
const SOURCE_TIMEOUT: Duration = Duration::from_secs(1);

/// A message and its arrival time.
pub(crate) type Dated<T> = Option<(Instant, T)>;

/// The latest messages of a room.
#[derive(Default)]
pub(crate) struct Received {
    pub truth: Dated<RoomTruth>,
    /// The users and their rates in bit/s in the truth before the last status of the simulator. The rates of the oracle
    /// in this status are of the same instant.
    pub rates_at_status: Vec<(u32, f32)>,
    pub users: Dated<UserReport>,
    /// The position reports that were kept.
    pub user_reports: u64,
    /// Unit vectors of the walks of the reported users, by their numbers; zero for one that has not walked yet.
    pub headings: BTreeMap<u32, Vec3>,
    pub channel: Dated<ChannelReport>,
    pub obstacles: Dated<ObstacleReport>,
    pub arrays: ArrayReports,
    pub telemetry_ages: TelemetryAges,
    /// Of the controller whose status is displayed.
    pub belief: Dated<BeliefReport>,
    /// The geometry that the simulator announces, as TOML.
    pub room_geometry: Dated<Arc<str>>,
    /// The geometry that each controller announces, as TOML, by its source.
    pub controller_geometries: BTreeMap<u64, (Instant, Arc<str>)>,
    /// By the name of the kind of process; that of a later array's driver has the array's index, as
    /// `driver-1`.
    pub statuses: BTreeMap<String, (Instant, NodeStatus)>,
    /// Kind and source of the processes in the room.
    pub alive: BTreeSet<(&'static str, u64)>,
    /// When one of them last left it.
    pub left_at: Option<Instant>,
    /// The rooms that have processes.
    pub rooms: Rooms,
    /// Sum rates for the chart, with the arrival of the report of the room that they are of.
    pub history: VecDeque<(Instant, PastSum)>,
    pub latency: Window,
    pub problems: Problems,
    /// The controllers of the room.
    pub controllers: Controllers,
    pub unreadable: u64,
}

impl Received {
    /// Of a room of this name, of which nothing was received.
    pub fn of(room: &str) -> Self {
        Self { rooms: Rooms::of(room), ..Self::default() }
    }

    /// Notes a liveliness token of any room.
    pub fn take_token(&mut self, token: &str, presence: Presence) {
        if let Some(process) = self.rooms.take(token, presence) {
            self.take_presence(process, presence);
        }
    }

    /// Notes a process that is in the room or has left it.
    pub fn take_presence(&mut self, process: (&'static str, u64), presence: Presence) {
        let (node, source) = process;
        let is_controller = node == NodeKind::Controller.name();
        match presence {
            Presence::Alive => {
                self.alive.insert(process);
                if is_controller {
                    self.controllers.join(source);
                }
            }
            Presence::Gone => {
                self.alive.remove(&process);
                self.left_at = Some(Instant::now());
                if is_controller {
                    self.controllers.leave(source);
                }
            }
        }
    }

    /// The message, unless it is old.
    pub fn fresh<T>(message: &Dated<T>) -> Option<&T> {
        message.as_ref().filter(|(at, _)| at.elapsed() < EXPIRY).map(|(_, message)| message)
    }

    /// Whether the last positions, of any age, are those of a simulator: of one that is in the room, or of the one that
    /// published the last truth. A simulator gives its reports and its truth the same source.
    pub fn is_simulated(&self) -> bool {
        let of_truth = self.truth.as_ref().map(|(_, truth)| truth.stamp.source);
        let of_users = self.users.as_ref().map(|(_, users)| users.stamp.source);
        let is_present = |source| self.alive.contains(&(NodeKind::SimNode.name(), source));
        match of_users {
            Some(source) => of_truth == Some(source) || is_present(source),
            None => of_truth.is_some(),
        }
    }

    /// Whether a recent message has the positions of the users.
    pub fn has_users(&self) -> bool {
        Self::fresh(&self.truth).is_some() || Self::fresh(&self.users).is_some()
    }

    /// When the report arrived that the figures of the users come from: the truth while it is fresh.
    pub fn reported_at(&self) -> Option<Instant> {
        let truth = self.truth.as_ref().map(|(at, _)| *at);
        let users = self.users.as_ref().map(|(at, _)| *at);
        if Self::fresh(&self.truth).is_some() { truth } else { users.or(truth) }
    }

    /// Keeps the sum rates of the present report of the room, unless those of this report, or of one shortly before it,
    /// are kept: a simulated room and a real one have one history.
    pub fn keep_sum(&mut self, sum: PastSum) {
        let Some(at) = self.reported_at() else { return };
        if self.history.back().is_some_and(|(last, _)| at.saturating_duration_since(*last) < HISTORY_STEP) {
            return;
        }
        self.history.push_back((at, sum));
        while self.history.front().is_some_and(|(first, _)| at.saturating_duration_since(*first) > HISTORY) {
            self.history.pop_front();
        }
    }

    /// The controllers that are in the room, the leader first, and those that were lost. Only the reports of an array
    /// show that one leads.
    pub fn present_controllers(&self) -> Vec<ControllerFigures> {
        let mut present = self.controllers.present(&self.alive, self.arrays.followed_epoch());
        if self.arrays.states().is_empty() {
            present.iter_mut().filter(|one| one.role == Role::Leads).for_each(|one| one.role = Role::Unheard);
        }
        present
    }

    /// Whether each controller that is seen stands by for one that is not.
    pub fn stand_by_for_unseen(&self) -> bool {
        self.controllers.follow_unseen(&self.alive, self.arrays.followed_epoch())
    }

    /// The status of a kind of process, unless it is old.
    pub fn fresh_status<'a>(&'a self, node: &str) -> Option<&'a NodeStatus> {
        self.statuses.get(node).filter(|(at, _)| at.elapsed() < EXPIRY).map(|(_, status)| status)
    }

    /// The source of the last status of a controller, of any age.
    pub fn last_controller(&self) -> Option<u64> {
        self.statuses.get(NodeKind::Controller.name()).map(|(_, status)| status.stamp.source)
    }

    /// Whether the displayed status is that of a controller that has left, and those in the room have just started: none
    /// of them has reported.
    pub fn awaits_controller(&self) -> bool {
        let of_controller =
            |(node, source): &(&'static str, u64)| (*node == NodeKind::Controller.name()).then_some(*source);
        let has_reported =
            |source: u64| self.controllers.has_reported(source) || self.last_controller() == Some(source);
        let mut present = self.alive.iter().filter_map(of_controller).peekable();
        present.peek().is_some() && !present.any(has_reported)
    }

    /// The decision times of the last 30 s. Those of a predecessor are none of a controller that has just started.
    pub fn decision_times(&self) -> Histogram {
        if self.awaits_controller() { Histogram::default() } else { self.latency.histogram() }
    }

    /// Whether a status replaces that of its kind of process. One process of a kind is displayed at
    /// a time, so that no figures of two processes mix: the one that is displayed already, while it
    /// is in the room and no other controller leads.
    fn is_displayed(&self, name: &str, status: &NodeStatus) -> bool {
        let Some((at, known)) = self.statuses.get(name) else { return true };
        let is_alive = |source| self.alive.contains(&(status.node.name(), source));
        let is_present = is_alive(known.stamp.source) && at.elapsed() < EXPIRY;
        // A controller that ends reports once more after its liveliness token.
        let is_succeeded =
            status.node == NodeKind::Controller && !is_alive(status.stamp.source) && self.is_controller_alive();
        !is_succeeded && (known.stamp.source == status.stamp.source || !is_present || self.leads(status))
    }

    /// Whether a status is that of the controller that leads; of several that may lead, none.
    fn leads(&self, status: &NodeStatus) -> bool {
        let name = controller_name(status.stamp.source);
        let is_leader = |one: &ControllerFigures| one.role.commands() && one.name == name;
        status.node == NodeKind::Controller && self.present_controllers().iter().any(is_leader)
    }

    /// The newest announcements. Those of a process that has left are drawn until another one announces.
    pub(super) fn announcements(&self) -> Announcements {
        let (room, controller) = (&self.room_geometry, self.drawn_controller_geometry());
        let is_old = |of: &Dated<Arc<str>>| Self::fresh(of).is_none();
        let (is_sim_node_old, is_controller_old) = (is_old(room), is_old(&controller));
        let is_outdated = is_sim_node_old && !is_controller_old;
        let text = |of: &Dated<Arc<str>>| of.as_ref().map(|(_, text)| Arc::clone(text));
        let simulator = self.fresh_status(NodeKind::SimNode.name());
        Announcements {
            sim_node: if is_outdated { None } else { text(room) },
            sim_node_scenario: simulator.map(|status| status.scenario.clone()).unwrap_or_default(),
            controller: text(&controller),
            of_controllers: self.fresh_controller_geometries(),
            is_sim_node_old,
            is_controller_old,
        }
    }

    /// The announcements of controllers that are not old.
    fn fresh_controller_geometries(&self) -> Vec<AnnouncedController> {
        let fresh = self.controller_geometries.iter().filter(|(_, (at, _))| at.elapsed() < EXPIRY);
        let announced = |(source, (_, text)): (&u64, &(Instant, Arc<str>))| AnnouncedController {
            name: controller_name(*source),
            geometry: Arc::clone(text),
            scenario: self.controllers.scenario(*source).to_owned(),
        };
        fresh.map(announced).collect()
    }

    /// The announcement of the displayed controller, else of another one, else the newest that is old.
    fn drawn_controller_geometry(&self) -> Dated<Arc<str>> {
        let displayed = self.last_controller();
        let is_fresh = |(at, _): &&(Instant, Arc<str>)| at.elapsed() < EXPIRY;
        let displayed = displayed.and_then(|source| self.controller_geometries.get(&source));
        let drawn = displayed.filter(is_fresh).or_else(|| self.controller_geometries.values().find(is_fresh));
        drawn.or_else(|| self.controller_geometries.values().max_by_key(|(at, _)| *at)).cloned()
    }

    pub(super) fn take_controller_geometry(&mut self, geometry: RoomGeometry) {
        let source = geometry.stamp.source;
        let mut kept = self.controller_geometries.remove(&source);
        keep_text(&mut kept, geometry.scenario);
        self.controller_geometries.retain(|_, (at, _)| at.elapsed() < EXPIRY);
        let is_present = |source| self.alive.contains(&(NodeKind::Controller.name(), source));
        if make_place(&mut self.controller_geometries, source, is_present) {
            self.controller_geometries.extend(kept.map(|kept| (source, kept)));
        }
    }

    /// Whether the reports of a source are displayed. Where two sources report users, the first one stays, as for a
    /// controller, until its liveliness token ends or it is silent, or the one reports on which the controller decides.
    fn is_of_owner(&self, source: u64) -> bool {
        let is_alive = |owner| self.alive.iter().any(|(_, alive)| *alive == owner);
        let owner = self.users.as_ref().filter(|(at, _)| at.elapsed() < SOURCE_TIMEOUT);
        let owner = owner.map(|(_, users)| users.stamp.source).filter(|owner| is_alive(*owner));
        owner.is_none_or(|owner| owner == source)
    }

    /// The source on whose reports the displayed controller decides, by its status.
    fn decided_source(&self) -> Option<u64> {
        self.fresh_status(NodeKind::Controller.name()).and_then(NodeStatus::room_source)
    }

    /// Keeps a user report of the owner, and the headings of its users: a user who stands still keeps the last one. The
    /// other reports of a former owner are forgotten, so that two sources never mix.
    pub(super) fn take_users(&mut self, report: UserReport) {
        let source = report.stamp.source;
        // A viewer that opens late may have received another source first.
        if !self.is_of_owner(source) && self.decided_source() != Some(source) {
            return;
        }
        self.channel.take_if(|(_, channel)| channel.stamp.source != source);
        self.obstacles.take_if(|(_, obstacles)| obstacles.stamp.source != source);
        self.headings.retain(|number, _| report.users.iter().any(|user| user.user == *number));
        for user in &report.users {
            let heading = self.headings.entry(user.user).or_insert_with(Vec3::zeros);
            let [x, y] = user.velocity_m_s.map(f64::from);
            if x.hypot(y) > WALKING_M_S {
                *heading = Vec3::new(x, y, 0.0).normalize();
            }
        }
        self.user_reports += 1;
        self.users = Some((Instant::now(), report));
    }

    pub(super) fn take_channel(&mut self, channel: ChannelReport) {
        if self.is_of_owner(channel.stamp.source) {
            self.channel = Some((Instant::now(), channel));
        }
    }

    pub(super) fn take_obstacles(&mut self, obstacles: ObstacleReport) {
        if self.is_of_owner(obstacles.stamp.source) {
            self.obstacles = Some((Instant::now(), obstacles));
        }
    }

    pub(super) fn take_truth(&mut self, truth: RoomTruth) {
        self.truth = Some((Instant::now(), truth));
    }

    pub(super) fn take_telemetry(&mut self, array: usize, telemetry: MirrorTelemetry) {
        self.telemetry_ages.handle_telemetry(array, telemetry.stamp, (Instant::now(), utc_ns()));
        self.arrays.note(array, telemetry);
    }

    pub(super) fn take_belief(&mut self, belief: BeliefReport) {
        let displayed = self.fresh_status(NodeKind::Controller.name());
        if displayed.is_none_or(|status| status.stamp.source == belief.stamp.source) {
            self.belief = Some((Instant::now(), belief));
        }
    }

    pub(super) fn take_status(&mut self, array: usize, status: NodeStatus) {
        let node = status.node.name();
        let name = if array == 0 { node.to_owned() } else { format!("{node}-{array}") };
        if status.node == NodeKind::Controller {
            self.controllers.forget(&self.alive);
            if !self.controllers.has_place(status.stamp.source, &self.alive) {
                return;
            }
            self.controllers.take(&status);
        }
        let alive = &self.alive;
        self.problems.take(&name, &status, |source| alive.contains(&(node, source)));
        if !self.is_displayed(&name, &status) {
            return;
        }
        if status.node == NodeKind::Controller {
            self.latency.take(&status);
        }
        if status.node == NodeKind::SimNode {
            let users = Self::fresh(&self.truth).map(|truth| &truth.users[..]).unwrap_or_default();
            self.rates_at_status = users.iter().map(|user| (user.user, user.rate_bps)).collect();
        }
        self.statuses.insert(name, (Instant::now(), status));
    }
}

/// Keeps an announcement; an unchanged text keeps its memory.
pub(super) fn keep_text(kept: &mut Dated<Arc<str>>, text: String) {
    let known = kept.take().map(|(_, known)| known).filter(|known| **known == *text);
    *kept = Some((Instant::now(), known.unwrap_or_else(|| text.into())));
}

#[cfg(test)]
mod tests;
