//! Names of rooms, and the keys that contain them.

use heliostat_proto::*;

#[test]
fn room_names_hold_only_letters_digits_dashes_and_underscores() {
    assert_eq!(Room::new(""), Err(RoomError::Empty));
    assert!(matches!(Room::new(&"a".repeat(65)), Err(RoomError::TooLong { found: 65 })));
    for bad in ["a/b", "*", "a b", "a$", "ä", "a?", "a#", "@x", "a.b", "\n"] {
        assert!(matches!(Room::new(bad), Err(RoomError::BadCharacter { .. })), "{bad:?}");
    }
    let room = Room::new("Lab_2-b").expect("a valid name");
    assert_eq!(room.command(), "heliostat/v1/Lab_2-b/mirrors/command");
    assert_eq!(room.status(NodeKind::SimNode), "heliostat/v1/Lab_2-b/status/sim-node");
    assert_eq!("Lab_2-b".parse(), Ok(room));
}

#[test]
fn liveliness_keys_survive_a_round_trip() {
    let room = Room::new("demo").expect("a valid name");
    let key = room.alive(NodeKind::Driver, 0xabc);
    assert_eq!(key, "heliostat/v1/demo/alive/driver/0000000000000abc");
    assert_eq!(keys::parse_alive(&key), Some((NodeKind::Driver, 0xabc)));
    assert_eq!(keys::parse_alive(&room.array(3).driver_alive(0xabc)), Some((NodeKind::Driver, 0xabc)));
    let not_drivers = ["driver-0", "driver-16", "tracker-1"].map(|node| key.replace("/driver/", &format!("/{node}/")));
    let others = [room.users(), room.all_alive(), format!("{key}/more"), key.replace("/v1/", "/v2/")];
    for other in others.into_iter().chain(not_drivers) {
        assert_eq!(keys::parse_alive(&other), None, "{other}");
        assert_eq!(keys::parse_alive_room(&other), None, "{other}");
    }
    assert_eq!(keys::parse_alive_room(&key), Some(room));
    assert_eq!(keys::alive_in_every_room(), "heliostat/v1/*/alive/*/*");
}

#[test]
fn a_source_has_one_text_in_a_token() {
    let room = Room::new("demo").expect("a valid name");
    let key = |text: &str| room.alive(NodeKind::Tracker, 0).replace("0000000000000000", text);
    assert_eq!(keys::parse_alive(&key("0000000000000abc")), Some((NodeKind::Tracker, 0xabc)));
    for second in ["abc", "+abc", "0000000000000ABC", "00000000000000abc", "+000000000000abc", ""] {
        assert_eq!(keys::parse_alive(&key(second)), None, "{second}");
    }
    let driver = room.alive(NodeKind::Driver, 0xabc);
    assert_eq!(keys::parse_array_alive(&driver), Some((Some(0), 0xabc)));
    assert_eq!(keys::parse_array_alive(&driver.replace("0000000000000abc", "abc")), None);
}

#[test]
fn counters_and_messages_name_an_array_by_the_first_part_of_its_keys() {
    let room = Room::new("lab").expect("a valid name");
    for array in [0, 1, MAX_ARRAYS - 1] {
        let key = format!("heliostat/v1/lab/{}/command", array_keys::array_name(array));
        assert_eq!(key, room.array(array).command());
    }
}

#[test]
fn a_key_has_the_kind_of_its_messages() {
    let room = Room::new("status").expect("a valid name");
    let kinds = [
        (room.users(), Kind::UserReport),
        (room.stop(), Kind::EmergencyStop),
        (room.stops(), Kind::StopReport),
        (room.array(15).stops(), Kind::StopReport),
        (room.status(NodeKind::Viewer), Kind::NodeStatus),
        (room.array(2).driver_status(), Kind::NodeStatus),
        (room.geometry(NodeKind::SimNode), Kind::RoomGeometry),
        (room.controller_memory(), Kind::ControllerMemory),
    ];
    for (key, kind) in kinds {
        assert_eq!(room.kind_of(&key), Some(kind), "{key}");
    }
    let others = [room.array(16).stops(), room.array(16).driver_status(), room.alive(NodeKind::Driver, 7)];
    let further =
        ["battery", "users/more", "status/x", "geometry/", ""].map(|rest| format!("heliostat/v1/status/{rest}"));
    for key in others.into_iter().chain(further).chain(["heliostat/v1/lab/users".into()]) {
        assert_eq!(room.kind_of(&key), None, "{key}");
    }
}
