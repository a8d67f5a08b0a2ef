//! docs/results/reproduction.md is the rendering of docs/results/reproduction.json.

use heliostat_reproduce::document::markdown;
use heliostat_reproduce::report::Report;

#[test]
fn the_document_is_the_rendering_of_its_json() {
    let text = include_str!("../../docs/results/reproduction.json");
    let report: Report = serde_json::from_str(text).expect("docs/results/reproduction.json is a report");
    let made_by = "make it again with `heliostat reproduce all --out DIR --write-docs docs`";
    assert!(
        markdown(&report) == include_str!("../../docs/results/reproduction.md"),
        "docs/results/reproduction.md differs; {made_by}"
    );
}
