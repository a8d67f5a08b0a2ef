//! Processes that die: nothing on the page may look current afterwards.

use heliostat_needs::needs;
use heliostat_tests::{Browser, wait_until};
use serde_json::Value;

use super::setting::{Setting, banner, drawn, is_live};

/// Texts of all state chips that are green.
fn green(browser: &Browser) -> Vec<Value> {
    let script = "return [...document.querySelectorAll('#chips .good')].map((chip) => chip.textContent)";
    browser.run(script).as_array().expect("a list").clone()
}

fn is_stale(browser: &Browser, part: &str) -> bool {
    browser.run(&format!("return document.getElementById('{part}').classList.contains('stale')")) == true
}

/// Whether the row with this name, of the counters or of the times, is marked as old.
fn is_row_stale(browser: &Browser, name: &str) -> bool {
    let rows = "[...document.querySelectorAll('#counts > div, #quantiles tbody > tr')]";
    let script =
        format!("return {rows}.find((row) => row.textContent.startsWith('{name}')).classList.contains('stale')");
    browser.run(&script) == true
}

/// Whether the row with this name has its age beside its figures.
fn has_age(browser: &Browser, name: &str) -> bool {
    let rows = "[...document.querySelectorAll('#counts > div, #quantiles tbody > tr')]";
    let script = format!(
        "const row = {rows}.find((row) => row.textContent.startsWith('{name}')); \
         return (row.dataset.age ?? '').endsWith(' old') && !['none', 'normal'].includes(getComputedStyle(row, '::after').content)"
    );
    browser.run(&script) == true
}

#[needs("browser")]
#[test]
fn a_process_that_dies_leaves_no_green_state_and_no_current_figure() {
    let (mut setting, browser) = Setting::shown();
    wait_until("green states", || green(&browser).len() == 2);
    wait_until("a page without a stale part", || {
        let sentence = browser.text("#sentence");
        let is_told = sentence.contains("Mbit/s") && sentence.contains("minimum rate");
        is_told && !is_stale(&browser, "room-card") && !is_stale(&browser, "times") && banner(&browser).is_empty()
    });

    setting.controller.kill();
    wait_until("no green controller", || !green(&browser).iter().any(|chip| chip == "alive"));
    wait_until("stale decision times", || is_stale(&browser, "times"));
    wait_until("no mirrors that follow", || green(&browser).is_empty());
    wait_until("a room that still reports", || !is_stale(&browser, "room-card"));
    wait_until("old counters of the controller", || is_row_stale(&browser, "decisions"));
    wait_until("current counters of the room", || !is_row_stale(&browser, "ticks lost"));
    wait_until("the age of the old ones alone", || {
        has_age(&browser, "decisions") && has_age(&browser, "age") && !has_age(&browser, "ticks lost")
    });

    setting.room.kill();
    wait_until("a stale room", || is_stale(&browser, "room-card") && is_stale(&browser, "rates"));
    wait_until("a sentence about the silence", || {
        let sentence = browser.text("#sentence");
        sentence.contains("has not reported for") && sentence.contains("unknown")
    });
    wait_until("an array without a report", || browser.text("#chip-array").starts_with("no report for"));
    let faults = "return [...document.querySelectorAll('#counts > div')]\
         .find((row) => row.textContent.startsWith('faults')).lastChild.textContent";
    wait_until("unknown faults of the array", || browser.run(faults) == "–");

    setting.server.kill();
    wait_until("a banner", || banner(&browser).contains("No connection to the server"));
    wait_until("no green state", || green(&browser).is_empty());
    for part in ["room-card", "rates", "sums", "times", "operate"] {
        wait_until(&format!("{part} that looks stale without a server"), || is_stale(&browser, part));
    }
    for row in ["decisions", "ticks lost", "array refused", "unreadable", "loop"] {
        wait_until(&format!("{row} that looks stale without a server"), || is_row_stale(&browser, row));
    }
}

#[needs("browser")]
#[test]
fn the_first_problem_stays_beside_stop_on_a_phone() {
    let (mut setting, browser) = Setting::shown();
    browser.resize(390, 844);
    let is_hidden = "return document.getElementById('worst').hidden";
    wait_until("no problem", || browser.run(is_hidden) == true);
    setting.room.kill();
    // At the end of the page: whether the text is that of the list, is low and in the window, leaves STOP in view, and
    // covers no content.
    let shown = "scrollTo(0, document.documentElement.scrollHeight); \
         const at = (id) => document.getElementById(id); \
         const [line, stop, bar, end] = ['worst', 'stop', 'emergency', 'event-log'].map((id) => at(id).getBoundingClientRect()); \
         const isOnTop = document.elementFromPoint(stop.x + stop.width / 2, stop.y + stop.height / 2)?.id === 'stop'; \
         return [at('worst').textContent === at('problem').firstElementChild?.textContent, \
           line.height > 0 && line.height < 30 && line.top >= 0 && line.bottom <= innerHeight, isOnTop, end.bottom <= bar.top]";
    wait_until("the first problem beside STOP", || browser.run(shown) == serde_json::json!([true, true, true, true]));
    // What a demo says after `kill` is complete, with what to do. In one step, before the next figures.
    let complete = "const line = document.getElementById('worst'); \
         line.textContent = 'No controller commands the mirrors: press restart on the page.'; \
         return [line.scrollWidth <= line.clientWidth, line.scrollHeight <= line.clientHeight]";
    assert_eq!(browser.run(complete), serde_json::json!([true, true]));
    // A tap on a disabled button shows no tooltip.
    let note =
        "const note = document.getElementById('not-taken'); return note.checkVisibility() ? note.textContent : ''";
    let reasons = "Disabled: optical power, direct paths, walking speed, mirrors (the room does not report); \
         kill, restart (only `heliostat demo` can kill or restart the processes that it started).";
    wait_until("the reasons of disabled buttons", || browser.run(note) == reasons);
    // A banner of several lines stays at the top of the window.
    browser.click("#stop");
    wait_until("a banner", || banner(&browser).contains("not confirmed the stop"));
    browser.run("scrollTo(0, document.documentElement.scrollHeight); document.getElementById('worst').click()");
    let is_in_view = "const list = document.getElementById('problem'); \
         const { top, bottom, height } = list.getBoundingClientRect(); \
         const { x, y } = list.firstElementChild.getBoundingClientRect(); \
         const isOnTop = list.contains(document.elementFromPoint(x + 2, y + 2)); \
         return height > 0 && top >= 0 && bottom <= innerHeight && isOnTop";
    wait_until("the complete list after a tap", || browser.run(is_in_view) == true);
    browser.resize(1280, 800);
    let is_shown = "return document.getElementById('worst').checkVisibility()";
    assert_eq!(browser.run(is_shown), false, "a larger window has the list in view");
}

#[needs("browser")]
#[test]
fn a_time_has_one_form_and_a_silence_one_word() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/sentence.js').then(({ duration, noReport }) => \
           [[0.44, 12.6, 119.4, 120, 7199, 7200].map(duration), [Infinity, 12.6].map(noReport)])";
    let expected =
        serde_json::json!([["0.4 s", "13 s", "119 s", "2 min", "119 min", "2 h"], ["no report", "no report for 13 s"]]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn an_answer_to_an_order_does_not_outlive_its_server() {
    let (mut setting, browser) = Setting::shown();
    browser.record("#order-status");
    browser.click("#power [data-value='4']");
    wait_until("an answer", || browser.recorded().iter().any(|text| text.ends_with(": done")));
    setting.server.kill();
    wait_until("no answer", || browser.text("#order-status").is_empty());
}

#[needs("browser")]
#[test]
fn a_lost_connection_does_not_hide_that_a_stop_was_open() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/sentence.js').then(({ banner, endBanner }) => { \
           const of = (phase) => ({ stop: { phase, stops: [], problems: [], free: [], lost: [] }, array: { arrays: 1 } }); \
           const names = (shown) => shown.text.includes('Its last stop was not confirmed: run `heliostat stop`'); \
           return ['requested', 'unconfirmed', 'confirmed', 'none'] \
             .map((phase) => [names(banner(of(phase), 3, 0, 0)), names(endBanner('It has ended.', of(phase)))]); })";
    let expected = serde_json::json!([[true, true], [true, true], [false, false], [false, false]]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn a_server_that_ends_in_order_says_so_on_its_open_pages() {
    let (mut setting, browser) = Setting::shown();
    setting.server.end();
    let expected = "The server of this page has ended by Ctrl-C or a signal. The room goes on without it.";
    wait_until("a banner with the reason", || banner(&browser).starts_with(expected));
    wait_until("no green state", || green(&browser).is_empty());
    assert!(banner(&browser).starts_with(expected), "a lost connection is no news");
    assert_eq!(browser.text("#sentence"), "The figures are the last ones before the end.");
    assert!(browser.text("#problem").is_empty(), "no problem is a present one");
    setting.restart_server();
    wait_until("a page of the new server", || is_live(&browser) && banner(&browser).is_empty());
}

#[needs("browser")]
#[test]
fn a_controller_that_hangs_is_named_by_the_banner_while_it_is_in_the_room() {
    let (setting, browser) = Setting::shown();
    setting.controller.signal("STOP");
    // The chip and the banner in one script: both say so at the same time.
    let shown = "const chip = document.getElementById('chip-controller').textContent; \
        const banner = document.getElementById('banner'); \
        return [chip, banner.hidden ? '' : banner.textContent]";
    wait_until("a controller without a report", || {
        let shown = browser.run(shown);
        let [chip, banner] = [0, 1].map(|index| shown[index].as_str().unwrap_or_default());
        chip.starts_with("no report for") && banner.starts_with("The controller has not reported for ")
    });
    setting.controller.signal("CONT");
    wait_until("no banner", || banner(&browser).is_empty());
}

#[needs("browser")]
#[test]
fn the_last_picture_stays_when_the_process_of_the_room_ends() {
    let (mut setting, browser) = Setting::shown();
    browser.run("window.loaded_before = true");
    let users = "return document.getElementById('room').room.motion.to?.users.length ?? 0";
    let shown = browser.run(users);
    assert_ne!(shown, 0);
    setting.room.kill();
    wait_until("a stale room", || is_stale(&browser, "room-card") && is_stale(&browser, "rates"));
    wait_until("old figures of the room", || is_row_stale(&browser, "loop") && is_row_stale(&browser, "ticks lost"));
    assert!(!is_row_stale(&browser, "decision") && !is_stale(&browser, "times"), "those of the controller are current");
    // Its messages are no longer current for the server, and the page keeps its last picture.
    wait_until("a server without the room", || {
        browser.run("return fetch('/room.json').then((answer) => answer.json())")["geometry_source"] == "controller"
    });
    wait_until("figures without the room", || {
        browser.run("return fetch('/events.json').then((answer) => answer.json())")["figures"]["origin"] == "no-data"
    });
    let kept = "const [rate] = document.querySelectorAll('#sum-figures dd span'); \
         return [document.getElementById('users').rows.length, Number(rate.textContent) > 0]";
    wait_until("the chip of a silent room", || browser.text("#chip-room").starts_with("no report for"));
    assert_eq!(browser.run(kept), serde_json::json!([shown, true]), "the last users and rates stay, in grey");
    assert_eq!(browser.text("#sum-figures div:first-child dt"), "greedy", "what the mirrors followed at these rates");
    let drawn = drawn(&browser);
    browser.run("document.getElementById('room').room.isDirty = true");
    wait_until("another picture", || super::setting::drawn(&browser) > drawn);
    assert_eq!((browser.run("return window.loaded_before"), browser.run(users)), (Value::Bool(true), shown));
}

#[needs("browser")]
#[test]
fn the_death_of_the_server_alone_makes_everything_stale() {
    let (mut setting, browser) = Setting::shown();
    setting.server.kill();
    wait_until("a banner", || banner(&browser).contains("No connection to the server"));
    wait_until("no green state", || green(&browser).is_empty());
    wait_until("a sentence that says so", || browser.text("#sentence").contains("unknown"));
}

#[needs("browser")]
#[test]
fn another_server_on_the_same_port_reloads_the_page() {
    let (mut setting, browser) = Setting::shown();
    browser.run("window.loaded_before = true");
    setting.server.kill();
    wait_until("a banner", || banner(&browser).contains("No connection"));
    assert_eq!(browser.run("return window.loaded_before"), true);
    setting.restart_server();
    wait_until("a page of the new server", || {
        browser.run("return window.loaded_before === undefined") == true && is_live(&browser)
    });
    wait_until("no banner", || banner(&browser).is_empty());
}
