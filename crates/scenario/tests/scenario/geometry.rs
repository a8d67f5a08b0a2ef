//! The geometry that a room announces: complete for a viewer, checked, and without file paths.

use heliostat_proto::MAX_GEOMETRY;
use heliostat_scenario::{BUILTIN_NAMES, GeometryDifference, RoomDifference, Scenario};

fn with(overrides: &[&str]) -> Scenario {
    Scenario::default().with_overrides(overrides).unwrap()
}

#[test]
fn every_built_in_scenario_gives_a_geometry_with_the_same_channel() {
    for name in BUILTIN_NAMES {
        let scenario = Scenario::builtin(name).unwrap();
        let announced = Scenario::from_geometry_toml(&scenario.geometry_toml()).unwrap();
        assert_eq!(scenario.geometry_difference(&announced), None, "{name}");
        assert_eq!(announced.name, scenario.name);
        let (here, there) = (scenario.channel_model().unwrap(), announced.channel_model().unwrap());
        assert_eq!(format!("{here:?}"), format!("{there:?}"), "{name}");
    }
}

#[test]
fn the_geometry_of_an_extreme_scenario_is_accepted_and_fits_into_a_message() {
    let panels = (0..64).map(|panel| format!("[{}.123456789012, -0.123456789012, 2.987654321098]", panel % 2));
    let panels = format!("led.positions_m=[{}]", panels.collect::<Vec<_>>().join(", "));
    let branch = "{ tilt_deg = 45.123456789, azimuth_deg = -123.123456789, fov_deg = 35.123456789 }";
    let branches = format!("receiver.branches=[{}]", [branch; 16].join(", "));
    let sets = [
        &panels,
        &branches,
        "led.points_per_side=1",
        "users.count=64",
        "blockage.forced_users=64",
        "room.length_x_m=100",
        "room.length_y_m=100",
        "blockage.obstacles_per_m2=0.07",
        "noise.variance_a2=6.5e-15",
    ];
    let scenario = with(&sets);
    let text = scenario.geometry_toml();
    assert!(text.len() <= MAX_GEOMETRY, "{} bytes", text.len());
    let announced = Scenario::from_geometry_toml(&text).unwrap();
    assert_eq!(scenario.geometry_difference(&announced), None);
    let low = with(&[
        "room.height_m=1",
        "receiver.height_m=0.5",
        "mirrors.centre_height_m=0.5",
        "mirrors.rows=2",
        "led.positions_m=[[0, 0, 1.0]]",
        "blockage.body_height_m=1",
        "blockage.obstacle_height_m=0.5",
    ]);
    assert!(Scenario::from_geometry_toml(&low.geometry_toml()).is_ok());
}

#[test]
fn a_geometry_holds_no_trace_file_and_refuses_other_keys_by_name() {
    let text = with(&["users.trace=/home/ann/walk.csv"]).geometry_toml();
    assert!(!text.contains("walk") && !text.contains("[users]"), "{text}");
    for (text, named) in [
        ("[users]\ntrace = \"/etc/passwd\"\n", "users"),
        ("[blockage]\nforced_users = 1\n", "forced_users"),
        ("[mirrors]\nrows = 0\n", "line 2: mirrors.rows = 0: expected an integer from 1 to 16: "),
        ("[room]\nheight_m = nan\n", "room.height_m = NaN"),
        ("[room]\nheigth_m = 3.0\n", "heigth_m"),
        ("[room", "room geometry"),
        ("name = 7", "name"),
    ] {
        let message = Scenario::from_geometry_toml(text).unwrap_err().to_string();
        assert!(message.contains(named), "{text}: {message}");
    }
}

#[test]
fn the_first_differing_key_of_two_geometries_is_named_with_both_values() {
    let room = Scenario::default();
    assert_eq!(
        room.geometry_difference(&with(&["users.count=3", "seed=4", "name=other", "blockage.forced_users=2"])),
        None
    );
    let difference = |key: &str, here: &str, there: &str| Some([key, here, there].map(String::from));
    let found = |other: &[&str]| {
        let GeometryDifference { key, here, there, .. } = room.geometry_difference(&with(other))?;
        Some([key, here, there])
    };
    assert_eq!(found(&["mirrors.rows=8", "room.height_m=3.5"]), difference("room.height_m", "3.0", "3.5"));
    assert_eq!(found(&["mirrors.rows=8"]), difference("mirrors.rows", "10", "8"));
    assert_eq!(found(&["noise.variance_a2=6.5e-15"]), difference("noise.variance_a2", "none", "6.5e-15"));
}

#[test]
fn only_differences_that_a_calibration_measures_and_can_find_are_no_fault() {
    let room = Scenario::default();
    let of = |overrides: &[&str]| with(overrides).room_difference(&room, "this controller");
    assert_eq!(of(&[]), None);
    assert_eq!(
        of(&["room.height_m=3.02", "mirrors.reflectivity=0.93", "led.half_power_semi_angle_deg=63"]),
        Some(RoomDifference::Measured(
            "this controller differs from the room only in what heliostat calibrate measures: room.height_m, \
             led.half_power_semi_angle_deg, mirrors.reflectivity. Most: led.half_power_semi_angle_deg is 60.0 in the \
             room and 63.0 in this controller"
                .into()
        ))
    );
    let Some(RoomDifference::Measured(wide)) = of(&["room.height_m=3.02", "led.half_power_semi_angle_deg=41"]) else {
        panic!("a calibration can find it")
    };
    assert!(
        wide.ends_with("Most: led.half_power_semi_angle_deg is 60.0 in the room and 41.0 in this controller"),
        "{wide}"
    );
    for (overrides, key) in [
        (&["room.height_m=3.5"][..], "room.height_m"),
        (&["room.height_m=3.02", "mirrors.rows=8"], "mirrors.rows"),
        (&["led.positions_m=[[0, 0, 3], [1, 0, 3]]"], "led.positions_m"),
        (&["receiver.area_mm2=400"], "receiver.area_mm2"),
    ] {
        let found = of(overrides).and_then(RoomDifference::problem).expect("a fault");
        let start = format!("room and controller differ: {key} is ");
        assert!(
            found.starts_with(&start) && found.ends_with("start both with the same --scenario and --set"),
            "{found}"
        );
    }
}

#[test]
fn an_announced_geometry_is_compared_with_that_of_the_controller() {
    let controller = Scenario::default();
    let problem = |announced: &str| {
        let found = controller.announced_difference(announced, "this controller");
        found.and_then(RoomDifference::problem).unwrap_or_default()
    };
    assert_eq!(problem(&with(&["users.count=3"]).geometry_toml()), "");
    let differs =
        "room and controller differ: room.length_x_m is 9.0 in the room and 5.0 in this controller; start both";
    assert!(problem(&with(&["room.length_x_m=9"]).geometry_toml()).starts_with(differs));
    assert!(problem("[room").starts_with("the geometry that the room announces is refused: room geometry"));
}
