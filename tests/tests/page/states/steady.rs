//! What keeps its place while answers, problems and ages come and go, and what waits for the first figures.

use heliostat_needs::needs;
use heliostat_tests::{Browser, wait_until};
use serde_json::{Value, json};

use super::setting::{Setting, order};

/// The places of the buttons of orders, of STOP, and of the line of events in a window with two columns, in two frames:
/// a browser keeps the place of the reader at the next one.
const PLACES: &str = "const frame = () => new Promise((resolve) => requestAnimationFrame(resolve)); \
     return frame().then(frame).then(() => { \
       const parts = [...document.querySelectorAll('#operate :is(button, select), #stop')]; \
       if (innerWidth > 860) parts.push(document.getElementById('event-log')); \
       return parts.map((part) => { const { left, top } = part.getBoundingClientRect(); return [left, top]; }); })";

/// The places before a script and after it. Both are of a few frames, so that the room itself seldom changes meanwhile.
fn places_around(browser: &Browser, change: &str, undo: &str) -> [Vec<[f64; 2]>; 2] {
    let script = format!(
        "const places = () => {{ {PLACES} }}; const at = (id) => document.getElementById(id); \
         return places().then((before) => {{ {change}; return places().then((after) => {{ {undo}; return [before, after]; }}); }})"
    );
    serde_json::from_value(browser.run(&script)).expect("places")
}

/// Whether all parts are where they were, apart from the rounding to pixels.
fn are_kept(before: &[[f64; 2]], now: &[[f64; 2]]) -> bool {
    let is_kept =
        |(before, now): (&[f64; 2], &[f64; 2])| before.iter().zip(now).all(|(one, other)| (one - other).abs() < 2.0);
    before.len() == now.len() && before.iter().zip(now).all(is_kept)
}

#[needs("browser")]
#[test]
fn an_answer_a_problem_and_a_banner_move_no_button_of_an_order() {
    let (_setting, browser) = Setting::shown();
    // A refusal that is longer than its place.
    let long = "a policy that no controller has ".repeat(10);
    let refused = format!(r#"{{ order: "policy", name: "{long}" }}"#);
    // The next figures change the parts of the page, so that each change is that of a copy.
    let refusal = format!(
        "const status = at('order-status'); const copy = status.cloneNode(false); \
         copy.textContent = 'refused: {long}'; copy.className = 'bad'; \
         status.replaceWith(copy)"
    );
    // Beside the list and the banner of the page. On a phone the bar has one more line.
    let problem = "for (const [id, text] of [['problem', 'The simulator reports no positions of users. '], ['banner', 'The array has confirmed the stop. ']]) { \
           const part = at(id).cloneNode(false); \
           part.hidden = false; \
           part.dataset.copy = 'yes'; \
           part.textContent = text.repeat(6); \
           at(id).after(part); } \
         document.documentElement.style.setProperty('--bar', '93px')";
    let no_problem = "document.querySelectorAll('[data-copy]').forEach((part) => part.remove()); \
         document.documentElement.style.removeProperty('--bar')";
    let pressed = "const power = at('power'); const copy = power.cloneNode(true); \
         const [button] = copy.querySelectorAll('[aria-pressed=false]'); \
         copy.querySelector('[aria-pressed=true]')?.setAttribute('aria-pressed', 'false'); \
         button.setAttribute('aria-pressed', 'true'); \
         power.replaceWith(copy)";
    let changes = [
        ("a refusal", refusal.as_str(), "copy.replaceWith(status)"),
        ("a problem and a banner", problem, no_problem),
        ("another pressed button", pressed, "copy.replaceWith(power)"),
    ];
    for (width, height) in [(390, 844), (1280, 800), (1280, 600), (1920, 1080)] {
        browser.resize(width, height);
        browser.run("scrollTo(0, 0); document.getElementById('power').scrollIntoView({ block: 'center' })");
        for (what, change, undo) in changes {
            wait_until(&format!("{what} that moves no button at {width} x {height}"), || {
                let [before, after] = places_around(&browser, change, undo);
                are_kept(&before, &after)
            });
        }
        order(&browser, &refused);
        // The text that the place cannot hold is reached by scrolling, and in the tooltip.
        let whole = "const status = document.getElementById('order-status'); \
             const { overflowY } = getComputedStyle(status); \
             return [status.title === status.textContent, overflowY, status.clientHeight < 80]";
        wait_until("a long refusal in its place", || {
            browser.text("#order-status").len() > long.len() && browser.run(whole) == json!([true, "auto", true])
        });
    }
}

#[needs("browser")]
#[test]
fn users_who_come_or_go_move_no_order_and_disable_the_buttons_of_absent_users() {
    let (_setting, browser) = Setting::shown();
    // The places of all orders and the enabled choices with 2, 9 and 3 users. In one step, before the next figures.
    let script = "return Promise.all([import('/orders.js'), ...['room', 'events'].map((name) => fetch(`/${name}.json`).then((answer) => answer.json()))]) \
           .then(([{ Orders }, plan, { figures }]) => { \
             const orders = new Orders(); \
             orders.open(plan); \
             return [2, 9, 3].map((count) => { \
               orders.update({ ...figures, users: Array.from({ length: count }, (_, user) => ({ ...figures.users[0], user })) }); \
               const places = [...document.querySelectorAll('#operate :is(button, select)')].map((part) => { \
                 const { left, top } = part.getBoundingClientRect(); return [left, top]; }); \
               return [places, document.querySelectorAll('#blocked button:enabled').length]; }); })";
    for (width, height) in [(390, 844), (1024, 768), (1280, 800), (1920, 1080)] {
        browser.resize(width, height);
        let found: [(Vec<[f64; 2]>, usize); 3] = serde_json::from_value(browser.run(script)).expect("places");
        let [(few, of_few), (many, of_many), (again, of_again)] = found;
        assert!(are_kept(&few, &many) && are_kept(&many, &again), "{width} x {height}: {few:?} {many:?} {again:?}");
        assert_eq!([of_few, of_many, of_again], [3, 9, 4], "{width} x {height}");
    }
    let reasons =
        "return import('/orders.js').then(({ tooFew }) => [tooFew(2, 2), tooFew(1, 0), tooFew(2, 1), tooFew(8, 5)])";
    let expected = ["", "no user is in the room", "only 1 user is in the room", "only 5 users are in the room"];
    assert_eq!(browser.run(reasons), json!(expected));
}

#[needs("browser")]
#[test]
fn the_line_of_events_is_complete_in_view_below_warnings() {
    let (mut setting, browser) = Setting::shown();
    setting.room.kill();
    wait_until("a problem", || !browser.text("#problem").is_empty());
    let shown = "const line = document.getElementById('event-log'); \
         const { x, top, bottom } = line.getBoundingClientRect(); \
         return [top >= 0, bottom <= innerHeight, line.contains(document.elementFromPoint(x + 20, bottom - 3))]";
    for (width, height) in [(1280, 720), (1280, 800), (1024, 768), (1280, 600)] {
        browser.resize(width, height);
        assert_eq!(browser.run(shown), json!([true, true, true]), "{width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn every_order_but_stop_is_disabled_with_the_reason_until_the_first_figures() {
    let (_setting, browser) = Setting::shown();
    // The page as it is served, then once the plan has arrived. In one script at the end, before the next figures.
    let enabled = "return Promise.all([import('/orders.js'), ...['/', '/room.json'].map((path) => fetch(path).then((answer) => answer.text()))]) \
           .then(([{ Orders }, page, plan]) => { \
             const all = (from) => [...from.querySelectorAll('#operate button, #emergency button')]; \
             const enabled = (from) => all(from).filter(({ disabled }) => !disabled).map(({ id, textContent }) => id || textContent); \
             const served = enabled(new DOMParser().parseFromString(page, 'text/html')); \
             document.getElementById('blocked').replaceChildren(); \
             new Orders().open(JSON.parse(plan)); \
             const reasons = new Set(all(document).filter(({ disabled }) => disabled).map(({ title }) => title)); \
             return [served, enabled(document), [...reasons], document.getElementById('not-taken').textContent]; })";
    let reason = "the page waits for the first figures of its server";
    let names = "optical power, direct paths, walking speed, mirrors, switch, kill, restart, re-arm";
    let expected = json!([["stop"], ["stop"], [reason], format!("Disabled: {names} ({reason}).")]);
    assert_eq!(browser.run(enabled), expected);
}

#[needs("browser")]
#[test]
fn a_disabled_order_has_its_own_reason() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/orders.js').then(({ reasons }) => { \
           const known = { origin: 'simulated', controller_alive: true, ages_s: { array: null }, array: { silent: [0], state: 'no report' }, \
             stop: { phase: 'none', stops: [], held: null, problems: [], lost: [] } }; \
           const of = (plan, now, policy = 'greedy') => Object.values(reasons(plan, { ...known, ...now }, policy)); \
           const [demo, ui] = [{ controls_processes: true }, { controls_processes: false }]; \
           return [of(demo, {}), of(demo, { controller_alive: false }), of(demo, {}, ''), of(demo, { origin: 'real' }), \
             of(ui, { origin: 'no-data' }), of({ ...ui, stop_only: 'a viewer' }, {})]; })";
    let absent = "the page sees no controller";
    let foreign = "only `heliostat demo` can kill or restart the processes that it started";
    let expected: Value = json!([
        ["", "", "", "", ""],
        ["", absent, "", absent, ""],
        ["", "no policy is chosen", "", "", ""],
        ["", "", "only a simulated room takes this order", "", ""],
        ["", "", "the room does not report", foreign, foreign],
        ["a viewer", "a viewer", "a viewer", foreign, foreign],
    ]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn a_rearm_is_disabled_only_where_every_array_answers_and_reports_no_stop() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/orders.js').then(({ reasons }) => { \
           const now = { origin: 'real', controller_alive: true, ages_s: { array: 0.1 }, array: { silent: [], state: 'following' } }; \
           const none = { phase: 'none', stops: [], held: null, problems: [], lost: [] }; \
           const of = (more = {}, stop = {}, plan = {}) => reasons(plan, { ...now, ...more, stop: { ...none, ...stop } }, 'greedy').rearm; \
           const acts = [of({ ages_s: { array: 3 } }), of({ ages_s: { array: null } }), of({ array: { silent: [1], state: 'following' } }), \
             of({ array: { silent: [], state: 'stopped' } }), of({ array: { silent: [], state: 'fault' } }), of({}, { phase: 'requested' }), of({}, { stops: [{}] }), of({}, { held: 'a stop' }), \
             of({}, { phase: 'released', lost: ['a driver'] }), of({}, { problems: ['open'] }), of({}, {}, { geometry_source: 'default' })]; \
           return [of(), of({}, { phase: 'released' }), ...new Set(acts)]; })";
    let none = "no array reports an emergency stop";
    assert_eq!(browser.run(script), json!([none, none, ""]));
    let shown = "const { disabled, title } = document.getElementById('rearm'); return [disabled, title]";
    wait_until("a room without a stop", || browser.run(shown) == json!([true, none]));
    browser.click("#stop");
    wait_until("a stop that can be released", || browser.run(shown)[0] == json!(false));
}

#[needs("browser")]
#[test]
fn a_phone_names_each_disabled_button_with_its_reason() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/orders.js').then(({ notTaken }) => \
           [notTaken([]), notTaken([['6', 'few'], ['mirrors', 'real'], ['7', 'few'], ['mirrors', 'real']])])";
    assert_eq!(browser.run(script), json!(["", "Disabled: 6, 7 (few); mirrors (real)."]));
    // What a demo shows after its button `kill`. In one step, before the next figures. Its line has a place without a text too.
    let killed = "return Promise.all([import('/orders.js'), ...['room', 'events'].map((name) => fetch(`/${name}.json`).then((answer) => answer.json()))]) \
           .then(([{ Orders }, plan, { figures }]) => { \
             const orders = new Orders(); \
             orders.open({ ...plan, controls_processes: true, users_max: 5 }); \
             const now = { ...figures, users: Array.from({ length: 5 }, (_, user) => ({ ...figures.users[0], user })), \
               ages_s: { ...figures.ages_s, array: null } }; \
             const note = document.getElementById('not-taken'); \
             const [height, text] = [() => document.getElementById('operate').clientHeight, () => note.checkVisibility() ? note.textContent : null]; \
             orders.update(now); \
             const [before, empty] = [height(), text()]; \
             orders.update({ ...now, controller_alive: false }); \
             return [empty, text(), height() === before]; })";
    browser.resize(390, 844);
    assert_eq!(browser.run(killed), json!(["", "Disabled: switch, kill (the page sees no controller).", true]));
}

#[needs("browser")]
#[test]
fn the_buttons_for_blocked_paths_are_as_many_as_the_scenario_has_users_and_none_is_alone_in_a_line() {
    let setting = Setting::with(&["--set", "users.count=3"]);
    let browser = setting.browser();
    let buttons = "return [...document.querySelectorAll('#blocked button')].map(({ dataset }) => dataset.value)";
    assert_eq!(browser.run(buttons), json!(["0", "1", "2", "3"]));
    // The lengths of the lines for the largest number of users. In one step, before the next figures.
    let lines = "return Promise.all([import('/orders.js'), fetch('/room.json').then((answer) => answer.json())]).then(([{ Orders }, plan]) => \
           [null, 64, 8, 7, 6, 5].map((users_max) => { \
             new Orders().open({ ...plan, users_max }); \
             const lines = new Map(); \
             for (const button of document.querySelectorAll('#blocked button')) { \
               const { top } = button.getBoundingClientRect(); lines.set(top, (lines.get(top) ?? 0) + 1); } \
             return [...lines.values()]; }))";
    for (width, height) in [(390, 844), (360, 640)] {
        browser.resize(width, height);
        let expected = json!([[5, 4], [5, 4], [5, 4], [5, 3], [7], [6]]);
        assert_eq!(browser.run(lines), expected, "{width} x {height}");
    }
    browser.resize(1280, 800);
    assert_eq!(browser.run(lines), json!([[9], [9], [9], [8], [7], [6]]));
}

#[needs("browser")]
#[test]
fn stop_acts_before_the_description_of_the_room_arrives() {
    let (_setting, browser) = Setting::shown();
    // A button without the handler of the open page, and no server.
    let sent = "return import('/orders.js').then(async ({ Orders }) => { \
           const stop = document.getElementById('stop'); \
           stop.replaceWith(stop.cloneNode(true)); \
           const [sent, send] = [[], window.fetch]; \
           const answers = [new Response('{}', { status: 202, headers: { 'content-type': 'application/json' } }), \
             new Response('no array received it', { status: 503, headers: { 'content-type': 'text/plain' } })]; \
           window.fetch = async (path, { body }) => { sent.push([path, body]); return answers.shift(); }; \
           const orders = new Orders(); \
           document.getElementById('stop').click(); \
           await new Promise((resolve) => setTimeout(resolve)); \
           const said = [orders.message?.text]; \
           await orders.send({ order: 'stop' }); \
           said.push(orders.message?.text); \
           window.fetch = send; \
           orders.answers([{ id: 1, text: 'stop: done', state: 'done' }]); \
           return [sent, said, orders.status.textContent]; })";
    // A stop without an array is held, and not refused. The answer in the first figures replaces that of the page.
    let stop = json!(["order", r#"{"order":"stop"}"#]);
    let expected = json!([[stop, stop], ["STOP: sent", "STOP: no array received it"], "stop: done"]);
    assert_eq!(browser.run(sent), expected);
}

#[needs("browser")]
#[test]
fn what_is_unknown_at_the_start_is_neither_red_nor_gone() {
    let (_setting, browser) = Setting::shown();
    // Before the first figures, then with those of a server to which nothing has reported. In one step, before the next
    // figures of the open page.
    let script = "return Promise.all([import('/stale.js'), import('/figures.js')]).then(([{ Ages }, { chips }]) => { \
           const parts = [...document.querySelectorAll('section[data-from]')]; \
           const red = () => parts.filter((part) => part.classList.contains('stale') && !part.classList.contains('unknown')).map(({ id }) => id); \
           for (const part of parts) part.classList.remove('stale'); \
           const ages = new Ages(() => {}); \
           ages.mark(); \
           const before = parts.filter((part) => part.classList.contains('stale')).length; \
           const now = { ages_s: {}, in_charge: { name: 'no report', idle: 'unknown' }, nodes: [], controller_alive: false, \
             controller_unseen: false, array: { state: 'no report', unusable: 0 }, origin: 'no-data' }; \
           ages.take(now); \
           ages.mark(); \
           chips(now, ages, null); \
           const states = ['array', 'controller', 'room'].map((part) => document.getElementById(`chip-${part}`)); \
           const found = [before, red(), states.map(({ textContent, className }) => [textContent, className]), \
             getComputedStyle(document.getElementById('rates'), '::after').backgroundColor]; \
           ages.take({ ages_s: { array: 9 } }); \
           chips({ ...now, ages_s: { array: 9 } }, ages, null); \
           return [...found, states[0].className]; })";
    let unknown = ["no report", "old"];
    let expected = json!([0, [], [unknown, unknown, unknown], "rgb(52, 73, 94)", "bad"]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn figures_are_taken_with_a_new_report_of_the_room_only() {
    let (_setting, browser) = Setting::shown();
    // Time of the server and age of the report, of the figures and of those before.
    let script = "return import('/sentence.js').then(({ isNewer }) => { \
           const of = (time_s, room) => ({ time_s, ages_s: { room } }); \
           return [isNewer(of(5, 0.1), null), isNewer(of(5, null), null), isNewer(of(5, 0.1), of(4.9, null)), \
             isNewer(of(5, 0.1), of(4.8, 0.1)), isNewer(of(5, 0.3), of(4.8, 0.1)), isNewer(of(9, 1.2), of(4, 0.1))]; })";
    assert_eq!(browser.run(script), json!([true, false, true, true, false, false]));
}

#[needs("browser")]
#[test]
fn a_phone_has_two_lines_above_the_sentence_the_views_in_the_picture_and_its_age_in_view() {
    let setting = Setting::new();
    let browser = setting.browser_3d();
    for (width, height) in [(390, 844), (360, 640)] {
        browser.resize(width, height);
        // In one script, before the next figures. The states are the longest ones.
        let shown = "scrollTo(0, 0); const at = (id) => document.getElementById(id); \
             for (const part of ['policy', 'array', 'controller', 'room']) at(`chip-${part}`).textContent = 'no report for 119 min'; \
             const tops = (of) => new Set([...document.querySelectorAll(of)].map((part) => Math.round(part.getBoundingClientRect().top))).size; \
             const [where, theme, chips] = ['where', 'theme', 'chips'].map((id) => at(id).getBoundingClientRect()); \
             const isBeside = where.top < theme.bottom && theme.top < where.bottom; \
             const isBelow = chips.top >= Math.max(where.bottom, theme.bottom); \
             const [views, room, switches] = ['views', 'room', 'switches'].map((id) => at(id).getBoundingClientRect()); \
             const isWithin = views.top >= room.top && views.right <= room.right && views.left >= room.left; \
             at('room-card').classList.add('stale'); \
             const { position, bottom } = getComputedStyle(at('room-card'), '::after'); \
             const isAboveBar = parseFloat(bottom) >= innerHeight - at('emergency').getBoundingClientRect().top; \
             return [tops('#chips li'), isBeside && isBelow, chips.bottom < 100, isWithin, switches.height < 40, position, isAboveBar, \
               document.documentElement.scrollWidth <= innerWidth]";
        assert_eq!(browser.run(shown), json!([1, true, true, true, true, "sticky", true, true]), "{width} x {height}");
    }
}
