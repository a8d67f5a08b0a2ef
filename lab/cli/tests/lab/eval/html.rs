//! `heliostat-lab eval --html`: the report as one file.

use std::fs;
use std::process::{Command, Output};

fn eval(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_heliostat-lab")).arg("eval").args(arguments).output().expect("the program starts")
}

/// The report of a comparison in a small room, with further flags.
fn report(further: &[&str]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("report.html");
    let room = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=3", "--set", "users.count=2"];
    let written = ["--seeds", "2", "--seed", "7", "--html", file.to_str().expect("a plain path")];
    let output = eval(&[&room[..], &written, further].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("Mbit/s"), "the table is printed too");
    fs::read_to_string(&file).expect("the report is there")
}

#[test]
fn a_report_names_its_origin_and_needs_no_other_file() {
    let page = report(&["--policies", "fixed-point,nearest,flat", "--states", "4"]);
    for part in
        ["<code>heliostat-lab eval ", "--policies fixed-point,nearest,flat", "<td>7 to 8: 4 states for each</td>"]
    {
        assert!(page.contains(part), "{part} in\n{page}");
    }
    let differences = ["(Mbit/s)", "(ratio)", "(QoS met)"].map(|unit| format!("difference to fixed-point {unit}"));
    for part in differences.iter().map(String::as_str).chain([", commit ", "<pre>", "[mirrors]"]) {
        assert!(page.contains(part), "{part} in\n{page}");
    }
    for part in ["decision time (us), median", "of the policy alone"] {
        assert!(page.contains(part), "{part} in\n{page}");
    }
    for link in ["src=", "href=", "url(", "<script", "<link", "@import"] {
        assert!(!page.contains(link), "{link} leads out of the file");
    }
}

/// The figures in the table are those of the JSON object.
#[test]
fn a_report_has_the_figures_of_the_comparison() {
    let flags = ["--policies", "fixed-point,flat", "--states", "4", "--seeds", "2", "--seed", "7"];
    let room = ["--set", "mirrors.rows=2", "--set", "mirrors.columns=3", "--set", "users.count=2"];
    let output = eval(&[&flags[..], &room, &["--json"]].concat());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let page = report(&["--policies", "fixed-point,flat", "--states", "4"]);
    let flat = &json["policies"]["flat"];
    let cell = |figure: &str, digits: usize| {
        let part = |part: &str| flat[figure][part].as_f64().unwrap_or_else(|| panic!("{figure}.{part} in {flat}"));
        format!("{:.digits$} ±{:.digits$}</td>", part("mean"), part("ci95"))
    };
    let cells = [cell("sum_rate_mbps", 1), cell("difference_mbps", 1), cell("difference_ratio", 3)];
    for cell in cells.into_iter().chain([cell("qos_met", 3)]) {
        assert!(page.contains(&cell), "{cell} in\n{page}");
    }
    let difference = flat["difference_mbps"]["mean"].as_f64().expect("a difference");
    let mean = |policy: &str| json["policies"][policy]["sum_rate_mbps"]["mean"].as_f64().expect("a rate");
    assert!((difference - (mean("flat") - mean("fixed-point"))).abs() < 1e-9, "{json}");
    assert!(json["policies"]["fixed-point"]["difference_mbps"].is_null());
}

#[test]
fn a_report_of_a_closed_loop_has_a_table_of_beliefs() {
    let page = report(&["--policies", "nearest,flat", "--states", "4", "--closed-loop", "--beliefs", "none,filter"]);
    for part in
        ["<th>belief</th>", "<th>none</th>", "<th>filter</th>", "place, mean (cm)", "belief, observation and policy"]
    {
        assert!(page.contains(part), "{part} in\n{page}");
    }
    assert!(!report(&["--policies", "nearest", "--states", "4"]).contains("<th>belief</th>"));
}

#[test]
fn a_report_of_a_sweep_has_curves_and_a_table_for_each_value() {
    let plots = |page: &str| page.matches("<svg").count();
    let flags = ["--policies", "flat,nearest", "--states", "3", "--sweep"];
    let alone = plots(&report(&["--policies", "flat,nearest", "--states", "3"]));
    let numbers = report(&[&flags[..], &["led.power_w=1,2"]].concat());
    assert_eq!(plots(&numbers), 2 * alone + 3, "three curves, and the plots of each value");
    assert!(numbers.contains("led.power_w = 2"), "{numbers}");
    let tables: Vec<&str> = numbers.split("<h3>").skip(1).collect();
    // Ratio and sum rate, three differences to the first policy, and three to the first point.
    assert_eq!((tables.len(), numbers.matches("class=\"figures\"").count()), (8, 8 + 2), "{numbers}");
    let of_points = "difference to led.power_w = 1, paired by episode: sum rate in Mbit/s</h3>";
    let table = tables.iter().find(|table| table.starts_with(of_points)).expect("the table of the first point");
    assert!(table.contains("<tr><th>led.power_w</th><th>(oracle)</th><th>flat</th><th>nearest</th></tr>"), "{table}");
    assert!(table.contains("<tr><th>1</th><td>-</td><td>-</td><td>-</td></tr>"), "{table}");
    assert!(table.contains("<tr><th>2</th><td>+"), "{table}");
    let words = report(&[&flags[..], &["receiver.combining=best,equal-gain"]].concat());
    assert_eq!(plots(&words), 2 * alone + 3, "words are categories");
    let over = words.split("<h2>Over ").nth(1).and_then(|rest| rest.split("<h3>").next()).expect("the plots");
    assert!(over.contains("best") && over.contains("equal-gain"), "{over}");
}

#[test]
fn an_unwritable_report_is_refused_before_the_work_and_a_failure_leaves_no_file() {
    let output = eval(&["--policies", "flat", "--states", "1000000", "--html", "/nowhere/report.html"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && message.contains("cannot write /nowhere/report.html"), "{message}");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("report.html");
    let path = file.to_str().expect("a plain path");
    let flags = ["--policies", "exhaustive", "--states", "2", "--seeds", "1", "--html", path];
    assert!(!eval(&flags).status.success() && !file.exists(), "the comparison fails");
    fs::write(&file, "kept").expect("writable");
    assert!(!eval(&flags).status.success());
    assert_eq!(fs::read_to_string(&file).expect("readable"), "kept");
}
