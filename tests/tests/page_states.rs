//! The live page in a browser while processes die, stop, restart and refuse, and what its pictures do.
//!
//! Room, controller and server of the page are processes of their own, so that each can be killed
//! alone. Effects are read from the page, because the page is what must not deceive.

use std::net::TcpListener;
use std::time::{Duration, Instant};

use heliostat_bus::free_loopback_endpoint;
use heliostat_tests::{Browser, Process, wait_until};
use serde_json::Value;

/// Room, controller and page.
struct Setting {
    room: Process,
    controller: Process,
    server: Process,
    endpoints: [String; 2],
    port: String,
}

impl Setting {
    fn new() -> Self {
        Self::with(&[])
    }

    /// The same with settings of the room's scenario, which the other processes share.
    fn with(set: &[&str]) -> Self {
        let endpoints = [(); 2].map(|()| free_loopback_endpoint().expect("a free port"));
        let [at_room, at_controller] = endpoints.each_ref().map(String::as_str);
        let room = Process::heliostat(&[&["sim-node", "--listen", at_room], set].concat());
        let join = ["controller", "--policy", "greedy", "--connect", at_room, "--listen", at_controller];
        let controller = Process::heliostat(&[&join, set].concat());
        let free = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
        let port = free.local_addr().expect("bound").port().to_string();
        drop(free);
        let server = serve(&endpoints, &port, set);
        Self { room, controller, server, endpoints, port }
    }

    fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    /// A browser that shows the running room.
    fn browser(&self, flags: &[&str]) -> Option<Browser> {
        let browser = Browser::open_with(&self.url(), flags)?;
        wait_until("a page that shows the room", || is_live(&browser));
        wait_until("a drawn room", || drawn(&browser) > 3);
        Some(browser)
    }
}

fn serve(endpoints: &[String; 2], port: &str, set: &[&str]) -> Process {
    let [room, controller] = endpoints.each_ref().map(String::as_str);
    let server = Process::heliostat(
        &[&["ui", "--plain", "--connect", room, "--connect", controller, "--ui-port", port], set].concat(),
    );
    wait_until("the address of the page", || {
        server.errors().contains(&format!("the page is at http://127.0.0.1:{port}"))
    });
    server
}

fn is_live(browser: &Browser) -> bool {
    browser.text("#chip-array") == "following" && browser.text("#chip-controller") == "alive"
}

/// Number of pictures since the page was loaded.
fn drawn(browser: &Browser) -> u64 {
    browser.run("return document.getElementById('room').room?.frames ?? 0").as_u64().expect("a number")
}

/// Texts of all state chips that are green.
fn green(browser: &Browser) -> Vec<Value> {
    let script = "return [...document.querySelectorAll('#chips .good')].map((chip) => chip.textContent)";
    browser.run(script).as_array().expect("a list").clone()
}

fn is_stale(browser: &Browser, part: &str) -> bool {
    browser.run(&format!("return document.getElementById('{part}').classList.contains('stale')")) == true
}

fn banner(browser: &Browser) -> String {
    let script = "const banner = document.getElementById('banner'); return banner.hidden ? '' : banner.textContent";
    browser.run(script).as_str().unwrap_or_default().to_owned()
}

/// Sends an order as a button does, also one for which there is no button.
fn order(browser: &Browser, order: &str) {
    let script = format!(
        "return fetch('/order', {{ method: 'POST', headers: {{ 'content-type': 'application/json' }}, \
         body: JSON.stringify({order}) }}).then((answer) => answer.status)"
    );
    browser.run(&script);
}

#[test]
fn the_camera_keeps_its_place_for_10_s_while_pictures_are_drawn() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    let eye = || browser.run("return document.getElementById('room').room.view.eye");
    let before = eye();
    browser.press("#room", "\u{E012}\u{E013}+");
    wait_until("a turned view", || eye() != before);
    let turned = eye();
    browser.run(
        "window.events = 0; const room = document.getElementById('room').room; const update = room.update; \
                 room.update = function (frame) { window.events += 1; update.call(this, frame); }",
    );
    let (begun, first) = (Instant::now(), drawn(&browser));
    while begun.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(eye(), turned, "the camera moved {} ms after the key", begun.elapsed().as_millis());
    }
    let pictures = drawn(&browser) - first;
    let frames = browser.run("return window.events").as_u64().expect("a number");
    println!("{pictures} pictures of {frames} frames");
    assert!(frames > 10 && pictures > 5, "{pictures} pictures of {frames} frames");
    // The user can return to a named view.
    browser.click("[data-eye=corner]");
    wait_until("another view", || eye() != turned);
}

#[test]
fn a_process_that_dies_leaves_no_green_state_and_no_current_figure() {
    let mut setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    wait_until("green states", || green(&browser).len() == 2);
    assert!(!is_stale(&browser, "room-card") && !is_stale(&browser, "times") && banner(&browser).is_empty());
    let sentence = browser.text("#sentence");
    assert!(sentence.contains("Mbit/s") && sentence.contains("minimum rate"), "{sentence}");

    setting.controller.kill();
    wait_until("no green controller", || !green(&browser).iter().any(|chip| chip == "alive"));
    wait_until("stale decision times", || is_stale(&browser, "times"));
    wait_until("no mirrors that follow", || green(&browser).is_empty());
    assert!(!is_stale(&browser, "room-card"), "the room still reports");

    setting.room.kill();
    wait_until("a stale room", || is_stale(&browser, "room-card") && is_stale(&browser, "rates"));
    let sentence = browser.text("#sentence");
    assert!(sentence.contains("has not reported for") && sentence.contains("unknown"), "{sentence}");
    assert!(browser.text("#chip-array").starts_with("no report for"), "{}", browser.text("#chip-array"));

    setting.server.kill();
    wait_until("a banner", || banner(&browser).contains("No connection to the server"));
    assert_eq!(green(&browser), Vec::<Value>::new());
    for part in ["room-card", "rates", "sums", "times", "counters"] {
        assert!(is_stale(&browser, part), "{part} looks current without a server");
    }
}

#[test]
fn the_death_of_the_server_alone_makes_everything_stale() {
    let mut setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    setting.server.kill();
    wait_until("a banner", || banner(&browser).contains("No connection to the server"));
    wait_until("no green state", || green(&browser).is_empty());
    assert!(browser.text("#sentence").contains("unknown"), "{}", browser.text("#sentence"));
}

#[test]
fn another_server_on_the_same_port_reloads_the_page() {
    let mut setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    browser.run("window.loaded_before = true");
    setting.server.kill();
    wait_until("a banner", || banner(&browser).contains("No connection"));
    assert_eq!(browser.run("return window.loaded_before"), true);
    setting.server = serve(&setting.endpoints, &setting.port, &[]);
    wait_until("a page of the new server", || {
        browser.run("return window.loaded_before === undefined") == true && is_live(&browser)
    });
    assert_eq!(banner(&browser), "");
}

#[test]
fn the_banner_says_whether_the_array_confirmed_a_stop() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    browser.click("#stop");
    wait_until("a confirmation", || banner(&browser).contains("has confirmed the stop"));
    assert_eq!(browser.text("#chip-array"), "stopped");
    let named = || banner(&browser).contains("heliostat ui (button)");
    wait_until("the operator", named);
    browser.click("#rearm");
    wait_until("a release", || banner(&browser).contains("is released"));
    wait_until("an array that follows", || is_live(&browser));
    wait_until("no banner after the release", || banner(&browser).is_empty());
    // The controller commanded during the stop, and the array refused it. That is over.
    wait_until("no message about the stop", || {
        browser.text("#problem").is_empty() && browser.text("#order-status").is_empty()
    });

    // A re-arm without a stop has no effect, and the page does not claim one.
    browser.click("#rearm");
    wait_until("a refusal", || browser.text("#order-status").contains("re-arm: refused: no emergency stop is latched"));
    assert_eq!(banner(&browser), "");

    // An array that cannot answer has not confirmed.
    setting.room.signal("STOP");
    browser.run("document.getElementById('stop').click()");
    wait_until("a request", || banner(&browser).starts_with("Stop requested"));
    wait_until("a warning", || banner(&browser).contains("has not confirmed the stop for"));
    setting.room.signal("CONT");
    wait_until("a late confirmation", || banner(&browser).contains("has confirmed the stop"));
}

#[test]
fn a_stop_without_an_array_is_answered_at_once_and_a_rearm_keeps_the_warning() {
    let mut setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    setting.room.kill();
    wait_until("an array that has left", || browser.text("#chip-array").starts_with("no report for"));
    let status = || browser.text("#order-status");
    browser.run("window.shown = []; new MutationObserver(() => window.shown.push(document.getElementById('order-status').textContent))\
                 .observe(document.getElementById('order-status'), { childList: true, characterData: true, subtree: true })");
    browser.click("#stop");
    let absent = "no array is present in this room";
    wait_until("an answer about the array", || status() == format!("stop: {absent}"));
    let shown = browser.run("return window.shown").to_string();
    assert!(!shown.contains("not answered yet"), "{shown}");
    let warning = "has not confirmed the stop for";
    wait_until("a warning", || banner(&browser).contains(warning));
    browser.click("#rearm");
    wait_until("an answer about the re-arm", || status().contains("re-arm: "));
    // The re-arm waits up to 2.5 s for a safety report and for a receiver. A page that loads again has
    // no banner for a moment.
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(4) {
        let shown = banner(&browser);
        assert!(shown.is_empty() || shown.contains(warning), "{shown}");
        std::thread::sleep(Duration::from_millis(100));
    }
    wait_until("the same warning", || banner(&browser).contains(warning));
    assert_eq!(status(), format!("re-arm: {absent}"));
}

#[test]
fn users_who_are_present_have_different_colours_and_keep_them() {
    let setting = Setting::with(&["--set", "users.count=17"]);
    let Some(browser) = setting.browser(&[]) else { return };
    let swatches = "return [...document.querySelectorAll('#users .swatch')].map((swatch) => swatch.style.background)";
    let colours = || -> Vec<String> { serde_json::from_value(browser.run(swatches)).expect("a list of texts") };
    wait_until("all users", || colours().len() == 17);
    let distinct: std::collections::BTreeSet<String> = colours().into_iter().collect();
    assert_eq!(distinct.len(), 17, "{distinct:?}");
    // Any 64 ids; those who stay keep their colours while the others are replaced.
    let found = browser.run(
        "return import('/geometry.js').then(({ presentUsers, userColour, USER_COLOURS }) => { \
           const ids = Array.from({ length: 64 }, (_, index) => 4294967295 - 8 * index); \
           presentUsers(ids); \
           const before = ids.map(userColour); \
           const stay = ids.filter((_, index) => index % 2); \
           const come = Array.from({ length: 32 }, (_, index) => 1000 + 8 * index); \
           presentUsers([...come, ...stay]); \
           const now = [...come, ...stay].map(userColour); \
           const kept = stay.every((id, index) => userColour(id) === before[2 * index + 1]); \
           return [new Set(before).size, new Set(now).size, kept, USER_COLOURS.every((one) => /^#[0-9a-f]{6}$/.test(one))]; })",
    );
    assert_eq!(found, serde_json::json!([64, 64, true, true]));
}

#[test]
fn a_refused_order_is_shown_as_refused_until_another_takes_effect() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    let status = || browser.text("#order-status");
    order(&browser, r#"{ order: "policy", name: "clairvoyant" }"#);
    wait_until("a refusal with its reason", || {
        let shown = status();
        assert!(!shown.contains("done"), "{shown}");
        shown.starts_with("policy clairvoyant: refused") && shown.contains("there is no policy")
    });
    browser.run("document.getElementById('policy').value = 'fixed-point'");
    browser.click("#switch-policy");
    wait_until("an order that took effect", || status() == "policy fixed-point: done");
    wait_until("no message", || status().is_empty() && browser.text("#problem").is_empty());

    // More users than the room has: the simulator refuses.
    order(&browser, r#"{ order: "blocked", users: 64 }"#);
    wait_until("a refusal of the room", || status().contains("block the direct path of 64 users: refused"));
    browser.click("#power [data-value='4']");
    browser.click("#blocked [data-value='1']");
    wait_until("the answer to the later order", || status() == "block the direct path of 1 user: done");
}

#[test]
fn the_switches_show_what_the_one_channel_model_computes() {
    // Users who stand: figures and frames of different instants then agree.
    let setting = Setting::with(&["--set", "blockage.forced_users=2"]);
    let Some(browser) = setting.browser(&[]) else { return };
    browser.click("#speed [data-value='0']");
    let without = "const { to } = document.getElementById('room').room.motion; \
                   return to.users.reduce((sum, user) => sum + user.without_mirrors_mbps, 0)";
    let no_irs = || browser.text("#sum-figures div:nth-child(2) dd span").parse::<f64>().unwrap_or(f64::NAN);
    wait_until("rates without the mirrors that sum to the room's own reference", || {
        let sum = browser.run(without).as_f64().unwrap_or(f64::NAN);
        (sum - no_irs()).abs() <= 0.1 + 0.01 * no_irs()
    });
    browser.run("document.getElementById('show-wall').click()");
    wait_until("a sentence about the room without mirrors", || {
        browser.text("#sentence").starts_with("Without the mirrors")
    });
    assert!(browser.text("#rates-title").contains("without the mirrors"));
    let missed = "return [...document.querySelectorAll('#users .number.bad')].length > 0";
    wait_until("users who lose their link", || browser.run(missed) == true);
    browser.run("document.getElementById('show-wall').click()");
    wait_until("the mirrors again", || browser.text("#sentence").starts_with("Mirrors "));

    let largest = "return fetch('/floor.json?mirrors=' + arguments_).then((answer) => answer.json())";
    let map = |mirrors: &str| browser.run(&largest.replace("arguments_", mirrors));
    let (with, bare) = (map("1"), map("0"));
    let rates = |map: &Value| -> Vec<f64> {
        map["rate_mbps"].as_array().expect("a list").iter().map(|rate| rate.as_f64().expect("a rate")).collect()
    };
    assert_eq!(rates(&with).len() as u64, with["columns"].as_u64().unwrap() * with["rows"].as_u64().unwrap());
    let better = rates(&with).iter().zip(rates(&bare)).filter(|(with, bare)| **with > *bare + 0.01).count();
    assert!(better > 0, "the mirrors light no point of the floor");
    browser.run("document.getElementById('show-heat').click(); document.getElementById('show-paths').click()");
    wait_until("a heat map", || browser.run("return document.getElementById('heat-scale').hidden") == false);
    wait_until("paths", || browser.run("return document.getElementById('room').room.motion.paths.size") == 5);
}

#[test]
fn an_outage_lasts_from_a_rate_below_the_minimum_to_the_next_one_above_it() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    let script = "return import('/outages.js').then(({ Outages }) => { \
           const outages = new Outages(); \
           const at = (time_s, rate_mbps) => \
             outages.take({ time_s, users: [{ user: 3, is_rate_known: true, rate_mbps, min_rate_mbps: 1 }] }); \
           for (let time_s = 0; time_s <= 10; time_s += 1) at(time_s, time_s >= 2 && time_s < 5 ? 0.5 : 2); \
           const { share, longest_s } = outages.of(3); \
           for (let time_s = 11; time_s <= 70; time_s += 1) at(time_s, 2); \
           return [share, longest_s, outages.of(3).share, outages.of(9)]; })";
    let found = browser.run(script);
    assert_eq!(found, serde_json::json!([0.3, 3, 0, null]));
}

#[test]
fn the_sentence_says_what_is_unknown() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    let sentence = |now: &str, age: f64| {
        let script = format!(
            "return import('/sentence.js').then(({{ sentence }}) => {{ \
               const user = (user, rate_mbps, is_rate_known = true) => ({{ user, rate_mbps, is_rate_known, min_rate_mbps: 1 }}); \
               return sentence({now}, {age}, {{ wall: true }}, null); }})"
        );
        browser.run(&script).as_str().expect("a text").to_owned()
    };
    let now = |users: &str, sum: &str| {
        format!("{{ origin: 'simulated', ages_s: {{ room: 0 }}, users: [{users}], sum_mbps: {sum} }}")
    };
    let sum = "{ policy: 92, no_irs: 30 }";
    assert_eq!(
        sentence(&now("user(3, 0), user(7, 5)", sum), 0.1),
        "Mirrors add 62 Mbit/s. 1 of 2 users is below the minimum rate."
    );
    assert_eq!(
        sentence(&now("user(3, 2), user(7, 5)", sum), 0.1),
        "Mirrors add 62 Mbit/s. All 2 users have their minimum rate."
    );
    assert_eq!(sentence(&now("", sum), 0.1), "No user is in the room.");
    assert_eq!(
        sentence(&now("user(3, 2)", "{ policy: 92, no_irs: null }"), 0.1),
        "The sum rate is 92 Mbit/s; the rate without mirrors is unknown. The user has the minimum rate."
    );
    assert_eq!(
        sentence(&now("user(3, 0, false), user(7, 5)", "null"), 0.1),
        "The rates are unknown. The rate of 1 of 2 users is unknown."
    );
    assert_eq!(
        sentence(&now("user(3, 2)", sum), 1.4),
        "The room has not reported for 1.4 s: users and rates are unknown."
    );
    assert!(sentence("null", 0.0).starts_with("Waiting"));
}

#[test]
fn a_browser_without_webgl_shows_a_plan() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&["--disable-gpu", "--disable-3d-apis"]) else { return };
    assert_eq!(browser.run("return document.documentElement.dataset.view"), "2d");
    let first = drawn(&browser);
    wait_until("more pictures", || drawn(&browser) > first + 5);
    let colours = "const canvas = document.querySelector('#room canvas'); \
                   const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
                   return new Set(new Uint32Array(data.buffer)).size";
    assert!(browser.run(colours).as_u64().is_some_and(|colours| colours > 10), "the plan is empty");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[test]
fn the_page_fits_a_phone_and_a_desktop_in_light_and_dark_without_errors() {
    let setting = Setting::new();
    let Some(browser) = setting.browser(&[]) else { return };
    for (width, height) in [(390, 844), (1280, 800), (1920, 1080)] {
        browser.resize(width, height);
        for theme in ["light", "dark"] {
            wait_until("the theme", || {
                let now = browser.text("#theme");
                if now != format!("theme: {theme}") {
                    browser.click("#theme");
                }
                now == format!("theme: {theme}")
            });
            let overflow = "return document.documentElement.scrollWidth - document.documentElement.clientWidth";
            wait_until("a page without a horizontal scroll bar", || browser.run(overflow) == 0);
            let cut = "return [...document.querySelectorAll('section, button, .switch, #sentence')]\
                       .filter((part) => part.getBoundingClientRect().right > innerWidth + 1).length";
            assert_eq!(browser.run(cut), 0, "{width} x {height}, {theme}: parts lie outside the page");
            let first = drawn(&browser);
            wait_until("pictures of this size", || drawn(&browser) > first + 2);
            assert!(browser.screenshot().len() > 10_000);
        }
    }
    // The whole desktop page is visible at once.
    browser.resize(1280, 800);
    wait_until("a page without a scroll bar", || {
        browser.run("return document.documentElement.scrollHeight <= 800") == true
    });
    // Each term is explained to a user of the keyboard too.
    let terms = "return [...document.querySelectorAll('dfn')].filter((term) => term.tabIndex === 0 && term.title.length > 20)\
                 .map((term) => term.textContent)";
    let terms = browser.run(terms).to_string();
    for term in ["no IRS", "oracle", "minimum"] {
        assert!(terms.contains(term), "{terms}");
    }
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
