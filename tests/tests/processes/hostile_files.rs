//! Files that declare more than they hold, or hold what they must not: every command ends with an
//! error, not by a signal, and no control character of a file reaches the terminal.

use std::fs;
use std::path::{Path, PathBuf};

use heliostat_onnx::attribute_proto::AttributeType;
use heliostat_onnx::tensor_proto::DataType;
use heliostat_onnx::{AttributeProto, ModelProto, NodeProto, TensorProto};
use heliostat_record::file::{Header, Recording};
use heliostat_scenario::Scenario;
use heliostat_tests::{Ended, Process, workspace};
use prost::Message;
use tempfile::TempDir;

/// Extent of a square table whose values are too many for any memory.
const HUGE: i64 = 200_000;

/// Runs the program that has the command.
fn run(arguments: &[&str]) -> Ended {
    let program = if ["eval", "map"].contains(&arguments[0]) { "heliostat-lab" } else { "heliostat" };
    Process::program(program, arguments).wait()
}

/// The error of a command that ended by itself, without a panic.
fn refusal(ended: &Ended) -> &str {
    assert!(ended.status.code().is_some(), "ended by {}: {}", ended.status, ended.errors);
    let text = ended.refusal();
    assert!(!text.contains("panicked"), "{text}");
    text
}

/// Control characters other than line ends.
fn control_characters(text: &str) -> Vec<char> {
    text.chars().filter(|character| character.is_control() && *character != '\n').collect()
}

fn written(folder: &TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let file = folder.path().join(name);
    fs::write(&file, bytes).expect("a file in a new folder can be written");
    file
}

fn path(file: &Path) -> &str {
    file.to_str().expect("the paths of a test are text")
}

fn node(operator: &str, inputs: &[&str], output: &str, attribute: Vec<AttributeProto>) -> NodeProto {
    NodeProto {
        name: output.into(),
        op_type: operator.into(),
        input: inputs.iter().map(|name| (*name).into()).collect(),
        output: vec![output.into()],
        attribute,
        ..NodeProto::default()
    }
}

fn floats(name: &str, dims: &[i64], values: usize) -> TensorProto {
    let data = vec![0.0; values];
    let (dims, data_type) = (dims.to_vec(), DataType::Float as i32);
    TensorProto { name: name.into(), dims, data_type, float_data: data, ..TensorProto::default() }
}

fn integers(name: &str, values: &[i64]) -> TensorProto {
    let (dims, data_type) = (vec![values.len() as i64], DataType::Int64 as i32);
    TensorProto { name: name.into(), dims, data_type, int64_data: values.to_vec(), ..TensorProto::default() }
}

/// A built-in actor to whose angles the sum of the value "huge" is added.
fn actor(nodes: Vec<NodeProto>, tensors: Vec<TensorProto>) -> Vec<u8> {
    let file = workspace().join("models/actors/ddpg-raw-specular-10x10.onnx");
    let mut model = ModelProto::decode(&fs::read(file).expect("the built-in actor is a file")[..]).expect("it is ONNX");
    let graph = model.graph.as_mut().expect("it has a graph");
    let last = graph.node.last_mut().expect("it has nodes");
    last.output = vec!["network_angles".into()];
    let keep =
        AttributeProto { name: "keepdims".into(), r#type: AttributeType::Int as i32, ..AttributeProto::default() };
    graph.node.extend(nodes);
    graph.node.push(node("ReduceSum", &["huge"], "total", vec![keep]));
    graph.node.push(node("Add", &["network_angles", "total"], "angles", Vec::new()));
    graph.initializer.extend(tensors);
    model.encode_to_vec()
}

#[test]
fn an_onnx_file_whose_tensors_do_not_fit_into_memory_is_refused() {
    let shape = || integers("shape", &[HUGE, HUGE]);
    let cases = [
        ("initializer", actor(Vec::new(), vec![floats("huge", &[HUGE, HUGE], 1)])),
        ("overflow", actor(Vec::new(), vec![floats("huge", &[i64::MAX, i64::MAX, 4], 1)])),
        ("constant", actor(vec![node("ConstantOfShape", &["shape"], "huge", Vec::new())], vec![shape()])),
        (
            "expand",
            actor(vec![node("Expand", &["one", "shape"], "huge", Vec::new())], vec![shape(), floats("one", &[1], 1)]),
        ),
        (
            "product",
            actor(
                vec![node("MatMul", &["column", "row"], "huge", Vec::new())],
                vec![floats("column", &[HUGE, 1], HUGE as usize), floats("row", &[1, HUGE], HUGE as usize)],
            ),
        ),
        (
            "tile",
            actor(
                vec![node("Tile", &["observation", "times"], "huge", Vec::new())],
                vec![integers("times", &[HUGE, HUGE])],
            ),
        ),
        (
            "pad",
            actor(
                vec![node("Pad", &["observation", "pads"], "huge", Vec::new())],
                vec![integers("pads", &[HUGE, HUGE, HUGE, HUGE])],
            ),
        ),
        (
            "computed shape",
            actor(
                vec![
                    node(
                        "Concat",
                        &["side", "side"],
                        "sides",
                        vec![AttributeProto {
                            name: "axis".into(),
                            r#type: AttributeType::Int as i32,
                            ..AttributeProto::default()
                        }],
                    ),
                    node("ConstantOfShape", &["sides"], "huge", Vec::new()),
                ],
                vec![integers("side", &[HUGE])],
            ),
        ),
    ];
    let folder = TempDir::new().expect("a folder");
    for (name, bytes) in cases {
        let file = written(&folder, "actor.onnx", &bytes);
        let ended = run(&["eval", "--policies", path(&file), "--states", "1", "--seeds", "1"]);
        let text = refusal(&ended);
        println!("{name}: {text}");
        assert!(text.contains("actor.onnx"), "{name}: {text}");
    }
}

#[test]
fn an_onnx_file_with_nul_and_control_characters_in_its_names_is_refused_in_plain_text() {
    let folder = TempDir::new().expect("a folder");
    for operator in ["No\0such", "No\u{1b}[2J\u{9b}31m\rsuch", ""] {
        let bytes = actor(vec![node(operator, &["observation"], "huge", Vec::new())], Vec::new());
        let file = written(&folder, "actor.onnx", &bytes);
        let ended = run(&["eval", "--policies", path(&file), "--states", "1", "--seeds", "1"]);
        let text = refusal(&ended);
        assert!(text.contains("actor.onnx") && control_characters(text).is_empty(), "{text:?}");
    }
}

/// A recording that was cut after its header.
fn recording(header: &Header) -> Vec<u8> {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("room.mcap");
    let started = Recording::create(fs::File::create(&file).expect("a new file"), header).expect("a recording starts");
    let bytes = fs::read(file).expect("it was written");
    // Its end would write the footer.
    drop(started);
    bytes
}

fn header() -> Header {
    let scenario = Scenario::default().to_toml();
    let scenario_hash = Scenario::hash_of(&scenario);
    Header { room: "demo".into(), contract: "1".into(), scenario, scenario_hash, ..Header::default() }
}

/// A chunk that declares a length of its records before compression.
fn chunk(compression: &str, uncompressed: u64, record: &[u8]) -> Vec<u8> {
    let mut body = [0_u64, 0, uncompressed].map(u64::to_le_bytes).concat();
    body.extend(1_u32.to_le_bytes());
    body.extend((compression.len() as u32).to_le_bytes());
    body.extend(compression.as_bytes());
    body.extend((record.len() as u64).to_le_bytes());
    body.extend(record);
    [&[6][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

#[test]
fn a_recording_that_declares_long_records_is_refused() {
    let folder = TempDir::new().expect("a folder");
    let record = |opcode: u8, length: u64| [&[opcode][..], &length.to_le_bytes(), &[0; 64]].concat();
    for (name, damage) in [
        ("metadata of 4 EiB", record(12, 1 << 62)),
        ("attachment of 1 TiB", record(9, 1 << 40)),
        ("every bit of the length", record(12, u64::MAX)),
        ("end of the data", record(15, 1 << 40)),
        ("footer", record(2, 1 << 40)),
        ("chunk of 1 TiB", chunk("zstd", 1 << 40, &[0; 64])),
        ("chunk without compression", chunk("", 1 << 40, &record(5, 1 << 40))),
    ] {
        for decide in [true, false] {
            let file = written(&folder, "room.mcap", &[recording(&header()), damage.clone()].concat());
            let endpoint = heliostat_bus::private_endpoint().expect("a port");
            let ended = if decide {
                run(&["replay", path(&file), "--verify"])
            } else {
                run(&["replay", path(&file), "--listen", &endpoint])
            };
            let text = refusal(&ended);
            println!("{name}: {text}");
            assert!(text.contains("room.mcap") && text.contains("cannot be read"), "{name}: {text}");
        }
    }
}

#[test]
fn control_characters_of_files_do_not_reach_the_terminal() {
    let folder = TempDir::new().expect("a folder");
    let title = "\u{1b}]0;owned\u{7}\u{1b}[2J\u{9b}31m\u{202e}";
    let scenario = written(&folder, "room.toml", format!("name = 3 # {title}\n").as_bytes());
    let key = written(&folder, "key.toml", format!("\"{title}\" = 3\n").as_bytes());
    let users = written(&folder, "users.csv", format!("x,{title}\n1,2\n").as_bytes());
    let room = written(&folder, "room.mcap", &recording(&Header { room: title.into(), ..header() }));
    let contract = written(&folder, "contract.mcap", &recording(&Header { contract: title.into(), ..header() }));
    for arguments in [
        vec!["scenario", "check", path(&scenario)],
        vec!["scenario", "check", path(&key)],
        vec!["scenario", "check", path(&key), "--json"],
        vec!["link", "--users", path(&users)],
        vec!["replay", path(&room), "--verify"],
        vec!["replay", path(&contract), "--verify"],
    ] {
        let ended = run(&arguments);
        for text in [&ended.output, &ended.errors] {
            assert!(control_characters(text).is_empty() && !text.contains('\u{202e}'), "{arguments:?}: {text:?}");
        }
        assert!(!ended.status.success(), "{arguments:?}: {}", ended.output);
    }
}

#[test]
fn a_check_of_an_absent_scenario_answers_as_json_too() {
    let ended = run(&["scenario", "check", "absent.toml", "--json"]);
    assert_eq!(ended.status.code(), Some(1), "{}", ended.errors);
    let report: serde_json::Value = serde_json::from_str(&ended.output).expect("one JSON object");
    assert_eq!(report["valid"], false);
    let problem = report["problem"].as_str().expect("a text");
    assert!(problem.starts_with("scenario file absent.toml cannot be read: "), "{problem}");
    assert!(ended.errors.contains("absent.toml cannot be used: scenario file absent.toml"), "{}", ended.errors);
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_refused_and_not_awaited() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("given");
    let _socket = std::os::unix::net::UnixListener::bind(&file).expect("a socket");
    let file = path(&file);
    for arguments in [
        vec!["controller", "--policy", "ddpg-raw", "--model", file],
        vec!["replay", file, "--verify"],
        vec!["link", "--users", file],
        vec!["scenario", "check", file],
    ] {
        let ended = run(&arguments);
        let text = refusal(&ended);
        assert!(text.contains("it is no regular file: expected one, or /dev/stdin"), "{arguments:?}: {text}");
    }
}

#[test]
fn files_and_flags_of_any_size_are_refused_with_the_bound() {
    let folder = TempDir::new().expect("a folder");
    let users = written(&folder, "users.csv", format!("x,y\n{}", "0,0\n".repeat(200_000)).as_bytes());
    let scenario = |text: &str, name: &str| written(&folder, name, text.as_bytes());
    let many = scenario("[users]\ncount = 1000000000\n", "users.toml");
    let fast = scenario("[users]\nspeed_max_m_s = 1e9\n", "fast.toml");
    let bright = scenario("[led]\npower_w = 3e38\n", "bright.toml");
    let crowded = scenario(
        "[room]\nlength_x_m = 200.0\nlength_y_m = 200.0\n[blockage]\nobstacles_per_m2 = 100.0\nobstacle_min_distance_m = 0.05\n",
        "crowded.toml",
    );
    let rays = scenario(
        "[room]\nlength_x_m = 200.0\nlength_y_m = 200.0\nheight_m = 50.0\n[mirrors]\nrows = 128\ncolumns = 128\ncentre_height_m = 20.0\n\
         [led]\npoints_per_side = 64\n[users]\ncount = 64\n[blockage]\nobstacles_per_m2 = 0.0\n",
        "rays.toml",
    );
    let large = "room.length_x_m=200";
    for (arguments, bound) in [
        (vec!["scenario", "check", path(&many)], "1 to 64"),
        (vec!["scenario", "check", path(&fast)], "to 50"),
        (vec!["scenario", "check", path(&bright)], "to 10000"),
        (vec!["scenario", "check", path(&crowded)], "blockage.obstacles_per_m2"),
        (vec!["scenario", "check", path(&rays)], "points x mirrors x users x branches"),
        (vec!["scenario", "check", "/dev/zero"], "/dev/zero"),
        (vec!["link", "--users", path(&users)], "64"),
        (vec!["link", "--user", "0,0", "--angles", "/dev/zero"], "/dev/zero"),
        (
            vec![
                "map",
                "--set",
                large,
                "--set",
                "room.length_y_m=200",
                "--set",
                "blockage.obstacles_per_m2=0",
                "--step-cm",
                "0.5",
            ],
            "points",
        ),
        (vec!["eval", "--sweep", "users.count=1..4000000000"], "values"),
        (vec!["controller", "--policy", "ddpg", "--model", "/dev/zero"], "/dev/zero"),
    ] {
        let ended = run(&arguments);
        let text = refusal(&ended);
        assert!(text.contains(bound), "{arguments:?}: {text}");
    }
}
