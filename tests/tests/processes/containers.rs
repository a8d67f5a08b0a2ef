//! The images and units of deploy/ in a container engine: they start, answer, restart and stop.
//!
//! They run where HELIOSTAT_REQUIRE names `containers`: they take minutes, and a Debian mirror.
//! The programs are those built beside this test: the images are built from a folder that holds them,
//! as the head of the Containerfile describes. That the build compiles the programs is not tested.

use heliostat_bus::free_loopback_endpoint;
use heliostat_needs::needs;
use heliostat_tests::containers::{Engine, Host, built_programs, metric, zenohd};
use heliostat_tests::{Process, wait_until, workspace};

const SERVICES: [&str; 3] = ["router", "sim-node", "controller"];

/// Starts `heliostat` in the network of the engine.
fn heliostat(engine: &Engine, arguments: &[&str]) -> Process {
    Process::heliostat_under(&engine.wrapper(), &[], arguments)
}

/// Runs an operator's command through the router of the containers.
fn order(engine: &Engine, command: &str, router: &str) -> String {
    let words = [command, "--room", "studio", "--client", "--connect", router, "--timeout", "20"];
    let ended = heliostat(engine, &words).wait();
    assert!(ended.status.success(), "{command}: {}", ended.errors);
    ended.output + &ended.errors
}

#[needs("containers")]
#[test]
fn the_images_run_a_room_that_answers_and_stop_in_an_orderly_way() {
    let zenohd = zenohd();
    let engine = Engine::start();
    engine.import_base("debian:bookworm-slim");
    let context = built_programs(&zenohd);
    engine.build_images(context.path());
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
    wait_until("decisions on the page of the controller", || {
        let page = engine.get(&of_controller, "/metrics");
        page.is_some_and(|page| metric(&page, "heliostat_decisions_total") > 10.0)
    });

    let scenario = workspace().join("deploy/rooms/studio.toml");
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

#[needs("containers")]
#[test]
fn the_units_start_restart_after_a_kill_and_stop_in_an_orderly_way() {
    let zenohd = zenohd();
    let engine = Engine::start();
    engine.import_base("systemd");
    let context = built_programs(&zenohd);
    let host = Host::start(&engine, "host", "none", context.path());
    host.install(&workspace().join("deploy/rooms"), "/etc/heliostat/");
    host.install(&workspace().join("deploy/router"), "/etc/heliostat/");
    host.install(&workspace().join("deploy/systemd"), "/etc/systemd/system/");
    host.shell("systemctl daemon-reload");
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
