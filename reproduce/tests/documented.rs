//! The document in docs/ is what its JSON says, word for word.

use heliostat_reproduce::document::markdown;
use heliostat_reproduce::report::Report;

#[test]
fn the_document_is_what_its_json_renders_to() {
    let text = include_str!("../../docs/results/reproduction.json");
    let report: Report = serde_json::from_str(text).expect("docs/results/reproduction.json is a report");
    let made_by = "make it again with `heliostat reproduce all --out DIR --write-docs docs/results`";
    assert!(markdown(&report) == include_str!("../../docs/results/reproduction.md"), "docs/results/reproduction.md differs; {made_by}");
}
