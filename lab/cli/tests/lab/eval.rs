//! `heliostat-lab eval` on the command line.

mod differences;
mod html;
#[cfg(target_os = "linux")]
mod interrupted;
mod python_functions;
mod sweep;

use std::process::{Command, Output};

use serde_json::Value;

/// The arguments, in the small room of the studies unless they name another.
fn in_small_room<'a>(arguments: &[&'a str]) -> Vec<&'a str> {
    let room: &[&str] = if arguments.contains(&"--scenario") { &[] } else { &["--scenario", "specular"] };
    [room, arguments].concat()
}

fn eval(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heliostat-lab"));
    command.arg("eval").args(in_small_room(arguments)).output().expect("the program starts")
}

fn report(arguments: &[&str]) -> Value {
    let output = eval(&[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

fn refusal(arguments: &[&str]) -> String {
    let output = eval(arguments);
    assert!(!output.status.success() && output.stdout.is_empty(), "{arguments:?}");
    String::from_utf8(output.stderr).expect("text")
}

fn mean(report: &Value, policy: &str, figure: &str) -> f64 {
    report["policies"][policy][figure]["mean"].as_f64().unwrap_or_else(|| panic!("{policy} {figure} in {report}"))
}

/// The reproducible part of a report: everything except times, and the number of threads that disturb them.
fn without_times(mut report: Value) -> Value {
    report.as_object_mut().expect("an object").remove("threads");
    for row in report["policies"].as_object_mut().expect("an object").values_mut() {
        row.as_object_mut().expect("an object").remove("decision_us");
    }
    report
}

const NOISY: [&str; 2] = ["--set", "noise.variance_a2=6.5e-15"];

#[test]
fn policies_keep_their_order_below_the_oracle() {
    let flags = ["--policies", "oracle,greedy,fixed-point,random,flat,no-irs", "--states", "20", "--seeds", "2"];
    let report = report(&[&flags[..], &NOISY, &["--blocked", "2", "--seed", "7"]].concat());
    assert_eq!(
        (&report["scenario"], &report["mode"], &report["states"], &report["seed"], &report["blocked"]),
        (&"specular".into(), &"static".into(), &20.into(), &7.into(), &2.into())
    );
    for row in report["policies"].as_object().expect("an object").values().chain([&report["oracle"]]) {
        for figure in ["sum_rate_mbps", "ratio_to_oracle", "qos_met", "jain", "blocked_rate_mbps", "ber"] {
            for part in ["mean", "ci95", "p5"] {
                assert!(row[figure][part].is_f64(), "{figure}.{part} in {row}");
            }
        }
    }
    let ratio = |policy| mean(&report, policy, "ratio_to_oracle");
    assert_eq!(ratio("oracle"), 1.0);
    assert_eq!(report["oracle"]["ratio_to_oracle"]["mean"], 1.0);
    assert!(ratio("greedy") > 0.96 && ratio("fixed-point") > 0.9, "{} {}", ratio("greedy"), ratio("fixed-point"));
    assert!(ratio("flat") + 0.1 < ratio("fixed-point") && ratio("no-irs") <= ratio("flat"));
    // Of a hundred random mirrors almost none serves a user.
    assert!((ratio("random") - ratio("no-irs")).abs() < 0.02, "{} {}", ratio("random"), ratio("no-irs"));
    let times = &report["policies"]["greedy"]["decision_us"];
    assert!(times["p50"].as_f64() > Some(0.0) && times["p50"].as_f64() <= times["p99"].as_f64());
}

#[test]
fn the_same_seed_gives_the_same_figures_in_both_loops() {
    for extra in [&[][..], &["--closed-loop"]] {
        let flags = ["--policies", "greedy,random", "--states", "4", "--seeds", "2"];
        let run = |seed: &str| without_times(report(&[&flags[..], extra, &["--seed", seed]].concat()));
        let first = run("3");
        assert_eq!(first, run("3"), "{extra:?}");
        assert_ne!(first["policies"], run("30")["policies"], "{extra:?}");
    }
}

/// A policy continues from its last solution, so that the order of its states matters.
#[test]
fn any_number_of_threads_gives_the_same_figures() {
    for mode in [&["--states", "9"][..], &["--closed-loop", "--ceilings", "--episodes", "3"]] {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("episodes.csv");
        let run = |threads: &str| {
            let flags = ["--policies", "greedy,fixed-point,ddpg,random", "--seeds", "2", "--threads", threads];
            let files = ["--csv-episodes", file.to_str().expect("a plain path")];
            let figures = without_times(report(&[&flags[..], mode, &SMALL, &files].concat()));
            (figures, std::fs::read_to_string(&file).expect("readable"))
        };
        let one = run("1");
        assert!(one.0["policies"]["random"].is_object(), "{}", one.0);
        for threads in ["2", "5"] {
            assert!(run(threads) == one, "{mode:?} on {threads} threads");
        }
    }
    let message = refusal(&["--threads", "0"]);
    assert!(message.contains("--threads"), "{message}");
}

#[test]
fn decision_times_beside_other_threads_are_said_to_be_disturbed() {
    let closed_loop = ["--closed-loop", "--episodes", "2"];
    for (threads, mode, is_noted) in
        [("1", &closed_loop[..], false), ("2", &closed_loop[..], true), ("2", &["--states", "2"], false)]
    {
        let flags = [&["--policies", "nearest", "--seeds", "1", "--threads", threads], mode].concat();
        let table = String::from_utf8(eval(&flags).stdout).expect("text");
        assert_eq!(table.contains("--threads 1 measures them undisturbed"), is_noted, "{threads} {mode:?}: {table}");
        assert_eq!(report(&flags)["threads"].to_string(), threads);
    }
}

#[test]
fn spaces_around_the_names_of_policies_count_for_nothing() {
    let report = report(&["--policies", "greedy, flat", "--states", "1", "--seeds", "1"]);
    assert!(report["policies"]["flat"].is_object(), "{report}");
}

/// Exact reports and instant mirrors lose little; late and noisy reports lose more, a prediction
/// recovers a part, and the filter recovers most.
#[test]
fn a_closed_loop_loses_rate_with_late_reports() {
    let flags = [
        "--policies",
        "greedy",
        "--closed-loop",
        "--beliefs",
        "none,constant-velocity,filter",
        "--states",
        "60",
        "--seeds",
        "1",
    ];
    let exact = report(&flags);
    let hall = report(&[&flags[..], &["--scenario", "hall"]].concat());
    let [exact, late, predicted, filtered] =
        [(&exact, "none"), (&hall, "none"), (&hall, "constant-velocity"), (&hall, "filter")]
            .map(|(report, belief)| mean(report, &format!("greedy+{belief}"), "ratio_to_oracle"));
    assert!(exact > 0.95 && late < exact - 0.02, "{exact} {late}");
    assert!(predicted > late && filtered > predicted + 0.02, "{late} {predicted} {filtered}");
    let met = mean(&hall, "greedy+filter", "qos_met");
    assert!((mean(&hall, "greedy+filter", "outage_time") - (1.0 - met)).abs() < 1e-12);
    let outages = |belief: &str| &hall["policies"][format!("greedy+{belief}")]["outages"];
    let [often, long] =
        ["per_user_minute", "p95_s"].map(|figure| outages("filter")[figure].as_f64().expect("a figure"));
    assert!(often > 1.0 && long > 0.02, "{often} {long}");
    assert!(hall["oracle"].get("outages").is_none(), "the oracle is solved at the instants only");
}

#[test]
fn a_policy_that_knows_the_true_room_is_above_one_with_reports() {
    let flags = ["--closed-loop", "--scenario", "hall", "--states", "60", "--seeds", "1", "--policies", "greedy,flat"];
    let compared = report(&[&flags[..], &["--ceilings"]].concat());
    let [reports, present, future] =
        ["greedy", "greedy+true-present", "greedy+true-future"].map(|name| mean(&compared, name, "ratio_to_oracle"));
    assert!(reports < present && present < future && future < 1.001, "{reports} {present} {future}");
    assert!(compared["policies"].get("flat+true-present").is_none(), "flat mirrors observe nothing");
    assert!(compared["policies"]["greedy+true-present"].get("decision_us").is_none());
    let has_difference = ["greedy", "flat", "greedy+true-present", "greedy+true-future"]
        .map(|name| compared["policies"][name].get("difference_to_best").is_some());
    assert_eq!(has_difference, [false, true, false, false], "the best policy is one that observes reports: {compared}");
}

/// In the recording the user stands near the mirrors, then in a far corner.
#[test]
fn episodes_of_a_recorded_walk_see_different_parts_of_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let (room, walk) = (folder.path().join("room.toml"), folder.path().join("walk.csv"));
    std::fs::write(&walk, "time,user,x,y\n0,0,0,2\n100,0,0,2\n101,0,-2,-2\n200,0,-2,-2\n").expect("writable");
    let text = "[users]\ncount = 1\ntrace = \"walk.csv\"\n[blockage]\nobstacles_per_m2 = 0\nbodies = false\n";
    std::fs::write(&room, text).expect("writable");
    let room = room.to_str().expect("a plain path");
    let flags = ["--closed-loop", "--scenario", room, "--policies", "greedy", "--states", "80", "--seeds", "2"];
    let first = without_times(report(&flags));
    let rate = &first["oracle"]["sum_rate_mbps"];
    let part = |part: &str| rate[part].as_f64().expect("a rate");
    assert!(part("ci95") > 0.05 * part("mean") && part("p5") < 0.95 * part("mean"), "{rate}");
    assert_eq!(first, without_times(report(&flags)), "the same seed sees the same parts");
}

/// Two names of one actor have equal rates.
#[test]
fn a_policy_that_is_not_told_apart_from_the_best_is_marked() {
    let folder = tempfile::tempdir().expect("a folder");
    let html = folder.path().join("report.html");
    let flags = ["--policies", "flat,ddpg,actor", "--training-seed", "1", "--states", "20", "--seeds", "1"];
    let flags = [&flags[..], &["--html", html.to_str().expect("a plain path")]].concat();
    let compared = report(&flags);
    let difference = |policy: &str| compared["policies"][policy]["difference_to_best"]["mean"].as_f64();
    assert_eq!((difference("ddpg"), difference("actor")), (None, Some(0.0)), "{compared}");
    assert!(difference("flat").is_some_and(|mean| mean < -0.1), "{compared}");
    let table = String::from_utf8(eval(&flags).stdout).expect("text");
    let marked: Vec<&str> = table.lines().filter(|line| line.contains('~')).collect();
    let [row, note] = marked[..] else { panic!("{table}") };
    assert!(row.starts_with("actor ~ ") && note.starts_with("~: not distinguishable from the best: "), "{table}");
    let page = std::fs::read_to_string(&html).expect("readable");
    assert!(page.contains("<th>actor ~</th>") && page.contains("<th>ddpg</th>"), "{page}");
}

#[test]
fn a_single_state_has_no_interval_and_marks_no_policy() {
    let output = eval(&["--policies", "fixed-point,flat", "--states", "1", "--seeds", "1"]);
    let table = String::from_utf8(output.stdout).expect("text");
    assert!(table.contains("1 state gives no confidence interval") && !table.contains('~'), "{table}");
}

#[test]
fn a_closed_loop_measures_the_beliefs_themselves() {
    let flags = ["--closed-loop", "--scenario", "hall", "--policies", "greedy,flat", "--states", "60", "--seeds", "1"];
    let flags = [&flags[..], &["--beliefs", "none,constant-velocity,filter"]].concat();
    let compared = report(&flags);
    let of = |belief: &str, figure: &str| {
        let figure = &compared["beliefs"][belief][figure];
        figure["mean"].as_f64().or(figure.as_f64()).unwrap_or(f64::NAN)
    };
    // Reports are 100 ms old, and walking users cross some decimetres until the command acts.
    let [none, predicted, filtered] =
        ["none", "constant-velocity", "filter"].map(|belief| of(belief, "place_error_cm"));
    assert!(none > predicted && predicted > filtered + 1.0 && filtered > 1.0, "{none} {predicted} {filtered}");
    let (median, half, most) =
        (of("filter", "place_error_median_cm"), of("filter", "coverage_50"), of("filter", "coverage_95"));
    assert!(median < filtered && half > 0.3 && half < 0.8 && most > half && most > 0.8, "{median} {half} {most}");
    assert!(of("none", "coverage_50").is_nan(), "reported places have no covariance");
    let walking = of("filter", "heading_error_walking_deg");
    assert!(walking > 1.0 && walking < 45.0, "{walking}");
    assert!(of("filter", "heading_error_standing_deg").is_nan(), "users of the random walk do not stand");
    let table = String::from_utf8(eval(&flags).stdout).expect("text");
    assert!(table.contains("belief about the users") && table.contains("place, median (cm)"), "{table}");
    let static_loop = report(&["--policies", "flat", "--states", "2", "--seeds", "1"]);
    assert!(static_loop.get("beliefs").is_none(), "{static_loop}");
}

#[test]
fn the_exhaustive_search_agrees_with_the_oracle_in_a_small_room() {
    let small = ["--set", "mirrors.rows=3", "--set", "mirrors.columns=3", "--set", "users.count=3"];
    let flags = ["--policies", "exhaustive", "--states", "10", "--seeds", "1"];
    let report = report(&[&flags[..], &small].concat());
    let ratio = mean(&report, "exhaustive", "ratio_to_oracle");
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    let message = refusal(&["--policies", "exhaustive", "--states", "2", "--seeds", "1"]);
    assert!(message.contains("exhaustive") && message.contains("assignments"), "{message}");
}

#[test]
fn several_arrays_are_evaluated_static_and_in_closed_loop() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("two.toml");
    let array = |wall: &str| format!("[[mirrors]]\nrows = 5\ncolumns = 5\nwall = \"{wall}\"\n");
    let write = |text: &str| std::fs::write(&file, text).expect("written");
    let obstacles = "[streams.obstacles]\nrate_hz = 0.0\n";
    let scenario = ["--scenario", file.to_str().expect("a plain path")];
    for mode in [&["--states", "20"][..], &["--closed-loop", "--states", "20"]] {
        let flags = [&["--policies", "greedy,flat", "--seeds", "1"], &scenario[..], mode].concat();
        write(&[&array("+y"), obstacles].concat());
        let one = report(&flags);
        write(&[&array("+y"), &array("-x"), obstacles].concat());
        let two = report(&flags);
        let rate = |report: &Value| mean(report, "greedy", "sum_rate_mbps");
        assert!(rate(&two) > 1.01 * rate(&one), "{} and {}", rate(&one), rate(&two));
        assert!(mean(&two, "greedy", "sum_rate_mbps") > mean(&two, "flat", "sum_rate_mbps"));
    }
    let message = refusal(&[&["--policies", "ddpg-raw"], &scenario[..]].concat());
    assert!(message.contains("5x5-5x5"), "{message}");
    let trained = Command::new(env!("CARGO_BIN_EXE_heliostat-lab")).args(["train", "ddpg"]).args(scenario).output();
    let message = String::from_utf8(trained.expect("it runs").stderr).expect("text");
    assert!(message.contains("2 mirror arrays") && message.contains("trained in a room with one array"), "{message}");
}

#[test]
fn a_csv_has_a_line_for_each_policy() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("figures.csv");
    let path = file.to_str().expect("a plain path");
    let output = eval(&["--policies", "flat,nearest", "--states", "3", "--seeds", "1", "--csv", path]);
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains("nearest"));
    let text = std::fs::read_to_string(&file).expect("readable");
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].starts_with("policy,sum_rate_mbps_mean,sum_rate_mbps_ci95,sum_rate_mbps_p5,ratio_to_oracle_mean"));
    let names: Vec<_> = lines[1..].iter().map(|line| line.split(',').next()).collect();
    assert_eq!(names, [Some("(oracle)"), Some("flat"), Some("nearest")]);
    assert!(lines.iter().all(|line| line.split(',').count() == lines[0].split(',').count()));
}

#[test]
fn the_default_policies_are_those_that_fit() {
    let of = |array: &[&str]| {
        let report = report(&[&["--states", "2", "--seeds", "1"], array].concat());
        report["policies"].as_object().expect("an object").len()
    };
    let odd = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=5"];
    assert_eq!((of(&[]), of(&odd)), (7, 7), "the actor of ddpg serves every array");
}

#[test]
fn an_unknown_policy_is_refused_with_the_known_ones() {
    let message = refusal(&["--policies", "greedy,gredy"]);
    assert!(message.contains("\"gredy\"") && message.ends_with("; a similar name exists: greedy\n"), "{message}");
    let message = refusal(&["--policies", "greedy", "--set", "users.cont=3"]);
    assert!(message.contains("unknown field `cont`") && message.contains("a similar name exists: count"), "{message}");
    let message = refusal(&["--policies", "nowhere.onnx"]);
    assert!(message.contains("nowhere.onnx") && message.contains("heliostat-lab train"), "{message}");
    let message = refusal(&["--policies", "ddpg-raw", "--set", "mirrors.rows=2", "--set", "mirrors.columns=5"]);
    assert!(message.contains("2x5") && message.contains("fixed-point"), "{message}");
    let message = refusal(&["--blocked", "6"]);
    assert!(message.contains("forced_users"), "{message}");
    let message = refusal(&["--policies", "flat,flat"]);
    assert!(message.contains("twice"), "{message}");
}

/// The actors of a policy for the default array, of all training seeds.
fn built_in(policy: &str) -> usize {
    let folders =
        ["/../../models/actors", "/../../lab/actors"].map(|folder| [env!("CARGO_MANIFEST_DIR"), folder].concat());
    let entries = folders.iter().flat_map(|folder| std::fs::read_dir(folder).expect("the folder"));
    let names = entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("a plain name"));
    names.filter(|name| name.starts_with(&format!("{policy}-specular")) && name.ends_with(".onnx")).count()
}

#[test]
fn a_learned_policy_uses_all_training_seeds_unless_one_is_chosen() {
    let flags = ["--policies", "analytic,flat", "--states", "10", "--seeds", "1"];
    let of = |extra: &[&str]| report(&[&flags[..], extra].concat());
    let (all, first) = (of(&[]), of(&["--training-seed", "1"]));
    assert_eq!(all["policies"]["analytic"]["training_seeds"], built_in("analytic"));
    assert_eq!(first["policies"]["analytic"]["training_seeds"], 1);
    assert!(all["policies"]["flat"]["training_seeds"].is_null());
    let above_flat = |report| mean(report, "analytic", "ratio_to_oracle") - mean(report, "flat", "ratio_to_oracle");
    assert!(above_flat(&all) > 0.1 && above_flat(&first) > 0.1);
    let message = refusal(&["--policies", "analytic", "--training-seed", "9"]);
    assert!(message.contains("seed9") && message.contains("heliostat-lab train analytic"), "{message}");
}

#[test]
fn stuck_mirrors_lower_the_rate_and_an_unaware_policy_meets_fewer_minimum_rates() {
    let flags = ["--closed-loop", "--policies", "fixed-point", "--states", "20", "--seeds", "1", "--unaware"];
    let room = ["--set", "actuator.profile=mems", "--set", "blockage.forced_users=5"];
    let flags = [&flags[..], &room, &["--sweep", "actuator.stuck_share=0,0.5"]].concat();
    let all = report(&flags);
    let of = |index: usize, policy: &str, figure: &str| mean(&all["reports"][index]["report"], policy, figure);
    for figure in ["sum_rate_mbps", "qos_met"] {
        assert_eq!(
            of(0, "fixed-point", figure),
            of(0, "fixed-point-unaware", figure),
            "without stuck mirrors both are equal"
        );
    }
    assert!(of(1, "fixed-point", "sum_rate_mbps") < 0.8 * of(0, "fixed-point", "sum_rate_mbps"), "{all}");
    assert!(of(1, "fixed-point", "qos_met") > of(1, "fixed-point-unaware", "qos_met") + 0.05, "{all}");
    let table = String::from_utf8(eval(&flags).stdout).expect("text");
    assert!(table.contains("sum rate in Mbit/s") && table.contains("fixed-point-unaware"), "{table}");
}

#[test]
fn one_seed_has_no_interval_and_the_table_says_so() {
    let calibrate = ["calibrate", "--seeds", "1", "--episodes", "1", "--set", "mismatch.level=rough"];
    let small = ["--set", "mirrors.rows=4", "--set", "mirrors.columns=4"];
    let run = |arguments: &[&str]| Command::new(env!("CARGO_BIN_EXE_heliostat-lab")).args(arguments).output();
    for output in [
        eval(&["--policies", "flat", "--states", "2", "--seeds", "1", "--closed-loop"]),
        run(&[&calibrate[..], &small].concat()).expect("the program starts"),
    ] {
        let text = String::from_utf8(output.stdout).expect("text");
        assert!(output.status.success() && !text.contains("NaN"), "{text}");
        assert!(text.contains("gives no confidence interval: use") && text.contains("--seeds 2 or more"), "{text}");
        assert!(!text.contains("1 seeds") && !text.contains("1 arrays"), "{text}");
    }
}

#[test]
fn a_comparison_that_fails_leaves_no_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let csv = folder.path().join("figures.csv");
    let csv = csv.to_str().expect("a plain path");
    for unread in [["--policies", "own.onnx"], ["--model", "own.onnx"]] {
        let output = eval(&[&unread[..], &["--states", "1", "--seeds", "1", "--csv", csv]].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{unread:?}: {errors}");
        assert!(errors.contains("no actor at own.onnx"), "{errors}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
}

#[test]
fn paths_draw_users_as_they_are_and_as_a_filter_predicts_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("users.svg");
    let paths = ["--paths", file.to_str().expect("text")];
    let flags = ["--scenario", "hall", "--closed-loop", "--policies", "greedy", "--states", "20", "--seeds", "1"];
    let refused = refusal(&[&flags[..], &["--beliefs", "constant-velocity"], &paths].concat());
    assert!(refused.contains("no policy predicts users") && !file.exists(), "{refused}");
    let drawn = |users: &str| {
        report(&[&flags[..], &["--set", users], &paths].concat());
        let svg = std::fs::read_to_string(&file).expect("the picture");
        let points = |line: &str| line.split("points=").nth(1).map_or(0, |points| points.split(' ').count());
        // A path has a point for each of at least 50 decisions, an ellipse 33, an arrow 5.
        svg.lines().filter(|line| line.contains("<polyline") && points(line) > 50).count()
    };
    assert_eq!([drawn("users.count=1"), drawn("users.count=3")], [2, 6], "a true and a predicted path of each user");
}

const SMALL: [&str; 6] = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=3", "--set", "users.count=2"];

#[test]
fn a_table_states_its_episodes_and_warns_where_they_are_few_or_an_interval_reaches_too_far() {
    let closed = ["--closed-loop", "--scenario", "hall", "--policies", "flat"];
    let table = |flags: &[&str]| String::from_utf8(eval(&[&closed[..], flags].concat()).stdout).expect("text");
    let few = table(&["--states", "40", "--seeds", "1"]);
    assert!(few.contains("2 episodes of the seed 1, 20 states each within 5 s"), "{few}");
    assert!(few.contains("2 episodes in all, too few to rely on them: use --episodes 10 or more"), "{few}");
    assert!(few.contains("*: the interval reaches beyond") && few.matches('*').count() > 1, "{few}");
    let many = table(&["--episodes", "5", "--seeds", "2"]);
    assert!(many.contains("10 episodes: 5 for each of 2 seeds from 1, 20 states each within 5 s"), "{many}");
    assert!(!many.contains("warning: the intervals"), "{many}");
    assert!(many.contains("sampled every 20 ms; each ends with its episode of 5 s"), "{many}");
    assert!(many.contains("share of time: mean share of users below"), "{many}");
    let message = refusal(&["--policies", "flat", "--episodes", "2", "--states", "40"]);
    assert!(message.contains("--states"), "{message}");
    let of_states = report(&[&["--policies", "flat", "--episodes", "3", "--seeds", "2"][..], &SMALL].concat());
    assert_eq!((&of_states["states"], &of_states["episodes"]), (&3.into(), &6.into()));
}

#[test]
fn conditions_that_change_a_figure_are_printed_and_are_in_each_form() {
    let folder = tempfile::tempdir().expect("a folder");
    let (html, csv) = (folder.path().join("report.html"), folder.path().join("figures.csv"));
    let flags = ["--closed-loop", "--scenario", "hall", "--policies", "pso,flat", "--episodes", "1", "--seeds", "2"];
    let room = ["--set", "mismatch.level=typical", "--set", "control.search_time_us=50", "--set", "users.count=2"];
    let deadline = ["--set", "control.deadline_ms=0.5"];
    let files = ["--html", html.to_str().expect("a plain path"), "--csv", csv.to_str().expect("a plain path")];
    let flags = [&flags[..], &room, &deadline, &files].concat();
    let compared = report(&flags);
    let found: Vec<&str> =
        compared["conditions"].as_array().expect("a list").iter().filter_map(|one| one["because"].as_str()).collect();
    let expected = ["mismatch.level = \"typical\"", "control.deadline_ms = 0.5", "control.search_time_us = 50"];
    assert_eq!(found, expected);
    let table = String::from_utf8(eval(&flags).stdout).expect("text");
    let [page, text] = [&html, &csv].map(|file| std::fs::read_to_string(file).expect("readable"));
    for part in ["the channel model of belief and policies does not apply", "the promise of equal runs of pso"] {
        assert!(table.contains(&format!("condition: {part}")) && page.contains(part), "{part}: {table}");
        assert_eq!(text.matches(part).count(), 3, "in the line of the oracle and of each policy: {text}");
    }
    assert!(text.lines().next().is_some_and(|header| header.ends_with(",conditions")), "{text}");
    let swept = String::from_utf8(eval(&[&flags[..], &["--sweep", "blockage.forced_users=0,1"]].concat()).stdout)
        .expect("text");
    for printed in [table, swept] {
        let is_condition: Vec<bool> = printed.lines().map(|line| line.starts_with("condition: ")).collect();
        let first_figures = is_condition.iter().position(|found| !found).expect("tables");
        assert!(
            first_figures > 0 && !is_condition[first_figures..].contains(&true),
            "conditions come first: {printed}"
        );
    }
}

#[test]
fn a_range_that_leaves_places_without_light_is_a_condition_of_exact_states_too() {
    let few = ["--scenario", "specular", "--policies", "flat", "--states", "2", "--seeds", "1"];
    let found = report(&[&few[..], &["--set", "control.range_deg=12"]].concat());
    let because = found["conditions"][0]["because"].as_str().expect("a condition");
    assert!(because.starts_with("control.range_deg = 12.0, within which mirrors reach 91 % of the floor"), "{found}");
    assert!(report(&few)["conditions"].is_null());
}
