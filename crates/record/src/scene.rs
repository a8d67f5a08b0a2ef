//! The room for Foxglove's 3D panel: walls, LEDs, mirrors, reflected rays, users,
//! obstacles.
//!
//! Positions are in m in the room's frame, under the frame id `FRAME`. A scene shows the truth of
//! a simulated room, or the reports of a real one. Walls, LEDs and mirrors are those of the
//! geometry that the room announced, else that the controller announced, else of the scenario.

mod shapes;

use foxglove::messages::{
    Color, CylinderPrimitive, SceneEntity, SceneUpdate, SpherePrimitive, TextPrimitive, Timestamp,
};
use foxglove::{Encode, Schema};
use heliostat_channel::{ChannelError, ChannelModel, Vec3};
use heliostat_proto::{Nanos, NodeKind, Obstacle};
use heliostat_scenario::Scenario;

use self::shapes::{CubeEdges, cube, entity, pose, segments, vector};
use crate::file::Topic;
use crate::received::Received;

/// The topic of scenes.
pub const SCENE_TOPIC: &str = "/scene";

/// Least time between two scenes.
const INTERVAL_NS: Nanos = 100_000_000;
/// Time between two messages about static objects, for viewers that start later.
const STILL_INTERVAL_NS: Nanos = 5_000_000_000;

// The Okabe-Ito palette, which is distinguishable with colour-vision deficiency.
const MET: Color = rgba(0.0, 0.62, 0.45, 1.0);
const MISSED: Color = rgba(0.84, 0.37, 0.0, 1.0);
const REFLECTED_LIGHT: Color = rgba(0.94, 0.89, 0.26, 0.35);
const LED: Color = rgba(0.94, 0.89, 0.26, 1.0);
const MIRROR: Color = rgba(0.34, 0.71, 0.91, 1.0);
const OBSTACLE: Color = rgba(0.5, 0.5, 0.5, 0.6);
const WALL: Color = rgba(0.6, 0.6, 0.6, 1.0);
const BLOCKED: Color = rgba(0.84, 0.37, 0.0, 0.5);
const CLEAR: Color = rgba(0.94, 0.89, 0.26, 0.7);

const fn rgba(r: f64, g: f64, b: f64, a: f64) -> Color {
    Color { r, g, b, a }
}

/// A user as drawn.
#[derive(Clone, Debug, Default)]
struct DrawnUser {
    position: Vec3,
    label: String,
    met: bool,
    los_blocked: Option<bool>,
}

/// Draws scenes from the messages of a room.
pub struct Scene {
    schema: Schema,
    model: ChannelModel,
    size_m: [f64; 3],
    users: Vec<DrawnUser>,
    obstacles: Vec<Obstacle>,
    /// Roll and yaw of each mirror in rad.
    angles: (Vec<f32>, Vec<f32>),
    has_truth: bool,
    /// The geometry that is drawn, and the process that announced it.
    announced: Option<(NodeKind, String)>,
    drawn_ns: Nanos,
    still_drawn_ns: Nanos,
    buffer: Vec<u8>,
}

impl Scene {
    /// The scene of a scenario's room, without users.
    ///
    /// # Errors
    /// A scenario that the channel model refuses.
    pub fn new(scenario: &Scenario) -> Result<Self, ChannelError> {
        let model = scenario.channel_model()?;
        let flat = vec![0.0; model.mirrors.len()];
        Ok(Self {
            schema: SceneUpdate::get_schema().expect("a Foxglove message has a schema"),
            model,
            size_m: size_m(scenario),
            users: Vec::new(),
            obstacles: Vec::new(),
            angles: (flat.clone(), flat),
            has_truth: false,
            announced: None,
            drawn_ns: 0,
            still_drawn_ns: 0,
            buffer: Vec::new(),
        })
    }

    /// The channel of the scenes.
    pub fn topic(&self) -> Topic<'_> {
        Topic {
            name: SCENE_TOPIC,
            encoding: "protobuf",
            schema: &self.schema.name,
            schema_encoding: &self.schema.encoding,
            schema_data: &self.schema.data,
        }
    }

    /// Draws the geometry that a process announces from now on. The geometry of a simulator has
    /// priority over that of a controller; an unchanged one keeps the angles of the mirrors.
    ///
    /// # Errors
    /// The reason for which the geometry cannot be drawn; the former one stays.
    pub fn announce(&mut self, node: NodeKind, geometry: &str) -> Result<(), String> {
        let is_drawn = self.announced.as_ref().is_some_and(|(by, text)| {
            (*by == node && text == geometry) || (*by == NodeKind::SimNode && node != NodeKind::SimNode)
        });
        if is_drawn {
            return Ok(());
        }
        self.announced = Some((node, geometry.to_owned()));
        let scenario = Scenario::from_geometry_toml(geometry).map_err(|error| error.to_string())?;
        let model = scenario.channel_model().map_err(|error| error.to_string())?;
        let flat = vec![0.0; model.mirrors.len()];
        if flat.len() != self.angles.0.len() {
            self.angles = (flat.clone(), flat);
        }
        (self.model, self.size_m, self.still_drawn_ns) = (model, size_m(&scenario), 0);
        Ok(())
    }

    /// Applies a message; true if a new scene is due. `array` is the index of the array that
    /// published it, for telemetry.
    pub fn update(&mut self, received: &Received, array: usize, arrived_ns: Nanos) -> bool {
        match received {
            Received::Truth(truth) => {
                self.has_truth = true;
                self.obstacles.clone_from(&truth.obstacles);
                self.users = truth
                    .users
                    .iter()
                    .map(|user| DrawnUser {
                        position: Vec3::from_iterator(user.position_m.map(f64::from)),
                        label: format!("{}: {:.1} Mbit/s", user.user, user.rate_bps * 1e-6),
                        met: user.rate_bps >= user.min_rate_bps,
                        los_blocked: Some(user.los_blocked),
                    })
                    .collect();
            }
            Received::Users(report) if !self.has_truth => {
                let user = |user: &heliostat_proto::UserState| DrawnUser {
                    position: Vec3::from_iterator(user.position_m.map(f64::from)),
                    label: user.user.to_string(),
                    met: true,
                    los_blocked: None,
                };
                self.users = report.users.iter().map(user).collect();
            }
            Received::Obstacles(report) if !self.has_truth => {
                self.obstacles.clone_from(&report.obstacles);
                return false;
            }
            Received::Telemetry(telemetry) => {
                let Some((_, mirrors)) = self.model.mirrors.ranges().nth(array) else { return false };
                if telemetry.check_mirrors(mirrors.len()).is_ok() {
                    self.angles.0[mirrors.clone()].copy_from_slice(&telemetry.roll_commanded);
                    self.angles.1[mirrors].copy_from_slice(&telemetry.yaw_commanded);
                }
                return false;
            }
            _ => return false,
        }
        arrived_ns.saturating_sub(self.drawn_ns) >= INTERVAL_NS
    }

    /// The encoded scene.
    pub fn draw(&mut self, at_ns: Nanos) -> &[u8] {
        self.drawn_ns = at_ns;
        let mut entities = vec![self.light(), self.users(), self.obstacles()];
        if at_ns.saturating_sub(self.still_drawn_ns) >= STILL_INTERVAL_NS {
            self.still_drawn_ns = at_ns;
            entities.push(self.room());
        }
        for entity in &mut entities {
            entity.timestamp = Some(Timestamp::new((at_ns / 1_000_000_000) as u32, (at_ns % 1_000_000_000) as u32));
        }
        self.buffer.clear();
        let update = SceneUpdate { deletions: Vec::new(), entities };
        update.encode(&mut self.buffer).expect("writing to a vector does not fail");
        &self.buffer
    }

    /// Walls, LEDs and mirrors.
    fn room(&self) -> SceneEntity {
        let [x, y, z] = self.size_m;
        let panel = |position: &Vec3| cube(position, Vec3::new(0.3, 0.3, 0.03), LED);
        let mirror = |(index, position): (usize, &Vec3)| {
            let array = self.model.mirrors.array_of(index);
            let (spec, across) = (array.spec(), array.room_from_wall(&Vec3::x()));
            let half = across * (spec.mirror_width_m / 2.0) + Vec3::z() * (spec.mirror_height_m / 2.0);
            let size = 2.0 * half.map(f64::abs) + array.inward().map(f64::abs) * 0.01;
            cube(position, size, MIRROR)
        };
        let outline = CubeEdges { centre: Vec3::new(0.0, 0.0, z / 2.0), half: Vec3::new(x, y, z) / 2.0 };
        SceneEntity {
            cubes: self
                .model
                .leds
                .iter()
                .map(|led| panel(&led.position))
                .chain(self.model.mirrors.positions().iter().enumerate().map(mirror))
                .collect(),
            lines: vec![segments(outline.points(), 0.01, WALL)],
            ..entity("room")
        }
    }

    /// The reflected ray of the nearest LED at each mirror's centre, down to the
    /// detectors, and the direct paths.
    fn light(&self) -> SceneEntity {
        let height = self.users.first().map_or(0.0, |user| user.position.z);
        let (mut rays, mut clear, mut blocked) = (Vec::new(), Vec::new(), Vec::new());
        for (index, mirror) in self.model.mirrors.positions().iter().enumerate() {
            let normal =
                self.model.mirrors.normal(index, (f64::from(self.angles.0[index]), f64::from(self.angles.1[index])));
            let Some(incoming) = self.nearest_led(mirror).map(|led| (mirror - led).normalize()) else { continue };
            let outgoing = incoming - 2.0 * incoming.dot(&normal) * normal;
            if outgoing.z < -1e-3 {
                rays.push(*mirror);
                rays.push(mirror + outgoing * ((height - mirror.z) / outgoing.z));
            }
        }
        for user in &self.users {
            let Some(led) = self.nearest_led(&user.position) else { continue };
            match user.los_blocked {
                Some(true) => blocked.extend([led, user.position]),
                Some(false) => clear.extend([led, user.position]),
                None => {}
            }
        }
        let lines = [(rays, 0.004, REFLECTED_LIGHT), (clear, 0.01, CLEAR), (blocked, 0.01, BLOCKED)];
        let lines = lines.into_iter().filter(|(points, ..)| !points.is_empty());
        SceneEntity {
            lines: lines.map(|(points, width, colour)| segments(points, width, colour)).collect(),
            ..entity("light")
        }
    }

    fn users(&self) -> SceneEntity {
        let colour = |user: &DrawnUser| if user.met { MET } else { MISSED };
        let sphere = |user: &DrawnUser| SpherePrimitive {
            pose: Some(pose(&user.position)),
            size: Some(vector(&Vec3::repeat(0.25))),
            color: Some(colour(user)),
        };
        let text = |user: &DrawnUser| TextPrimitive {
            pose: Some(pose(&(user.position + Vec3::z() * 0.3))),
            billboard: true,
            font_size: 0.15,
            scale_invariant: false,
            color: Some(colour(user)),
            text: user.label.clone(),
        };
        SceneEntity {
            spheres: self.users.iter().map(sphere).collect(),
            texts: self.users.iter().map(text).collect(),
            ..entity("users")
        }
    }

    fn obstacles(&self) -> SceneEntity {
        let cylinder = |obstacle: &Obstacle| {
            let [x, y, radius, height] =
                [obstacle.x_m, obstacle.y_m, obstacle.radius_m, obstacle.height_m].map(f64::from);
            CylinderPrimitive {
                pose: Some(pose(&Vec3::new(x, y, height / 2.0))),
                size: Some(vector(&Vec3::new(2.0 * radius, 2.0 * radius, height))),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color: Some(OBSTACLE),
            }
        };
        SceneEntity { cylinders: self.obstacles.iter().map(cylinder).collect(), ..entity("obstacles") }
    }

    fn nearest_led(&self, place: &Vec3) -> Option<Vec3> {
        let distance = |led: &Vec3| (led - place).norm_squared();
        let leds = self.model.leds.iter().map(|led| led.position);
        leds.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }
}

/// The extents of the room along x, y and z in m.
fn size_m(scenario: &Scenario) -> [f64; 3] {
    let room = &scenario.room;
    [room.length_x_m, room.length_y_m, room.height_m]
}

#[cfg(test)]
mod tests {
    use heliostat_channel::{decode::aim_at_point, mirrors::MirrorAngles};
    use heliostat_proto::{MirrorTelemetry, RoomTruth, TruthUser};
    use prost::Message;

    use super::*;

    fn scene() -> (Scenario, Scene) {
        let scenario = Scenario::builtin("specular").expect("a built-in one");
        let scene = Scene::new(&scenario).expect("it describes a channel");
        (scenario, scene)
    }

    fn entity_of<'a>(update: &'a SceneUpdate, id: &str) -> &'a SceneEntity {
        update.entities.iter().find(|entity| entity.id == id).unwrap_or_else(|| panic!("no entity {id}"))
    }

    #[test]
    fn rays_of_aimed_mirrors_meet_at_the_target_user() {
        let (scenario, mut scene) = scene();
        let model = scenario.channel_model().expect("it describes a channel");
        let target = Vec3::new(0.7, -0.4, 0.85);
        let mut angles = MirrorAngles::flat(model.mirrors.len());
        aim_at_point(&model, &target, &mut angles);
        let narrow = |angles: &[f64]| angles.iter().map(|angle| *angle as f32).collect::<Vec<_>>();
        let telemetry = MirrorTelemetry {
            roll_commanded: narrow(&angles.roll),
            yaw_commanded: narrow(&angles.yaw),
            ..MirrorTelemetry::default()
        };
        let user =
            TruthUser { position_m: [0.7, -0.4, 0.85], rate_bps: 2e6, los_blocked: true, ..TruthUser::default() };
        let truth = RoomTruth { users: vec![user], ..RoomTruth::default() };
        assert!(!scene.update(&Received::Telemetry(telemetry), 0, 1));
        assert!(scene.update(&Received::Truth(truth), 0, 10_000_000_000));
        let update = SceneUpdate::decode(scene.draw(10_000_000_000)).expect("it matches its schema");
        let rays = &entity_of(&update, "light").lines[0];
        assert_eq!(rays.points.len(), 2 * model.mirrors.len());
        for end in rays.points.iter().skip(1).step_by(2) {
            let apart = (Vec3::new(end.x, end.y, end.z) - target).norm();
            assert!(apart < 1e-3, "a ray ends {apart} m from its target");
        }
        let user = &entity_of(&update, "users").spheres[0];
        assert_eq!(user.color, Some(MET));
        let room = entity_of(&update, "room");
        assert_eq!((room.cubes.len(), room.lines[0].points.len()), (model.mirrors.len() + 1, 24));
    }

    #[test]
    fn the_geometry_that_the_room_announces_replaces_that_of_the_scenario() {
        let (_, mut scene) = scene();
        let geometry =
            |set: &str| Scenario::builtin("specular").unwrap().with_overrides(&[set]).unwrap().geometry_toml();
        let mut mirrors = |node, set: &str| {
            scene.announce(node, &geometry(set)).expect("a valid geometry");
            let update = SceneUpdate::decode(scene.draw(STILL_INTERVAL_NS)).expect("a scene");
            update.entities.iter().find(|entity| entity.id == "room").map(|room| room.cubes.len() - 1)
        };
        assert_eq!(mirrors(NodeKind::Controller, "mirrors.rows=4"), Some(40), "drawn at once");
        assert_eq!(mirrors(NodeKind::SimNode, "mirrors.rows=3"), Some(30));
        assert_eq!(mirrors(NodeKind::SimNode, "mirrors.rows=3"), None, "nothing has changed");
        assert_eq!(mirrors(NodeKind::Controller, "mirrors.rows=4"), None, "the room has priority");
        assert!(scene.announce(NodeKind::SimNode, "[users]").is_err_and(|reason| reason.contains("users")));
    }

    #[test]
    fn scenes_keep_their_interval_and_static_objects_are_repeated() {
        let (_, mut scene) = scene();
        let truth = Received::Truth(RoomTruth::default());
        let start = 1_000_000_000_000;
        assert!(scene.update(&truth, 0, start));
        scene.draw(start);
        assert!(!scene.update(&truth, 0, start + INTERVAL_NS - 1));
        assert!(scene.update(&truth, 0, start + INTERVAL_NS));
        let entities = |bytes: &[u8]| SceneUpdate::decode(bytes).expect("a scene").entities.len();
        assert_eq!(entities(scene.draw(start + INTERVAL_NS)), 3);
        assert_eq!(entities(scene.draw(start + STILL_INTERVAL_NS)), 4);
    }
}
