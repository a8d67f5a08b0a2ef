//! Several tabs of one browser, and of several rooms below one host.

use heliostat_needs::needs;
use heliostat_tests::wait_until;

use super::setting::{Setting, is_live};

#[needs("browser")]
#[test]
fn seven_tabs_share_one_stream_and_each_sends_orders() {
    let (setting, browser) = Setting::shown();
    let first = browser.tab();
    let tabs: Vec<String> = (0..6).map(|_| browser.open_tab(&setting.server.url())).collect();
    for tab in [&first, &tabs[0], &tabs[5]] {
        browser.switch_to(tab);
        wait_until("a page that shows the room", || is_live(&browser));
        // The body is no order, so an answer of any status shows that the request has reached the server.
        let order = "return fetch('order', { method: 'POST', headers: { 'content-type': 'application/json' }, body: '{}', \
                     signal: AbortSignal.timeout(60000) }).then((answer) => answer.status)";
        assert_eq!(browser.run(order), 422);
        // The worker holds the stream of the tabs.
        assert_eq!(browser.run("return document.documentElement.dataset.stream"), "shared");
    }
    assert_eq!(browser.console_errors().iter().filter(|error| !error.contains("422")).count(), 0);
}

#[needs("browser")]
#[test]
fn more_rooms_than_a_host_has_connections_for_are_polled_and_receive_orders() {
    let (_setting, browser) = Setting::shown();
    // The first tab keeps the shared worker of this page alive, so the stream is tried directly. It ends with figures
    // and a frame in this mode.
    browser.run(
        "window.reach = (wanted) => import('/stream.js').then(({ Stream }) => new Promise((done) => { \
         const kinds = new Set(); let mode = null; \
         new Stream((kind, text) => { if (kind === 'mode') mode = text; kinds.add(kind); \
         if (mode === wanted && kinds.has('figures') && kinds.has('frame')) done(mode); }); }))",
    );
    // A late answer comes after the stream has been opened.
    for delay_ms in [0, 400] {
        // Pages of other rooms of this host announce their streams in the same way.
        browser.run(&format!(
            "window.rooms = [1, 2, 3, 4].map((room) => {{ const channel = new BroadcastChannel('heliostat-streams'); \
             const answer = (id) => channel.postMessage({{ holds: `room ${{room}}`, to: id }}); \
             channel.onmessage = ({{ data }}) => {{ if (data.asks) setTimeout(() => answer(data.asks), {delay_ms}); }}; \
             return channel; }})",
        ));
        assert_eq!(browser.run("return window.reach('polled')"), "polled");
        browser.run("window.rooms.forEach((channel) => channel.close())");
    }
    assert_eq!(browser.run("return window.reach('live')"), "live");
}
