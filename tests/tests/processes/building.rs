//! The rooms of a building with two hosts, set up by the commands and files of docs/deploy.md: the units in
//! two containers with systemd, and the compose file.
//!
//! The tests of containers.rs state what they need. docs/faults.md measures the faults.

use std::fs;
use std::path::Path;
use std::process::Command;

use heliostat_needs::needs;
use heliostat_tests::containers::{Engine, Host, built_programs, metric, zenohd};
use heliostat_tests::{programs, wait_until, workspace};

/// The commands of the section "Two hosts" that follow this comment, up to the next comment or block.
fn commands(place: &str) -> String {
    let text = fs::read_to_string(workspace().join("docs/deploy.md")).expect("there is a guide");
    let section = text.split_once("\n## Two hosts\n").expect("a section").1;
    let section = section.split("\n## ").next().unwrap_or_default();
    let after = section.split_once(&format!("\n# {place}\n")).unwrap_or_else(|| panic!("no commands {place}")).1;
    let lines = after.lines().take_while(|line| !line.starts_with("```") && !line.starts_with("# "));
    lines.map(|line| format!("{line}\n")).collect()
}

/// A folder in which the commands of the guide have made `building-keys`.
fn make_keys() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::os::unix::fs::symlink(workspace().join("deploy"), folder.path().join("deploy")).expect("a fresh folder");
    run_make_keys(folder.path());
    folder
}

/// Runs the commands of the guide for the machine of the keys.
fn run_make_keys(folder: &Path) {
    let script = commands("on the machine of the keys").replace("host-a.example.org", "host-a");
    let script = script.replace("host-b.example.org", "host-b");
    assert!(script.contains("make-keys"), "{script}");
    let path = format!("{}:{}", programs().display(), std::env::var("PATH").unwrap_or_default());
    let output = Command::new("bash").args(["-ec", &script]).env("PATH", path).current_dir(folder).output();
    let output = output.expect("bash runs");
    assert!(output.status.success(), "{script}: {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_command_that_makes_the_keys_of_a_building_renews_them() {
    let folder = make_keys();
    let read = |file: &str| fs::read_to_string(folder.path().join("building-keys").join(file)).expect("a file");
    let renewed = [
        "host-a/router/foyer-router.pem",
        "host-b/studio/controller.pem",
        "host-b/studio/router.pem",
        "host-b/foyer/driver.key",
        "operator/studio/operator.pem",
    ];
    let (before, authority) = (renewed.map(read), read("authorities/studio/ca.pem"));
    run_make_keys(folder.path());
    for (file, before) in renewed.iter().zip(&before) {
        assert_ne!(read(file), *before, "{file}");
    }
    assert_eq!(read("authorities/studio/ca.pem"), authority);
    // What leaves the machine of the keys has no private key of an authority.
    for copied in ["host-a", "host-b", "operator"] {
        for room in ["studio", "foyer"] {
            let files = fs::read_dir(folder.path().join("building-keys").join(copied).join(room)).expect("a folder");
            let mut names: Vec<String> =
                files.flatten().map(|file| file.file_name().to_string_lossy().into_owned()).collect();
            names.sort();
            assert!(!names.iter().any(|name| name == "ca.key"), "{copied}, {room}: {names:?}");
            if copied == "operator" {
                assert_eq!(names, ["ca.pem", "operator.key", "operator.pem"], "{room}");
            }
        }
    }
}

/// Waits until a controller is in standby, or in command.
fn wait_for_role(host: &Host, port: u16, is_standby: bool) {
    wait_until(&format!("a controller whose standby is {is_standby}"), || {
        let page = host.metrics(port);
        let decided = metric(&page, "heliostat_decisions_total") > 10.0;
        decided && (metric(&page, "heliostat_standby") == 1.0) == is_standby
    });
}

#[needs("containers")]
#[test]
fn the_units_of_two_hosts_run_two_rooms_and_a_standby_replaces_a_stopped_controller() {
    let zenohd = zenohd();
    let engine = Engine::start();
    engine.import_base("systemd");
    let (context, keys) = (built_programs(&zenohd), make_keys());
    engine.docker(&["network", "create", "cable"]);
    let hosts = ["host-a", "host-b"].map(|name| {
        let host = Host::start(&engine, name, "cable", context.path());
        host.install(&workspace().join("deploy"), "/root/deploy");
        host.install(&keys.path().join("building-keys").join(name), &format!("/root/{name}"));
        host
    });
    // Root's own commands need no sudo, which the base image lacks.
    let run = |host: &Host, script: &str| host.shell(&format!("set -e; cd /root; sudo() {{ \"$@\"; }}; {script}"));
    // The guide names this step for containers, whose file system may have no access control lists.
    hosts.iter().for_each(|host| drop(run(host, "mount --make-rshared /")));
    let probe = "systemd-run --quiet --wait --collect -p DynamicUser=yes -p LoadCredential=probe:/etc/hostname \
                 sh -c 'cat $CREDENTIALS_DIRECTORY/probe' && echo readable || true";
    let is_readable = hosts[0].shell(probe).contains("readable");
    assert!(is_readable, "systemd in a container of this machine passes no credentials to a dynamic user");
    let copy = commands("on host A, with its folder in the home directory; likewise on host B");
    for (host, [name, folder]) in hosts.iter().zip([["A", "host-a"], ["B", "host-b"]]) {
        let copy = copy.replace("host-a", folder);
        run(host, &(copy + &commands("on both hosts") + &commands(&format!("on host {name}"))));
    }
    let [a, b] = &hosts;
    // The metrics of building/rooms: the array of each room, its controller and its standby.
    let rooms = [(a, b, [9465, 9464, 9469]), (b, a, [9467, 9466, 9468])];
    for (array, _, [of_array, of_controller, _]) in rooms {
        wait_until("commands that the array accepts", || array.commands(of_array) > 10.0);
        wait_for_role(array, of_controller, false);
    }
    for (host, name) in hosts.iter().zip(["A", "B"]) {
        run(host, &commands(&format!("on host {name}, when both controllers lead")));
    }
    for (_, standby, [_, _, of_standby]) in rooms {
        wait_for_role(standby, of_standby, true);
    }
    a.shell("systemctl stop heliostat-controller@studio");
    wait_for_role(b, 9469, false);
    let before = a.commands(9465);
    wait_until("commands of the standby", || a.commands(9465) > before + 10.0);

    // Each router is killed, and its host finds the other one again.
    for host in &hosts {
        let before = host.property("heliostat-router", "MainPID");
        host.shell(&format!("kill -KILL {before}"));
        wait_until("a restart of the router", || {
            let after = host.property("heliostat-router", "MainPID");
            after != before && after != "0"
        });
        let before = a.commands(9465);
        wait_until("commands across the hosts", || a.commands(9465) > before + 10.0);
    }
    for host in &hosts {
        host.shell("systemctl stop 'heliostat-*'");
    }
}

#[needs("containers")]
#[test]
fn the_compose_file_runs_two_rooms_on_two_networks_and_a_cut_cable_parks_no_room_with_a_local_leader() {
    let zenohd = zenohd();
    let engine = Engine::start();
    engine.import_base("debian:bookworm-slim");
    let (context, folder) = (built_programs(&zenohd), make_keys());
    engine.build_images(context.path());
    let keys = folder.path().join("building-keys");
    let of_hosts = ["host-a", "host-b"].map(|host| keys.join(host));
    let owned = Command::new("chown").args(["-R", "65532"]).args(of_hosts).status();
    assert!(owned.is_ok_and(|status| status.success()), "the keys cannot be given to the user of the images");
    let variables = [("HELIOSTAT_KEYS", keys.display().to_string())];
    let compose =
        |arguments: &[&str]| engine.compose_file("building", "deploy/building/compose.yaml", &variables, arguments);
    compose(&["up", "-d", "--no-build"]);
    let container =
        |service: &str| engine.docker(&["ps", "-aqf", &format!("label=com.docker.compose.service={service}")]);
    let page = |service: &str, port: u16| {
        let get = format!(
            "exec 3<>/dev/tcp/127.0.0.1/{port} && printf 'GET /metrics HTTP/1.0\\r\\n\\r\\n' >&3 && cat <&3 || true"
        );
        engine.docker(&["exec", &container(service), "bash", "-c", &get])
    };
    let commands = |room: &str| metric(&page(&format!("{room}-room"), 9465), "heliostat_room_commands_total");
    let stands_by = |room: &str| {
        let page = page(&format!("{room}-standby"), 9464);
        metric(&page, "heliostat_decisions_total") > 10.0 && metric(&page, "heliostat_standby") == 1.0
    };
    for room in ["studio", "foyer"] {
        wait_until("commands that the array accepts", || commands(room) > 10.0);
        wait_until("a standby on the other host", || stands_by(room));
    }
    let router = container("router-b");
    engine.docker(&["network", "disconnect", "building_cable", &router]);
    for room in ["studio", "foyer"] {
        let before = commands(room);
        wait_until("commands without the cable", || commands(room) > before + 100.0);
    }
    engine.docker(&["network", "connect", "--alias", "host-b", "building_cable", &router]);
    compose(&["kill", "studio-controller"]);
    wait_until("a standby that takes over across the cable", || {
        metric(&page("studio-standby", 9464), "heliostat_standby") == 0.0
    });
    let before = commands("studio");
    wait_until("commands of the standby", || commands("studio") > before + 10.0);
    compose(&["down", "--volumes"]);
}
