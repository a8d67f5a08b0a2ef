//! The data of the page's 3-D view: a plan of the static objects, and frames of the moving ones.
//!
//! A mirror *serves* the user to whom it has the largest gain at its present angles, by the same
//! channel model that gives the rates. Telemetry alone gives these angles: without it a mirror is
//! drawn flat, and serves no user. Lengths are in m, rounded to millimetres.

use std::sync::{Arc, Mutex};

use heliostat_channel::{Cylinder, MirrorAngles, MirrorArrays, Scene, Vec3};
use heliostat_proto::MirrorTelemetry;
use heliostat_scenario::Scenario;
use heliostat_service::locks::lock;
use heliostat_service::printable::printable;
use serde::Serialize;

use crate::View;
use crate::belief::Belief;
use crate::blocked_area::blocked_area;
use crate::floor::at_power_of;
use crate::shown_room::{GeometrySource, ShownRoom};
use crate::view::{Dated, Received};

/// The static objects.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Name of the room in the keys.
    pub room: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The hash of the geometry; frames of another one do not fit this plan.
    pub geometry: String,
    /// Where the geometry comes from.
    pub geometry_source: GeometrySource,
    /// Extents along x, y and z in m.
    pub size_m: [f64; 3],
    /// Centres of the LEDs in m.
    pub leds_m: Vec<[f64; 3]>,
    /// Centres of the mirrors in m, in index order.
    pub mirrors_m: Vec<[f64; 3]>,
    /// Number of mirrors of each array, in the order of the arrays.
    pub arrays: Vec<usize>,
    /// Height of the detectors above the floor in m; blocked areas are drawn at this height.
    pub detector_height_m: f64,
}

/// A user as drawn.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneUser {
    /// Number of the user in the reports.
    pub user: u32,
    /// Position of the detector in m.
    pub at_m: [f64; 3],
    /// The body: x, y, radius and height in m; absent if bodies do not block.
    pub body_m: Option<[f64; 4]>,
    /// The LED that serves the user.
    pub led: usize,
    /// Whether the direct path is blocked; absent where no process reports it.
    pub blocked: Option<bool>,
    /// Whether it is blocked by order.
    pub forced: bool,
    /// The user's minimum rate in Mbit/s.
    pub min_rate_mbps: f64,
    /// Rate without the mirrors in Mbit/s, by the channel model.
    pub without_mirrors_mbps: f64,
    /// Where the controller believes the user to be; absent if it publishes no belief.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub belief: Option<Belief>,
}

/// The moving objects.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Frame {
    /// The hash of the geometry, as in the plan.
    pub geometry: String,
    /// Corners of each mirror: four times x, y, z in m.
    pub mirrors_m: Vec<[f64; 12]>,
    /// For each mirror the index in `users` of the user that it serves; -1 for none, and where no
    /// telemetry gives its angles.
    pub serves: Vec<i32>,
    /// Indices of the mirrors that do not follow commands, and of those of an array that sends no
    /// telemetry while another one does.
    pub unusable: Vec<u32>,
    /// The users.
    pub users: Vec<SceneUser>,
    /// The obstacles: x, y, radius and height in m.
    pub obstacles_m: Vec<[f64; 4]>,
    /// Corners of each area without direct light at the detectors' height, in m.
    pub blocked_areas_m: Vec<Vec<[f64; 2]>>,
}

/// Computes the frames of a view.
pub struct FrameBuilder {
    view: Arc<View>,
    state: Mutex<FrameState>,
}

struct FrameState {
    /// The room of `scene`.
    room: Arc<ShownRoom>,
    scene: Scene,
    gains: Vec<f64>,
}

/// Sum rates of all users by the channel model, in Mbit/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ModelledSum {
    /// At the reported angles.
    pub policy: f64,
    /// Without mirrors.
    pub no_irs: f64,
}

/// What determines the rate at any point of the room.
pub(crate) struct OpticalState {
    pub room: Arc<ShownRoom>,
    /// Number of users, who share the bandwidth.
    pub users: usize,
    pub blockers: Vec<Cylinder>,
    pub angles: MirrorAngles,
}

/// The latest users, obstacles and telemetry.
struct Observed {
    users: Vec<ObservedUser>,
    /// The body of each user, where bodies block light.
    bodies: Vec<Option<Cylinder>>,
    obstacles: Vec<Cylinder>,
    telemetry: Option<MirrorTelemetry>,
}

impl Observed {
    fn new(
        scenario: &Scenario,
        users: Vec<ObservedUser>,
        obstacles: Vec<Cylinder>,
        telemetry: Option<MirrorTelemetry>,
    ) -> Self {
        let bodies = users.iter().map(|user| body(scenario, user)).collect();
        Self { users, bodies, obstacles, telemetry }
    }

    /// All cylinders that block light.
    fn blockers(&self) -> Vec<Cylinder> {
        self.obstacles.iter().chain(self.bodies.iter().flatten()).copied().collect()
    }
}

/// A user as published.
struct ObservedUser {
    user: u32,
    min_rate_bps: f32,
    position: Vec3,
    /// Unit vector, or zero if unknown.
    heading: Vec3,
    blocked: Option<bool>,
    forced: bool,
    belief: Option<Belief>,
}

impl View {
    /// The static objects of the room.
    pub fn plan(&self, room: &str) -> Plan {
        let shown = self.shown_room();
        let size = &shown.scenario.room;
        Plan {
            room: room.to_owned(),
            scenario: printable(&shown.scenario.name).into_owned(),
            geometry: shown.id.clone(),
            geometry_source: shown.source,
            size_m: [size.length_x_m, size.length_y_m, size.height_m],
            leds_m: shown.model.leds.iter().map(|led| rounded(&led.position)).collect(),
            mirrors_m: shown.model.mirrors.positions().iter().map(rounded).collect(),
            arrays: shown.model.mirrors.arrays().iter().map(|array| array.len()).collect(),
            detector_height_m: shown.scenario.receiver.height_m,
        }
    }
}

impl FrameBuilder {
    /// A builder without users.
    pub fn new(view: Arc<View>) -> Self {
        let state = FrameState::new(view.shown_room());
        Self { view, state: Mutex::new(state) }
    }

    /// The current frame.
    pub fn frame(&self) -> Frame {
        let mut state = lock(&self.state);
        let room = self.view.shown_room();
        if !Arc::ptr_eq(&room, &state.room) {
            *state = FrameState::new(Arc::clone(&room));
        }
        let observed = self.view.observed(&room);
        let blockers = observed.blockers();
        let Observed { users, bodies, obstacles, telemetry } = observed;
        let mirrors = room.model.mirrors.len();
        let reported = reported_angles(mirrors, telemetry.as_ref());
        let are_reported = reported.is_some();
        let angles = reported.unwrap_or_else(|| MirrorAngles::flat(mirrors));
        let mut serves = state.serve(&users, &blockers, &angles);
        let (unusable, unknown) = {
            let received = self.view.received();
            (unusable_mirrors(&received, &room), unknown_mirrors(&received, &room))
        };
        if !are_reported {
            serves.fill(-1);
        }
        unknown.iter().for_each(|mirror| serves[*mirror as usize] = -1);
        let serving = state.scene.serving();
        let budget = self.view.budget(&room.model);
        let without_mirrors = |index: usize| {
            let sinr = budget.sinr(state.scene.los_gain()[index]);
            budget.rate_bps(sinr, users.len()) * 1e-6
        };
        Frame {
            geometry: room.id.clone(),
            mirrors_m: (0..angles.len()).map(|index| corners(&room.model.mirrors, index, &angles)).collect(),
            serves,
            unusable,
            users: (users.iter().zip(&bodies).enumerate())
                .map(|(index, (user, body))| SceneUser {
                    user: user.user,
                    min_rate_mbps: f64::from(user.min_rate_bps) * 1e-6,
                    without_mirrors_mbps: without_mirrors(index),
                    belief: user.belief.clone(),
                    at_m: rounded(&user.position),
                    body_m: body.as_ref().map(outline),
                    led: serving[index],
                    blocked: user.blocked,
                    forced: user.forced,
                })
                .collect(),
            obstacles_m: obstacles.iter().map(outline).collect(),
            blocked_areas_m: blocked_areas(&room, &blockers),
        }
    }
}

impl View {
    /// The number of users, all cylinders that block light, and the angles of the mirrors.
    pub(crate) fn optical_state(&self) -> OpticalState {
        let room = self.shown_room();
        let observed = self.observed(&room);
        let mirrors = room.model.mirrors.len();
        OpticalState {
            users: observed.users.len(),
            blockers: observed.blockers(),
            angles: reported_angles(mirrors, observed.telemetry.as_ref())
                .unwrap_or_else(|| MirrorAngles::flat(mirrors)),
            room,
        }
    }

    /// The sum rates at the reported angles by the channel model. `None` without users, where a process reports gains
    /// or the truth, and where an array reports no angles.
    pub(crate) fn modelled_sum(&self) -> Option<ModelledSum> {
        let room = self.shown_room();
        let observed = self.observed(&room);
        let users = &observed.users;
        let is_reported = users.is_empty() || users.iter().any(|user| user.blocked.is_some());
        if is_reported || !unknown_mirrors(&self.received(), &room).is_empty() {
            return None;
        }
        let (model, budget) = (&room.model, self.budget(&room.model));
        let angles = reported_angles(model.mirrors.len(), observed.telemetry.as_ref())?;
        let positions: Vec<Vec3> = users.iter().map(|user| user.position).collect();
        let mut scene = Scene::new(model, users.len());
        scene.update(model, &positions, &observed.blockers(), &vec![false; users.len()]);
        let mut sinr = vec![0.0; users.len()];
        scene.sinr(model, &angles, &mut sinr);
        let mbps = |sinr: f64| budget.rate_bps(sinr, users.len()) * 1e-6;
        Some(ModelledSum {
            policy: sinr.iter().map(|sinr| mbps(at_power_of(&budget, model, *sinr))).sum(),
            no_irs: scene.los_gain().iter().map(|gain| mbps(budget.sinr(*gain))).sum(),
        })
    }

    /// The latest users, obstacles and telemetry. Where no process reports users any longer, the last
    /// picture stays; the page marks how old it is.
    fn observed(&self, room: &ShownRoom) -> Observed {
        let received = self.received();
        let is_over = !received.has_users();
        let last = || received.arrays.last_joint(&room.model.mirrors).filter(|_| is_over);
        let telemetry = received.arrays.joint(&room.model.mirrors).or_else(last);
        let belief = Received::fresh(&received.belief);
        let belief_of = |user, drawn_ns| belief.and_then(|report| Belief::of(report, user, drawn_ns));
        let point = |position: [f32; 3]| Vec3::from(position.map(f64::from));
        if let Some(truth) = shown(&received.truth, is_over && received.is_simulated()) {
            let observed = |user: &heliostat_proto::TruthUser| {
                let (sin, cos) = f64::from(user.heading_rad).sin_cos();
                ObservedUser {
                    user: user.user,
                    min_rate_bps: user.min_rate_bps,
                    position: point(user.position_m),
                    heading: Vec3::new(cos, sin, 0.0),
                    blocked: Some(user.los_blocked),
                    forced: user.forced,
                    belief: belief_of(user.user, truth.stamp.time_ns),
                }
            };
            let users = truth.users.iter().map(observed).collect();
            let obstacles = truth.obstacles.iter().map(Cylinder::from).collect();
            return Observed::new(&room.scenario, users, obstacles, telemetry);
        }
        let obstacles = shown(&received.obstacles, is_over).map_or(&[][..], |report| &report.obstacles);
        let obstacles = obstacles.iter().map(Cylinder::from).collect();
        let Some(report) = shown(&received.users, is_over) else {
            return Observed::new(&room.scenario, Vec::new(), obstacles, telemetry);
        };
        let gains = shown(&received.channel, is_over).map_or(&[][..], |report| &report.users);
        let users = report.users.iter().map(|user| {
            let measured = gains.iter().find(|gains| gains.user == user.user);
            let blocked = measured.map(|gains| gains.los_gain == 0.0);
            ObservedUser {
                user: user.user,
                min_rate_bps: user.min_rate_bps,
                position: point(user.position_m),
                heading: received.headings.get(&user.user).copied().unwrap_or_else(Vec3::zeros),
                blocked,
                forced: false,
                belief: belief_of(user.user, report.stamp.time_ns),
            }
        });
        Observed::new(&room.scenario, users.collect(), obstacles, telemetry)
    }
}

impl FrameState {
    fn new(room: Arc<ShownRoom>) -> Self {
        Self { scene: Scene::new(&room.model, 0), room, gains: Vec::new() }
    }

    /// Index of the user that each mirror serves, or -1.
    fn serve(&mut self, users: &[ObservedUser], blockers: &[Cylinder], angles: &MirrorAngles) -> Vec<i32> {
        let model = &self.room.model;
        let (count, mirrors) = (users.len(), angles.len());
        if self.scene.users() != count {
            self.scene = Scene::new(model, count);
            self.gains = vec![0.0; count * mirrors];
        }
        let positions: Vec<Vec3> = users.iter().map(|user| user.position).collect();
        let blocked: Vec<bool> = users.iter().map(|user| user.blocked == Some(true)).collect();
        self.scene.update(model, &positions, blockers, &blocked);
        self.scene.irs_gain_each(model, angles, &mut self.gains);
        let best = |mirror: usize| {
            let gain = |user: usize| self.gains[user * mirrors + mirror];
            let best = (0..count).max_by(|a, b| gain(*a).total_cmp(&gain(*b)));
            best.filter(|user| gain(*user) > 0.0).map_or(-1, |user| user as i32)
        };
        (0..mirrors).map(best).collect()
    }
}

/// A message that is not old; of any age in a room that is over.
fn shown<T>(message: &Dated<T>, is_over: bool) -> Option<&T> {
    let last = message.as_ref().filter(|_| is_over).map(|(_, message)| message);
    Received::fresh(message).or(last)
}

fn body(scenario: &Scenario, user: &ObservedUser) -> Option<Cylinder> {
    Some(scenario.blockage.body()?.behind(&user.position, &user.heading))
}

/// The angles of the mirrors: measured, else commanded; `None` without telemetry of so many mirrors.
fn reported_angles(mirrors: usize, telemetry: Option<&MirrorTelemetry>) -> Option<MirrorAngles> {
    let telemetry = telemetry.filter(|telemetry| telemetry.check_mirrors(mirrors).is_ok())?;
    let choose = |measured: &[f32], commanded: &[f32]| {
        let angles = if measured.is_empty() { commanded } else { measured };
        angles.iter().map(|angle| f64::from(*angle)).collect()
    };
    Some(MirrorAngles {
        roll: choose(&telemetry.roll_measured, &telemetry.roll_commanded),
        yaw: choose(&telemetry.yaw_measured, &telemetry.yaw_commanded),
    })
}

/// Corners of a mirror, in order along its edge.
fn corners(mirrors: &MirrorArrays, index: usize, angles: &MirrorAngles) -> [f64; 12] {
    let array = mirrors.array_of(index);
    let normal = array.normal(angles.roll[index], angles.yaw[index]);
    // Yaw turns a mirror about the vertical and roll about its own width, which therefore stays
    // horizontal.
    let flat_width = array.room_from_wall(&Vec3::x());
    let width = Vec3::z().cross(&normal).try_normalize(1e-9).unwrap_or(flat_width);
    let height = normal.cross(&width);
    let (half_width, half_height) = (array.spec().mirror_width_m / 2.0, array.spec().mirror_height_m / 2.0);
    let mut corners = [0.0; 12];
    for (corner, (x, z)) in corners.chunks_exact_mut(3).zip([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) {
        let at = mirrors.positions()[index] + x * half_width * width + z * half_height * height;
        corner.copy_from_slice(&rounded(&at));
    }
    corners
}

fn blocked_areas(shown: &ShownRoom, blockers: &[Cylinder]) -> Vec<Vec<[f64; 2]>> {
    let room = &shown.scenario.room;
    let (extents, height) = ((room.length_x_m / 2.0, room.length_y_m / 2.0), shown.scenario.receiver.height_m);
    let pairs = shown.model.leds.iter().flat_map(|led| blockers.iter().map(move |blocker| (led, blocker)));
    let areas = pairs.map(|(led, blocker)| blocked_area(blocker, &led.position, height, extents));
    let drawable = areas.filter(|corners| corners.len() > 2);
    drawable.map(|corners| corners.into_iter().map(|corner| corner.map(millimetres)).collect()).collect()
}

/// The mirrors of the arrays without recent telemetry, while another array has some: nothing is known
/// about their angles.
fn unknown_mirrors(received: &Received, room: &ShownRoom) -> Vec<u32> {
    let arrays = &room.model.mirrors;
    let silent = received.arrays.silent(arrays.arrays().len());
    if silent.len() == arrays.arrays().len() {
        return Vec::new();
    }
    let ranges = arrays.ranges().enumerate().filter(|(index, _)| silent.contains(index));
    ranges.flat_map(|(_, (_, mirrors))| mirrors.map(|mirror| mirror as u32)).collect()
}

/// The unusable mirrors: those that the drivers report, and those of silent arrays. Picture and figures
/// show these.
pub(crate) fn unusable_mirrors(received: &Received, room: &ShownRoom) -> Vec<u32> {
    let reported = received.arrays.joint(&room.model.mirrors).map(|telemetry| telemetry.unusable);
    reported.into_iter().flatten().chain(unknown_mirrors(received, room)).collect()
}

fn outline(cylinder: &Cylinder) -> [f64; 4] {
    [cylinder.x_m, cylinder.y_m, cylinder.radius_m, cylinder.height_m].map(millimetres)
}

fn rounded(point: &Vec3) -> [f64; 3] {
    [point.x, point.y, point.z].map(millimetres)
}

fn millimetres(length_m: f64) -> f64 {
    (length_m * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use heliostat_bus::{Bus, BusConfig, private_endpoint};
    use heliostat_proto::{ChannelReport, Room, UserChannel, UserReport, UserState};

    use super::*;
    use crate::view::EXPIRY;

    #[test]
    fn mirrors_without_telemetry_serve_no_user_and_have_no_modelled_rate() {
        let scenario = Scenario::builtin("specular").and_then(|room| room.with_overrides(&["blockage.bodies=false"]));
        let endpoint = private_endpoint().expect("an endpoint");
        let config = BusConfig::new(Room::new("scene").expect("a valid name")).listen_at(&endpoint);
        let bus = Bus::open(&config).expect("a free endpoint");
        let view = Arc::new(View::open(&bus, Some(&scenario.expect("a valid scenario"))).expect("an open session"));
        let frames = FrameBuilder::new(Arc::clone(&view));
        // One flat mirror reflects the light of the LED to this place.
        let user = UserState { position_m: [0.3, 0.0, 0.85], ..UserState::default() };
        let report = UserReport { users: vec![user], ..UserReport::default() };
        let served = || {
            view.received().users = Some((Instant::now(), report.clone()));
            let frame = frames.frame();
            assert_eq!((frame.users.len(), frame.serves.len(), frame.unusable.len()), (1, 100, 0));
            let without_mbps = frame.users[0].without_mirrors_mbps;
            let is_served = frame.serves.iter().any(|user| *user >= 0);
            let sum = view.modelled_sum();
            let shown = view.figures().sum_mbps.filter(|sum| sum.is_modelled);
            assert_eq!(shown.map(|sum| (sum.policy, sum.no_irs)), sum.map(|sum| (sum.policy, Some(sum.no_irs))));
            assert!(sum.is_none_or(|sum| (sum.no_irs - without_mbps).abs() < 1e-9), "{sum:?}");
            (is_served, sum.map(|sum| sum.policy > without_mbps))
        };
        assert_eq!(served(), (false, None), "no array has reported");
        let flat = || vec![0.0; 100];
        let telemetry = MirrorTelemetry { roll_commanded: flat(), yaw_commanded: flat(), ..MirrorTelemetry::default() };
        view.received().arrays.note(0, telemetry);
        assert_eq!(served(), (true, Some(true)), "the array reports flat mirrors");
        assert!(!view.history().is_empty(), "a page that is loaded again draws the rates of a real room too");
        let gains = ChannelReport { users: vec![UserChannel::default()], ..ChannelReport::default() };
        view.received().channel = Some((Instant::now(), gains));
        assert_eq!(served().1, None, "a receiver reports the gains of the user");
        view.received().channel = None;
        view.received().arrays.age(EXPIRY);
        assert_eq!(served(), (false, None), "the array is silent");
    }
}
