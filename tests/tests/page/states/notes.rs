//! What is wrong in the room and lasts: a banner at the top names it, with what to do.

use heliostat_needs::needs;
use heliostat_proto::{MirrorTelemetry, NodeKind};
use heliostat_tests::{Browser, encoded, wait_until};
use serde_json::Value;

use super::setting::Setting;

/// What is wrong, by the banner; empty where it is hidden.
fn wrong(browser: &Browser) -> String {
    let shown = "const banner = document.getElementById('problem'); return banner.hidden ? '' : banner.textContent";
    browser.run(shown).as_str().unwrap_or_default().to_owned()
}

/// Whether the complete banner is in the window, above the room.
fn is_at_the_top(browser: &Browser) -> Value {
    browser.run(
        "scrollTo(0, 0); const banner = document.getElementById('problem').getBoundingClientRect(); \
         return banner.height > 20 && banner.top >= 0 && banner.bottom <= innerHeight \
           && banner.bottom <= document.getElementById('room').getBoundingClientRect().top",
    )
}

#[needs("browser")]
#[test]
fn two_drivers_of_one_array_are_named_at_the_top_with_what_to_do() {
    let (setting, observer) = Setting::observed();
    let browser = setting.browser();
    assert_eq!(wrong(&browser), "");
    wait_until("telemetry of the first driver", || observer.telemetry().is_some());
    // A second driver of the array: the same telemetry from another source.
    let mut second = observer.telemetry().expect("waited for");
    second.stamp.source ^= 1;
    let report = |telemetry: &mut MirrorTelemetry| {
        telemetry.stamp.sequence += 1;
        observer.publish(&observer.room().telemetry(), &encoded(telemetry));
    };
    for (width, height) in [(390, 844), (1024, 768), (1440, 900)] {
        browser.resize(width, height);
        wait_until("a warning about two drivers", || {
            report(&mut second);
            let wrong = wrong(&browser);
            wrong.contains("Two drivers serve one array (mirrors, sources ")
                && wrong.contains("stop one of them")
                && is_at_the_top(&browser) == true
        });
    }
    // The controller refuses the second one, and the page says so once.
    wait_until("refused telemetry", || {
        report(&mut second);
        observer.counter(NodeKind::Controller, "refused:telemetry:foreign-source") > 0
    });
    wait_until("one line about it", || {
        report(&mut second);
        browser.run("return document.getElementById('problem').children.length") == 1
    });
    wait_until("no warning once one has left", || !wrong(&browser).contains("drivers"));
}

#[needs("browser")]
#[test]
fn a_missing_controller_and_a_missing_room_are_named_at_the_top_with_what_to_start() {
    let (mut setting, browser) = Setting::shown();
    setting.controller.kill();
    wait_until("a note about the controller", || {
        wrong(&browser).contains("No controller commands the mirrors: start one") && is_at_the_top(&browser) == true
    });
    wait_until("its beginning in the log", || {
        browser.text("#event-list").matches("no controller commands the mirrors").count() == 1
    });
    setting.room.kill();
    wait_until("a note about the positions, or about all processes", || {
        let wrong = wrong(&browser);
        wrong.contains("The simulator reports no positions of users: start it again")
            || wrong.contains("No process of this room answers")
    });
}

#[needs("browser")]
#[test]
fn late_decisions_are_explained_by_the_stage_that_delays_them() {
    let (setting, observer) = Setting::observed();
    let browser = setting.browser();
    // Its decisions take longer than the budget, whatever else the machine does.
    browser.run("document.getElementById('policy').value = 'oracle'");
    browser.click("#switch-policy");
    wait_until("an explanation by the stage of the policy", || {
        let late = browser.text("#late");
        late.contains("over 0.5 ms, by longest stage: infer ") && !late.contains("load")
    });
    assert_eq!(browser.run("return document.getElementById('late').hidden"), false);
    let count = |name: &str| observer.counter(NodeKind::Controller, name);
    wait_until("a stage for each late decision", || {
        let by = ["wait", "decode", "observe", "infer", "safe", "publish"]
            .map(|stage| count(&format!("over_budget_by:{stage}")));
        count("over_budget") > 0 && by.iter().sum::<u64>() == count("over_budget")
    });
}
