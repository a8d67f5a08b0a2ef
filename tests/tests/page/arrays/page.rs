//! The live page of a room with two arrays, in a browser.

use heliostat_bus::{BusConfig, private_endpoint};
use heliostat_needs::needs;
use heliostat_proto::Room;
use heliostat_service::Stop;
use heliostat_tests::faults::Tracker;
use heliostat_tests::{Browser, PageServer, Process, Turn, wait_until};
use serde_json::{Value, json};

use super::room::{RequestAtEnd, drive, scenario_file};
use super::simulated;

/// The server of a page about a room.
fn page(room: &str, endpoints: &[&str]) -> PageServer {
    let connected: Vec<&str> = endpoints.iter().flat_map(|endpoint| ["--connect", *endpoint]).collect();
    PageServer::start(&[&["--room", room], &connected[..]].concat())
}

/// Whether the state of the arrays is green, and its text.
fn arrays(browser: &Browser) -> (bool, String) {
    let is_good = browser.run("return document.getElementById('chip-array').classList.contains('good')") == true;
    (is_good, browser.text("#chip-array"))
}

/// A part of the newest frame or of the plan.
fn shown(browser: &Browser, what: &str) -> Value {
    browser.run(&format!("const room = document.getElementById('room').room; return {what}"))
}

#[needs("browser")]
#[test]
fn both_arrays_are_drawn_and_obey_the_buttons_of_the_page() {
    let _turn = Turn::wait();
    let folder = tempfile::tempdir().expect("a folder");
    let (_sim, _controller, [of_sim, of_controller]) = simulated("drawn", folder.path());
    let server = page("drawn", &[&of_sim, &of_controller]);
    let browser = Browser::open(&server.url());
    wait_until("two arrays that follow", || arrays(&browser) == (true, "following".into()));
    wait_until("a drawn room", || shown(&browser, "room.frames > 3") == true);
    assert_eq!(shown(&browser, "room.view.content.plan.arrays"), json!([6, 8]));
    assert_eq!(shown(&browser, "room.view.content.panels.length"), json!(2), "a panel for each array");
    assert_eq!(shown(&browser, "room.view.content.mirrors.count"), json!(14));
    // The first corner of the first mirror of each array: at the walls y = 2.5 m and x = -2.5 m.
    wait_until("mirrors at both walls", || {
        let corner = |mirror: usize, axis: usize| {
            shown(&browser, &format!("room.motion.to.mirrors_m[{mirror}][{axis}]")).as_f64().unwrap_or(f64::NAN)
        };
        (corner(0, 1) - 2.5).abs() < 0.2 && (corner(6, 0) + 2.5).abs() < 0.2
    });
    assert_eq!(shown(&browser, "room.motion.to.serves.length"), json!(14));
    wait_until("mirrors of both arrays that serve users", || {
        let served = "[[0, 6], [6, 14]].every(([start, end]) => room.motion.to.serves.slice(start, end).some((user) => user >= 0))";
        shown(&browser, served) == true
    });
    browser.click("#stop");
    wait_until("a stop of both", || arrays(&browser) == (false, "stopped".into()));
    browser.click("#rearm");
    wait_until("two arrays that follow again", || arrays(&browser) == (true, "following".into()));
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[needs("browser")]
#[test]
fn the_page_names_the_array_whose_driver_has_left() {
    let _turn = Turn::wait();
    let folder = tempfile::tempdir().expect("a folder");
    let file = scenario_file(folder.path());
    let endpoints: Vec<String> = (0..4).map(|_| private_endpoint().expect("an endpoint")).collect();
    let [first, second, of_controller, of_tracker] = &endpoints[..] else { unreachable!("four endpoints") };
    let config = || BusConfig::new(Room::new("shown").expect("a valid name"));
    let [both, later] = [Stop::default(), Stop::default()];
    std::thread::scope(|scope| {
        let _end = RequestAtEnd(vec![both.clone(), later.clone()]);
        let drive_second = |stop: &Stop| {
            let (config, folder, stop) = (config().listen_at(second), folder.path().to_owned(), stop.clone());
            scope.spawn(move || drive(1, config, folder, &stop))
        };
        let (config_of_first, of_first, stop) = (config().listen_at(first), folder.path().to_owned(), both.clone());
        scope.spawn(move || drive(0, config_of_first, of_first, &stop));
        let second_driver = drive_second(&later);
        let flags = ["controller", "--scenario", &file, "--room", "shown", "--listen", of_controller];
        let policy = ["--connect", first, "--connect", second, "--policy", "fixed-point", "--exit-with-parent"];
        let _controller = Process::heliostat(&[&flags[..], &policy].concat());
        // Peers forward no reports, so that the page is connected to the tracker too.
        let tracked = config().listen_at(of_tracker).connect_to(of_controller).connect_to(first);
        let _tracker = Tracker::start(&tracked);
        let server = page("shown", &[first, second, of_controller, of_tracker]);
        let browser = Browser::open_flat(&server.url());
        wait_until("two arrays that follow", || arrays(&browser) == (true, "following".into()));
        let unusable = || shown(&browser, "room.motion.to?.unusable");
        wait_until("a frame in which every mirror is usable", || unusable() == json!([]));
        let kept = "return fetch('/room.json').then((answer) => answer.json()).then(({ history }) => history.length)";
        wait_until("sum rates that the server keeps for a page that is loaded again", || {
            browser.run(kept).as_u64().is_some_and(|count| count > 1)
        });

        later.request();
        second_driver.join().expect("no panic").expect("a driver that ends");
        wait_until("a state that is not green", || {
            arrays(&browser) == (false, "following, no report of mirrors-1, 8 unusable".into())
        });
        wait_until("mirrors of unknown angles", || unusable() == json!([6, 7, 8, 9, 10, 11, 12, 13]));
        assert_eq!(shown(&browser, "room.motion.to.serves.slice(6)"), json!([-1, -1, -1, -1, -1, -1, -1, -1]));
        wait_until("a note about the driver", || {
            browser.text("#problem").matches("No driver receives the commands to mirrors-1").count() == 1
        });

        let _driver = drive_second(&both);
        wait_until("two arrays that follow again", || arrays(&browser) == (true, "following".into()));
        wait_until("usable mirrors", || unusable() == json!([]));
        wait_until("no note about the driver", || !browser.text("#problem").contains("No driver"));
        browser.click("#stop");
        wait_until("two arrays that have confirmed the stop", || {
            browser.text("#banner").starts_with("The arrays have confirmed the stop: their devices have executed it.")
        });
    });
}
