//! Orders of an operator: whether they took effect, wait for an answer, or were refused.

use std::time::{Duration, Instant};

use heliostat_needs::needs;
use heliostat_tests::wait_until;

use super::setting::{Setting, banner, is_live, order};

#[needs("browser")]
#[test]
fn the_banner_says_whether_the_array_confirmed_a_stop() {
    let (setting, browser) = Setting::shown();
    browser.click("#stop");
    wait_until("a confirmation", || banner(&browser).contains("has confirmed the stop"));
    wait_until("a state of the array", || browser.text("#chip-array") == "stopped");
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

    // A re-arm without a stop, which the button of the page does not send, has no effect, and the page does not claim one.
    order(&browser, "{ order: 'rearm', stops: [] }");
    wait_until("a refusal", || {
        browser.text("#order-status").contains("re-arm: refused: no array that answers reports an emergency stop")
    });
    assert_eq!(banner(&browser), "");

    // An array that cannot answer has not confirmed.
    setting.room.signal("STOP");
    browser.run("document.getElementById('stop').click()");
    wait_until("a request", || banner(&browser).starts_with("Stop requested"));
    wait_until("a warning", || banner(&browser).contains("has not confirmed the stop for"));
    setting.room.signal("CONT");
    wait_until("a late confirmation", || banner(&browser).contains("has confirmed the stop"));
}

#[needs("browser")]
#[test]
fn the_banner_says_the_time_of_an_unconfirmed_stop_once() {
    let setting = Setting::new();
    let browser = setting.browser();
    let script = "return import('/sentence.js').then(({ banner }) => { \
           const of = (phase, age_s, held = null) => banner({ array: { arrays: 1, state: 'stopped' }, \
             stop: { phase, since_s: 5.02, held, problems: ['it is silent'], free: [], lost: [], \
               stops: [{ name: '3/4', operator: 'ann', reason: 'ladder', age_s }] } }, 0, 0, 0).text; \
           const times = (text) => text.match(/ (for|at least) [0-9.]+ s/g) ?? []; \
           const held = of('unconfirmed', 5, 'withheld by the stop of ann since 12:00:00 UTC'); \
           return [of('unconfirmed', 4.97), of('unconfirmed', 30), of('confirmed', 5), held].map(times); })";
    assert_eq!(
        browser.run(script),
        serde_json::json!([[" for 5.0 s"], [" for 5.0 s", " at least 30 s"], [" at least 5.0 s"], []])
    );
}

#[needs("browser")]
#[test]
fn the_banner_of_a_viewer_says_whose_keys_a_release_needs() {
    let setting = Setting::new();
    let browser = setting.browser();
    let script = "return import('/sentence.js').then(({ banner }) => { \
           const stop = { phase: 'confirmed', since_s: 2, held: null, problems: [], free: [], lost: [], \
             stops: [{ name: '3/4', operator: 'ann', reason: 'ladder', age_s: 2 }] }; \
           const now = { array: { arrays: 1, state: 'stopped' }, stop }; \
           return [null, 'a viewer'].map((limit) => banner(now, 0, 0, 0, limit).text); })";
    let texts = browser.run(script);
    let ends_with = |index: usize, end: &str| texts[index].as_str().is_some_and(|text| text.ends_with(end));
    assert!(ends_with(0, " Re-arm releases it."), "{texts}");
    assert!(ends_with(1, " Re-arm with the keys of an operator releases it."), "{texts}");
}

#[needs("browser")]
#[test]
fn the_banner_names_a_lost_driver_and_what_ends_its_warning() {
    let setting = Setting::new();
    let browser = setting.browser();
    let script = "return import('/sentence.js').then(({ banner }) => { \
           const of = (phase, lost) => banner({ array: { arrays: 1, state: 'parked' }, \
             stop: { phase, since_s: 2, stops: [], held: null, problems: [], free: [], lost } }, 0, 0, 0).text; \
           const lost = ['array 0: driver 7 was lost']; \
           return [of('unconfirmed', []), of('unconfirmed', lost), of('released', []), of('released', lost)]; })";
    let texts = browser.run(script);
    let ends_with = |index: usize, end: &str| texts[index].as_str().is_some_and(|text| text.ends_with(end));
    assert!(ends_with(0, " Only the arrays can end this warning."), "{texts}");
    let ends = " Only reports of the arrays, the return of a lost driver or a release can end this warning.";
    assert!(ends_with(1, ends), "{texts}");
    assert_eq!(texts[2], "The stop is released: the array has confirmed it.");
    let lost = "The stop is released, and a lost driver has not confirmed it. Array 0: driver 7 was lost.";
    assert_eq!(texts[3], lost);
}

#[needs("browser")]
#[test]
fn an_order_that_the_server_does_not_answer_has_the_words_of_its_button() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/orders.js').then(({ notConfirmed }) => \
           ['stick', 'kill-controller', 'stop'].map((order) => notConfirmed(order, 'no answer')))";
    let advice = "check that `heliostat ui` or `heliostat demo` still runs, and that this computer reaches it";
    let expected = [
        format!("not confirmed: jam a quarter: no answer; {advice}"),
        format!("not confirmed: kill: no answer; {advice}"),
        "not confirmed: STOP: no answer; run `heliostat stop`, or cut the power of the mirrors".to_owned(),
    ];
    assert_eq!(browser.run(script), serde_json::json!(expected));
}

#[needs("browser")]
#[test]
fn an_order_without_a_server_or_with_the_answer_of_a_proxy_says_so_without_the_words_of_the_browser() {
    let (mut setting, browser) = Setting::shown();
    // A proxy whose server is gone answers by itself.
    let refusal = "return import('/requests.js').then(({ refusalIn }) => { \
           const of = (status, type) => refusalIn(new Response('<h1>Bad Gateway</h1>', { status, headers: { 'content-type': type } })) \
             .then(() => 'the server', (error) => error.message); \
           return Promise.all([of(422, 'text/plain; charset=utf-8'), of(502, 'text/plain'), of(503, 'text/html')]); })";
    let by_proxy = |status: u16| format!("a proxy before the server answers with status {status}");
    let expected = ["the server".to_owned(), by_proxy(502), by_proxy(503)];
    assert_eq!(browser.run(refusal), serde_json::json!(expected));
    setting.server.kill();
    browser.run("document.getElementById('stop').click()");
    let expected = "not confirmed: STOP: the server of this page cannot be reached; run `heliostat stop`, or cut the power of the mirrors";
    wait_until("a message of the page", || browser.text("#order-status") == expected);
    wait_until("a banner with what to do", || banner(&browser).contains("Check that `heliostat ui` or"));
}

#[needs("browser")]
#[test]
fn a_stop_that_a_program_between_answers_is_not_shown_as_taken() {
    let (_setting, browser) = Setting::shown();
    // A login page, an empty success, a refusal in the form of the server's, and the answer of the server.
    let script = "return import('/orders.js').then(async ({ Orders }) => { \
           const of = (body, status, type) => new Response(body, { status, headers: { 'content-type': type } }); \
           const answers = [of('<h1>Sign in</h1>', 200, 'text/html'), new Response(null, { status: 204 }), \
             of('no healthy upstream', 503, 'text/plain'), of('{}', 202, 'application/json')]; \
           const [orders, send, said] = [new Orders(), window.fetch, []]; \
           orders.hasFigures = true; \
           for (const answer of answers) { \
             window.fetch = async () => answer; \
             await orders.send({ order: 'stop' }); \
             said.push(orders.message?.text ?? ''); \
           } \
           window.fetch = send; \
           return said; })";
    let by_proxy = |status: u16| {
        format!(
            "not confirmed: STOP: a proxy before the server answers with status {status}; run `heliostat stop`, or cut the \
             power of the mirrors"
        )
    };
    let expected = [by_proxy(200), by_proxy(204), "STOP: no healthy upstream".to_owned(), String::new()];
    assert_eq!(browser.run(script), serde_json::json!(expected));
}

#[needs("browser")]
#[test]
fn a_stop_without_an_array_is_answered_at_once_and_a_rearm_keeps_the_warning() {
    let (mut setting, browser) = Setting::shown();
    setting.room.kill();
    wait_until("an array that has left", || browser.text("#chip-array").starts_with("no report for"));
    let status = || browser.text("#order-status");
    browser.record("#order-status");
    browser.click("#stop");
    let absent = "no array has confirmed it";
    wait_until("an answer about the array", || status() == format!("stop: {absent}"));
    let shown = browser.recorded();
    assert!(!shown.iter().any(|text| text.contains("not answered yet")), "{shown:?}");
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
    wait_until("the outcome of the re-arm", || status() == format!("re-arm: {absent}"));
}

#[needs("browser")]
#[test]
fn a_refused_order_is_shown_as_refused_until_another_takes_effect() {
    let (_setting, browser) = Setting::shown();
    browser.record("#order-status");
    order(&browser, r#"{ order: "policy", name: "clairvoyant" }"#);
    wait_until("a refusal with its reason", || {
        let shown = browser.recorded();
        assert!(!shown.iter().any(|text| text.contains("done")), "{shown:?}");
        shown.iter().any(|text| text.starts_with("policy clairvoyant: refused") && text.contains("there is no policy"))
    });
    browser.run("document.getElementById('policy').value = 'fixed-point'");
    browser.click("#switch-policy");
    wait_until("the answer in words", || browser.recorded().contains(&"policy fixed-point: done".to_owned()));
    wait_until("no message", || browser.text("#order-status").is_empty() && browser.text("#problem").is_empty());

    // More users than the room has: the simulator refuses.
    order(&browser, r#"{ order: "blocked", users: 64 }"#);
    wait_until("a refusal of the room", || {
        browser.recorded().iter().any(|text| text.contains("block the direct path of 64 users: refused"))
    });
    browser.click("#power [data-value='4']");
    browser.click("#blocked [data-value='1']");
    wait_until("the answer in words", || {
        browser.recorded().contains(&"block the direct path of 1 user: done".to_owned())
    });
}
