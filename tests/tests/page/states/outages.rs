//! How long a user was below the minimum rate, as the page shows it.

use heliostat_needs::needs;

use super::setting::Setting;

#[needs("browser")]
#[test]
fn an_outage_lasts_from_a_rate_below_the_minimum_to_the_next_one_above_it() {
    let (_setting, browser) = Setting::shown();
    let script = "return import('/outages.js').then(({ Outages }) => { \
           const outages = new Outages(); \
           const at = (time_s, rate_mbps) => \
             outages.take({ time_s, users: [{ user: 3, is_rate_known: true, rate_mbps, min_rate_mbps: 1 }] }); \
           for (let time_s = 0; time_s <= 10; time_s += 1) at(time_s, time_s >= 2 && time_s < 5 ? 0.5 : 2); \
           const { share, longest_s } = outages.of(3); \
           for (let time_s = 11; time_s <= 70; time_s += 1) at(time_s, 2); \
           const later = outages.of(3).share; \
           outages.take({ time_s: 74, origin: 'no-data', users: [] }); \
           const silent = outages.of(3) !== null; \
           at(80, 2); \
           return [share, longest_s, later, outages.of(9), silent, outages.of(3)]; })";
    let found = browser.run(script);
    assert_eq!(found, serde_json::json!([0.3, 3, 0, null, true, null]), "the time of a silence is not observed");
    // Outages of 1 s, 2 s and 4 s: the quantiles are linear between them.
    let script = "return import('/outages.js').then(({ Outages }) => { \
           const outages = new Outages(); \
           const below = [1, 3, 4, 6, 7, 8, 9]; \
           for (let time_s = 0; time_s <= 12; time_s += 1) { \
             const rate_mbps = below.includes(time_s) ? 0.5 : 2; \
             outages.take({ time_s, users: [{ user: 3, is_rate_known: true, rate_mbps, min_rate_mbps: 1 }] }); \
           } \
           const { count, p50_s, p95_s, longest_s } = outages.of(3); \
           return [count, p50_s, Math.round(10 * p95_s) / 10, longest_s]; })";
    assert_eq!(browser.run(script), serde_json::json!([3, 2, 3.8, 4]));
}

#[needs("browser")]
#[test]
fn an_outage_names_the_time_in_which_its_user_was_observed() {
    let (_setting, browser) = Setting::shown();
    let script = "return Promise.all([import('/outages.js'), import('/figures.js')]).then(([{ Outages }, { outageLengths }]) => { \
           const outages = new Outages(); \
           const texts = []; \
           for (let time_s = 0; time_s <= 80; time_s += 1) { \
             const rate_mbps = time_s === 1 ? 0.5 : 2; \
             outages.take({ time_s, users: [{ user: 3, is_rate_known: true, rate_mbps, min_rate_mbps: 1 }] }); \
             if ([0, 1, 3, 80].includes(time_s)) texts.push(outageLengths(outages.of(3))); \
           } \
           return texts; })";
    let expected = [
        "",
        "no outage in the last 1.0 s",
        "1 outage in the last 3.0 s: p50 1.0 s, p95 1.0 s",
        "no outage in the last 60 s",
    ];
    assert_eq!(browser.run(script), serde_json::json!(expected));
}
