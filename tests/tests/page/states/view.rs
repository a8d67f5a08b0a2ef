//! What the page draws and says about the room, in several browsers, sizes and themes.

use std::collections::BTreeSet;

use heliostat_needs::needs;
use heliostat_tests::{Browser, choose_theme, wait_until};
use serde_json::Value;

use super::setting::{GREEDY_LINE, Setting, drawn};

#[needs("browser")]
#[test]
fn the_camera_keeps_its_place_while_pictures_are_drawn() {
    let setting = Setting::new();
    let browser = setting.browser_3d();
    let eye = || browser.run("return document.getElementById('room').room.view.eye");
    let before = eye();
    browser.press("#room", "\u{E012}\u{E013}+");
    wait_until("a turned view", || eye() != before);
    let turned = eye();
    browser.run(
        "window.events = 0; const room = document.getElementById('room').room; const update = room.update; \
                 room.update = function (frame) { window.events += 1; update.call(this, frame); }",
    );
    let first = drawn(&browser);
    wait_until("five pictures of ten frames", || {
        let (pictures, frames) = (drawn(&browser) - first, browser.run("return window.events").as_u64());
        assert_eq!(eye(), turned, "the camera moved after {pictures} pictures of {frames:?} frames");
        pictures >= 5 && frames.expect("a number") >= 10
    });
    // The user can return to a named view.
    browser.click("[data-eye=corner]");
    wait_until("another view", || eye() != turned);
}

#[needs("browser")]
#[test]
fn a_blocked_path_has_the_colour_of_the_legend_in_both_themes() {
    let setting = Setting::new();
    let browser = setting.browser_3d();
    browser.click("#blocked [data-value='1']");
    // The colours of the first blocked path and of the legend, both as the browser writes them.
    let colours = "const { content } = document.getElementById('room').room.view; \
        if (!content.dashed.count) return null; \
        const mark = document.querySelector('#legend .blocked'); \
        const drawn = new content.dashed.colour.constructor().fromArray(content.dashed.colours).getHexString(); \
        return [drawn, getComputedStyle(mark).borderTopColor.match(/\\d+/g).map((part) => Number(part).toString(16).padStart(2, '0')).join('')]";
    for theme in ["light", "dark"] {
        choose_theme(&browser, theme);
        wait_until(&format!("one colour in the theme {theme}"), || {
            let pair = browser.run(colours);
            pair[0].is_string() && pair[0] == pair[1]
        });
    }
}

#[needs("browser")]
#[test]
fn another_theme_is_drawn_at_once_also_where_pictures_are_rare() {
    let (_setting, browser) = Setting::shown();
    // In one step, without a further picture of the room. The colours of the floor in the theme and in the other one.
    let script = "return import('/geometry.js').then(({ palette }) => { \
           const { room } = document.getElementById('room'); \
           const canvas = document.querySelector('#room canvas'); \
           const isDrawn = (colour) => { \
             const [red, green, blue] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16)); \
             const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
             let count = 0; \
             for (let at = 0; at < data.length; at += 4) count += data[at] === red && data[at + 1] === green && data[at + 2] === blue; \
             return count > 1000; }; \
           room.nextDraw = Infinity; \
           const found = ['first', 'second', 'third'].map(() => { \
             document.getElementById('theme').click(); \
             const isDark = document.documentElement.dataset.theme === 'dark'; \
             return [isDrawn(palette(isDark).floor), isDrawn(palette(!isDark).floor)]; }); \
           room.nextDraw = 0; \
           return found; })";
    assert_eq!(browser.run(script), serde_json::json!([[true, false], [true, false], [true, false]]));
}

#[needs("browser")]
#[test]
fn users_who_are_present_have_different_colours_and_keep_them() {
    let setting = Setting::with(&["--set", "users.count=17"]);
    let browser = setting.browser();
    let swatches = "return [...document.querySelectorAll('#users .swatch')].map((swatch) => swatch.style.background)";
    let colours = || -> Vec<String> { serde_json::from_value(browser.run(swatches)).expect("a list of texts") };
    wait_until("all users", || colours().len() == 17);
    let distinct: BTreeSet<String> = colours().into_iter().collect();
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

#[needs("browser")]
#[test]
fn the_switches_show_what_the_one_channel_model_computes() {
    // Users who stand: figures and frames of different instants then agree.
    let setting = Setting::with(&["--set", "blockage.forced_users=2"]);
    let browser = setting.browser();
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

#[needs("browser")]
#[test]
fn without_the_mirrors_table_sentence_and_picture_are_of_one_report() {
    let (_setting, browser) = Setting::shown();
    // Figures, a share of the oracle's rate, and a frame of different instants: a rate is of the instant of its share.
    let script = "return Promise.all([import('/figures.js'), import('/sentence.js')]).then(([{ sums, users }, { sentence }]) => { \
           const now = { origin: 'simulated', ages_s: { room: 0 }, nodes: [], sum_mbps: { policy: 5, no_irs: 2 }, \
             users: [{ user: 3, blocked: false, forced: false, is_rate_known: true, rate_mbps: 5, oracle_mbps: 6, share_of_oracle: 0.75, compared_mbps: 4.5, min_rate_mbps: 4.8 }] }; \
           const frame = { users: [{ user: 3, blocked: true, forced: false, without_mirrors_mbps: 0, min_rate_mbps: 1 }] }; \
           const shown = (wall) => { \
             users(now, { wall }, frame, { of: () => null }); \
             return [...document.getElementById('users').rows].map(({ cells }) => [1, 2, 3].map((cell) => cells[cell].textContent)); }; \
           const noIrs = (wall) => sums(now, { wall }, frame).no_irs; \
           const said = (wall) => sentence(now, 0.1, { wall }, frame); \
           return [shown(false), said(false), shown(true), said(true), noIrs(false), noIrs(true)]; })";
    let expected = serde_json::json!([
        [["blocked", "0.00", "below 1.0"]],
        "Without the mirrors, 1 of 1 users is below the minimum rate: user 3.",
        [["clear", "4.50 75 %", "below 4.8"]],
        "Mirrors add 3.0 Mbit/s. The user is below the minimum rate.",
        0,
        2
    ]);
    assert_eq!(browser.run(script), expected);

    browser.run("document.getElementById('show-wall').click()");
    // Texts of the users in the picture, of those in the table, and the time of their frame.
    let script = "const { to, arrived } = document.getElementById('room').room.motion; \
           const path = ({ blocked, forced }) => blocked === null ? 'unknown' : forced ? 'by order' : blocked ? 'blocked' : 'clear'; \
           const below = (user) => user.without_mirrors_mbps < user.min_rate_mbps; \
           const drawn = to.users.map((user) => [String(user.user), path(user), below(user)]); \
           const listed = [...document.getElementById('users').rows].map(({ cells }) => \
             [cells[0].textContent, cells[1].textContent, cells[2].classList.contains('bad')]); \
           return [drawn, listed, arrived]";
    let mut frames = BTreeSet::new();
    wait_until("twenty frames of users who walk", || {
        let found = browser.run(script);
        assert_eq!(found[0], found[1]);
        frames.insert(found[2].to_string());
        frames.len() >= 20
    });
}

#[needs("browser")]
#[test]
fn the_names_of_users_who_stand_behind_each_other_do_not_cover_each_other() {
    let (_setting, browser) = Setting::shown();
    let script = "return Promise.all([import('/vendor/three.module.min.js'), import('/labels.js')]).then(([THREE, { Label, separateSprites }]) => { \
           const camera = new THREE.PerspectiveCamera(22, 1.5, 0.05, 400); \
           camera.up.set(0, 0, 1); camera.position.set(-9, 0, 1); camera.lookAt(0, 0, 1); \
           const labels = [[0, 0, 1], [1, 0.02, 1], [2, -0.02, 1], [0, 1.2, 1], [0, 0, 2]].map((place, index) => { \
             const label = new Label('#0072b2'); label.place(place, index === 1 ? '1 ✕' : String(index)); return label; }); \
           separateSprites(labels, camera); \
           return labels.map(({ sprite, width }) => [Math.round(100 * (0.5 - sprite.center.x)), Math.round(100 * width)]); })";
    let found = browser.run(script);
    let shifts: Vec<(i64, i64)> = serde_json::from_value(found).expect("a shift and a width in hundredths of a sprite");
    let by_place = [shifts[1], shifts[0], shifts[2]];
    for pair in by_place.windows(2) {
        assert!(pair[1].0 - pair[0].0 >= (pair[0].1 + pair[1].1) / 2 - 8, "neighbours from left to right: {shifts:?}");
    }
    assert_eq!([shifts[3].0, shifts[4].0], [0, 0], "names that are free stay: {shifts:?}");
}

#[needs("browser")]
#[test]
fn the_name_of_a_user_behind_the_camera_is_not_drawn_and_shifts_no_other_name() {
    let (_setting, browser) = Setting::shown();
    let script = "return Promise.all([import('/vendor/three.module.min.js'), import('/labels.js')]).then(([THREE, { Label, separateSprites }]) => { \
           const camera = new THREE.PerspectiveCamera(22, 1.5, 0.05, 400); \
           camera.up.set(0, 0, 1); camera.position.set(-9, 0, 1); camera.lookAt(0, 0, 1); \
           const labels = [[0, 0, 1], [-18, 0, 0.52]].map((place, index) => { \
             const label = new Label('#0072b2'); label.place(place, String(index)); return label; }); \
           const state = () => { separateSprites(labels, camera); return labels.map(({ sprite }) => [sprite.visible, sprite.center.x]); }; \
           const behind = state(); \
           camera.position.set(-30, 0, 1); \
           return [behind, state().map(([isVisible]) => isVisible)]; })";
    let expected = serde_json::json!([[[true, 0.5], [false, 0.5]], [true, true]]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn the_fairness_index_is_that_of_the_rates_in_the_table() {
    let setting = Setting::with(&["--set", "blockage.forced_users=2"]);
    let browser = setting.browser();
    let script = "return import('/fairness.js').then(({ jain }) => \
           [jain([5, 5, 5, 5]), jain([8, 0, 0, 0]), jain([1, 2, 3]), jain([0, 0]), jain([]), jain([2, null])])";
    assert_eq!(browser.run(script), serde_json::json!([1, 0.25, 36.0 / 42.0, null, null, null]));
    // Users who stand have rates that stay.
    browser.click("#speed [data-value='0']");
    let shown = "const rates = [...document.querySelectorAll('#users tr')].map((row) => Number(row.cells[2].firstChild.textContent)); \
                 const sum = rates.reduce((total, rate) => total + rate, 0); \
                 const squares = rates.reduce((total, rate) => total + rate * rate, 0); \
                 return [Number(document.getElementById('jain').textContent), sum * sum / (rates.length * squares)]";
    wait_until("an index that agrees with the rates", || {
        let [shown, expected] = serde_json::from_value(browser.run(shown)).unwrap_or([f64::NAN; 2]);
        (shown - expected).abs() <= 0.01
    });
}

#[needs("browser")]
#[test]
fn the_sentence_says_what_is_unknown() {
    let (_setting, browser) = Setting::shown();
    let sentence = |now: &str, age: f64| {
        let script = format!(
            "return import('/sentence.js').then(({{ sentence }}) => {{ \
               const user = (user, rate_mbps, is_rate_known = true) => ({{ user, rate_mbps, is_rate_known, min_rate_mbps: 1 }}); \
               return sentence({now}, {age}, {{ wall: true }}, null); }})"
        );
        browser.run(&script).as_str().expect("a text").to_owned()
    };
    let now = |users: &str, sum: &str| {
        format!(
            "{{ origin: 'simulated', ages_s: {{ room: 0 }}, nodes: [], users: [{users}], sum_mbps: {sum}, sum_name: 'sum rate' }}"
        )
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
        sentence(&now("user(3, 0, false), user(7, 5, false)", "null"), 0.1),
        "The rates are unknown. No receiver reports the gains of its user."
    );
    assert_eq!(
        sentence(&now("user(3, 2)", sum), 1.4),
        "The room has not reported for 1.4 s: users and rates are unknown."
    );
    let refusing = now("user(3, 2)", sum).replace(
        "nodes: []",
        "nodes: [{ node: 'controller', state: 'position reports refused', problem: 'users: outside-room' }]",
    );
    assert_eq!(sentence(&refusing, 0.1), "The controller refuses the position reports.");
    // The reason is in the list of problems. In one script, before the next figures.
    let listed = "return import('/figures.js').then(({ problems }) => { \
           problems({ notes: [], remarks: [], orders: [], nodes: [{ node: 'controller', problem: 'users: outside-room' }] }); \
           return document.getElementById('problem').textContent; })";
    assert_eq!(browser.run(listed), "Controller: users: outside-room.");
    assert!(sentence("null", 0.0).starts_with("Waiting"));
}

#[needs("browser")]
#[test]
fn the_sentence_has_the_modelled_sum_rate_where_no_receiver_reports_gains() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/sentence.js').then(({ sentence }) => { \
           const users = [3, 7].map((user) => ({ user, rate_mbps: 0, is_rate_known: false, min_rate_mbps: 1 })); \
           const now = { origin: 'real', ages_s: { room: 0 }, nodes: [], users, sum_name: 'modelled sum rate' }; \
           const of = (sum_mbps) => sentence({ ...now, sum_mbps }, 0.1, { wall: true }); \
           return [of({ policy: 45, no_irs: 12, is_modelled: true }), of(null)]; })";
    let expected = [
        "The modelled sum rate is 45 Mbit/s, and 12 without the mirrors. No receiver reports the gains of its user.",
        "The rates are unknown. No receiver reports the gains of its user.",
    ];
    assert_eq!(browser.run(script), serde_json::json!(expected));
    // The title of the chart follows the figures; in one script, before the next ones.
    let titles = "return import('/charts.js').then(({ Charts }) => { \
           const charts = new Charts({ budget_us: 500, history: [] }, async () => []); \
           charts.theme(); \
           const title = (name) => { charts.figures({ policy: 45 }, name); return document.getElementById('sums-title').textContent; }; \
           return ['modelled sum rate', 'sum rate'].map(title); })";
    let expected = ["Modelled sum rate of all users, last 90 s, Mbit/s", "Sum rate of all users, last 90 s, Mbit/s"];
    assert_eq!(browser.run(titles), serde_json::json!(expected));
}

#[needs("browser")]
#[test]
fn the_chip_of_the_policy_and_the_name_of_the_sum_rate_agree_on_what_the_mirrors_follow() {
    let (setting, browser) = Setting::shown();
    browser.click("#stop");
    wait_until("an idle policy", || browser.text("#chip-policy").ends_with(" (idle)"));
    wait_until("a sum rate of stopped mirrors", || browser.text("#sum-figures div:first-child dt") == "stopped");
    // The time before the stop stays that of the policy.
    let script = "return import('/charts.js').then(({ stretches }) => { \
           const point = (time_s, name, idle) => ({ time_s, name, idle }); \
           return stretches([point(1, 'greedy', false), point(2, 'greedy', false), point(3, 'stopped', true)], 10) \
             .map(({ from_s, name, idle }) => [from_s, name, idle]); })";
    assert_eq!(browser.run(script), serde_json::json!([[-9, "greedy", false], [-7, "stopped", true]]));
    wait_until("a line with the colour of the policy before the stop", || browser.run(GREEDY_LINE) == true);
    // A page that is opened later draws the same, and names the colour.
    let later = Browser::open_flat(&setting.server.url());
    wait_until("the colour of the policy before the page was open", || later.run(GREEDY_LINE) == true);
    wait_until("its name in the legend", || later.text("#sum-chart .earlier").contains("greedy"));
}

#[needs("browser")]
#[test]
fn the_marks_of_the_legend_have_the_dashes_of_their_lines_and_no_two_lines_share_a_colour() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/charts.js').then(({ Charts, markOf }) => { \
           const colours = (dark) => { \
             document.documentElement.dataset.theme = dark ? 'dark' : 'light'; \
             const of = Object.create(Charts.prototype); of.redraw = { reset: () => {} }; of.theme(); \
             const followed = [{ name: 'stopped', idle: true }, { name: '', idle: false }, { name: 'greedy', idle: false }]; \
             return [...followed.map((one) => of.colourOf(one)), of.flat, of.ink, '#bbbbbb', '#999999']; }; \
           return [markOf('#111111', []), markOf('#111111', [2, 3]), \
             ...[true, false].map((dark) => new Set(colours(dark)).size)]; })";
    let dotted = "repeating-linear-gradient(90deg, #111111 0 2px, transparent 2px 5px)";
    assert_eq!(browser.run(script), serde_json::json!(["#111111", dotted, 7, 7]));
}

#[needs("browser")]
#[test]
fn no_two_policies_of_the_list_share_a_colour() {
    let (_setting, browser) = Setting::shown();
    let script = "return Promise.all([import('/charts.js'), fetch('/room.json').then((answer) => answer.json())]) \
           .then(([{ Charts }, { policies }]) => { \
             const of = Object.create(Charts.prototype); of.redraw = { reset: () => {} }; \
             const names = [...new Set(['exhaustive', ...policies.map(({ name }) => name)])]; \
             const colours = (dark) => { \
               document.documentElement.dataset.theme = dark ? 'dark' : 'light'; of.theme(); return names.map((name) => of.colourOf({ name, idle: false })); }; \
             return [true, false].map((dark) => names.length - new Set(colours(dark)).size); })";
    assert_eq!(browser.run(script), serde_json::json!([0, 0]));
}

#[needs("browser")]
#[test]
fn a_learned_policy_has_the_file_of_its_network_or_the_hash_in_its_tooltip() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/figures.js').then(({ networkIn }) => { \
           const file = { hash: '1a2b', name: 'own.onnx' }; \
           return [networkIn('1a2b', file), networkIn('3c4d', file), networkIn('3c4d', null), networkIn(null, file)]; })";
    let expected = ["Its network is own.onnx.", "Its network has the hash 3c4d.", "Its network has the hash 3c4d.", ""];
    assert_eq!(browser.run(script), serde_json::json!(expected));
}

#[needs("browser")]
#[test]
fn the_tooltip_of_a_counter_names_its_process_and_when_it_started() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/figures.js').then(({ countedBy }) => \
           [['controller 0a', 0], ['sim-node 0b', 61], ['driver 0c', 150], ['driver 0c', null], ['', null]] \
             .map(([process, minutes]) => countedBy({ process, minutes })))";
    let expected = [
        "Counted since the start of controller 0a, less than a minute ago.",
        "Counted since the start of sim-node 0b, 61 min ago.",
        "Counted since the start of driver 0c, 2 h ago.",
        "Counted since the start of driver 0c.",
        "",
    ];
    assert_eq!(browser.run(script), serde_json::json!(expected));
    let tip = "return [...document.querySelectorAll('#counts dfn')].find(({ textContent }) => textContent === 'ticks lost')?.title ?? ''";
    wait_until("a tooltip", || browser.run(tip).as_str().is_some_and(|tip| tip.contains("the start of sim-node ")));
}

#[needs("browser")]
#[test]
fn users_who_lose_their_link_without_the_mirrors_are_named_as_users() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/sentence.js').then(({ sentence }) => { \
           const now = { origin: 'simulated', ages_s: { room: 0 }, nodes: [], users: [] }; \
           const of = (rates) => sentence(now, 0.1, { wall: false }, { \
             users: rates.map((without_mirrors_mbps, user) => ({ user, without_mirrors_mbps, min_rate_mbps: 1 })) }); \
           return [of([2, 2, 0]), of([0, 2, 0])]; })";
    let expected = [
        "Without the mirrors, 1 of 3 users is below the minimum rate: user 2.",
        "Without the mirrors, 2 of 3 users are below the minimum rate: users 0, 2.",
    ];
    assert_eq!(browser.run(script), serde_json::json!(expected));
}

#[needs("browser")]
#[test]
fn a_browser_without_webgl_shows_a_plan() {
    let (_setting, browser) = Setting::shown();
    assert_eq!(browser.run("return document.documentElement.dataset.view"), "2d");
    let first = drawn(&browser);
    wait_until("more pictures", || drawn(&browser) > first + 5);
    let colours = "const canvas = document.querySelector('#room canvas'); \
                   const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
                   return new Set(new Uint32Array(data.buffer)).size";
    assert!(browser.run(colours).as_u64().is_some_and(|colours| colours > 10), "the plan is empty");
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}

#[needs("browser")]
#[test]
fn the_page_fits_a_phone_and_a_desktop_in_light_and_dark_without_errors() {
    let setting = Setting::new();
    let browser = setting.browser_3d();
    for (width, height) in [(390, 844), (1280, 800), (1920, 1080)] {
        browser.resize(width, height);
        for theme in ["light", "dark"] {
            choose_theme(&browser, theme);
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
    // STOP is in view at each size, without scrolling and at the end of the page too.
    for (width, height) in [(390, 844), (844, 390), (1280, 800)] {
        browser.resize(width, height);
        for place in ["0", "document.documentElement.scrollHeight"] {
            let visible = format!(
                "scrollTo(0, {place}); const {{ x, y, width, height }} = document.getElementById('stop').getBoundingClientRect(); \
                 const top = document.elementFromPoint(x + width / 2, y + height / 2); return top?.id === 'stop'"
            );
            wait_until("a stop button in view", || browser.run(&visible) == true);
        }
    }
    browser.run("scrollTo(0, 0)");
    // The whole desktop page is visible at once, except where late decisions are explained.
    browser.resize(1280, 800);
    wait_until("a page without a scroll bar", || {
        browser
            .run("return document.documentElement.scrollHeight <= 800 + document.getElementById('late').offsetHeight")
            == true
    });
    // Each term is explained to a user of the keyboard too.
    let terms = "return [...document.querySelectorAll('dfn')].filter((term) => term.tabIndex === 0 && term.title.length > 20)\
                 .map((term) => term.textContent)";
    let terms = browser.run(terms).to_string();
    for term in ["no IRS", "oracle", "minimum", "fallbacks", "faults"] {
        assert!(terms.contains(term), "{terms}");
    }
    assert_eq!(browser.console_errors(), Vec::<String>::new());
}
