//! The images and units of deploy/ in a container engine: they start, answer, restart and stop.
//!
//! A test that cannot run here says why, and passes; HELIOSTAT_REQUIRE_CONTAINERS makes that a failure.
//! The programs are those built beside this test: the images are built from a folder that holds them,
//! as the head of the Containerfile describes. That the build compiles the programs is not tested.

use std::fs;
use std::path::{Path, PathBuf};

use heliostat_bus::free_loopback_endpoint;
use heliostat_tests::containers::{Engine, zenohd};
use heliostat_tests::{Process, programs, wait_until};

const SERVICES: [&str; 3] = ["router", "sim-node", "controller"];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A folder with the programs of the images.
fn built_programs(zenohd: &Path) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let own = ["heliostat-controller", "heliostat-sim-node"].map(|name| programs().join(name));
    for program in own.iter().map(PathBuf::as_path).chain([zenohd]) {
        let name = if program == zenohd { "zenohd".as_ref() } else { program.file_name().expect("a name") };
        let copied = fs::copy(program, folder.path().join(name));
        copied.unwrap_or_else(|error| panic!("{}: {error}; is it built?", program.display()));
    }
    folder
}

/// The value of a metric without regard to its labels; 0 where it is absent.
fn metric(page: &str, name: &str) -> f64 {
    let line = page.lines().find(|line| line.starts_with(&format!("{name}{{")));
    line.and_then(|line| line.rsplit(' ').next()?.parse().ok()).unwrap_or(0.0)
}

/// Starts `heliostat` in the network of the engine.
fn heliostat(engine: &Engine, arguments: &[&str]) -> Process {
    Process::heliostat_under(&engine.wrapper().each_ref().map(String::as_str), &[], arguments)
}

/// Runs an operator's command through the router of the containers.
fn order(engine: &Engine, command: &str, router: &str) -> String {
    let words = [command, "--room", "studio", "--client", "--connect", router, "--timeout", "20"];
    let ended = heliostat(engine, &words).wait();
    assert!(ended.status.success(), "{command}: {}", ended.errors);
    ended.output + &ended.errors
}

#[test]
fn the_images_run_a_room_that_answers_and_stop_in_an_orderly_way() {
    let Some(zenohd) = zenohd() else { return };
    let Some(engine) = Engine::start() else { return };
    let Some(()) = engine.import_base("debian:bookworm-slim") else { return };
    let context = built_programs(&zenohd);
    let file = root().join("deploy/container/Containerfile");
    for service in SERVICES {
        let tag = format!("heliostat-{service}");
        let words = ["build", "--build-arg", "RUST_IMAGE=debian:bookworm-slim", "--target", service, "--tag", &tag];
        let place = ["--file", file.to_str().expect("a plain path"), context.path().to_str().expect("a plain path")];
        engine.docker(&[&words[..], &place].concat());
    }
    let [router, of_controller, of_room] = [(); 3].map(|()| {
        let endpoint = free_loopback_endpoint().unwrap();
        endpoint.rsplit(':').next().expect("an endpoint has a port").to_owned()
    });
    let variables = [
        ("HELIOSTAT_ROUTER_PORT", router.clone()),
        ("HELIOSTAT_CONTROLLER_METRICS_PORT", of_controller.clone()),
        ("HELIOSTAT_ROOM_METRICS_PORT", of_room.clone()),
    ];
    let router = format!("tcp/127.0.0.1:{router}");
    engine.compose(&variables, &["up", "-d", "--no-build"]);
    let container =
        |service: &str| engine.docker(&["ps", "-aqf", &format!("label=com.docker.compose.service={service}")]);
    let state =
        |service: &str, of: &str| engine.docker(&["inspect", "-f", &format!("{{{{{of}}}}}"), &container(service)]);
    for service in ["sim-node", "controller"] {
        wait_until(&format!("a healthy {service}"), || state(service, ".State.Health.Status") == "healthy");
    }

    let commands =
        || engine.get(&of_room, "/metrics").map_or(0.0, |page| metric(&page, "heliostat_room_commands_total"));
    wait_until("commands that the array accepts", || commands() > 10.0);
    let page = engine.get(&of_controller, "/metrics").expect("the controller serves its metrics");
    assert!(metric(&page, "heliostat_decisions_total") > 10.0, "{page}");

    let scenario = root().join("deploy/rooms/studio.toml");
    let flags = ["ui", "--room", "studio", "--plain", "--client", "--connect", &router, "--ui-port", "0", "--scenario"];
    let ui = heliostat(&engine, &[&flags[..], &[scenario.to_str().expect("a plain path")]].concat());
    let before = "the page is at http://127.0.0.1:";
    wait_until("the address of the page", || (ui.errors() + "\n").contains(before));
    let errors = ui.errors();
    let port = errors.split_once(before).and_then(|(_, rest)| rest.split(['/', '\n', ' ']).next()).expect("a port");
    wait_until("the live page", || engine.get(port, "/").is_some_and(|page| page.contains("<title>Heliostat</title>")));

    // The volume keeps an emergency stop over a restart.
    order(&engine, "stop", &router);
    engine.compose(&variables, &["restart", "sim-node"]);
    wait_until("a healthy sim-node", || state("sim-node", ".State.Health.Status") == "healthy");
    let begun = commands();
    assert_eq!(begun, 0.0, "the array is still stopped");
    assert!(order(&engine, "rearm", &router).contains("command line"), "the re-arm names the stop that it releases");
    wait_until("commands after the re-arm", || commands() > 10.0);

    // A container that does not end within 10 s is killed, and then its exit code is 137.
    engine.compose(&variables, &["stop"]);
    for service in SERVICES {
        assert_eq!(
            state(service, ".State.ExitCode"),
            "0",
            "{service}: {}",
            engine.docker(&["logs", &container(service)])
        );
    }
    assert!(
        engine.docker(&["logs", &container("sim-node")]).contains("ratio to oracle"),
        "the room ends with its summary"
    );
    engine.compose(&variables, &["down", "--volumes"]);
}

/// A container in which systemd is the first process, with the programs and files of deploy/.
struct Host<'a> {
    engine: &'a Engine,
}

impl<'a> Host<'a> {
    fn start(engine: &'a Engine, context: &Path) -> Self {
        // As --privileged, which needs a capability that not every machine has.
        let rights =
            ["--cap-add=ALL", "--cap-drop=SYS_RESOURCE", "--security-opt=seccomp=unconfined", "--cgroupns=host"];
        let folders =
            ["--volume=/sys/fs/cgroup:/sys/fs/cgroup:rw", "--tmpfs=/run", "--tmpfs=/run/lock", "--tmpfs=/tmp"];
        let words = ["run", "--detach", "--name=host", "--network=none", "--env=container=docker"];
        engine.docker(&[&words[..], &rights, &folders, &["systemd", "/lib/systemd/systemd"]].concat());
        let host = Self { engine };
        wait_until("systemd", || host.shell("systemctl is-system-running || true") == "running");
        host.shell("mkdir -p /etc/heliostat");
        let copy =
            |from: &Path, to: &str| engine.docker(&["cp", from.to_str().expect("a plain path"), &format!("host:{to}")]);
        for (folder, to) in
            [("rooms", "/etc/heliostat/"), ("router", "/etc/heliostat/"), ("systemd", "/etc/systemd/system/")]
        {
            copy(&root().join("deploy").join(folder).join("."), to);
        }
        copy(&context.join("."), "/usr/local/bin/");
        host.shell("systemctl daemon-reload");
        host
    }

    fn shell(&self, script: &str) -> String {
        self.engine.docker(&["exec", "host", "bash", "-c", script])
    }

    fn property(&self, unit: &str, name: &str) -> String {
        self.shell(&format!("systemctl show --property={name} --value {unit}"))
    }

    /// The number of commands that the array of a room accepted.
    fn commands(&self, port: u16) -> f64 {
        let get = format!(
            "exec 3<>/dev/tcp/127.0.0.1/{port} && printf 'GET /metrics HTTP/1.0\\r\\n\\r\\n' >&3 && cat <&3 || true"
        );
        metric(&self.shell(&get), "heliostat_room_commands_total")
    }
}

#[test]
fn the_units_start_restart_after_a_kill_and_stop_in_an_orderly_way() {
    let Some(zenohd) = zenohd() else { return };
    let Some(engine) = Engine::start() else { return };
    let Some(()) = engine.import_base("systemd") else { return };
    let context = built_programs(&zenohd);
    let host = Host::start(&engine, context.path());
    let units = [
        "heliostat-router",
        "heliostat-sim-node@studio",
        "heliostat-controller@studio",
        "heliostat-sim-node@foyer",
        "heliostat-controller@foyer",
        "heliostat-standby@foyer",
    ];
    let complaints = host.shell(&format!(
        "cd /etc/systemd/system && systemd-analyze verify {} 2>&1",
        units.map(|unit| format!("{unit}.service")).join(" ")
    ));
    assert_eq!(complaints, "", "systemd-analyze verify");
    host.shell(&format!("systemctl enable --now {}", units.join(" ")));
    // The metrics of rooms/studio.env and rooms/foyer.env: one room without a router, one with it.
    let rooms = [9465, 9467];
    for port in rooms {
        wait_until("commands that the array accepts", || host.commands(port) > 10.0);
    }
    for unit in units {
        let before = host.property(unit, "MainPID");
        host.shell(&format!("kill -KILL {before}"));
        wait_until(&format!("a restart of {unit}"), || {
            let after = host.property(unit, "MainPID");
            after != before && after != "0" && host.property(unit, "ActiveState") == "active"
        });
    }
    for port in rooms {
        let before = host.commands(port);
        wait_until("commands after the restarts", || host.commands(port) > before + 10.0);
    }
    for unit in units.iter().rev() {
        host.shell(&format!("systemctl stop {unit}"));
        // `timeout` where systemd had to kill the process.
        assert_eq!(host.property(unit, "Result"), "success", "{unit}");
    }
    let journal = host.shell("journalctl --no-pager --unit=heliostat-sim-node@studio");
    assert!(journal.contains("ratio to oracle"), "the room ends with its summary: {journal}");
}
