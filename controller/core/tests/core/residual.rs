//! The policy that corrects the belief by channel residuals.

use heliostat_channel::{Orientation, Vec3};
use heliostat_core::{
    belief::{Estimate, residual::GainResidual},
    core::{Controller, DegradedMode},
    correction::Correction,
    evidence::{ALL_USERS, Believed, Evidence, FEATURES, LAST_REPORT, MEANS, MIRRORED},
    inbox::Message,
    policy::{
        Corrected, Engine, Network, PolicyError, PolicyKind,
        actor_file::{ActorFile, key},
        compact_file::CORRECTIONS,
    },
};
use heliostat_onnx::{
    ModelProto, NodeProto, TypeProto, ValueInfoProto, f32_row, tensor_shape_proto::dimension::Value as Extent,
    type_proto::Value,
};
use heliostat_proto::MirrorCommand;
use heliostat_scenario::Scenario;
use prost::Message as _;

use crate::support::{ActorRecipe, BiasEngine, Room, build_with, controller, model, receive, scenario};

/// A room whose obstacles no survey reports, so that the belief has its complete state.
fn hidden() -> Scenario {
    scenario(&["control.belief=\"filter\"", "blockage.obstacles_per_m2=0.05", "streams.obstacles.rate_hz=0"])
}

fn commands(scenario: &Scenario, kind: PolicyKind, recipe: &ActorRecipe) -> Vec<MirrorCommand> {
    let mut controller = controller(scenario, build_with(kind, scenario, &recipe.file()).unwrap());
    let mut room = Room::new(scenario);
    let all = (1..=40).map(|tick| room.tick(&mut controller, tick).command()).collect();
    assert_eq!(controller.counters().degraded(DegradedMode::PolicyFailed), 0);
    all
}

#[test]
fn corrections_of_zero_give_the_commands_of_greedy_bit_for_bit() {
    for scenario in [hidden(), scenario(&["control.belief=\"filter\"", "control.tilt={}"]), scenario(&[])] {
        let none = ActorRecipe::compact([0.0; 3]);
        let expected = commands(&scenario, PolicyKind::Greedy, &none);
        assert_eq!(commands(&scenario, PolicyKind::Residual, &none), expected);
        // A compact file is read as such under the name of any learned policy.
        assert_eq!(commands(&scenario, PolicyKind::Ddpg, &none), expected);
    }
}

#[test]
fn tilts_change_the_commands_where_users_are_believed() {
    let tilted = ActorRecipe::compact([-0.5, 0.0, -1.0]);
    let uncertain = ActorRecipe::compact([-0.5, 0.0, 0.5]);
    let of = |recipe| commands(&hidden(), PolicyKind::Residual, recipe);
    let greedy = commands(&hidden(), PolicyKind::Greedy, &tilted);
    assert_ne!(of(&tilted), greedy);
    assert_eq!(of(&uncertain), greedy, "a change that is less than its deviation");
    let unfiltered = scenario(&["control.belief=\"constant-velocity\""]);
    assert_eq!(
        commands(&unfiltered, PolicyKind::Residual, &tilted),
        commands(&unfiltered, PolicyKind::Greedy, &tilted)
    );
}

#[test]
fn reported_orientations_are_not_corrected_and_those_of_other_users_are() {
    let scenario = hidden();
    let run = |kind, reported: &[u32]| {
        let recipe = ActorRecipe::compact([-0.5, 0.0, -1.0]);
        let mut controller = controller(&scenario, build_with(kind, &scenario, &recipe.file()).unwrap());
        let mut room = Room::new(&scenario);
        let mut held = room.orientations_of(1, 0.3, reported);
        receive(&mut controller, Room::time(1), Message::Orientation(&mut held));
        (room.tick(&mut controller, 1).command(), controller)
    };
    let all = [0, 1, 2];
    let (command, controller) = run(PolicyKind::Residual, &all);
    assert_eq!(command, run(PolicyKind::Greedy, &all).0);
    // A training reads which corrections counted.
    let corrections = |controller: &Controller| controller.observer().evidence().unwrap().corrections().to_vec();
    assert_eq!(corrections(&controller), [Correction::NONE; 3]);
    let (_, controller) = run(PolicyKind::Residual, &all[..2]);
    let counted: Vec<bool> = corrections(&controller).iter().map(|one| *one != Correction::NONE).collect();
    assert_eq!(counted, [false, false, true]);
}

#[test]
fn another_user_under_an_old_number_has_no_residuals_of_the_former_one() {
    let scenario = hidden();
    let recipe = ActorRecipe::compact([0.0; 3]);
    let mut controller = controller(&scenario, build_with(PolicyKind::Residual, &scenario, &recipe.file()).unwrap());
    let mut room = Room::new(&scenario);
    (1..=20).for_each(|tick| drop(room.tick(&mut controller, tick)));
    let mut report = room.positions(21);
    report.users[1].position_m = [-2.2, 2.1, 0.85];
    receive(&mut controller, Room::time(21), Message::Users(&mut report)).command();
    let ids = &controller.observation().ids;
    let rows = controller.observer().evidence().expect("the policy reads it").rows();
    let observed = |user: u32| rows[ids.iter().position(|id| *id == user).unwrap()][MEANS.start];
    assert!(observed(0) > 0.1 && observed(2) > 0.1, "{} {}", observed(0), observed(2));
    assert_eq!(observed(1), 0.0);
}

/// A network that gives zeros while it is loaded, and a value that is not finite later.
struct Diverging(usize);

impl Engine for Diverging {
    fn load(&self, _: &[u8], _: usize) -> Result<Box<dyn Network>, String> {
        Ok(Box::new(DivergingNetwork { runs_left: self.0, input: vec![0.0; FEATURES], output: vec![0.0; 3] }))
    }
}

struct DivergingNetwork {
    runs_left: usize,
    input: Vec<f32>,
    output: Vec<f32>,
}

impl Network for DivergingNetwork {
    fn engine(&self) -> &'static str {
        "diverging"
    }

    fn set_rows(&mut self, rows: usize) -> Result<(), PolicyError> {
        self.input.resize(rows * FEATURES, 0.0);
        self.output.resize(rows * 3, 0.0);
        Ok(())
    }

    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        self.output[1] = if self.runs_left == 0 { f32::NAN } else { 0.0 };
        self.runs_left = self.runs_left.saturating_sub(1);
        Ok(&self.output)
    }
}

#[test]
fn the_fallback_decides_where_a_correction_is_not_finite() {
    let scenario = hidden();
    let file = ActorRecipe::compact([0.0; 3]).file();
    let policy = Corrected::load(&CORRECTIONS, &file, (3, 9), &Diverging(1 + 10)).unwrap();
    let mut controller = controller(&scenario, Box::new(policy));
    let mut room = Room::new(&scenario);
    for tick in 1..=14 {
        room.tick(&mut controller, tick).command();
    }
    assert_eq!(controller.counters().degraded(DegradedMode::PolicyFailed), 4, "one run at the load and ten decisions");
    assert!(controller.last_failure().is_some_and(|failure| failure.to_string().contains("not finite")));
    // At the load such a network is refused.
    let refusal = Corrected::load(&CORRECTIONS, &file, (3, 9), &Diverging(0)).err().expect("a refusal").to_string();
    assert!(refusal.contains("not finite"), "{refusal}");
}

#[test]
fn files_that_do_not_fit_are_refused_with_advice() {
    let scenario = scenario(&[]);
    let fitting = || ActorRecipe::compact([0.0; 3]);
    let refusal = |recipe: ActorRecipe| {
        build_with(PolicyKind::Residual, &scenario, &recipe.file()).err().expect("a refusal").to_string()
    };
    let cases = [
        (fitting().with_metadata(key::OBSERVATION_VERSION, "3"), "observation version \"3\", expected 4"),
        (fitting().without_metadata(key::ACTION), "the action \"angles\", expected \"compact\""),
        (ActorRecipe { input_length: 7, ..fitting() }, "the inputs \"observation\" (f32 [rows, 7]), expected"),
        (ActorRecipe { output_name: "angles", ..fitting() }, "expected exactly one, \"corrections\" (f32 [rows, 3])"),
        (
            ActorRecipe { port: f32_row, ..fitting() },
            "(f32 [1, 38]), expected exactly one, \"observation\" (f32 [rows, 38])",
        ),
        (ActorRecipe { port: f32_row, ..fitting() }, "first dimension is dynamic"),
        (ActorRecipe { port: no_rows, ..fitting() }, "(f32 [0, 38]), expected exactly one"),
        (ActorRecipe { port: without_type, ..fitting() }, "the inputs \"observation\" (of no known type), expected"),
        (ActorRecipe { opset: 9999, ..fitting() }, "the opset 9999, expected an opset from 7 to 28; export it again"),
        (fitting().with_metadata(key::ACTION, "a\u{1b}[31m"), "the action \"a\\u{1b}[31m\", expected \"compact\""),
        (ActorRecipe::compact([f32::NAN; 3]), "not finite"),
        (ActorRecipe::fitting(&scenario), "heliostat train residual"),
    ];
    for (recipe, words) in cases {
        let text = refusal(recipe);
        assert!(text.contains("test.onnx") && text.contains(words), "{text}");
    }
}

fn no_rows(name: &str, length: usize) -> ValueInfoProto {
    let mut port = f32_row(name, length);
    if let Some(TypeProto { value: Some(Value::TensorType(tensor)), .. }) = &mut port.r#type {
        tensor.shape.as_mut().expect("a shape").dim[0].value = Some(Extent::DimValue(0));
    }
    port
}

fn without_type(name: &str, _: usize) -> ValueInfoProto {
    ValueInfoProto { name: name.into(), ..ValueInfoProto::default() }
}

#[test]
fn a_network_that_the_reference_cannot_verify_is_refused_in_a_sentence() {
    let recipe = ActorRecipe::compact([0.0; 3]);
    let refusal = |change: fn(&mut NodeProto)| {
        let mut model = ModelProto::decode(&recipe.bytes()[..]).expect("just written");
        change(model.graph.as_mut().and_then(|graph| graph.node.last_mut()).expect("two nodes"));
        let file = ActorFile { bytes: model.encode_to_vec().into(), ..recipe.file() };
        Corrected::load(&CORRECTIONS, &file, (3, 9), &BiasEngine).err().expect("a refusal").to_string()
    };
    let not_supported = "test.onnx: the reference evaluation, which verifies the engine, does not support the operator";
    let unknown = refusal(|node| node.op_type = "Bogus".into());
    assert!(unknown.contains(&format!("{not_supported} Bogus as it is used here; export")), "{unknown}");
    let foreign = refusal(|node| node.domain = "com.example".into());
    assert!(foreign.contains(&format!("{not_supported} Add of the domain \"com.example\"; export")), "{foreign}");
}

/// The row of a user with a measured history, in a room whose array is on a wall.
fn row(wall: &str, turn: fn([f64; 2]) -> [f64; 2]) -> [f32; FEATURES] {
    let scenario = scenario(&[&format!("mirrors.wall=\"{wall}\"")]);
    let turned = |[x, y]: [f64; 2], z: f64| {
        let [x, y] = turn([x, y]);
        Vec3::new(x, y, z)
    };
    let mut evidence = Evidence::default();
    for tick in 1..=5 {
        let los = [(0.5 + 0.1 * tick as f64) * 1e-6, 1e-6];
        let residual = GainResidual { user: 4, los, los_shown: true, irs: [3e-7, 4e-7], steering: 2e-6 };
        evidence.handle_channel(Room::time(10 * tick), &[residual]);
    }
    let estimate = Estimate {
        position: turned([0.7, -0.4], 0.9),
        velocity: turned([0.6, 0.3], 0.0),
        position_cov_m2: [0.01, 0.0, 0.02],
        velocity_var_m2_s2: 0.04,
        heading: turned([0.5, 0.6], 0.0),
        direct_clear: 0.8,
    };
    let tilt = turned([0.3, 0.1], 0.0);
    let orientation = Orientation::from_polar_azimuth(tilt.norm().asin(), tilt.y.atan2(tilt.x));
    evidence.begin();
    evidence.add(&model(&scenario), &Believed { user: 4, estimate, orientation });
    evidence.rows()[0]
}

fn near(one: &[f32], other: &[f32]) -> bool {
    one.iter().zip(other).all(|(one, other)| (one - other).abs() < 1e-6)
}

#[test]
fn rows_do_not_depend_on_the_wall_and_a_mirrored_room_changes_signs_only() {
    let plain = row("+y", |at| at);
    assert!(near(&row("+x", |[x, y]| [y, -x]), &plain));
    let mut mirrored = row("+y", |[x, y]| [-x, y]);
    assert!(!near(&mirrored, &plain));
    MIRRORED.iter().for_each(|index| mirrored[*index] = -mirrored[*index]);
    assert!(near(&mirrored, &plain), "{mirrored:?} {plain:?}");
}

#[test]
fn a_row_holds_the_residuals_and_their_means() {
    let row = row("+y", |at| at);
    let (last, ratio) = (&row[LAST_REPORT], (0.75_f32).ln());
    assert!(near(last, &[1.0, 0.0, 1.0, ratio]), "{last:?}");
    // The longest mean hardly differs from the plain one of the reports after the first.
    let mean = [0.7, 0.8, 0.9, 1.0].map(f32::ln).iter().sum::<f32>() / 4.0;
    assert!((row[MEANS.end - 3] - mean).abs() < 0.03, "{} for {mean}", row[MEANS.end - 3]);
    assert!((row[ALL_USERS.start] - 0.1).abs() < 1e-3, "five direct measurements: {}", row[ALL_USERS.start]);
}
