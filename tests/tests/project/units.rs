//! The systemd units of deploy/, and the rules that all of them keep.

use std::fs;
use std::path::Path;

use heliostat_tests::workspace;

#[test]
fn every_unit_that_cannot_start_waits_for_an_operator_after_as_many_attempts() {
    let units = fs::read_dir(workspace().join("deploy/systemd")).expect("a folder").flatten();
    let texts: Vec<String> = units.map(|entry| fs::read_to_string(entry.path()).expect("a unit")).collect();
    let limits = "\nStartLimitIntervalSec=60\nStartLimitBurst=10\n";
    assert!(texts.len() >= 8 && texts.iter().all(|text| text.contains(limits)), "a unit has other limits");
}

/// A path in `DeviceAllow=` is the device node of the start: a board that is plugged in again can have another one.
#[test]
fn the_drop_in_for_serial_ports_allows_kinds_of_ports_that_the_kernel_knows_at_the_start() {
    let file = workspace().join("deploy/serial/heliostat-driver@.service.d/serial.conf");
    let text = fs::read_to_string(file).expect("a drop-in");
    let allowed: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("DeviceAllow=")).collect();
    assert_eq!(allowed, ["char-ttyACM rw", "char-ttyUSB rw"]);
    for order in ["Wants", "After"] {
        let line = format!("\n{order}=modprobe@cdc_acm.service modprobe@usbserial.service\n");
        assert!(text.contains(&line), "{order}: {text}");
    }
    let unit = fs::read_to_string(workspace().join("deploy/systemd/heliostat-driver@.service")).expect("a unit");
    assert!(unit.contains("deploy/serial"), "the unit does not name its drop-in");
}

#[test]
fn every_process_that_a_command_or_a_stop_passes_has_the_same_priority() {
    for unit in ["controller@", "standby@", "driver@", "sim-node@", "router"] {
        let file = workspace().join(format!("deploy/systemd/heliostat-{unit}.service"));
        let text = fs::read_to_string(file).expect("a unit");
        assert!(text.contains("\nNice=-5\n"), "{unit}: another priority");
    }
}

/// systemd gives a folder to the user of the unit that starts last: another unit would lose its files.
#[test]
fn each_unit_keeps_its_files_in_a_folder_of_its_own() {
    let mut folders: Vec<String> = Vec::new();
    for entry in fs::read_dir(workspace().join("deploy/systemd")).expect("a folder").flatten() {
        let text = fs::read_to_string(entry.path()).expect("a unit");
        let Some(folder) = text.lines().find_map(|line| line.strip_prefix("StateDirectory=")) else {
            assert!(!text.contains("%S/"), "{}: it has no folder", entry.path().display());
            continue;
        };
        let used = text.split_whitespace().filter_map(|word| word.strip_prefix("%S/"));
        assert!(used.clone().count() > 0 && used.clone().all(|path| path.starts_with(folder)), "{folder}");
        folders.push(folder.to_owned());
    }
    assert!(folders.len() >= 3, "{folders:?}");
    for (index, folder) in folders.iter().enumerate() {
        let shares = |other: &String| Path::new(other).starts_with(folder) || Path::new(folder).starts_with(other);
        assert!(!folders[index + 1..].iter().any(shares), "{folder} is a folder of two units");
    }
}

/// An archive of a release has `heliostat` and the two programs that it packs with it.
#[test]
fn each_unit_starts_a_program_of_the_archive_a_router_or_a_program_of_the_operator() {
    let read = |file: &str| fs::read_to_string(workspace().join(file)).expect("a file of deploy/");
    let build = read("deploy/release/build");
    let (_, packed) = build.split_once("\n    for program in ").expect("the build packs programs");
    let packed: Vec<&str> = packed.split(';').next().unwrap_or_default().split_whitespace().collect();
    for entry in fs::read_dir(workspace().join("deploy/systemd")).expect("a folder").flatten() {
        let text = fs::read_to_string(entry.path()).expect("a unit");
        let start = text.lines().find_map(|line| line.strip_prefix("ExecStart=/usr/local/bin/")).expect("a program");
        let program = start.split(' ').next().unwrap_or_default();
        let is_known = packed.contains(&program) || ["zenohd", "heliostat-tracker-%i"].contains(&program);
        assert!(is_known, "{}: the archive has {packed:?}, and no {program}", entry.path().display());
    }
}

#[test]
fn the_drop_in_of_a_driver_in_python_replaces_the_program_and_keeps_the_record_of_the_unit() {
    let guide = fs::read_to_string(workspace().join("docs/deploy.md")).expect("a guide");
    let (_, drop_in) = guide.split_once("\nExecStart=\nExecStart=").expect("the guide has the drop-in");
    let start = drop_in.lines().next().unwrap_or_default();
    let unit = fs::read_to_string(workspace().join("deploy/systemd/heliostat-driver@.service")).expect("a unit");
    for words in [" --room %i ", " --state %S/heliostat-driver/%i ", " $HELIOSTAT_DRIVER_BUS"] {
        assert!(start.contains(words) && unit.contains(words), "{words}: {start}");
    }
}

#[test]
fn the_unit_of_the_page_keeps_its_token_over_a_restart() {
    let unit = fs::read_to_string(workspace().join("deploy/systemd/heliostat-page@.service")).expect("a unit");
    assert!(unit.contains("\nStateDirectory=heliostat-page/%i\n"), "{unit}");
    assert!(unit.contains(" --ui-token-file %S/heliostat-page/%i/token "), "{unit}");
    let guide = fs::read_to_string(workspace().join("docs/deploy.md")).expect("a guide");
    assert!(guide.contains("/var/lib/heliostat-page/ROOM/token"), "the guide does not name the file");
}

#[test]
fn prometheus_collects_every_process_of_the_rooms() {
    for (rooms, configuration) in [
        ("deploy/rooms", "deploy/prometheus/prometheus.yml"),
        ("deploy/building/rooms", "deploy/building/prometheus.yml"),
    ] {
        let configured = fs::read_to_string(workspace().join(configuration)).expect("a configuration");
        let mut ports = 0;
        for entry in fs::read_dir(workspace().join(rooms)).expect("a folder").flatten() {
            if entry.path().extension().is_none_or(|extension| extension != "env") {
                continue;
            }
            let text = fs::read_to_string(entry.path()).expect("a room");
            for line in text.lines().filter(|line| line.contains("_METRICS=")) {
                let (_, port) = line.rsplit_once(':').expect("an address and a port");
                let target = format!(":{port}\"");
                assert!(configured.contains(&target), "{configuration} lacks {line} of {}", entry.path().display());
                ports += 1;
            }
        }
        assert!(ports >= 7, "{rooms}: {ports} ports");
    }
}
