//! What the page may not cover, shrink or hide, and whether it can be read and used without a mouse.

use heliostat_needs::needs;
use heliostat_tests::{Browser, choose_theme, wait_until};
use serde_json::{Value, json};

use super::setting::{GREEDY_LINE, Setting};

/// Shows the explanation of late decisions, as on a busy machine.
const WITH_HINT: &str = "const late = document.getElementById('late'); late.hidden = false; late.textContent = \
    '240 of 300 decisions over 0.5 ms, by longest stage: publish 233, observe 5, infer 1, wait 1. Likely cause: load. End other programs.';";

#[needs("browser")]
#[test]
fn the_answer_to_an_order_covers_nothing() {
    let (_setting, browser) = Setting::shown();
    // What lies behind the answer at the time at which it is shown.
    let watch = "window.behind = null; const shown = document.getElementById('order-status'); \
        const parts = ['sentence', 'stop', 'rearm', 'chips', 'theme', 'banner', 'problem', 'room-card', 'rates']; \
        const isBehind = (part, status) => part.width && part.left < status.right && part.right > status.left \
          && part.top < status.bottom && part.bottom > status.top; \
        new MutationObserver(() => { \
          if (shown.textContent !== ANSWER) return; \
          scrollTo(0, 0); \
          const status = shown.getBoundingClientRect(); \
          window.behind = parts.filter((id) => isBehind(document.getElementById(id).getBoundingClientRect(), status)); \
        }).observe(shown, { childList: true, characterData: true, subtree: true })";
    for (width, height) in [(1440, 900), (1024, 768), (390, 844)] {
        browser.resize(width, height);
        // On a phone the room is below the bar of STOP, and may lie behind its answer.
        let allowed: &[&str] = if width == 390 { &["room-card", "rates"] } else { &[] };
        for watts in ["1", "4"] {
            browser.run(&watch.replace("ANSWER", &format!("'optical power {watts} W: done'")));
            browser.click(&format!("#power [data-value='{watts}']"));
            let mut behind = Value::Null;
            wait_until("an answer", || {
                behind = browser.run("return window.behind");
                behind.is_array()
            });
            let wrong: Vec<_> = behind
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(Value::as_str)
                .filter(|part| !allowed.contains(part))
                .collect();
            assert!(wrong.is_empty(), "{width} x {height}: {wrong:?}");
        }
    }
}

#[needs("browser")]
#[test]
fn the_answer_to_a_stop_is_readable_completely_beside_the_buttons() {
    let (_setting, browser) = Setting::shown();
    // In one script, before the next event of the server takes the text away.
    let readable = "return import('/orders.js').then(({ notConfirmed }) => { \
        const at = (id) => document.getElementById(id); \
        const status = at('order-status'); \
        at('rearm').textContent = 're-arm all 16'; \
        status.className = 'bad'; \
        status.textContent = notConfirmed('stop', 'the server of this page cannot be reached'); \
        const place = status.getBoundingClientRect(); \
        const touched = ['stop', 'rearm', 'sentence'].filter((id) => { \
          const part = at(id).getBoundingClientRect(); \
          return part.left < place.right && part.right > place.left && part.top < place.bottom && part.bottom > place.top; }); \
        return [status.scrollHeight <= status.clientHeight, status.scrollWidth <= status.clientWidth, \
          place.left >= 0 && place.right <= innerWidth && place.top >= 0 && place.bottom <= innerHeight, touched]; })";
    for (width, height) in [(1440, 900), (1024, 768), (390, 844), (360, 640)] {
        browser.resize(width, height);
        browser.run("scrollTo(0, 0)");
        assert_eq!(browser.run(readable), json!([true, true, true, []]), "{width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn the_name_of_the_room_is_complete_in_a_narrow_window() {
    let (_setting, browser) = Setting::shown();
    let complete = "const where = document.getElementById('where'); \
         const line = document.getElementById('emergency').getBoundingClientRect(); \
         const { top, bottom } = where.getBoundingClientRect(); \
         return [where.scrollWidth <= where.clientWidth && where.scrollHeight <= where.clientHeight, top < line.bottom && bottom > line.top]";
    for (width, height) in [(900, 768), (1024, 768), (1200, 800), (1280, 800)] {
        browser.resize(width, height);
        assert_eq!(browser.run(complete), json!([true, true]), "{width} x {height}");
    }
    // Beside the states of a room in which something is wrong. In one script, before the next figures.
    for states in [["following, 25 unusable", "simulated"], ["no report for 119 min", "no report for 119 min"]] {
        let wrong = format!(
            "const [array, room] = {}; document.getElementById('chip-policy').textContent = 'greedy (idle)'; \
             document.getElementById('chip-array').textContent = array; document.getElementById('chip-room').textContent = room; {complete}",
            json!(states)
        );
        for (width, height) in [(1280, 800), (1440, 900)] {
            browser.resize(width, height);
            assert_eq!(browser.run(&wrong), json!([true, true]), "{states:?} at {width} x {height}");
        }
    }
}

#[needs("browser")]
#[test]
fn a_long_sentence_is_complete_and_moves_nothing() {
    let (_setting, browser) = Setting::shown();
    // In one step, before the next figures.
    let script = "return import('/figures.js').then(({ showSentence }) => { \
           const at = (id) => document.getElementById(id); \
           const shown = (text) => { showSentence(text); const { scrollHeight, clientHeight } = at('sentence'); \
             return [at('headline').clientHeight, at('room-card').getBoundingClientRect().top, scrollHeight <= clientHeight]; }; \
           const [short, ...long] = ['Mirrors add 12 Mbit/s.', \
             'Mirrors add nothing to the sum rate. 3 of 5 users are below the minimum rate.', \
             'The modelled sum rate is 45 Mbit/s, and 12 without the mirrors. No receiver reports the gains of its user.'].map(shown); \
           return long.every((one) => one.every((value, index) => value === short[index])); })";
    for (width, height) in [(900, 768), (1024, 768), (1280, 800), (1920, 1080)] {
        browser.resize(width, height);
        assert_eq!(browser.run(script), true, "{width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn the_charts_keep_their_size_while_the_log_of_events_opens_and_grows() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1024, 768), (1440, 900), (1920, 1080)] {
        browser.resize(width, height);
        // In one step: the page also changes by itself, for example with the hint at late decisions. A tall window has
        // the list open from the start.
        let grown = format!(
            "return import('/events.js').then(({{ showEvents }}) => {{ \
               const sizes = () => ['sum-chart', 'latency-chart', 'room'].map((id) => document.getElementById(id).clientHeight); \
               const events = document.getElementById('events'); \
               events.open = {}; \
               const before = sizes(); \
               events.open = true; \
               showEvents(Array.from({{ length: 100 }}, (_, index) => ({{ at_ms: index, text: `event ${{index}}`, is_bad: false }}))); \
               return [before, sizes(), document.getElementById('event-list').children.length]; }})",
            height >= 1000
        );
        let found = browser.run(&grown);
        assert_eq!(found[2], 100);
        assert_eq!(found[0], found[1], "{width} x {height}");
        if height < 1000 {
            let longer = "const events = document.getElementById('events'); const [open, closed] = [true, false].map((open) => { \
                 events.open = open; return document.documentElement.scrollHeight; }); return open - closed";
            assert_eq!(browser.run(longer), 0, "the list makes the page longer at {width} x {height}");
        }
        browser.run("document.getElementById('events').open = false; scrollTo(0, 0)");
    }
}

#[needs("browser")]
#[test]
fn the_column_of_figures_scrolls_to_the_decision_times_behind_the_open_log_of_events() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1024, 768), (1280, 800), (1440, 900)] {
        browser.resize(width, height);
        // In one script, before the next figures.
        let seen = "const at = (id) => document.getElementById(id); const column = at('rates').parentElement; \
             at('events').open = true; \
             column.scrollTop = column.scrollHeight; \
             const [chart, table, list] = ['latency-chart', 'quantiles', 'event-list'].map((id) => at(id).getBoundingClientRect()); \
             const found = [chart.top >= column.getBoundingClientRect().top, table.bottom <= list.top, list.bottom <= innerHeight]; \
             at('events').open = false; \
             column.scrollTop = 0; \
             return found";
        assert_eq!(browser.run(seen), json!([true, true, true]), "{width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn the_log_of_events_opens_with_the_decision_times_in_view_above_it() {
    let (_setting, browser) = Setting::shown();
    let seen = "const at = (id) => document.getElementById(id); \
         const [chart, table, list, column] = ['latency-chart', 'quantiles', 'event-list', 'rates'].map((id) => at(id)); \
         const [top, list_top] = [chart.getBoundingClientRect().top, list.getBoundingClientRect().top]; \
         return [top >= column.parentElement.getBoundingClientRect().top, table.getBoundingClientRect().bottom <= list_top]";
    for (width, height) in [(1024, 768), (1280, 800), (1440, 900)] {
        browser.resize(width, height);
        browser.run("document.getElementById('rates').parentElement.scrollTop = 0; document.getElementById('events').open = true");
        wait_until(&format!("chart, times and log at {width} x {height}"), || browser.run(seen) == json!([true, true]));
        browser.run("document.getElementById('events').open = false");
    }
}

#[needs("browser")]
#[test]
fn every_figure_and_order_is_in_view_on_a_small_desktop_once_the_column_of_figures_is_scrolled() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1024, 768), (1280, 800), (1440, 900)] {
        browser.resize(width, height);
        // With the explanation of late decisions: a busy machine shows it.
        let hidden = format!(
            "{WITH_HINT} scrollTo(0, 0); const column = document.getElementById('rates').parentElement; \
             const hidden = (ids) => ids.filter((id) => {{ \
               const part = document.getElementById(id).getBoundingClientRect(); \
               return part.height === 0 || part.bottom > innerHeight + 1 || part.right > innerWidth + 1; }}); \
             column.scrollTop = 0; \
             const first = hidden(['stop', 'chips', 'sentence', 'users', 'jain', 'sum-figures', 'sum-chart', 'operate', 'policy-help', 'counts']); \
             column.scrollTop = column.scrollHeight; \
             const last = hidden(['latency-chart', 'quantiles', 'last-event', 'stop', 'operate', 'policy-help']); \
             column.scrollTop = 0; \
             return [...first, ...last, ...(document.documentElement.scrollHeight > innerHeight ? ['page'] : [])]"
        );
        wait_until(&format!("every part in view at {width} x {height}"), || browser.run(&hidden) == json!([]));
        // A part that is too small for its content is cut off.
        let cut = "return [...document.querySelectorAll('main section:not(#room-card)')].filter((part) => \
             part.scrollHeight > part.clientHeight + 1 || part.scrollWidth > part.clientWidth + 1).map((part) => part.id)";
        assert_eq!(browser.run(cut), json!([]), "{width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn no_name_of_a_counter_wraps_and_no_group_of_orders_or_switch_is_alone_in_a_line() {
    let (_setting, browser) = Setting::shown();
    // The places in the lines of the groups, the numbers of lines of switches, names that wrap, and what is too wide.
    let lines = "const tops = (of) => [...document.querySelectorAll(of)].map((part) => Math.round(part.getBoundingClientRect().top)); \
         const groups = tops('#operate .control'); \
         const alone = groups.at(-1) !== groups.at(-2); \
         const wrapped = [...document.querySelectorAll('#counts dt')].filter((name) => name.clientHeight > 20).length; \
         const wide = [...document.querySelectorAll('section, .switch, .switch span')].filter((part) => part.scrollWidth > part.clientWidth + 1).length; \
         const page = document.documentElement; \
         return [alone, new Set(tops('.switch')).size, wrapped, wide, page.scrollWidth > page.clientWidth]";
    for (width, height) in [(1920, 1080), (1440, 900), (1280, 800), (1024, 768), (390, 844), (360, 640)] {
        browser.resize(width, height);
        assert_eq!(browser.run(lines), json!([false, 1, 0, 0, false]), "{width} x {height}");
    }
    browser.resize(1920, 1080);
    let one_line =
        "return new Set([...document.querySelectorAll('#operate .control')].map((part) => part.offsetTop)).size";
    assert_eq!(browser.run(one_line), 1);
}

#[needs("browser")]
#[test]
fn warnings_and_takeovers_leave_picture_orders_and_stop_in_view_on_a_small_desktop() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1024, 768), (1280, 700), (1280, 800), (1440, 900)] {
        browser.resize(width, height);
        // All that can be shown at one time: a stop, four warnings, unusable mirrors, takeovers.
        let hidden = "scrollTo(0, 0); const at = (id) => document.getElementById(id); \
             at('banner').hidden = at('problem').hidden = false; \
             at('banner').textContent = 'The array has confirmed the stop: its device has executed it. '.repeat(4); \
             at('problem').replaceChildren(...Array.from({ length: 4 }, () => Object.assign(document.createElement('li'), \
               { textContent: 'Two drivers serve one array (mirrors, sources 0000000000000007 and 0000000000000008): stop one of them.' }))); \
             at('chip-array').textContent = 'following, 25 unusable'; \
             for (let count = 0; count < 6; count += 1) at('counts').append(at('counts').firstElementChild.cloneNode(true)); \
             const hidden = ['stop', 'chips', 'sentence', 'room', 'operate', 'policy-help'].filter((id) => { \
               const { top, bottom, right } = at(id).getBoundingClientRect(); \
               return bottom - top < (id === 'room' ? 180 : 1) || top < 0 || bottom > innerHeight + 1 || right > innerWidth + 1; }); \
             return [hidden, document.documentElement.scrollHeight <= innerHeight]";
        assert_eq!(browser.run(hidden), json!([[], true]), "{width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn the_charts_stay_readable_at_every_size_with_and_without_a_hint_on_late_decisions() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1024, 768), (1280, 720), (1280, 800), (1366, 768), (1440, 900), (390, 844)] {
        browser.resize(width, height);
        let charts = "['sum-chart', 'latency-chart'].map((id) => document.getElementById(id).clientHeight)";
        let heights = format!("const before = {charts}; {WITH_HINT} return [...before, ...{charts}]");
        let heights: [u64; 4] = serde_json::from_value(browser.run(&heights)).expect("four heights");
        assert!(heights.iter().all(|height| *height >= 120), "{heights:?} at {width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn the_names_of_earlier_policies_are_above_the_lines_of_a_chart_that_keeps_its_size() {
    let setting = Setting::new();
    let browser = setting.browser();
    wait_until("a line of the first policy", || browser.run(GREEDY_LINE) == true);
    browser.run("document.getElementById('policy').value = 'nearest'");
    browser.click("#switch-policy");
    let is_above = "const of = (part) => document.querySelector(`#sum-chart ${part}`)?.getBoundingClientRect(); \
         const [names, lines] = [of('.earlier'), of('.u-over')]; \
         return names.height > 0 && lines?.top >= names.bottom";
    wait_until("the name of the former policy above the lines", || browser.run(is_above) == true);
    wait_until("its name and its end", || browser.text("#sum-chart .earlier").contains("greedy until "));
    // In one script, before the next figures.
    let heights = "const [chart, names] = ['#sum-chart', '#sum-chart .earlier'].map((of) => document.querySelector(of)); \
         const [before, after] = [true, false].map((hidden) => { names.hidden = hidden; return chart.clientHeight; }); \
         return after - before";
    assert_eq!(browser.run(heights), 0);
    // More names than one line of a phone has.
    for policy in ["random", "hold", "no-irs", "fixed-point", "flat"] {
        browser.run(&format!("document.getElementById('policy').value = '{policy}'"));
        browser.click("#switch-policy");
        wait_until("the policy in the legend", || browser.text("#sum-figures div:first-child dt") == policy);
    }
    browser.resize(390, 844);
    let in_lines = "return document.querySelector('#sum-chart .earlier').clientHeight >= 28";
    wait_until("several lines of names", || browser.run(in_lines) == true);
    wait_until("all of them above the lines of the chart", || browser.run(is_above) == true);
}

#[needs("browser")]
#[test]
fn the_charts_stay_readable_beside_notes_and_a_calibration() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1366, 768), (1366, 657), (1920, 1080), (390, 844)] {
        browser.resize(width, height);
        // As beside a calibration: two controllers, and a long note. In one script, before the next figures.
        let heights = "scrollTo(0, 0); const at = (id) => document.getElementById(id); \
             at('remark').hidden = false; at('remark').textContent = 'A controller differs from the room in what a calibration measures. '.repeat(12); \
             at('counts').insertAdjacentHTML('beforeend', '<div><dt>controllers</dt><dd class=\"wide\">1a2b calibrates, 3c4d stands by</dd></div>'.repeat(3)); \
             at('sentence').textContent = 'A calibration commands the mirrors: spot 2 of 3, 57 of 100 mirrors located. '.repeat(2); \
             return ['sum-chart', 'latency-chart', 'remark'].map((id) => at(id).clientHeight)";
        let heights: [u64; 3] = serde_json::from_value(browser.run(heights)).expect("three heights");
        let [sum, latency, remark] = heights;
        assert!(sum.min(latency) >= 120, "{heights:?} at {width} x {height}");
        assert!(width == 390 || (1..=36).contains(&remark), "{heights:?} at {width} x {height}");
    }
}

#[needs("browser")]
#[test]
fn the_charts_stay_readable_below_the_banner_of_a_stop() {
    let (_setting, browser) = Setting::shown();
    for (width, height) in [(1024, 768), (1366, 768), (1440, 900)] {
        browser.resize(width, height);
        let heights = "const banner = document.getElementById('banner'); banner.hidden = false; \
             banner.textContent = 'The array has confirmed the stop: its device has executed it. '.repeat(4); \
             return ['sum-chart', 'latency-chart'].map((id) => document.getElementById(id).clientHeight)";
        let heights: [u64; 2] = serde_json::from_value(browser.run(heights)).expect("two heights");
        assert!(heights.iter().all(|height| *height >= 120), "{heights:?} at {width} x {height}");
    }
}

/// The texts of the page whose contrast to their background is below 4.5, with the contrast.
const FAINT: &str = "
    const parse = (colour) => colour.match(/[\\d.]+/g).map(Number);
    const linear = (value) => { const part = value / 255; return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4; };
    const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    const background = (element) => {
        for (let at = element; at; at = at.parentElement) {
            const colour = parse(getComputedStyle(at).backgroundColor);
            if (colour.length === 3 || colour[3] > 0) return colour;
        }
        return [255, 255, 255];
    };
    const faint = [];
    for (const element of document.querySelectorAll('body *')) {
        const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
        const { width, height } = element.getBoundingClientRect();
        if (!own || !width || !height || element.closest(':disabled, option, .hidden')) continue;
        let opacity = 1;
        for (let at = element; at; at = at.parentElement) opacity *= Number(getComputedStyle(at).opacity);
        const back = background(element);
        const text = parse(getComputedStyle(element).color).slice(0, 3).map((value, index) => opacity * value + (1 - opacity) * back[index]);
        const [low, high] = [luminance(text), luminance(back)].sort((one, other) => one - other);
        const contrast = (high + 0.05) / (low + 0.05);
        if (contrast < 4.5) faint.push(`${element.id || element.tagName} ${element.textContent.trim().slice(0, 30)}: ${contrast.toFixed(1)}`);
    }
    return faint;";

#[needs("browser")]
#[test]
fn every_text_has_a_contrast_of_at_least_4_5_also_where_it_is_old() {
    let (mut setting, browser) = Setting::shown();
    let check = |state: &str| {
        for theme in ["light", "dark"] {
            choose_theme(&browser, theme);
            assert_eq!(browser.run(FAINT), json!([]), "{state}, {theme}");
        }
    };
    check("a running room");
    browser.click("#stop");
    wait_until("a confirmed stop", || browser.text("#banner").contains("confirmed the stop"));
    check("a stopped room");
    setting.controller.kill();
    setting.room.kill();
    wait_until("old parts", || browser.run("return document.querySelectorAll('section.stale').length >= 4") == true);
    wait_until("what is wrong", || !browser.text("#problem").is_empty());
    check("an old room");
}

#[needs("browser")]
#[test]
fn a_screen_reader_finds_the_sentence_in_a_landmark_and_each_list_as_a_list() {
    let (_setting, browser) = Setting::shown();
    let roles = "return [document.querySelectorAll('ul[role], ol[role], dl[role]').length, \
         document.getElementById('sentence').closest('[role=region][aria-label]') !== null, \
         document.getElementById('problem').closest('[role=alert]') !== null]";
    assert_eq!(browser.run(roles), json!([0, true, true]));
}

#[needs("browser")]
#[test]
fn a_screen_reader_reads_a_banner_once_while_its_ages_change() {
    let (_setting, browser) = Setting::shown();
    let spoken = "return import('/sentence.js').then(({ spoken }) => \
         spoken('The array has not confirmed the stop for 7.3 s. Ordered by a (b) at least 12 min ago.'))";
    assert_eq!(browser.run(spoken), "The array has not confirmed the stop. Ordered by a (b).");
    browser.click("#stop");
    let said = "const said = document.getElementById('said'); return said.role === 'alert' ? said.textContent : ''";
    let is_said = |text: &str| browser.run(said).as_str().is_some_and(|said| said.contains(text));
    wait_until("a confirmed stop", || is_said("confirmed the stop: its device has executed it."));
    assert!(is_said(" (button). Re-arm releases it."), "{}", browser.run(said));
}

/// The focused element: its id, and whether a ring shows the focus.
fn focused(browser: &Browser) -> (String, bool) {
    let script = "const at = document.activeElement; \
        const name = at.id || at.dataset.eye || `${at.parentElement?.id} ${at.dataset.value ?? at.textContent}`; \
        const drawn = at.type === 'checkbox' ? at.nextElementSibling : at; \
        const { outlineStyle, outlineWidth } = getComputedStyle(drawn); \
        return [name, outlineStyle !== 'none' && parseFloat(outlineWidth) >= 1]";
    serde_json::from_value(browser.run(script)).expect("a name and a flag")
}

#[needs("browser")]
#[test]
fn every_order_is_reached_by_the_tab_key_with_a_visible_focus() {
    let setting = Setting::new();
    let browser = setting.browser_3d();
    let orders = browser.run(
        "return [...document.querySelectorAll('button, select, input, summary')].filter((one) => !one.disabled && one.offsetParent !== null) \
           .map((one) => one.id || one.dataset.eye || `${one.parentElement.id} ${one.dataset.value ?? one.textContent}`)",
    );
    let mut missing: Vec<String> = serde_json::from_value(orders).expect("a list of names");
    assert!(missing.len() > 25 && missing.iter().any(|name| name == "stop"), "{missing:?}");
    browser.run("document.body.tabIndex = -1; document.body.focus()");
    for _ in 0..120 {
        browser.press(":focus", "\u{E004}");
        let (name, is_visible) = focused(&browser);
        assert!(
            is_visible || name.starts_with("undefined") || name.starts_with("null"),
            "the focus of {name} is invisible"
        );
        missing.retain(|known| *known != name);
        if missing.is_empty() {
            return;
        }
    }
    panic!("not reached by Tab: {missing:?}");
}

#[needs("browser")]
#[test]
fn each_policy_is_explained_where_it_is_chosen() {
    let (_setting, browser) = Setting::shown();
    let policies = browser.run("return fetch('/room.json').then((answer) => answer.json())")["policies"].clone();
    let policies = policies.as_array().expect("a list");
    assert!(policies.len() > 5, "{policies:?}");
    for policy in policies {
        let [name, description] = ["name", "description"].map(|key| policy[key].as_str().expect("a text").to_owned());
        assert!(description.split(' ').count() >= 3, "{name}: {description}");
        browser.run(&format!(
            "const list = document.getElementById('policy'); list.value = {name:?}; list.dispatchEvent(new Event('change'))"
        ));
        let help = browser.text("#policy-help");
        assert!(help.starts_with(&format!("{name}: {description}")), "{help}");
    }
}
