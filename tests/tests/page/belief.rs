//! The belief that a controller publishes: on the bus, beside the truth in the metrics, and on the
//! page in a browser.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};

use heliostat_bus::{Bus, BusConfig, Subscription, free_loopback_port, private_endpoint};
use heliostat_needs::needs;
use heliostat_proto::gauges::TrackerNoise;
use heliostat_proto::{BeliefReport, MirrorCommand, NodeKind, Room, RoomTruth, codec};
use heliostat_tests::{Browser, PageServer, Process, RoomObserver, fetch_metrics, sample_value, wait_until};

const FILTER: [&str; 6] =
    ["--scenario", "hall", "--set", "control.belief=\"filter\"", "--set", "streams.positions.rate_hz=50"];

/// A room and a controller, each with a metrics page.
struct Setting {
    room: Process,
    controller: Process,
    endpoints: [String; 2],
    metrics: [SocketAddr; 2],
}

impl Setting {
    fn new(settings: &[&str]) -> Self {
        let endpoints = [(); 2].map(|()| private_endpoint().expect("an endpoint"));
        let metrics = [(); 2].map(|()| SocketAddr::from(([127, 0, 0, 1], free_loopback_port().expect("a free port"))));
        let [room_at, controller_at] = endpoints.each_ref().map(String::as_str);
        let [room_page, controller_page] = metrics.map(|address| address.to_string());
        let both = |arguments: &[&str]| Process::heliostat(&[arguments, &["--exit-with-parent"], settings].concat());
        let room = both(&["sim-node", "--json", "--listen", room_at, "--metrics-listen", &room_page]);
        let join = ["controller", "--policy", "greedy", "--connect", room_at, "--listen", controller_at];
        let controller = both(&[&join[..], &["--json", "--metrics-listen", &controller_page]].concat());
        Self { room, controller, endpoints, metrics }
    }

    /// The check of this name, of a room in operation.
    fn doctor(&self, name: &str) -> serde_json::Value {
        let [room_at, controller_at] = self.endpoints.each_ref().map(String::as_str);
        let free = free_loopback_port().expect("a free port").to_string();
        let doctor = ["doctor", "--json", "--connect", room_at, "--connect", controller_at, "--port", &free];
        let report = Process::heliostat(&[&doctor[..], &FILTER].concat()).wait().json();
        let checks = report["checks"].as_array().expect("a list of checks");
        checks.iter().find(|check| check["name"] == name).unwrap_or_else(|| panic!("{name}: {report}")).clone()
    }

    fn bus(&self) -> Bus {
        let config = BusConfig::new(Room::new("demo").expect("valid"));
        Bus::open(&self.endpoints.iter().fold(config, |config, at| config.connect_to(at))).expect("the bus opens")
    }
}

/// Messages of one key in the order of arrival.
type Arrived<T> = Arc<Mutex<Vec<T>>>;

fn collect<T: codec::Message + Send + 'static>(bus: &Bus, key: &str) -> (Arrived<T>, Subscription) {
    let arrived: Arrived<T> = Arc::default();
    let keep = Arc::clone(&arrived);
    let subscription = bus.subscribe(key, move |payload| {
        keep.lock().expect("no callback panics").push(codec::decode(payload).expect("a valid message"));
    });
    (arrived, subscription.expect("the key is valid"))
}

#[test]
fn the_belief_follows_each_command_and_is_near_the_truth() {
    let setting = Setting::new(&FILTER);
    let bus = setting.bus();
    let (commands, _commands) = collect::<MirrorCommand>(&bus, &bus.room().command());
    // The first commands may precede the match of their subscription.
    wait_until("a command", || !commands.lock().expect("received").is_empty());
    let latest = Arc::clone(&commands);
    // With each belief the newest command that had arrived before it.
    let beliefs: Arrived<(BeliefReport, u64)> = Arc::default();
    let keep = Arc::clone(&beliefs);
    let _beliefs = bus.subscribe(&bus.room().belief(), move |payload| {
        let answered = latest.lock().expect("no callback panics").last().map_or(0, |command| command.answers);
        let belief = codec::decode(payload).expect("a valid belief");
        keep.lock().expect("no callback panics").push((belief, answered));
    });
    let (truths, _truths) = collect::<RoomTruth>(&bus, &bus.room().truth());
    let count = || beliefs.lock().expect("no callback panics").len();
    wait_until("many beliefs", || count() > 80);

    let (beliefs, truths) = (beliefs.lock().expect("received"), truths.lock().expect("received"));
    let [first, .., last] = &beliefs[..] else { unreachable!("many beliefs") };
    let span_s = (last.0.stamp.time_ns - first.0.stamp.time_ns) as f64 * 1e-9;
    assert!((beliefs.len() - 1) as f64 <= 21.0 * span_s, "{} beliefs in {span_s:.1} s", beliefs.len());
    let (mut compared, mut far) = (0, 0);
    for (belief, answered) in beliefs.iter() {
        assert!(*answered >= belief.tick, "the belief of tick {} arrived before its command", belief.tick);
        let ahead_ns = belief.holds_ns.saturating_sub(belief.stamp.time_ns);
        assert!((1..100_000_000).contains(&ahead_ns), "{ahead_ns} ns after the decision");
        assert!(belief.users.iter().all(|user| user.xx_m2 > 0.0 && user.yy_m2 > 0.0), "{belief:?}");
        let Some(truth) = truths.iter().min_by_key(|truth| truth.stamp.time_ns.abs_diff(belief.holds_ns)) else {
            continue;
        };
        // The truth of another time shows other places.
        if truth.stamp.time_ns.abs_diff(belief.holds_ns) > 200_000_000 {
            continue;
        }
        for user in &belief.users {
            let Some(known) = truth.users.iter().find(|known| known.user == user.user) else { continue };
            let [dx, dy] = [0, 1].map(|axis| user.position_m[axis] - known.position_m[axis]);
            far += usize::from(dx.hypot(dy) >= 1.0);
            compared += 1;
        }
    }
    // A belief from reports before a pause of a busy machine is old.
    assert!(compared > 50 && 20 * far <= compared, "{far} of {compared} places are far from the truth");
}

#[test]
fn a_controller_without_a_filter_publishes_no_belief() {
    let setting = Setting::new(&["--scenario", "hall", "--set", "control.belief=\"none\""]);
    let bus = setting.bus();
    let (beliefs, _beliefs) = collect::<BeliefReport>(&bus, &bus.room().belief());
    let (commands, _commands) = collect::<MirrorCommand>(&bus, &bus.room().command());
    wait_until("many commands", || commands.lock().expect("received").len() > 100);
    assert_eq!(beliefs.lock().expect("received").len(), 0);
    let summary = setting.controller.end().json();
    assert!(summary.get("belief").is_none(), "{summary}");
    assert!(setting.room.end().json().get("belief").is_none());
}

#[test]
fn the_metrics_compare_the_belief_with_the_reports_and_the_truth() {
    let setting = Setting::new(&FILTER);
    let [room_at, controller_at] = setting.metrics;
    wait_until("many compared places and reports", || {
        sample_value(&fetch_metrics(room_at), "heliostat_belief_places_total") > 1000.0
            && sample_value(&fetch_metrics(controller_at), "heliostat_belief_reports_total") > 500.0
    });
    let (room, controller) = (fetch_metrics(room_at), fetch_metrics(controller_at));
    let places = sample_value(&room, "heliostat_belief_places_total");
    let inside = |ellipse: &str| {
        let sample = format!("heliostat_belief_places_inside_total{{room=\"demo\",ellipse=\"{ellipse}\"}}");
        sample_value(&room, &sample) / places
    };
    println!("{places} places: {:.3} within 50 %, {:.3} within 95 %", inside("50"), inside("95"));
    assert!(inside("50") > 0.2 && inside("50") < 0.8, "{room}");
    assert!(inside("95") > 0.7 && inside("95") > inside("50"), "{room}");
    let mean = sample_value(&controller, "heliostat_belief_innovation_mean");
    println!("mean normalised innovation squared {mean:.2}");
    assert!(mean > 1.0 && mean < 4.0, "{controller}");
    assert!(sample_value(&controller, "heliostat_belief_reports_total") > 500.0, "{controller}");

    let summary = setting.controller.end().json();
    assert!(summary["belief"]["reports"].as_u64() > Some(500), "{summary}");
    let summary = setting.room.end().json();
    assert!(summary["belief"]["places"].as_u64() > Some(500), "{summary}");
}

#[test]
fn a_tracker_with_twice_the_stated_noise_shows_in_metrics_status_summary_and_doctor() {
    let rough = ["--set", "mismatch.level=rough", "--set", "mismatch.kinds=[\"tracker\"]"];
    let setting = Setting::new(&[&FILTER[..], &rough].concat());
    let noise = |by: &str| {
        let sample = format!("heliostat_tracker_position_noise_metres{{room=\"demo\",by=\"{by}\"}}");
        sample_value(&fetch_metrics(setting.metrics[1]), &sample)
    };
    wait_until("twice the stated noise", || noise("belief") > 1.7 * noise("scenario"));
    let observer = RoomObserver::connect("demo", &setting.endpoints.each_ref().map(String::as_str));
    let reported = || observer.status(NodeKind::Controller).as_ref().and_then(TrackerNoise::of);
    wait_until("the noise in the status", || {
        reported().is_some_and(|noise| noise.position_m > 1.7 * noise.position_stated_m)
    });
    let tracker = setting.doctor("tracker");
    assert_eq!(tracker["verdict"], "warn", "{tracker}");
    assert!(tracker["advice"].as_str().is_some_and(|advice| advice.contains("streams.positions.noise_m=0.")));
    let summary = setting.controller.end().json();
    assert!(summary["belief"]["noise"]["position_m"].as_f64() > Some(0.08), "{summary}");
}

#[test]
fn mirrors_out_of_place_are_a_problem_of_the_controller_with_the_time_since_when() {
    let out_of_place = ["--set", "actuator.offset_deg=2", "--set", "streams.channel.rate_hz=50"];
    let setting = Setting::new(&[&FILTER[..], &out_of_place].concat());
    let observer = RoomObserver::connect("demo", &setting.endpoints.each_ref().map(String::as_str));
    let mut problem = String::new();
    wait_until("a problem of the light", || {
        problem = observer.status(NodeKind::Controller).map_or(String::new(), |status| status.last_problem);
        problem.starts_with("the mirrors bring 0.")
    });
    assert!(problem.contains(" of the expected light since ") && problem.contains("heliostat calibrate"), "{problem}");
    let light = setting.doctor("light");
    assert_eq!(light["verdict"], "warn", "{light}");
    let led = "heliostat_light_off{room=\"demo\",of=\"led-0\"}";
    wait_until("enough ratios of the LED", || fetch_metrics(setting.metrics[1]).contains(led));
    let page = fetch_metrics(setting.metrics[1]);
    assert!(sample_value(&page, "heliostat_light_ratio{room=\"demo\",of=\"mirrors\"}") < 0.8, "{page}");
    assert_eq!(sample_value(&page, "heliostat_light_off{room=\"demo\",of=\"mirrors\"}"), 1.0, "{page}");
    assert_eq!(sample_value(&page, led), 0.0, "{page}");
    let summary = setting.controller.end().json();
    assert_eq!(summary["light"][0]["of"], "mirrors", "{summary}");
}

#[needs("browser")]
#[test]
fn the_page_draws_the_belief_of_each_user_until_it_is_switched_off() {
    let setting = Setting::new(&FILTER);
    let [room_at, controller_at] = setting.endpoints.each_ref().map(String::as_str);
    let server = PageServer::start(&[&["--connect", room_at, "--connect", controller_at][..], &FILTER].concat());
    let url = server.url();
    for (open, is_3d) in [(Browser::open as fn(&str) -> Browser, true), (Browser::open_flat, false)] {
        let browser = open(&url);
        let users = "return document.getElementById('room').room?.motion.to?.users ?? []";
        let believed = || {
            browser.run(users).as_array().is_some_and(|users| {
                !users.is_empty() && users.iter().all(|user| user["belief"]["semi_axes_m"].is_array())
            })
        };
        wait_until("a belief of each user", believed);
        // In a simulated room the frame holds the true place, so the distance is the error.
        let near = || {
            browser.run(users).as_array().is_some_and(|users| {
                users.iter().all(|user| {
                    let place = |at: &str, axis: usize| {
                        user.pointer(at).map_or(f64::NAN, |at| at[axis].as_f64().unwrap_or(f64::NAN))
                    };
                    let [dx, dy] = [0, 1].map(|axis| place("/at_m", axis) - place("/belief/at_m", axis));
                    dx.hypot(dy) < 0.5
                })
            })
        };
        wait_until("beliefs near the true places", near);
        let heading = || {
            browser.run(users).as_array().is_some_and(|users| {
                users.iter().any(|user| {
                    let [x, y] = [0, 1].map(|axis| user["belief"]["heading"][axis].as_f64().unwrap_or(0.0));
                    x.hypot(y) > 0.5
                })
            })
        };
        wait_until("a heading of a walking user", heading);
        let noise = "return [...document.querySelectorAll('#counts dfn')].some(({ textContent, title }) => \
                     textContent === 'tracker noise' && title.includes('the scenario states 5.0 cm'))";
        wait_until("the noise of the tracker", || browser.run(noise) == true);
        wait_until("the light of served users", || browser.text("#counts").contains("light received"));
        assert_eq!(browser.run("return document.documentElement.dataset.view") == "3d", is_3d);
        let drawn = "const { users } = document.getElementById('room').room.view.content; \
                     return [...users.values()].filter(({ belief }) => belief.visible).length";
        let marks = "return document.getElementById('room').room.view.content.headings.mesh.count";
        if is_3d {
            wait_until("ellipses and headings", || {
                browser.run(drawn).as_u64() > Some(0) && browser.run(marks).as_u64() > Some(0)
            });
        }
        assert_eq!(browser.run("return document.getElementById('show-belief').checked"), true);
        browser.run("document.getElementById('show-belief').click()");
        assert_eq!(browser.run("return document.getElementById('room').room.shown.belief"), false);
        if is_3d {
            wait_until("no ellipse and no heading", || browser.run(drawn) == 0 && browser.run(marks) == 0);
        }
        assert_eq!(browser.console_errors(), Vec::<String>::new());
    }
}
