//! `heliostat-lab map` on the command line: a well-formed SVG with units, and values that follow from
//! the physics.

use serde_json::Value;
use tempfile::TempDir;

use super::lab;

/// The figures of a coarse map with these arguments, and its picture.
fn map(arguments: &[&str]) -> (Value, String) {
    let folder = TempDir::new().expect("a folder");
    let out = folder.path().join("map.svg");
    let common =
        ["map", "--scenario", "specular", "--json", "--step-cm", "20", "--out", out.to_str().expect("a plain path")];
    let output = lab(&[&common, arguments].concat());
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    let figures = serde_json::from_slice(&output.stdout).expect("one JSON object");
    (figures, std::fs::read_to_string(out).expect("a picture"))
}

fn figure(map: &Value, name: &str) -> f64 {
    map[name].as_f64().unwrap_or_else(|| panic!("{name} is missing in {map}"))
}

/// The elements of an SVG in order; each is closed, and nothing but white space follows the last.
fn elements(svg: &str) -> Vec<String> {
    let (mut open, mut found, mut rest) = (Vec::new(), Vec::new(), svg.trim());
    while let Some(start) = rest.find('<') {
        let end = start + rest[start..].find('>').expect("every tag ends");
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        let name = |tag: &str| tag.split_whitespace().next().expect("every tag has a name").to_owned();
        match tag.strip_prefix('/') {
            Some(closed) => assert_eq!(open.pop().as_deref(), Some(closed), "closed in order"),
            None => {
                assert_eq!(tag.matches('"').count() % 2, 0, "quotes come in pairs: {tag}");
                found.push(name(tag));
                if !tag.ends_with('/') {
                    open.push(name(tag));
                }
            }
        }
    }
    assert!(open.is_empty() && rest.is_empty(), "{open:?} {rest:?}");
    found
}

#[test]
fn the_svg_is_well_formed_and_labelled() {
    for (what, unit) in [("rate", "rate (Mbit/s)"), ("sinr", "SINR (dB)"), ("coverage", "minimum rate met")] {
        let (_, svg) = map(&["--what", what]);
        let count = |name: &str| elements(&svg).iter().filter(|element| *element == name).count();
        assert_eq!(elements(&svg)[0], "svg");
        // 25 x 25 places and 128 steps of the colour bar.
        assert!(count("rect") >= 25 * 25 + 128, "{what}: {} rectangles", count("rect"));
        // The title and the colour bar bear the unit; the axes and the legend are named.
        assert!(svg.matches(unit).count() >= 2, "{what}");
        for text in ["x (m)", "y (m)", "scenario specular", "user", "LED", "obstacle or body", "mirrors: oracle"] {
            assert!(svg.contains(text), "{what}: {text}");
        }
        // Two obstacles or more and five bodies, each as a dark and a light line, and the mirrors.
        assert!(count("polyline") > 2 * 5, "{what}: {} lines", count("polyline"));
    }
}

/// The width and height of the coloured floor in pixels.
fn floor_size(svg: &str) -> [f64; 2] {
    let number = |element: &str, name: &str| -> f64 {
        let text = element.split_once(&format!(" {name}=\"")).expect("an attribute").1;
        text.split('"').next().expect("a value").parse().expect("a number")
    };
    let rectangles = svg.split("<rect").skip(1).map(|rest| rest.split('>').next().expect("an end"));
    let coloured: Vec<[f64; 4]> = rectangles
        .filter(|element| !element.contains("#FFFFFF"))
        .map(|element| ["x", "y", "width", "height"].map(|name| number(element, name)))
        .collect();
    // The cells of the floor come first; the colour bar starts at the right of them.
    let [x0, y0, ..] = coloured[0];
    let row = coloured.iter().take_while(|[_, y, ..]| (y - y0).abs() < 1.0);
    let right = row.clone().map(|[x, _, width, _]| x + width).fold(0.0, f64::max);
    let cells = coloured.iter().filter(|[x, ..]| *x < right);
    let floor = cells.take_while(|[x, y, ..]| *x >= x0 - 1.0 && *y <= y0 + 1.0);
    let top = floor.map(|[_, y, ..]| *y).fold(f64::INFINITY, f64::min);
    [right - x0, y0 + coloured[0][3] - top]
}

#[test]
fn a_map_has_the_same_scale_on_both_axes_and_states_it() {
    for (x_m, y_m) in [(8.0, 4.0), (4.0, 8.0), (5.0, 5.0)] {
        let sizes = [format!("room.length_x_m={x_m}"), format!("room.length_y_m={y_m}")];
        let (figures, svg) = map(&["--set", &sizes[0], "--set", &sizes[1], "--array", "none"]);
        let scale = figure(&figures, "pixels_per_m");
        let [width, height] = floor_size(&svg);
        assert!((width / x_m - scale).abs() < 0.02 * scale, "{x_m} m are {width} pixels: {figures}");
        assert!((height / y_m - scale).abs() < 0.02 * scale, "{y_m} m are {height} pixels: {figures}");
        assert!(svg.contains("1 m") && elements(&svg)[0] == "svg", "no scale bar");
    }
}

#[test]
fn an_onnx_actor_gives_the_angles() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/actors/ddpg-specular.onnx");
    let [own, built_in] = [file, "ddpg"].map(|array| map(&["--array", array]).0);
    for name in ["min", "mean", "max"] {
        assert_eq!(figure(&own, name), figure(&built_in, name), "{name}");
    }
    let output = lab(&["map", "--array", "absent.onnx"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("no actor at absent.onnx"));
}

#[test]
fn a_map_without_mirrors_has_the_direct_path_only() {
    let clear = ["--set", "blockage.bodies=false", "--set", "blockage.obstacles_per_m2=0", "--set", "led.side_m=0"];
    let (none, _) = map(&[&clear[..], &["--array", "none"]].concat());
    assert_eq!(figure(&none, "points"), 625.0);
    // Under the LED: eqs. (1), (6) and (7) with 20 mm2 at 2.15 m and 4 MHz a user.
    let gain = 2.0 * 20e-6 / (std::f64::consts::TAU * 2.15_f64.powi(2));
    let sinr = 0.16 * 2.0 * gain * gain / 4.16e-15;
    let rate = 4.0 * (1.0 + std::f64::consts::E / std::f64::consts::TAU * sinr).log2();
    assert!((figure(&none, "max") - rate).abs() < 1e-3 * rate, "{none} for {rate}");
    assert!(figure(&none, "min") > 0.0 && figure(&none, "mean") < rate);
}

#[test]
fn aimed_mirrors_raise_the_rate_at_their_target() {
    let clear = ["--set", "blockage.bodies=false", "--set", "blockage.obstacles_per_m2=0"];
    let of = |array: &str| map(&[&clear[..], &["--array", array]].concat()).0;
    let (none, flat, aimed, oracle) = (of("none"), of("flat"), of("aim:-1,-1"), of("oracle"));
    for lit in [&flat, &aimed, &oracle] {
        assert!(figure(lit, "mean") > figure(&none, "mean") && figure(lit, "min") >= figure(&none, "min"));
    }
    // All mirrors at one point exceed the rate under the LED alone.
    assert!(figure(&aimed, "max") > 1.1 * figure(&none, "max"), "{aimed} beside {none}");
}

#[test]
fn a_blocked_point_has_no_rate_and_coverage_is_a_share() {
    let (rate, _) = map(&["--array", "none"]);
    assert_eq!(figure(&rate, "min"), 0.0);
    let (covered, _) = map(&["--array", "none", "--what", "coverage"]);
    assert_eq!((figure(&covered, "min"), figure(&covered, "max")), (0.0, 1.0));
    assert!((0.5..1.0).contains(&figure(&covered, "mean")));
    let (sinr, _) = map(&["--array", "none", "--what", "sinr"]);
    assert_eq!(figure(&sinr, "min"), -20.0);
}

#[test]
fn every_policy_and_a_file_of_angles_can_be_drawn() {
    for policy in ["fixed-point", "greedy", "nearest", "random", "no-irs", "user:4"] {
        assert!(figure(&map(&["--array", policy]).0, "mean") > 0.0, "{policy}");
    }
    let folder = TempDir::new().expect("a folder");
    let angles = folder.path().join("angles.csv");
    std::fs::write(&angles, format!("roll_deg,yaw_deg\n{}", "0,0\n".repeat(100))).expect("writable");
    let (mut by_file, _) = map(&["--angles", angles.to_str().expect("a plain path")]);
    let (mut flat, _) = map(&["--angles", "flat"]);
    for map in [&mut by_file, &mut flat] {
        (map["array"], map["file"]) = (Value::Null, Value::Null);
    }
    assert_eq!(by_file, flat);
}

#[test]
fn errors_name_the_cause() {
    for (arguments, expected) in [
        (&["--array", "aim:here"][..], "aim:X,Y"),
        (&["--array", "aim:9,9"][..], "is outside the room; expected |x| <= "),
        (&["--array", "user:5"], "from 0 to 4"),
        (&["--array", "best"], "fixed-point"),
        (&["--step-cm", "0"], "0.5 to 100"),
        (&["--at-seconds", "9999"], "0 to 3600"),
        (&["--out", "map.png"], ".svg"),
        (&["--out", "no/such/folder/map.svg", "--step-cm", "50"], "no/such/folder/map.svg"),
        (&["--scenario", "absent.toml"], "absent.toml"),
        (&["--what", "colour"], "coverage"),
    ] {
        let output = lab(&[&["map"], arguments].concat());
        let errors = String::from_utf8(output.stderr).expect("text");
        assert!(output.status.code() == Some(2) && errors.contains(expected), "{arguments:?}: {errors}");
    }
}

#[test]
fn a_map_of_rates_states_how_many_users_share_the_bandwidth() {
    let folder = TempDir::new().expect("a folder");
    let out = folder.path().join("map.svg");
    let file = out.to_str().expect("a plain path");
    for (what, expected) in [("rate", true), ("coverage", true), ("sinr", false)] {
        let output = lab(&["map", "--scenario", "specular", "--step-cm", "50", "--out", file, "--what", what]);
        let text = String::from_utf8(output.stdout).expect("text");
        assert_eq!(text.contains(", one of 5 users on the bandwidth, from"), expected, "{text}");
    }
}

#[test]
fn a_map_of_a_room_with_tilted_receivers_has_a_condition() {
    let folder = TempDir::new().expect("a folder");
    let out = folder.path().join("map.svg");
    let file = out.to_str().expect("a plain path");
    let errors = |model: &str| {
        let set = format!("users.orientation.model={model}");
        let output = lab(&["map", "--scenario", "specular", "--step-cm", "50", "--out", file, "--set", &set]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stderr).expect("text")
    };
    assert!(errors("measured").contains("every receiver faces up"));
    assert_eq!(errors("up"), "");
}
