//! `heliostat-lab eval --sweep`: one and two keys, and points that have different policies.

use super::{eval, mean, refusal, report};

/// Evaluates two sizes of the array, of which the second one has an actor of `ddpg-raw`; returns the text and
/// the cells of the CSV file.
fn evaluated(policies: &str) -> (String, Vec<Vec<String>>) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("figures.csv");
    let few = ["--states", "3", "--seeds", "1", "--fitting", "--csv", file.to_str().expect("a plain path")];
    let points = ["--policies", policies, "--sweep", "mirrors.rows=2,10", "--set", "mirrors.columns=10"];
    let output = eval(&[&few[..], &points].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(&file).expect("readable");
    let cells = text.lines().map(|line| line.split(',').map(String::from).collect()).collect();
    (String::from_utf8(output.stdout).expect("text"), cells)
}

/// The difference of the sum rate in the line that begins with these cells.
fn difference<'a>(lines: &'a [Vec<String>], rows: &str, policy: &str) -> &'a str {
    let column = lines[0].iter().position(|name| name == "difference_mbps_mean").expect("differences");
    let line = lines.iter().find(|line| line[..2] == [rows, policy]).expect("a line");
    &line[column]
}

/// The cells of a point in the table of the differences of the sum rate.
fn row<'a>(text: &'a str, rows: &str) -> Vec<&'a str> {
    let table = text.split("paired: sum rate in Mbit/s").nth(1).expect("a table");
    let cells = |line: &'a str| line.split_whitespace().filter(|cell| !cell.starts_with('±')).collect::<Vec<_>>();
    table.lines().map(cells).find(|cells| cells.first() == Some(&rows)).expect("a row")
}

#[test]
fn a_sweep_whose_first_point_has_one_policy_has_all_columns() {
    let (text, lines) = evaluated("ddpg-raw,flat");
    assert!(lines.iter().all(|line| line.len() == lines[0].len()), "{lines:?}");
    assert_eq!(lines.len(), 1 + 2 + 3);
    assert_eq!((difference(&lines, "2", "flat"), difference(&lines, "10", "ddpg-raw")), ("", ""));
    assert!(difference(&lines, "10", "flat").parse::<f64>().is_ok(), "{lines:?}");
    assert!(text.contains("difference to ddpg-raw, paired: sum rate"), "{text}");
    let second = row(&text, "10");
    assert_eq!((row(&text, "2"), second.len()), (vec!["2", "-", "-", "-"], 4), "{text}");
}

#[test]
fn a_point_that_subtracts_another_policy_has_no_difference_in_a_sweep() {
    let (text, lines) = evaluated("ddpg-raw,greedy,flat");
    assert!(difference(&lines, "2", "flat").parse::<f64>().is_ok(), "{lines:?}");
    assert_eq!(difference(&lines, "10", "flat"), "");
    assert!(text.contains("difference to greedy, paired: sum rate"), "{text}");
    assert_eq!(row(&text, "10"), ["10", "-", "-", "-", "-"], "{text}");
}

/// Two names of one actor have equal rates.
#[test]
fn a_point_marks_the_policies_that_are_not_told_apart_from_its_best() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("figures.csv");
    let flags = ["--policies", "flat,ddpg,actor", "--training-seed", "1", "--states", "20", "--seeds", "1"];
    let files = ["--sweep", "users.count=2,5", "--csv", file.to_str().expect("a plain path")];
    let output = eval(&[&flags[..], &files].concat());
    let text = String::from_utf8(output.stdout).expect("text");
    let marked: Vec<&str> = text.lines().filter(|line| line.contains('~')).collect();
    let [first, second, note] = marked[..] else { panic!("{text}") };
    assert!([first, second].iter().all(|line| line.ends_with(" ~") && line.matches('~').count() == 1), "{text}");
    assert!(note.starts_with("~: not distinguishable from the best: "), "{text}");
    let csv = std::fs::read_to_string(&file).expect("readable");
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    let column = lines[0].iter().position(|name| *name == "difference_to_best_mean").expect("differences");
    for line in &lines[1..] {
        match line[1] {
            "actor" => assert_eq!(line[column..column + 2], ["0", "0"], "{csv}"),
            "flat" => assert!(line[column].parse::<f64>().is_ok_and(|mean| mean < -0.1), "{csv}"),
            _ => assert_eq!(line[column], "", "{csv}"),
        }
    }
}

#[test]
fn a_sweep_has_a_report_for_each_value_of_its_key() {
    let flags = ["--policies", "ddpg,flat", "--states", "3", "--seeds", "1", "--sweep", "users.count=1..3"];
    let sweep = report(&flags);
    assert_eq!(sweep["keys"], serde_json::json!(["users.count"]));
    let reports = sweep["reports"].as_array().expect("a list");
    assert_eq!(reports[1]["values"], serde_json::json!(["2"]));
    let users: Vec<_> = reports.iter().map(|entry| entry["report"]["users"].as_u64()).collect();
    assert_eq!(users, [Some(1), Some(2), Some(3)]);
    let output = eval(&flags);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    let points: Vec<&str> = errors.lines().filter(|line| line.starts_with("eval: ")).collect();
    let expected = [1, 2, 3].map(|users| format!("eval: {users} of 3: users.count = {users}"));
    assert_eq!(points, expected, "{errors}");
    let text = String::from_utf8(output.stdout).expect("text");
    let heads = ["ratio to the oracle", "sum rate in Mbit/s", "warning: the intervals come from 3 states"];
    assert_eq!(text.lines().filter(|line| heads.iter().any(|head| line.starts_with(head))).count(), 3, "{text}");
    let message = refusal(&["--sweep", "users.count=0..2", "--policies", "flat"]);
    assert!(message.contains("users.count"), "{message}");
    let message = refusal(&["--sweep", "users.count", "--policies", "flat"]);
    assert!(message.contains("FIRST..LAST"), "{message}");
}

/// Machines share the seeds of a comparison: docs/evaluation.md.
#[test]
fn commands_of_one_seed_give_together_the_episodes_of_one_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("episodes.csv");
    let episodes = |seed: &str, seeds: &str| -> Vec<Vec<String>> {
        let flags = ["--closed-loop", "--scenario", "hall", "--policies", "flat", "--episodes", "1"];
        let of_seeds = ["--seed", seed, "--seeds", seeds, "--csv-episodes", file.to_str().expect("a plain path")];
        report(&[&flags[..], &of_seeds].concat());
        let text = std::fs::read_to_string(&file).expect("readable");
        let names: Vec<&str> = text.lines().next().expect("a head").split(',').collect();
        let lines = text.lines().skip(1).map(|line| {
            let cells = names.iter().zip(line.split(',')).filter(|(name, _)| **name != "configuration");
            cells.map(|(_, cell)| cell.to_owned()).collect::<Vec<String>>()
        });
        lines.collect()
    };
    let mut together = episodes("5", "2");
    let mut apart = [episodes("5", "1"), episodes("6", "1")].concat();
    together.sort();
    apart.sort();
    assert_eq!(together.len(), 4, "the oracle and a policy, for each seed");
    assert_eq!(apart, together);
}

#[test]
fn two_keys_give_each_combination_with_its_outage_and_a_room_without_mirrors() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name).to_str().expect("a plain path").to_owned();
    let (csv, episodes, html) = (file("figures.csv"), file("episodes.csv"), file("report.html"));
    let flags = ["--closed-loop", "--scenario", "hall", "--policies", "greedy,flat", "--episodes", "1", "--seeds", "2"];
    let sweeps = ["--sweep", "mirrors.rows=0,3", "--sweep", "blockage.forced_users=0,2", "--set", "mirrors.columns=3"];
    let files = ["--csv", &csv, "--csv-episodes", &episodes, "--html", &html];
    let flags = [&flags[..], &sweeps[..]].concat();
    let all = report(&[&flags[..], &files[..]].concat());
    let reports = all["reports"].as_array().expect("a list");
    assert_eq!((reports.len(), &all["keys"][1]), (4, &"blockage.forced_users".into()));
    assert_eq!(reports[2]["values"], serde_json::json!(["3", "0"]));
    for entry in reports {
        let report = &entry["report"];
        assert_eq!((&report["episodes"], report["commit"].is_string()), (&2.into(), true), "{report}");
        let none = report["mirrors"] == 0;
        assert_eq!(none, entry["values"][0] == "0");
        let rate = |policy: &str| mean(report, policy, "sum_rate_mbps");
        assert_eq!(rate("greedy") == rate("flat"), none, "without mirrors all policies are equal: {report}");
        // The world moves in other parts, so that its last digits differ.
        let is_best = (mean(report, "greedy", "ratio_to_oracle") - 1.0).abs() < 1e-6;
        assert_eq!(none, is_best, "and equal to the oracle: {report}");
        assert_eq!(none, report["configuration"].as_str().expect("a hash").contains("without mirrors"));
    }
    let lines = |path: &str| -> Vec<String> {
        std::fs::read_to_string(path).expect("readable").lines().map(String::from).collect()
    };
    let figures = lines(&csv);
    assert!(figures[0].starts_with("mirrors.rows,blockage.forced_users,policy,sum_rate_mbps_mean"), "{}", figures[0]);
    assert!(figures[0].ends_with("episodes,scenario,configuration,commit,conditions"), "{}", figures[0]);
    assert_eq!(figures.len(), 1 + 4 * 3);
    let column = figures[0].split(',').position(|name| name == "difference_outage_time_mean").expect("differences");
    let of = |policy: &str| figures.iter().find(|line| line.starts_with(&format!("3,2,{policy},"))).expect("a line");
    let cell = |policy: &str| of(policy).split(',').nth(column).expect("a cell");
    let expected = &reports[3]["report"]["policies"]["flat"]["difference_outage_time"]["mean"];
    assert_eq!((cell("greedy"), cell("flat").parse().ok()), ("", expected.as_f64()), "{figures:?}");
    let each = lines(&episodes);
    assert!(each[0].starts_with("mirrors.rows,blockage.forced_users,policy,actor,seed,room_seed,states,sum_rate_mbps"));
    assert_eq!(each.len(), 1 + 4 * 3 * 2, "a line for each point, policy and episode");
    assert!(each.iter().all(|line| line.split(',').count() == each[0].split(',').count()));
    // The mean over the episodes is that of the table.
    let column = each[0].split(',').position(|name| name == "outage_time").expect("outages");
    let of_flat = each.iter().filter(|line| line.starts_with("3,2,flat,"));
    let shares: Vec<f64> = of_flat.map(|line| line.split(',').nth(column).unwrap().parse().unwrap()).collect();
    let expected = mean(&reports[3]["report"], "flat", "outage_time");
    assert!(shares.len() == 2 && (0.5 * (shares[0] + shares[1]) - expected).abs() < 1e-9, "{shares:?} {expected}");
    // So is the rate of outages, weighted by the last column.
    let column = each[0].split(',').position(|name| name == "outages_per_user_minute").expect("outages");
    assert!(each[0].ends_with("commit,user_minutes"), "{}", each[0]);
    let (mut outages, mut minutes) = (0.0, 0.0);
    for line in each.iter().filter(|line| line.starts_with("3,2,flat,")) {
        let cell =
            |index: usize| line.split(',').nth(index).and_then(|text| text.parse::<f64>().ok()).expect("a number");
        let weight = cell(line.split(',').count() - 1);
        (outages, minutes) = (outages + weight * cell(column), minutes + weight);
    }
    let expected = &reports[3]["report"]["policies"]["flat"]["outages"];
    assert!((outages / minutes - expected["per_user_minute"].as_f64().expect("a rate")).abs() < 1e-9, "{expected}");
    assert!((minutes - expected["user_minutes"].as_f64().expect("a time")).abs() < 1e-9, "{expected}");
    let page = std::fs::read_to_string(&html).expect("readable");
    assert!(page.contains("blockage.forced_users = 2") && page.contains("outage (share of the users"), "panels");
    assert!(page.contains("<p class=\"note\">warning: the intervals come from 2 episodes"), "{page}");
    let text = String::from_utf8(eval(&flags).stdout).expect("text");
    assert!(text.contains("outage: share of the users' time"), "{text}");
    assert!(text.contains("2 episodes: 1 for each of 2 seeds from"), "{text}");
    assert!(text.contains("difference to greedy, paired: outage"), "{text}");
    let intervals = |table: &str, point: [&str; 2]| {
        let mut lines = text.split(table).nth(1).expect("a table").lines();
        let line = lines.find(|line| line.split_whitespace().take(2).eq(point)).expect("a row");
        line.matches('±').count()
    };
    // The oracle has no ratio, and each policy has two figures in the first table.
    assert_eq!(intervals("share of minimum rates met", ["3", "2"]), 1 + 2 * 2, "{text}");
    assert_eq!(intervals("sum rate in Mbit/s", ["3", "2"]), 3, "{text}");
    let first = "difference to mirrors.rows = 0, blockage.forced_users = 0, paired by episode: sum rate in Mbit/s";
    assert_eq!([["0", "0"], ["3", "2"]].map(|point| intervals(first, point)), [0, 3], "{text}");
    assert!(reports[0].get("difference_to_first").is_none(), "{}", reports[0]);
    for policy in ["greedy", "flat"] {
        for (index, figure) in
            (1..4).flat_map(|index| ["sum_rate_mbps", "qos_met", "outage_time"].map(|one| (index, one)))
        {
            let found = reports[index]["difference_to_first"]["policies"][policy][figure]["mean"].as_f64();
            let [own, first] = [index, 0].map(|point| mean(&reports[point]["report"], policy, figure));
            assert!((found.expect("a difference") - (own - first)).abs() < 1e-9, "{policy}, {figure} at {index}");
            let each = &reports[index]["report"]["each"]["policies"][policy][figure][0];
            assert_eq!(each.as_array().map(Vec::len), Some(2), "a value for each episode: {each}");
        }
    }
    assert!(reports[0].get("difference_along").is_none(), "{}", reports[0]);
    for (key, base) in [("mirrors.rows", 1), ("blockage.forced_users", 2)] {
        let found = reports[3]["difference_along"][key]["policies"]["flat"]["sum_rate_mbps"]["mean"].as_f64();
        let [own, base] = [3, base].map(|point: usize| mean(&reports[point]["report"], "flat", "sum_rate_mbps"));
        assert!((found.expect("a difference") - (own - base)).abs() < 1e-9, "{key}: {}", reports[3]);
    }
    assert!(reports[2]["difference_along"].get("blockage.forced_users").is_none(), "the first value of this key");
    // The file has the differences of the tables, with their intervals.
    for (column, at) in [
        ("difference_to_first_outage_time", "/difference_to_first/policies/flat/outage_time"),
        ("difference_along_mirrors.rows_sum_rate_mbps", "/difference_along/mirrors.rows/policies/flat/sum_rate_mbps"),
        (
            "difference_along_blockage.forced_users_qos_met",
            "/difference_along/blockage.forced_users/policies/flat/qos_met",
        ),
    ] {
        for part in ["mean", "ci95", "p5"] {
            let name = format!("{column}_{part}");
            let column = figures[0].split(',').position(|found| found == name).expect("a column");
            let cell = |point: &str, policy: &str| {
                let line = figures.iter().find(|line| line.starts_with(&format!("{point},{policy},"))).expect("a line");
                line.split(',').nth(column).expect("a cell").parse::<f64>().ok()
            };
            let expected = reports[3].pointer(&format!("{at}/{part}")).and_then(serde_json::Value::as_f64);
            let both = cell("3,2", "flat").zip(expected);
            assert!(both.is_some_and(|(found, expected)| (found - expected).abs() < 1e-9), "{name}: {}", reports[3]);
            assert!(cell("3,2", "(oracle)").is_some() && cell("0,0", "flat").is_none(), "{name}: {figures:?}");
        }
    }
    let along =
        "difference to mirrors.rows = 0 with the same blockage.forced_users, paired by episode: sum rate in Mbit/s";
    assert_eq!([["0", "2"], ["3", "2"]].map(|point| intervals(along, point)), [0, 3], "{text}");
    let beliefs = text.split("belief about the users").nth(1).expect("the table of the beliefs");
    // No policy observes users in a room without mirrors.
    let points: Vec<Vec<&str>> = beliefs.lines().map(|line| line.split_whitespace().take(3).collect()).collect();
    for point in [["3", "0", "filter"], ["3", "2", "filter"]] {
        assert!(points.iter().any(|found| found[..] == point), "{point:?}: {text}");
    }
    let message = refusal(&[&flags[..], &["--sweep", "seed=1,2"]].concat());
    assert!(message.contains("at most two keys"), "{message}");
}

#[test]
fn points_with_other_rooms_are_not_paired() {
    let flags = ["--policies", "flat", "--states", "2", "--seeds", "2", "--sweep"];
    let differs = |sweep: &str| {
        let all = report(&[&flags[..], &[sweep]].concat());
        let each = &all["reports"][1]["report"]["each"];
        let length = |value: &serde_json::Value| value.as_array().map(Vec::len);
        assert_eq!((length(&each["room_seed"]), &each["states"]), (Some(4), &serde_json::json!([1, 1, 1, 1])));
        for figure in ["sum_rate_mbps", "jain", "ber"] {
            let values = &each["policies"]["flat"][figure];
            assert_eq!((length(values), length(&values[0])), (Some(1), Some(4)), "a value for each state: {each}");
            assert_eq!(length(&each["oracle"][figure][0]), Some(4), "{each}");
        }
        assert!(each["policies"]["flat"].get("outage_time").is_none(), "a figure of the closed loop: {each}");
        all["reports"][1].get("difference_to_first").is_some()
    };
    assert_eq!(["led.power_w=1,2", "seed=1,7"].map(differs), [true, false]);
    let table = |sweep: &str| String::from_utf8(eval(&[&flags[..], &[sweep]].concat()).stdout).expect("text");
    let title = "difference to led.power_w = 1, paired by episode: sum rate in Mbit/s";
    assert!(table("led.power_w=1,2").contains(title) && !table("seed=1,7").contains("paired by episode"));
}

#[test]
fn a_key_without_effect_is_refused_and_faults_of_reports_and_mirrors_in_a_file_are_conditions() {
    for flags in [["--sweep", "actuator.stuck_share=0,1"], ["--set", "streams.positions.latency_ms=300"]] {
        let message = refusal(&[&flags[..], &["--policies", "flat"]].concat());
        let key = flags[1].split('=').next().expect("a key");
        assert!(message.contains(&format!("{key}: no effect")) && message.contains("--closed-loop"), "{message}");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("room.toml");
    std::fs::write(&file, "[actuator]\nstuck_share = 0.5\n[streams.positions]\nloss = 0.5\n").expect("written");
    let path = file.to_str().expect("a plain path");
    let found = report(&["--scenario", path, "--policies", "flat", "--states", "2", "--seeds", "1"]);
    for (index, key) in ["streams.positions.loss", "actuator.stuck_share"].into_iter().enumerate() {
        let because = found["conditions"][index]["because"].as_str().expect("a condition");
        assert!(because.contains(key), "{found}");
    }
}

#[test]
fn a_key_that_changes_no_figure_is_named() {
    let few = ["--policies", "flat", "--states", "2", "--seeds", "1", "--scenario", "hall"];
    let seats = "users={mobility=\"seated\", count=1, seats_m=[[1.0, 1.0]]}";
    for (sweep, key) in [
        ("name=a,b", Some("name")),
        ("users.seated.spacing_m=0.5,1", Some("users.seated.spacing_m")),
        ("led.power_w=1,2", None),
    ] {
        let output = eval(&[&few[..], &["--set", seats, "--sweep", sweep]].concat());
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{errors}");
        let expected = key.map(|key| format!("--sweep {key}: no effect"));
        assert_eq!(expected.is_some(), errors.contains("no effect"), "{errors}");
        assert!(expected.is_none_or(|expected| errors.contains(&expected)), "{errors}");
    }
}

#[test]
fn flags_that_contradict_each_other_are_refused_with_point_and_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("figures.csv");
    let file = file.to_str().expect("a plain path");
    let cases: [(&[&str], &[&str]); 13] = [
        (&["--set", "mirrors.rows=0"], &["mirrors.rows = 0", "no-irs", "--sweep mirrors.rows=0"]),
        (
            &["--sweep", "users.count=1..5", "--blocked", "3"],
            &["at users.count = 1", "forced_users = 3", "users.count, which is 1"],
        ),
        (&["--sweep", "users.count=1,1"], &["users.count = 1 is given twice"]),
        (&["--sweep", "users.count=1,2", "--set", "users.count=4"], &["--set fixes users.count"]),
        (&["--sweep", "users.count=1,2", "--set", "users={count=4}"], &["--set fixes users.count"]),
        (&["--sweep", "blockage={},{bodies=false}", "--set", "blockage.bodies=true"], &["--set fixes blockage.bodies"]),
        (
            &["--set", "blockage={forced_users=1}", "--blocked", "2"],
            &["--blocked and --set both fix blockage.forced_users"],
        ),
        (&["--sweep", "blockage.forced_users=1,2", "--blocked", "2"], &["--blocked fixes blockage.forced_users"]),
        (
            &["--scenario", "paper", "--sweep", "noise.thermal_a2_per_hz=1e-24,2e-24"],
            &["--sweep noise.thermal_a2_per_hz: no effect", "noise.variance_a2 replaces the sum", "a scenario file"],
        ),
        (&["--closed-loop", "--beliefs", "filter,filter"], &["--beliefs names filter twice"]),
        (&["--csv-episodes", "-"], &["cannot write -: expected a file"]),
        (&["--csv", file, "--csv-episodes", file], &["--csv and --csv-episodes name one file"]),
        (&["--csv-episodes", file, "--html", file], &["--csv-episodes and --html name one file"]),
    ];
    for (flags, parts) in cases {
        let message = refusal(&[&["--policies", "flat"], flags].concat());
        assert!(parts.iter().all(|part| message.contains(part)), "{flags:?}: {message}");
    }
}
