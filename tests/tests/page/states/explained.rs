//! Whether a user who sees the page for the first time finds what its parts mean.

use heliostat_needs::needs;
use heliostat_tests::wait_until;

use super::setting::Setting;

#[needs("browser")]
#[test]
fn a_button_for_blocked_paths_names_the_users_whose_paths_it_blocks() {
    let setting = Setting::with(&["--set", "users.count=3"]);
    let browser = setting.browser();
    let script = "return import('/orders.js').then(({ blockedTitle }) => \
           [[], [7], [7, 3, 12]].map((users) => blockedTitle(users.map((user) => ({ user })))))";
    let expected = [
        "leave every direct path as it is",
        "block the direct path of user 7",
        "block the direct paths of users 7, 3, 12",
    ];
    assert_eq!(browser.run(script), serde_json::json!(expected));
    let title = "return document.querySelector('#blocked [data-value=\"2\"]')?.title ?? ''";
    wait_until("the users of a button", || browser.run(title) == "block the direct paths of users 0, 1");
    let titles = "return ['#power [data-value=\"1\"]', '#speed [data-value=\"0\"]'].map((of) => document.querySelector(of).title)";
    assert_eq!(browser.run(titles), serde_json::json!(["each LED transmits 1 W of light", "users stand still"]));
    // The button acts on the users that it names.
    browser.click("#blocked [data-value='2']");
    let by_order = "return [...document.querySelectorAll('#users tr')].filter(({ cells }) => cells[1].textContent === 'by order') \
           .map(({ cells }) => cells[0].textContent)";
    wait_until("their paths blocked by order", || browser.run(by_order) == serde_json::json!(["0", "1"]));
}

#[needs("browser")]
#[test]
fn a_state_that_a_narrow_window_cuts_off_has_its_text_or_more_as_its_tooltip() {
    let (_setting, browser) = Setting::shown();
    // In one script, before the next figures.
    let script = "return import('/figures.js').then(({ chips }) => { \
           const now = { in_charge: { name: 'greedy', idle: '' }, policy: 'greedy', network: '', controller_alive: true, \
             nodes: [], controllers: [], origin: 'real', array: { state: 'following', unusable: 0 } }; \
           const fresh = { isStale: () => false, isUnknown: () => false, of: () => 0 }; \
           const titles = (more) => { chips({ ...now, ...more }, fresh, null); \
             return ['policy', 'array', 'controller', 'room'].map((part) => document.getElementById(`chip-${part}`).title); }; \
           return [...titles({}), titles({ in_charge: { name: 'stopped', idle: 'A stop is in force.' } })[0]]; })";
    let expected = ["greedy", "following", "alive", "real", "A stop is in force."];
    assert_eq!(browser.run(script), serde_json::json!(expected));
}

#[needs("browser")]
#[test]
fn the_legend_has_obstacles_and_the_sum_rates_say_what_their_shares_are_of() {
    let (_setting, browser) = Setting::shown();
    let colours = "return import('/geometry.js').then(({ palette }) => { \
           const probe = document.createElement('i'); \
           probe.style.color = palette(document.documentElement.dataset.theme === 'dark').obstacle; \
           return [probe.style.color, document.querySelector('#legend .obstacle').style.backgroundColor]; })";
    let colours = browser.run(colours);
    assert_eq!(colours[0], colours[1]);
    let tips =
        "return [...document.querySelectorAll('#sum-figures small')].map((share) => [share.textContent, share.title])";
    wait_until("shares with their meaning, and an oracle without one", || {
        let tips = browser.run(tips);
        let is_explained = |index: usize| {
            tips[index][0].as_str().is_some_and(|text| text.ends_with(" %"))
                && tips[index][1].as_str().is_some_and(|title| title.contains("share of the oracle's sum rate"))
        };
        is_explained(0) && is_explained(1) && tips[3] == serde_json::json!(["", ""])
    });
}

#[needs("browser")]
#[test]
fn the_thousands_of_a_time_are_apart() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/figures.js').then(({ grouped }) => [0, 999.6, 12345, 1234567].map(grouped))";
    assert_eq!(
        browser.run(script),
        serde_json::json!(["0", "1\u{202f}000", "12\u{202f}345", "1\u{202f}234\u{202f}567"])
    );
}

#[needs("browser")]
#[test]
fn the_chart_of_the_sum_rates_begins_with_the_first_policy_that_the_mirrors_followed() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/charts.js').then(({ settled }) => { \
           const times = (...names) => settled(names.map((name, time_s) => ({ time_s, name, idle: name !== 'greedy' && name !== '' }))).map(({ time_s }) => time_s); \
           return [times('parked', '', 'greedy', 'stopped', 'no report'), times('no report', 'no report', '', 'parked', 'greedy'), \
             times('', ''), times('greedy', ''), times()]; })";
    let expected = serde_json::json!([[2, 3, 4], [0, 1, 2, 3, 4], [0, 1], [0, 1], []]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn the_number_of_blocked_paths_is_unknown_while_the_room_is_silent() {
    let (setting, browser) = Setting::shown();
    let pressed =
        "return [...document.querySelectorAll('#blocked [aria-pressed=true]')].map(({ dataset }) => dataset.value)";
    let buttons = "return document.querySelectorAll('#blocked button').length";
    browser.click("#blocked [data-value='2']");
    wait_until("two blocked paths", || browser.run(pressed) == serde_json::json!(["2"]));
    let before = browser.run(buttons);
    setting.room.signal("STOP");
    wait_until("an unknown number", || browser.run(pressed) == serde_json::json!([]));
    assert_eq!(browser.run(buttons), before);
    setting.room.signal("CONT");
    wait_until("the number again", || browser.run(pressed) == serde_json::json!(["2"]));
    // A real room takes no such order. In one step, before the next figures.
    let of_real = "return Promise.all([import('/orders.js'), ...['room', 'events'].map((name) => fetch(`/${name}.json`).then((answer) => answer.json()))]) \
           .then(([{ Orders }, plan, { figures }]) => { \
             const orders = new Orders(); \
             orders.open(plan); \
             return ['simulated', 'real'].map((origin) => { \
               orders.update({ ...figures, origin, users: figures.users.map((user) => ({ ...user, forced: false })) }); \
               return document.querySelectorAll('#blocked [aria-pressed=true]').length; }); })";
    assert_eq!(browser.run(of_real), serde_json::json!([1, 0]));
}

#[needs("browser")]
#[test]
fn the_chart_of_the_sum_rates_has_what_the_server_kept_while_the_page_received_nothing() {
    let (_setting, browser) = Setting::shown();
    let filled = "return import('/charts.js').then(({ filled }) => { \
           const at = (...times) => times.map((time_s) => ({ time_s })); \
           return filled(at(0, 1, 5), at(0.5, 3, 5, 9)).map(({ time_s }) => time_s); })";
    assert_eq!(browser.run(filled), serde_json::json!([0, 1, 3, 5]), "only what lies in the gap");
    // The chart asks the server once, for figures that come after a gap.
    let asked = "return import('/charts.js').then(async ({ Charts }) => { \
           let asked = 0; \
           const charts = new Charts({ budget_us: 500, history: [] }, async () => { asked += 1; return [[3, { policy: 2 }]]; }); \
           charts.redraw = { run() {}, reset() {} }; \
           for (const time_s of [0, 1, 5, 6]) charts.update({ time_s, origin: 'simulated', sum_mbps: { policy: 1 } }, { name: 'greedy', idle: '' }); \
           await new Promise((resolve) => setTimeout(resolve)); \
           return [asked, charts.past.map(({ time_s }) => time_s)]; })";
    assert_eq!(browser.run(asked), serde_json::json!([1, [0, 1, 3, 5, 6]]));
}

#[needs("browser")]
#[test]
fn a_chart_without_figures_says_since_when_and_the_times_of_decisions_age_with_the_reports() {
    let (_setting, browser) = Setting::shown();
    // In one step, before the next figures.
    let script = "return Promise.all([import('/charts.js'), import('/stale.js'), import('/figures.js')]).then(([{ Charts }, { Ages }, { counters }]) => { \
           const charts = new Charts({ budget_us: 500, history: [] }, async () => []); \
           charts.theme(); \
           const shown = () => [charts.noSums, charts.noDecisions].map((part) => (part.checkVisibility() ? part.textContent : '')); \
           const draw = (time_s, count) => { charts.drawSum(time_s); charts.drawLatency({ edges_us: [100], counts: [count, 0] }); return shown(); }; \
           const empty = draw(0, 0); \
           charts.past = [{ time_s: 5, name: 'greedy', idle: false, policy: 1 }]; \
           const [full, old] = [draw(95, 1), draw(96, 1)]; \
           const times = ['decision', 'loop', 'age'].map((name) => ({ name, of: name === 'loop' ? 'room' : 'controller', us: null })); \
           const now = { times, late: null, array: { silent: [], arrays: 1, faults: [] }, counts: [], tracker_noise: null, light: [], controllers: [] }; \
           counters(now); \
           const ages = new Ages(() => {}); \
           const aged = (room) => { \
             ages.take({ ages_s: { room, controller: 0.1, array: 0.1 } }); \
             ages.mark(); \
             return [...document.querySelectorAll('#quantiles tbody tr')].map((row) => (row.classList.contains('stale') ? row.dataset.age : '')); }; \
           return [empty, full, old, aged(12), aged(0.1)]; })";
    let sums = "no sum rates in the last 90 s";
    let expected = serde_json::json!([
        [sums, "no decisions in the last 30 s"],
        ["", ""],
        [sums, ""],
        ["12 s old", "12 s old", "12 s old"],
        ["", "", ""],
    ]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn a_line_of_the_sum_rates_keeps_its_name_and_a_reference_that_is_the_policy_has_another() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/charts.js').then(({ Charts }) => { \
           const charts = new Charts({ budget_us: 500, history: [] }, async () => []); \
           charts.theme(); \
           charts.followed = { name: 'stopped', idle: true }; \
           const present = charts.lines()[0][1]; \
           charts.past = [{ time_s: 1, ...charts.followed }, { time_s: 4, name: 'flat', idle: false }]; \
           charts.followed = { name: 'flat', idle: false }; \
           charts.drawSum(10); \
           return [present, charts.earlier.textContent, charts.lines().map(([, name]) => name)]; })";
    let expected =
        serde_json::json!(["stopped", "stopped until 6 s ago", ["flat", "no IRS", "flat (reference)", "oracle"]]);
    assert_eq!(browser.run(script), expected);
}

#[needs("browser")]
#[test]
fn a_late_picture_has_its_age_until_a_new_one_is_painted() {
    let (_setting, browser) = Setting::shown();
    let card = "const card = document.getElementById('room-card'); const isOld = card.classList.contains('stale'); ";
    // As on a machine that draws slowly. The figures of the room stay current.
    let slow = format!(
        "{card} document.getElementById('room').room.nextDraw = Infinity; \
         return [isOld && card.dataset.age.endsWith(' old'), document.getElementById('rates').classList.contains('stale')]"
    );
    wait_until("the age of the picture", || browser.run(&slow) == serde_json::json!([true, false]));
    let fast = format!("{card} document.getElementById('room').room.nextDraw = 0; return isOld");
    wait_until("a new picture", || browser.run(&fast) == false);
}

#[needs("browser")]
#[test]
fn a_panel_names_what_is_awaited_until_the_room_has_a_picture() {
    let (_setting, browser) = Setting::shown();
    let is_hidden = "return document.getElementById('awaited').hidden";
    wait_until("a picture without the panel", || browser.run(is_hidden) == true);
    // The page begins with the panel, before its scripts.
    let begins = "return fetch('/').then((answer) => answer.text()).then((page) => /id=\"awaited\">Waiting for [^<]+</.test(page))";
    assert_eq!(browser.run(begins), true);
    // In one step: it covers the canvas.
    let covers = "const [panel, room] = ['awaited', 'room'].map((id) => document.getElementById(id)); \
         panel.hidden = false; \
         const { x, y, width, height } = room.getBoundingClientRect(); \
         const top = document.elementFromPoint(x + width / 2, y + height / 2)?.id; \
         const isOpaque = getComputedStyle(panel).backgroundColor.startsWith('rgb('); \
         panel.hidden = true; \
         return [top, isOpaque]";
    assert_eq!(browser.run(covers), serde_json::json!(["awaited", true]));
}

#[needs("browser")]
#[test]
fn the_histogram_has_every_bucket_where_the_page_was_open_before_the_controller() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/charts.js').then(async ({ Charts }) => { \
           const charts = new Charts({ budget_us: 500, history: [] }, async () => []); \
           charts.theme(); \
           charts.drawLatency({ edges_us: [], counts: [] }); \
           charts.drawLatency({ edges_us: [100, 500], counts: [3, 2, 1] }); \
           await new Promise((resolve) => setTimeout(resolve)); \
           const { min, max } = charts.latencyPlot.scales.x; \
           return [min, max]; })";
    assert_eq!(browser.run(script), serde_json::json!([-0.5, 2.5]));
}

#[needs("browser")]
#[test]
fn a_tap_on_a_figure_shows_its_meaning_within_the_window_and_another_tap_hides_it() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(390, 844), (1280, 800)] {
        browser.resize(width, height);
        // In one script, before the next figures. A figure without a term has no tip.
        let tips = "const tip = document.getElementById('tip'); \
             const tap = (of) => { \
               const part = document.querySelector(of); \
               part.scrollIntoView({ block: 'center' }); \
               part.click(); \
               const { left, top, right, bottom } = tip.getBoundingClientRect(); \
               const isInView = left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight; \
               return tip.hidden ? '' : isInView ? tip.textContent : 'outside the window'; }; \
             const figures = ['#counts dd', '#sum-figures dd', '#quantiles td:nth-child(2)', '#users td:nth-child(4)', '#jain']; \
             return [figures.map((of) => tap(of).length > 20), tap('#users td:first-child')]";
        assert_eq!(browser.run(tips), serde_json::json!([[true, true, true, true, true], ""]), "{width} x {height}");
    }
    // The keyboard shows the meaning of a term.
    let focused = "document.querySelector('#counts dfn').focus(); const tip = document.getElementById('tip'); \
         return !tip.hidden && tip.textContent === document.activeElement.title";
    assert_eq!(browser.run(focused), true);
    browser.press(":focus", "\u{E00C}");
    assert_eq!(browser.run("return document.getElementById('tip').hidden"), true);
}
