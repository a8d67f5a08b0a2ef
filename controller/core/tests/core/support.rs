//! A small room that reports, and actors made to order.

use heliostat_channel::{ChannelModel, MirrorAngles, Orientation, Vec3};
use heliostat_core::{
    belief::Belief,
    core::{Controller, Decision, DegradedMode},
    inbox::Message,
    observation::{Observation, ObservationEncoder},
    policy::{
        self, Actor, BuildError, DenseEngine, Policy, PolicyKind, PolicyResult, Resources,
        actor_file::{ANGLES, ActorError, ActorFile, INPUT_NAME, room_entries},
    },
};
use heliostat_onnx::{
    ModelProto, ValueInfoProto, f32_row,
    graph::{Ends, Graph},
};
use heliostat_proto::{
    ChannelReport, LedReport, MirrorCommand, MirrorTelemetry, Nanos, Obstacle, ObstacleReport, OrientationReport,
    Stamp, UserChannel, UserOrientation, UserReport, UserState,
};
use heliostat_scenario::Scenario;
use prost::Message as _;

pub const MS: Nanos = 1_000_000;
pub const SOURCE: u64 = 0x51;
pub const START: Nanos = 1_000 * MS;

/// The default scenario with three by three mirrors and three users.
pub fn scenario(overrides: &[&str]) -> Scenario {
    let small = ["mirrors.rows=3", "mirrors.columns=3", "users.count=3"];
    Scenario::builtin("specular").unwrap().with_overrides(&[&small[..], overrides].concat()).unwrap()
}

pub fn model(scenario: &Scenario) -> ChannelModel {
    scenario.channel_model().unwrap()
}

/// The room `hall`, its channel, and a belief about its users.
pub fn hall(overrides: &[&str]) -> (Scenario, ChannelModel, Belief) {
    let scenario = Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap();
    let model = model(&scenario);
    let belief = Belief::new(&scenario, &model, 64);
    (scenario, model, belief)
}

pub fn controller(scenario: &Scenario, policy: Box<dyn Policy>) -> Controller {
    Controller::new(scenario, model(scenario), policy, 7)
}

/// A controller with flat mirrors, and its room.
pub fn flat(overrides: &[&str]) -> (Controller, Room) {
    by_policy(PolicyKind::Flat, overrides)
}

/// A controller with this policy, and its room.
pub fn by_policy(kind: PolicyKind, overrides: &[&str]) -> (Controller, Room) {
    let scenario = scenario(overrides);
    (controller(&scenario, build(kind, &scenario).unwrap()), Room::new(&scenario))
}

/// A controller with a policy that calls a function, and its room.
pub fn scripted(overrides: &[&str], act: fn(&Observation, &mut MirrorAngles) -> PolicyResult) -> (Controller, Room) {
    let scenario = scenario(overrides);
    (controller(&scenario, Box::new(Scripted(act))), Room::new(&scenario))
}

/// Telemetry of flat mirrors.
pub fn telemetry(source: u64, sequence: u64, time_ns: Nanos, mirrors: usize) -> MirrorTelemetry {
    let (stamp, flat) = (Stamp { source, sequence, time_ns }, vec![0.0; mirrors]);
    MirrorTelemetry { stamp, roll_commanded: flat.clone(), yaw_commanded: flat, ..MirrorTelemetry::default() }
}

/// What came of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    Nothing,
    Moved(MirrorCommand),
    Held(DegradedMode),
}

impl Outcome {
    pub fn command(self) -> MirrorCommand {
        match self {
            Self::Moved(command) => command,
            other => panic!("expected a command, got {other:?}"),
        }
    }

    /// Without the number of the command, which a restored controller begins again.
    pub fn unnumbered(self) -> Self {
        match self {
            Self::Moved(command) => Self::Moved(MirrorCommand { sequence: 0, ..command }),
            other => other,
        }
    }
}

pub fn receive(controller: &mut Controller, now: Nanos, message: Message<'_>) -> Outcome {
    match controller.handle_and_poll(now, message, &mut |_| {}) {
        None => Outcome::Nothing,
        Some(Decision::Move { command, .. }) => Outcome::Moved(command.clone()),
        Some(Decision::Hold(mode)) => Outcome::Held(mode),
    }
}

/// A room with users who walk in circles and report every 10 ms.
pub struct Room {
    pub source: u64,
    pub users: usize,
    pub sequence: u64,
}

impl Room {
    pub fn new(scenario: &Scenario) -> Self {
        Self { source: SOURCE, users: scenario.users.count, sequence: 0 }
    }

    /// Time of the n-th tick.
    pub fn time(tick: u64) -> Nanos {
        START + tick * 10 * MS
    }

    fn stamp(&mut self, tick: u64) -> Stamp {
        self.sequence += 1;
        Stamp { source: self.source, sequence: self.sequence, time_ns: Self::time(tick) }
    }

    pub fn positions(&mut self, tick: u64) -> UserReport {
        let ids: Vec<u32> = (0..self.users as u32).collect();
        self.positions_of(tick, &ids)
    }

    /// The positions of these users, in this order.
    pub fn positions_of(&mut self, tick: u64, ids: &[u32]) -> UserReport {
        let stamp = self.stamp(tick);
        UserReport { stamp, tick, users: ids.iter().map(|id| walker(*id, self.users, tick)).collect() }
    }

    /// All users measure the same gain of the direct path.
    pub fn gains(&mut self, tick: u64, los_gain: f32) -> ChannelReport {
        let ids: Vec<u32> = (0..self.users as u32).collect();
        self.gains_of(tick, los_gain, &ids)
    }

    /// The gains of these users, in this order.
    pub fn gains_of(&mut self, tick: u64, los_gain: f32, ids: &[u32]) -> ChannelReport {
        let stamp = self.stamp(tick);
        let one = |user: &u32| UserChannel { user: *user, los_gain, irs_gain: 0.0, sinr: 0.0 };
        ChannelReport { stamp, tick, users: ids.iter().map(one).collect() }
    }

    /// These users hold their receivers with this polar angle in rad, each towards another azimuth.
    pub fn orientations_of(&mut self, tick: u64, polar: f64, ids: &[u32]) -> OrientationReport {
        let held = |user: u32| Orientation::from_polar_azimuth(polar, f64::from(user)).quaternion();
        let one = |user: &u32| UserOrientation { user: *user, quaternion: held(*user).map(|part| part as f32) };
        OrientationReport { stamp: self.stamp(tick), users: ids.iter().map(one).collect() }
    }

    pub fn survey(&mut self, tick: u64, obstacles: Vec<Obstacle>) -> ObstacleReport {
        ObstacleReport { stamp: self.stamp(tick), obstacles }
    }

    /// Reports gains and then positions of a tick, at its time.
    pub fn tick(&mut self, controller: &mut Controller, tick: u64) -> Outcome {
        receive(controller, Self::time(tick), Message::Channel(&mut self.gains(tick, 1e-6)));
        receive(controller, Self::time(tick), Message::Users(&mut self.positions(tick)))
    }
}

fn walker(user: u32, users: usize, tick: u64) -> UserState {
    let turn = std::f64::consts::TAU * f64::from(user) / users as f64 + 0.01 * tick as f64;
    let (sin, cos) = turn.sin_cos();
    UserState {
        user,
        position_m: [(1.4 * cos) as f32, (1.1 * sin) as f32, 0.85],
        velocity_m_s: [(-1.4 * sin) as f32, (1.1 * cos) as f32],
        min_rate_bps: 1e6,
    }
}

/// Reports users who stay at these places, ten times a second, and then the gains that each of them
/// measures: of the direct path, and over the mirrors.
pub fn report_gains(
    belief: &mut Belief,
    model: &ChannelModel,
    tick: u64,
    places: &[Vec3],
    (gains, leds): (&[[f64; 2]], Option<&LedReport>),
) {
    let stamp = Stamp { source: 1, sequence: tick, time_ns: tick * 100 * MS };
    let user = |(user, place): (u32, &Vec3)| {
        let position_m = [place.x as f32, place.y as f32, place.z as f32];
        UserState { user, position_m, ..UserState::default() }
    };
    belief.handle_users(&UserReport { stamp, tick, users: (0..).zip(places).map(user).collect() });
    let measured = |(user, gains): (u32, &[f64; 2])| {
        let [los_gain, irs_gain] = gains.map(|gain| gain as f32);
        UserChannel { user, los_gain, irs_gain, ..UserChannel::default() }
    };
    let channel = ChannelReport { stamp, tick, users: (0..).zip(gains).map(measured).collect() };
    belief.handle_channel(model, &channel, leds, &[], &[]);
}

/// A policy that calls a function.
pub struct Scripted(pub fn(&Observation, &mut MirrorAngles) -> PolicyResult);

impl Policy for Scripted {
    fn name(&self) -> &str {
        "scripted"
    }

    fn act(&mut self, _: &ChannelModel, observation: &Observation, out: &mut MirrorAngles) -> PolicyResult {
        (self.0)(observation, out)
    }
}

/// An ONNX file to order: a network of one layer whose weights are zero, so that it answers its bias.
pub struct ActorRecipe {
    pub input_name: &'static str,
    pub output_name: &'static str,
    pub input_length: usize,
    pub output_length: usize,
    pub bias: Vec<f32>,
    pub metadata: Vec<(String, String)>,
    /// Declares input or output, of one row or of any number.
    pub port: fn(&str, usize) -> ValueInfoProto,
    pub opset: i64,
}

impl ActorRecipe {
    /// An actor that fits the scenario and sees up to four users.
    pub fn fitting(scenario: &Scenario) -> Self {
        let (users_max, mirrors) = (4, scenario.mirror_count());
        Self {
            input_name: INPUT_NAME,
            output_name: ANGLES,
            input_length: ObservationEncoder::new(users_max, mirrors).len(),
            output_length: 2 * mirrors,
            bias: vec![0.25; 2 * mirrors],
            metadata: room_entries(scenario, users_max),
            port: f32_row,
            opset: 17,
        }
    }

    pub fn with_metadata(self, key: &str, value: &str) -> Self {
        let mut without = self.without_metadata(key);
        without.metadata.push((key.into(), value.into()));
        without
    }

    pub fn without_metadata(mut self, key: &str) -> Self {
        self.metadata.retain(|(name, _)| name != key);
        self
    }

    pub fn bytes(&self) -> Vec<u8> {
        let (inputs, outputs) = (self.input_length, self.output_length);
        let mut graph = Graph::default();
        let weights = graph.constant("layer.weight", &[inputs, outputs], &vec![0.0; inputs * outputs]);
        let bias = graph.constant("bias", &[1, self.bias.len()], &self.bias);
        let product = graph.node("MatMul", &[self.input_name, &weights]);
        graph.node("Add", &[&product, &bias]);
        let ends = Ends { name: "test", input: (self.input_name, inputs), output: (self.output_name, outputs) };
        let mut model = ModelProto::decode(&graph.finish(&ends, &self.metadata)[..]).expect("just written");
        model.opset_import[0].version = self.opset;
        let graph = model.graph.as_mut().expect("a graph");
        graph.input = vec![(self.port)(self.input_name, inputs)];
        graph.output = vec![(self.port)(self.output_name, outputs)];
        model.encode_to_vec()
    }

    pub fn file(&self) -> ActorFile {
        ActorFile { origin: "test.onnx".into(), bytes: self.bytes().into() }
    }
}

/// A policy by its name; learned ones with an actor that fits.
pub fn build(kind: PolicyKind, scenario: &Scenario) -> Result<Box<dyn Policy>, BuildError> {
    let actor = ActorRecipe::fitting(scenario).file();
    policy::build(kind, scenario, &Resources { actor: Some(&actor), engine: &DenseEngine, monotonic_ns })
}

/// Loads an actor.
pub fn load_actor(file: &ActorFile, scenario: &Scenario) -> Result<Actor, ActorError> {
    Actor::load(file, scenario, &DenseEngine)
}

fn monotonic_ns() -> u64 {
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START.get_or_init(std::time::Instant::now).elapsed().as_nanos() as u64
}
