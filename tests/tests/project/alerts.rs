//! The alert rules against their rows in docs/operation.md.

use std::fs;
use std::path::Path;

fn read(file: &str) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(file);
    fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

#[test]
fn each_alert_has_its_row_in_the_section_that_its_annotation_names() {
    let (rules, guide) = (read("deploy/prometheus/alerts.yml"), read("docs/operation.md"));
    let (_, section) = guide.split_once("\n## Alerts\n").expect("the guide has the section");
    let section = section.split("\n## ").next().unwrap_or_default();
    let rows: Vec<Vec<&str>> = section
        .lines()
        .filter(|line| line.starts_with("| `Heliostat"))
        .map(|line| line.split(" | ").collect())
        .collect();
    let documented: Vec<&str> = rows.iter().map(|cells| cells[0].trim_matches(['|', ' ', '`'])).collect();
    let alerts: Vec<(&str, &str)> =
        rules.split("- alert: ").skip(1).map(|rule| rule.split_once('\n').expect("a rule has several lines")).collect();
    let named: Vec<&str> = alerts.iter().map(|(name, _)| *name).collect();
    assert!(named.len() >= 18, "{named:?}");
    assert_eq!(named, documented, "the rules in deploy/prometheus/alerts.yml, and the rows in docs/operation.md");
    for (name, rule) in &alerts {
        assert!(rule.contains("\n          runbook: docs/operation.md#alerts\n"), "{name} has no runbook");
    }
    for cells in &rows {
        assert!(
            cells.len() == 4 && cells.iter().all(|cell| cell.len() > 3),
            "expected name, meaning, look at and do: {cells:?}"
        );
    }
}

/// That the tests pass is for `promtool`, which `.ci/checks` calls.
#[test]
fn each_alert_fires_in_a_test_of_the_rules() {
    let (rules, tests) = (read("deploy/prometheus/alerts.yml"), read("deploy/prometheus/alerts_test.yml"));
    let fires = |name: &str| {
        let mut cases = tests.split("alertname: ").skip(1).filter_map(|case| case.split_once('\n'));
        cases.any(|(of, rest)| of == name && rest.trim_start().starts_with("exp_alerts:"))
    };
    let names = rules.split("- alert: ").skip(1).filter_map(|rule| rule.lines().next());
    let untested: Vec<&str> = names.filter(|name| !fires(name)).collect();
    assert!(untested.is_empty(), "no case of deploy/prometheus/alerts_test.yml lets these fire: {untested:?}");
}

#[test]
fn each_configuration_of_prometheus_names_an_alertmanager() {
    for file in ["deploy/prometheus/prometheus.yml", "deploy/building/prometheus.yml"] {
        assert!(read(file).lines().any(|line| line.starts_with("alerting: ")), "{file} names no Alertmanager");
    }
}
