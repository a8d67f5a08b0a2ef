//! `heliostat link` on the command line: closed forms, files, and errors.

use std::process::{Command, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use super::heliostat;

/// The JSON of `heliostat link` with these arguments.
fn link(arguments: &[&str]) -> Value {
    let output = heliostat(&[&["link", "--json"], arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// The error of `heliostat link` for these arguments.
fn refusal(arguments: &[&str]) -> String {
    let output = heliostat(&[&["link"], arguments].concat());
    assert!(!output.status.success(), "{arguments:?} should have been refused");
    let errors = String::from_utf8(output.stderr).expect("text");
    assert!(!errors.contains("panicked"), "{errors}");
    errors
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

fn assert_near(found: f64, expected: f64, relative: f64, what: &str) {
    assert!((found - expected).abs() <= relative * expected.abs(), "{what}: {found} instead of {expected}");
}

/// A file in a folder that lasts as long as the test.
fn file(folder: &TempDir, name: &str, text: &str) -> String {
    let path = folder.path().join(name);
    std::fs::write(&path, text).expect("writable");
    path.display().to_string()
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

#[test]
fn direct_gain_is_the_closed_form() {
    let users = ["--user", "0,0", "--user", "2,-2", "--obstacles", "none"];
    for (angles, side) in [("flat", "0"), ("oracle", "0"), ("flat", "0.1")] {
        let budget = link(&[&users[..], &["--angles", angles, "--set", &format!("led.side_m={side}")]].concat());
        // (n + 1) A_r cos cos / (2 pi D^2) with n = 1, 20 mm2 and the LED 2.15 m above: a panel
        // differs in the fourth digit.
        for (user, expected) in [(0, 1.376e-6), (1, 1.847e-7)] {
            assert_near(number(&budget["users"][user]["los_gain"]), expected, 1e-3, "direct gain");
            assert_eq!(budget["users"][user]["los_blocked"], false);
        }
    }
}

#[test]
fn every_field_is_present_and_consistent() {
    let budget = link(&["--user", "0,0", "--user", "2,-2", "--user", "-1,1.5,0.5", "--angles", "nearest"]);
    let users = budget["users"].as_array().expect("a list");
    assert_eq!(users.len(), 3);
    let noise = number(&budget["noise_variance_a2"]);
    let mut sum = 0.0;
    for user in users {
        let [los, irs, sinr, rate, ber] =
            ["los_gain", "irs_gain", "sinr", "rate_mbps", "ber"].map(|field| number(&user[field]));
        assert!(user["los_blocked"].is_boolean());
        // Eqs. (6) and (7) with R0 = 0.4 A/W, P = 2 W and 20 MHz among three.
        assert_near(sinr, 0.16 * 2.0 * (los + irs).powi(2) / noise, 1e-9, "SINR");
        let per_hz = (1.0 + std::f64::consts::E / std::f64::consts::TAU * sinr).log2();
        assert_near(rate, 20.0 / 3.0 * per_hz, 1e-9, "rate");
        assert!((0.0..=0.5).contains(&ber));
        sum += rate;
    }
    assert_near(number(&budget["sum_rate_mbps"]), sum, 1e-12, "sum of rates");
    assert_eq!(users[2]["position_m"], serde_json::json!([-1.0, 1.5, 0.5]));
    assert!(number(&budget["oracle_sum_rate_mbps"]) >= number(&budget["sum_rate_mbps"]) * (1.0 - 0.016));
}

#[test]
fn the_oracle_has_a_larger_sum_rate_than_flat_mirrors() {
    let users = ["--user", "2,-2", "--user", "0.5,1", "--set", "blockage.forced_users=1"];
    let [flat, oracle] = ["flat", "oracle"].map(|how| link(&[&users[..], &["--angles", how]].concat()));
    let sum = |budget: &Value| number(&budget["sum_rate_mbps"]);
    assert!(sum(&oracle) > 1.5 * sum(&flat), "{} and {}", sum(&oracle), sum(&flat));
    assert_eq!(oracle["oracle_sum_rate_mbps"], oracle["sum_rate_mbps"]);
    assert_eq!(oracle["oracle_sum_rate_mbps"], flat["oracle_sum_rate_mbps"]);
    assert_eq!(flat["users"][0]["los_blocked"], true);
    assert_eq!(flat["users"][0]["los_gain"], 0.0);
    assert_eq!(flat["users"][0]["los_blocked_by"], serde_json::json!(["forced"]));
}

type Vector = [f64; 3];

fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn length(a: Vector) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn unit(a: Vector) -> Vector {
    a.map(|x| x / length(a))
}

#[test]
fn mirrors_aimed_by_hand_give_the_gain_of_the_unfolded_path() {
    let (led, user) = ([0.0, 0.0, 3.0], [1.2, -0.7, 0.85]);
    let (mut angles, mut expected) = (String::from("roll_deg,yaw_deg\n"), Vec::new());
    for index in 0..100 {
        // 10 x 10 mirrors of 0.25 m x 0.10 m with gaps of 0.02 m about (0, 2.5, 2), row by row from
        // the lowest.
        let (row, column) = (f64::from(index / 10), f64::from(index % 10));
        let mirror = [(column - 4.5) * 0.27, 2.5, 2.0 + (row - 4.5) * 0.12];
        let (to_led, to_user) = (sub(led, mirror), sub(user, mirror));
        let (towards_led, towards_user) = (unit(to_led), unit(to_user));
        let normal = unit([0, 1, 2].map(|axis| towards_led[axis] + towards_user[axis]));
        // n = -(sin yaw cos roll, cos yaw cos roll, sin roll)
        let roll = (-normal[2]).asin();
        let yaw = (-normal[0]).atan2(-normal[1]);
        angles.push_str(&format!("{},{}\n", roll.to_degrees(), yaw.to_degrees()));
        // Lambertian order 1: rho 2 A_r cos(irradiance) cos(incidence) / (2 pi (D1 + D2)^2)
        let path = length(to_led) + length(to_user);
        let (irradiance, incidence) = (towards_led[2], -towards_user[2]);
        expected.push(0.95 * 2.0 * 20e-6 * irradiance * incidence / (std::f64::consts::TAU * path * path));
    }
    let folder = folder();
    let file = file(&folder, "angles.csv", &angles);
    let place = format!("{},{}", user[0], user[1]);
    let budget = link(&["--user", &place, "--angles", &file, "--set", "led.side_m=0", "--per-mirror"]);
    let link = &budget["users"][0];
    assert_near(number(&link["irs_gain"]), expected.iter().sum(), 1e-9, "gain of the array");
    for (mirror, expected) in expected.iter().enumerate() {
        assert_near(number(&link["mirror_gain"][mirror]), *expected, 1e-9, &format!("mirror {mirror}"));
    }
}

#[test]
fn an_obstacle_on_the_direct_path_is_named() {
    let folder = folder();
    // Half way to the user at (2, -2) the ray is 1.9 m above the floor; the other obstacle is
    // beside it.
    let obstacles = file(&folder, "obstacles.csv", "x,y,radius,height\n-2,2,0.2,1.5\n1.6,-1.6,0.2,1.75\n");
    let budget = link(&["--user", "0,0", "--user", "2,-2", "--angles", "flat", "--obstacles", &obstacles]);
    let [clear, blocked] = [0, 1].map(|user| &budget["users"][user]);
    assert_eq!((&clear["los_blocked"], number(&clear["los_gain"]) > 0.0), (&Value::Bool(false), true));
    assert_eq!((&blocked["los_blocked"], number(&blocked["los_gain"])), (&Value::Bool(true), 0.0));
    assert_eq!(blocked["los_blocked_by"], serde_json::json!(["obstacle 1"]));
    let table = heliostat(&["link", "--user", "2,-2", "--obstacles", &obstacles]);
    assert!(String::from_utf8(table.stdout).expect("text").contains("obstacle 1"));
}

#[test]
fn a_body_is_behind_its_user() {
    let folder = folder();
    let facing = |heading: f64| {
        let users = file(&folder, "users.csv", &format!("x,y,z,heading_deg\n2,-2,0.85,{heading}\n"));
        link(&["--users", &users, "--angles", "flat"])["users"][0]["los_blocked_by"].clone()
    };
    // At (2, -2) the LED is in the direction of 135 degrees.
    assert_eq!(facing(135.0), serde_json::json!([]));
    assert_eq!(facing(-45.0), serde_json::json!(["body of user 0"]));
}

#[test]
fn users_are_read_from_a_file_with_optional_z() {
    let folder = folder();
    let with_z = file(&folder, "a.csv", "x,y,z\n0,0,0.85\n2,-2,0.85\n");
    let without = file(&folder, "b.csv", "# measured on a Monday\nx, y\n0, 0\n2, -2\n");
    let [a, b] = [with_z, without].map(|users| link(&["--users", &users, "--angles", "flat"]));
    assert_eq!(a, b);
    assert_eq!(a["users"].as_array().map(Vec::len), Some(2));
}

#[test]
fn errors_name_the_cause() {
    let folder = folder();
    let user = ["--user", "1,1"];
    let angles = |name: &str, text: &str| refusal(&[&user[..], &["--angles", &file(&folder, name, text)]].concat());
    let line = "0,0\n".repeat(99);
    let cases = [
        (angles("h.csv", "yaw,roll\n0,0\n"), vec!["h.csv", "yaw,roll", "roll_deg,yaw_deg"]),
        (angles("n.csv", &format!("roll_deg,yaw_deg\n{line}")), vec!["n.csv", "99 mirrors", "100"]),
        (angles("nan.csv", &format!("roll_deg,yaw_deg\nNaN,0\n{line}")), vec!["nan.csv", "mirror 0", "NaN"]),
        (angles("far.csv", &format!("roll_deg,yaw_deg\n{line}0,91\n")), vec!["far.csv", "mirror 99", "91"]),
        (angles("w.csv", &format!("roll_deg,yaw_deg\n{line}up,0\n")), vec!["w.csv", "line 101"]),
        (refusal(&["--user", "9,1"]), vec!["user 0", "(9, 1, 0.85)", "outside the room"]),
        (refusal(&["--user", "1,1,3.5"]), vec!["user 0", "3.5", "outside the room"]),
        (refusal(&["--user", "1,nan"]), vec!["user 0", "NaN"]),
        (refusal(&["--user", "1"]), vec!["--user 1", "X,Y"]),
        (refusal(&["--users", "absent.csv"]), vec!["absent.csv", "No such file"]),
        (refusal(&["--users", &file(&folder, "u.csv", "x,y,heigth\n1,1,1\n")]), vec!["u.csv", "heigth", "x,y[,z]"]),
        (refusal(&["--users", &file(&folder, "e.csv", "x,y,z\n")]), vec!["no users"]),
        (refusal(&["--users", &file(&folder, "t.csv", "x,y,z\n1,1,1\n2,2\n")]), vec!["t.csv", "line 3"]),
        (refusal(&[&user[..], &["--angles", "falt"]].concat()), vec!["falt", "flat"]),
        (refusal(&[&user[..], &["--angles", "user:1"]].concat()), vec!["user:1", "0"]),
        (refusal(&[&user[..], &["--angles", "aim:1"]].concat()), vec!["aim:1", "aim:X,Y"]),
        (refusal(&[&user[..], &["--obstacles", "absent.csv"]].concat()), vec!["absent.csv"]),
        (
            refusal(&[&user[..], &["--obstacles", &file(&folder, "o.csv", "x,y,radius,height\n0,0,-1,1\n")]].concat()),
            vec!["o.csv", "radius"],
        ),
        (refusal(&[&user[..], &["--set", "led.power=1"]].concat()), vec!["power"]),
        (refusal(&[]), vec!["--user"]),
    ];
    for (message, expected) in cases {
        for word in expected {
            assert!(message.contains(word), "\"{word}\" is missing in: {message}");
        }
    }
}

/// Runs the program with a reader that closes the pipe immediately.
fn with_closed_output(arguments: &[&str]) -> (bool, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_heliostat"))
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("the program ends");
    (output.status.success(), String::from_utf8(output.stderr).expect("text"))
}

#[test]
fn a_closed_output_is_not_an_error() {
    for arguments in [
        &["link", "--user", "1,1", "--per-mirror"][..],
        &["link", "--user", "1,1", "--json"],
        &["scenario", "show"],
        &["scenario", "check", "specular"],
        &["bench", "decide", "--policy", "nearest", "--hz", "0", "--decisions", "10", "--json"],
    ] {
        assert_eq!(with_closed_output(arguments), (true, String::new()), "{arguments:?}");
    }
}

#[test]
fn a_room_whose_users_tilt_their_receivers_has_a_condition() {
    let errors = |model: &str| {
        let set = format!("users.orientation.model={model}");
        let output = heliostat(&["link", "--user", "1,1", "--json", "--set", &set]);
        assert!(output.status.success() && serde_json::from_slice::<Value>(&output.stdout).is_ok());
        String::from_utf8(output.stderr).expect("text")
    };
    let found = errors("measured");
    assert!(found.starts_with("condition: users.orientation") && found.contains("every receiver faces up"), "{found}");
    assert_eq!(errors("up"), "");
}

#[test]
fn the_table_states_how_many_users_share_the_bandwidth() {
    for (users, expected) in [(1, "1 user on the bandwidth"), (2, "2 users on the bandwidth")] {
        let output = heliostat(&[&["link"][..], &["--user", "1,1", "--user", "-1,1"][..2 * users]].concat());
        let table = String::from_utf8(output.stdout).expect("text");
        assert!(table.lines().next().is_some_and(|line| line.ends_with(expected)), "{table}");
    }
}

#[test]
fn an_onnx_actor_gives_the_angles() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/actors/ddpg-specular.onnx");
    let users = ["--user", "1,1", "--user", "-1,0.5"];
    let rate = |angles: &str| number(&link(&[&users[..], &["--angles", angles]].concat())["sum_rate_mbps"]);
    assert_eq!(rate(file), rate("ddpg"));
    assert!(refusal(&[&users[..], &["--angles", "absent.onnx"]].concat()).contains("no actor at absent.onnx"));
}

#[test]
fn without_users_both_ways_to_give_them_are_named() {
    let errors = refusal(&[]);
    assert!(errors.contains("--user X,Y") && errors.contains("--users with a CSV"), "{errors}");
}
