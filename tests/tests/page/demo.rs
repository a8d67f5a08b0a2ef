//! The live page: what it serves and refuses, and in a browser, that each button acts on the
//! running system.
//!
//! Effects are read from the topics, not from the page. The ignored test replaces the
//! pictures in docs/images, and writes the frames of the moving one to target/page-frames.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;

use heliostat_needs::needs;
use heliostat_proto::{ArrayState, NodeKind};
use heliostat_tests::{Browser, Process, RoomObserver, Turn, choose_theme, wait_until, workspace};

/// A demo with a page, and an observer of its topics.
struct Setting {
    demo: Process,
    observer: RoomObserver,
    /// Host and port of the page.
    host: String,
    // Taken before the processes start, and dropped last.
    _turn: Turn,
}

impl Setting {
    fn new(arguments: &[&str]) -> Self {
        Self::start(&[&["--scenario", "specular"], arguments].concat())
    }

    fn start(arguments: &[&str]) -> Self {
        let turn = Turn::wait();
        let always = ["demo", "--plain", "--ui-port", "0"];
        let all: Vec<&str> = always.iter().chain(arguments).copied().collect();
        let demo = Process::heliostat(&all);
        wait_until("the address of the page", || demo.errors().contains("the page is at http://"));
        let output = demo.errors();
        let endpoint = |number: usize| {
            let found = output.match_indices("tcp/").nth(number).map(|(at, _)| &output[at..]);
            found.and_then(|rest| rest.split([',', ';', ' ']).next()).expect("two endpoints are printed").to_owned()
        };
        let observer = RoomObserver::connect("demo", &[&endpoint(0), &endpoint(1)]);
        Self { host: word_after(&output, "the page is at http://"), demo, observer, _turn: turn }
    }

    fn url(&self) -> String {
        format!("http://{}/", self.host)
    }

    /// Status line, headers and body of the response to a request.
    fn request(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).expect("the page is served");
        let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
        let length = body.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\n{headers}Connection: close\r\nContent-Length: {length}\r\n\r\n{body}"
        )
        .expect("the page reads");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("text");
        answer
    }
}

fn word_after(output: &str, before: &str) -> String {
    let rest = output.split_once(before).unwrap_or_else(|| panic!("no {before:?} in {output}")).1;
    rest.split([' ', ',', ';', '/', '\n']).next().unwrap_or_default().to_owned()
}

#[test]
fn requests_of_other_origins_are_refused() {
    let setting = Setting::new(&["--policy", "flat"]);
    let host = ("Host", setting.host.as_str());
    let page = setting.request("GET", "/", &[host], "");
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("<title>Heliostat</title>"), "{page}");
    assert!(page.contains("Content-Security-Policy: default-src 'none'; script-src 'self'"), "{page}");
    assert!(setting.request("GET", "/vendor/uPlot.iife.min.js", &[host], "").contains("uPlot (v"));
    assert!(setting.request("GET", "/room.json", &[host], "").contains("\"fixed-point\""));
    assert!(setting.request("GET", "/", &[("Host", "example.org")], "").starts_with("HTTP/1.1 403"));

    let json = ("Content-Type", "application/json");
    let same_origin = format!("http://{}", setting.host);
    let order = r#"{"order":"stop"}"#;
    for origin in [None, Some("http://example.org"), Some("null"), Some("http://127.0.0.1")] {
        let headers: Vec<_> = [host, json].into_iter().chain(origin.map(|origin| ("Origin", origin))).collect();
        assert!(setting.request("POST", "/order", &headers, order).starts_with("HTTP/1.1 403"), "{origin:?}");
    }
    let answer_to = |body: &str| setting.request("POST", "/order", &[host, json, ("Origin", &same_origin)], body);
    assert!(answer_to(r#"{"order":"power","watts":-1}"#).contains("more than 0 and at most 100 W"));
    assert!(answer_to(r#"{"order":"explode"}"#).starts_with("HTTP/1.1 422"));
    let form = ("Content-Type", "text/plain");
    let answer = setting.request("POST", "/order", &[host, form, ("Origin", &same_origin)], order);
    assert!(answer.starts_with("HTTP/1.1 415"), "{answer}");
    assert!(setting.observer.telemetry().is_none_or(|array| array.state != ArrayState::Stopped));

    let controller = || setting.observer.status(NodeKind::Controller).unwrap_or_default();
    // Before the page and the controller are connected, an order has no receiver, and the page
    // reports it.
    wait_until("a receiver of the order", || {
        let answer = answer_to(r#"{"order":"policy","name":"clairvoyant"}"#);
        let is_received = answer.starts_with("HTTP/1.1 202");
        assert!(
            is_received || (answer.starts_with("HTTP/1.1 503") && answer.contains("no controller received the order")),
            "{answer}"
        );
        is_received
    });
    wait_until("a refusal with the name", || controller().last_problem.contains("there is no policy \"clairvoyant\""));
    assert!(controller().last_problem.starts_with("order "), "{}", controller().last_problem);
    assert_eq!(controller().policy, "flat");
    assert!(setting.observer.counter(NodeKind::Controller, "policies_refused") >= 1);
}

#[test]
fn a_page_behind_a_proxy_says_whether_orders_are_accepted() {
    let public = "https://mirrors.example.org";
    let setting = Setting::new(&["--policy", "flat", "--ui-origin", &format!("{public}/lab/room1/")]);
    let proxy = "through a proxy at https://mirrors.example.org/lab/room1/";
    wait_until("the address behind the proxy", || setting.demo.errors().contains(proxy));
    let json = ("Content-Type", "application/json");
    for host in [setting.host.as_str(), "mirrors.example.org"] {
        let check = |origin: &str| setting.request("POST", "/check", &[("Host", host), ("Origin", origin)], "");
        assert!(setting.request("GET", "/", &[("Host", host)], "").starts_with("HTTP/1.1 200"), "{host}");
        assert!(check(public).starts_with("HTTP/1.1 204"), "{host}: {}", check(public));
        let refused = check("https://other.example.org");
        assert!(
            refused.starts_with("HTTP/1.1 403") && refused.contains("--ui-origin https://other.example.org"),
            "{refused}"
        );
        let headers = [("Host", host), json, ("Origin", public)];
        assert!(setting.request("POST", "/order", &headers, "{}").starts_with("HTTP/1.1 422"), "{host}");
    }
}

#[test]
fn a_port_that_was_asked_for_and_is_in_use_is_an_error_that_names_it() {
    let in_use = std::net::TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    let port = in_use.local_addr().expect("bound").port().to_string();
    let demo = Process::heliostat(&["demo", "--plain", "--policy", "flat", "--ui-port", &port]);
    let ended = demo.wait();
    let refusal = ended.refusal();
    assert!(refusal.contains(&format!("the page cannot be served at 127.0.0.1:{port}: ")), "{refusal}");
    assert!(refusal.contains("another --ui-port"), "{refusal}");
    let none = Process::heliostat(&["demo", "--plain", "--policy", "flat", "--no-ui"]);
    wait_until("a demo without a page", || none.errors().contains("sum rate"));
    assert!(!none.errors().contains("the page is at"), "{}", none.errors());
}

/// The number of pixels of a canvas that have one of the colours.
const DRAWN: &str = "(selector, colours) => {
    const canvas = document.querySelector(selector);
    if (!canvas || !canvas.width || !canvas.height) return 0;
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    const has = (at) => colours.some((colour) => colour.every((value, index) => data[at + index] === value));
    return Array.from({ length: data.length / 4 }, (_, pixel) => 4 * pixel).filter(has).length;
}";

#[needs("browser")]
#[test]
fn every_button_acts_on_the_running_system() {
    let setting = Setting::new(&["--policy", "greedy", "--set", "blockage.forced_users=2"]);
    let browser = Browser::open(&setting.url());
    let observer = &setting.observer;
    let policy = || observer.status(NodeKind::Controller).map(|status| status.policy).unwrap_or_default();
    let array = || observer.telemetry().expect("received before");
    wait_until("a page that shows the room", || browser.text("#chip-array") == "following");
    wait_until("a drawn room", || browser.run("return document.getElementById('room').room.frames > 3") == true);
    assert_eq!(browser.run("return document.documentElement.dataset.view"), "3d", "the browser has no WebGL");
    // The colours of the policy greedy, and of decisions within and over the limit.
    for (chart, colours) in [("sum-chart", "[[17, 119, 51]]"), ("latency-chart", "[[86, 180, 233], [213, 94, 0]]")] {
        let drawn = format!("return ({DRAWN})('#{chart} canvas', {colours})");
        wait_until("a drawn chart", || browser.run(&drawn).as_u64().is_some_and(|pixels| pixels > 20));
    }
    let foreign =
        "return performance.getEntriesByType('resource').filter(one => !one.name.startsWith(location.origin)).length";
    assert_eq!(browser.run(foreign), 0, "the page loads from another server");

    browser.run("document.getElementById('policy').value = 'fixed-point'");
    browser.click("#switch-policy");
    wait_until("another policy", || policy() == "fixed-point");
    wait_until("its name on the page", || browser.text("#chip-policy") == "fixed-point");

    browser.click("#blocked [data-value='4']");
    let forced = || observer.truth().map_or(0, |truth| truth.users.iter().filter(|user| user.forced).count());
    wait_until("four users whose direct path is blocked", || forced() == 4);
    browser.click("#blocked [data-value='0']");
    wait_until("no user whose direct path is blocked by order", || forced() == 0);

    browser.click("#power [data-value='4']");
    wait_until("a higher optical power", || gauge(observer, "power_w") == Some(4.0));
    browser.click("#speed [data-value='0']");
    let standing =
        || observer.users().is_some_and(|report| report.users.iter().all(|user| user.velocity_m_s == [0.0; 2]));
    wait_until("users who stand", standing);
    browser.click("#speed [data-value='2']");
    wait_until("users who walk", || !standing());

    browser.click("#stick");
    wait_until("stuck mirrors", || gauge(observer, "faulty_mirrors") == Some(25.0));
    wait_until("their number on the page", || browser.text("#label-mirrors") == "Mirrors (25 jammed)");
    // The state and the picture have one source: what the driver has found.
    let drawn = "const { unusable } = document.getElementById('room').room.motion.to; \
                 return document.getElementById('chip-array').textContent.includes(`, ${unusable.length} unusable`)";
    wait_until("the same number of unusable mirrors in the state and in the picture", || browser.run(drawn) == true);
    browser.click("#release");
    wait_until("mirrors that follow", || gauge(observer, "faulty_mirrors") == Some(0.0));
    wait_until("a state without them", || browser.text("#chip-array") == "following");

    browser.click("#kill");
    wait_until("a parked array", || array().state == ArrayState::Parked);
    wait_until("a page without a controller", || browser.text("#chip-controller") == "gone");
    let epoch = array().epoch;
    browser.click("#restart");
    wait_until("a new controller", || array().state == ArrayState::Following && array().epoch > epoch);
    wait_until("the policy of the one before", || policy() == "fixed-point");
    wait_until("the new controller on the page", || browser.text("#chip-controller") == "alive");
    let events = || browser.run("return document.getElementById('event-list').textContent").to_string();
    wait_until("the event of its start", || events().contains("controller: gone"));
    assert!(!events().contains("not seen"), "{}", events());

    // By keyboard, for users without a mouse.
    browser.press("#stop", "\u{E007}");
    wait_until("a stopped array", || array().state == ArrayState::Stopped);
    wait_until("the state on the page", || browser.text("#chip-array").starts_with("stopped"));
    wait_until("a policy that is idle", || browser.text("#chip-policy") == "fixed-point (idle)");
    browser.click("#rearm");
    wait_until("an array that follows again", || array().state == ArrayState::Following);
    // The answers are those of the processes, and no message outlives its cause.
    wait_until("no message", || browser.text("#order-status").is_empty() && browser.text("#problem").is_empty());
    drop(setting.demo);
}

#[needs("browser")]
#[test]
fn a_controller_that_hangs_is_replaced_by_the_button_restart() {
    let setting = Setting::new(&["--policy", "greedy"]);
    let browser = Browser::open_flat(&setting.url());
    let source = || setting.observer.status(NodeKind::Controller).map(|status| status.stamp.source);
    wait_until("a page that shows the controller", || browser.text("#chip-controller") == "alive");
    wait_until("its status", || source().is_some());
    let hung = source();
    let process = word_after(&setting.demo.errors(), "controller is process ");
    assert!(Command::new("kill").args(["-STOP", &process]).status().expect("there is a kill command").success());
    wait_until("a controller without a report", || browser.text("#chip-controller").starts_with("no report for"));
    browser.record("#order-status");
    browser.click("#restart");
    wait_until("the answer", || browser.recorded().contains(&"restart the controller: done".to_owned()));
    wait_until("another controller", || source() != hung);
    wait_until("the new controller on the page", || browser.text("#chip-controller") == "alive");
    let events = || browser.run("return document.getElementById('event-list').textContent").to_string();
    wait_until("the event", || events().contains("order: restart the controller: done"));
}

#[needs("browser")]
#[test]
fn a_demo_whose_simulator_is_paused_says_what_to_do_in_a_demo() {
    let setting = Setting::new(&["--policy", "greedy"]);
    let browser = Browser::open_flat(&setting.url());
    wait_until("a page that shows the room", || browser.text("#chip-array") == "following");
    let process = word_after(&setting.demo.errors(), "sim-node is process ");
    let signal = |name: &str| {
        assert!(Command::new("kill").args([name, &process]).status().expect("there is a kill command").success());
    };
    signal("-STOP");
    let problem = || browser.text("#problem");
    let paused = "The simulator reports no positions of users: its process has ended, is paused or hangs; start it by the \
                  command in the terminal, continue it, or end the demo and start it again.";
    wait_until("what to do", || problem() == paused);
    // Its connection expires: the controller is alone.
    let driverless = || setting.observer.counter(NodeKind::Controller, "driver_absent") > 0;
    wait_until("a controller without a driver", driverless);
    let chip = || browser.text("#chip-controller");
    wait_until("a page that knows it", || chip() == "alive" && problem() == paused);
    signal("-CONT");
    wait_until("a room that reports", || problem().is_empty() && browser.text("#chip-array") == "following");
}

fn gauge(observer: &RoomObserver, name: &str) -> Option<f64> {
    observer.status(NodeKind::SimNode)?.gauge(name)
}

#[test]
#[ignore = "replaces the pictures in docs/images"]
fn pictures_of_the_default_demo() {
    let setting = Setting::start(&["--scenario", "hall"]);
    let folder = workspace().join("docs/images");
    std::fs::create_dir_all(&folder).expect("a folder for screenshots");
    // The server keeps the history of the charts. A browser without a graphics card takes the processors from the controller.
    std::thread::sleep(std::time::Duration::from_secs(90));
    let browser = Browser::open(&setting.url());
    wait_until("a page that shows the room", || browser.text("#chip-array") == "following");
    choose_theme(&browser, "light");
    for (name, width, height) in [("page-light", 1280, 800), ("page-narrow", 390, 844)] {
        browser.resize(width, height);
        // Without the ring of the focus.
        browser.run("document.activeElement.blur()");
        std::thread::sleep(std::time::Duration::from_secs(3));
        std::fs::write(folder.join(name).with_extension("png"), browser.screenshot()).expect("written");
    }
    // The frames of the moving picture, 8 s of the room.
    let frames = workspace().join("target/page-frames");
    std::fs::create_dir_all(&frames).expect("a folder for frames");
    browser.resize(1100, 720);
    for frame in 0..16 {
        std::fs::write(frames.join(format!("{frame:02}.png")), browser.screenshot()).expect("written");
        std::thread::sleep(std::time::Duration::from_millis(500));
    }
}
