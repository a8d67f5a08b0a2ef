//! docs/results/reproduction.md is the rendering of docs/results/reproduction.json.

use std::fs;
use std::path::Path;

use heliostat_reproduce::document::markdown;
use heliostat_reproduce::report::Report;

/// `HELIOSTAT_RENDER=1` writes the page again from its JSON file, after a change of its wording.
#[test]
fn the_document_is_the_rendering_of_its_json() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results");
    let text = fs::read_to_string(folder.join("reproduction.json")).expect("the file of the last run");
    let report: Report = serde_json::from_str(&text).expect("docs/results/reproduction.json is a report");
    let page = folder.join("reproduction.md");
    if std::env::var_os("HELIOSTAT_RENDER").is_some() {
        fs::write(&page, markdown(&report)).expect("the page can be written");
    }
    let made_by = "make it again with `heliostat reproduce all --out DIR --write-docs docs/results`";
    assert!(
        markdown(&report) == fs::read_to_string(page).expect("the page"),
        "docs/results/reproduction.md differs; {made_by}"
    );
}
