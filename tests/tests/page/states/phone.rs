//! What a phone shows, in one column with a bar at the bottom.

use heliostat_needs::needs;
use serde_json::json;

use super::setting::Setting;

#[needs("browser")]
#[test]
fn the_answer_to_an_order_is_in_the_bar_of_a_phone_and_a_tap_hides_a_refusal() {
    let (_setting, browser) = Setting::shown();
    // In one script, before the next event of the server takes the text away.
    let in_bar = "const at = (id) => document.getElementById(id); \
        const status = at('order-status'); \
        at('rearm').textContent = 're-arm all 16'; \
        status.className = 'good'; \
        status.textContent = 'block the direct path of 8 users: done'; \
        const [place, bar, stop, rearm] = [status, at('emergency'), at('stop'), at('rearm')].map((part) => part.getBoundingClientRect()); \
        return [place.top >= bar.top && place.right <= bar.right && place.bottom <= bar.bottom, place.left >= Math.max(stop.right, rearm.right), \
          status.scrollHeight <= status.clientHeight && status.scrollWidth <= status.clientWidth, at('rearm').scrollWidth <= at('rearm').clientWidth]";
    for (width, height) in [(390, 844), (360, 640)] {
        browser.resize(width, height);
        assert_eq!(browser.run(in_bar), json!([true, true, true, true]), "{width} x {height}");
    }
    // It stays hidden in later figures, and the answer to the next order is shown.
    let tapped = "return import('/orders.js').then(({ Orders }) => { \
        const status = document.getElementById('order-status'); \
        status.replaceWith(status.cloneNode(true)); \
        const orders = new Orders(); \
        const refused = (id) => ({ id, state: 'refused', text: `order ${id}: refused` }); \
        const shown = () => document.getElementById('order-status').textContent; \
        orders.answers([refused(1)]); \
        const before = shown(); \
        document.getElementById('order-status').click(); \
        orders.answers([refused(1)]); \
        const after = shown(); \
        orders.answers([refused(2), refused(1)]); \
        return [before, after, shown()]; })";
    assert_eq!(browser.run(tapped), json!(["order 1: refused", "", "order 2: refused"]));
}

#[needs("browser")]
#[test]
fn a_long_path_in_a_text_does_not_widen_the_page_of_a_phone() {
    let (_setting, browser) = Setting::shown();
    browser.resize(390, 844);
    // In one script, before the next event of the server takes the texts away.
    let wider = "document.getElementById('events').open = true; \
        return ['banner', 'problem', 'sentence', 'refused', 'remark', 'order-status', 'last-event', 'late', 'policy-help'].filter((id) => { \
          const part = document.getElementById(id); \
          const before = part.textContent; \
          part.hidden = false; \
          part.textContent = `/${'a-long-folder-name/'.repeat(12)}room.toml`; \
          const isWider = document.documentElement.scrollWidth > innerWidth; \
          part.textContent = before; \
          return isWider; })";
    assert_eq!(browser.run(wider), json!([]));
}

#[needs("browser")]
#[test]
fn the_figures_of_a_user_are_in_one_line_on_a_phone_and_not_cut_off_on_a_smaller_one() {
    let (_setting, browser) = Setting::shown();
    // Long figures, in one script before the next ones.
    let shown = "for (const { cells } of document.querySelectorAll('#users tr')) { \
           [cells[1].textContent, cells[3].textContent, cells[4].textContent] = ['by order', 'below 1.0', '23 %, 1.2 s']; \
           [cells[2].children[0].textContent, cells[2].children[1].textContent] = ['12.34', ' > 999 %']; } \
         const rates = document.getElementById('rates'); \
         const heights = [...document.querySelectorAll('#users td')].map((cell) => cell.clientHeight); \
         return [rates.scrollWidth <= rates.clientWidth, Math.max(...heights) < 26]";
    browser.resize(390, 844);
    assert_eq!(browser.run(shown), json!([true, true]));
    browser.resize(360, 640);
    assert_eq!(browser.run(shown)[0], json!(true));
}

#[needs("browser")]
#[test]
fn what_is_no_fault_takes_no_place_above_the_figures_of_a_phone() {
    let (_setting, browser) = Setting::shown();
    browser.resize(390, 844);
    // In one script, before the next figures.
    let places = "scrollTo(0, 0); const at = (id) => document.getElementById(id); const remark = at('remark'); \
         const top = () => at('sentence').getBoundingClientRect().top; \
         const before = top(); \
         remark.hidden = false; \
         remark.textContent = 'A controller differs from the room in what a calibration measures. '.repeat(12); \
         const end = document.querySelector('main').getBoundingClientRect().bottom; \
         return [top() === before, remark.getBoundingClientRect().top >= end, remark.scrollHeight <= remark.clientHeight]";
    assert_eq!(browser.run(places), json!([true, true, true]));
}

#[needs("browser")]
#[test]
fn a_phone_has_the_complete_name_of_the_room_and_parts_that_a_finger_hits() {
    let (_setting, browser) = Setting::shown();
    browser.resize(390, 844);
    let shown = "const where = document.getElementById('where'); \
         const small = [...document.querySelectorAll('button, select, summary, .switch')].filter((part) => { \
           const { width, height } = part.getBoundingClientRect(); \
           return part.checkVisibility() && (width < 38 || height < 32); }); \
         return [small.map((part) => part.id || part.textContent), \
           where.scrollWidth <= where.clientWidth && where.scrollHeight <= where.clientHeight]";
    assert_eq!(browser.run(shown), json!([[], true]));
}
