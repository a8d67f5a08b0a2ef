//! The page of faults: each row names a test, and each test has a row.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use heliostat_tests::faults::{FAULTS, page};

/// The names of the tests that measure a fault.
fn tests() -> BTreeSet<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults");
    let mut names = BTreeSet::new();
    for entry in fs::read_dir(folder).expect("the folder of this test").flatten() {
        let text = fs::read_to_string(entry.path()).expect("a source is readable");
        let functions = text.split("#[test]\n").skip(1).map(|function| {
            let rest = function.split_once("fn ").expect("a test is a function").1;
            (rest.split_once('(').expect("a function has parameters").0.to_owned(), function)
        });
        // A test that measures passes its name on.
        let measuring = functions.filter(|(name, function)| function.contains(&format!("\"{name}\"")));
        names.extend(measuring.map(|(name, _)| name));
    }
    names
}

#[test]
fn every_fault_of_the_table_has_a_test_of_its_name() {
    let table: BTreeSet<String> = FAULTS.iter().map(|fault| fault.test.to_owned()).collect();
    assert_eq!(table, tests());
    assert_eq!(table.len(), FAULTS.len(), "two rows of the table have one test");
    assert!(FAULTS.len() >= 30, "only {} faults", FAULTS.len());
}

#[test]
fn every_row_of_the_page_names_a_test_and_every_test_has_a_row() {
    if std::env::var_os("HELIOSTAT_WRITE_FAULTS").is_some() {
        println!("skipped: the page is written at this time");
        return;
    }
    let page = fs::read_to_string(page::path()).expect("the page of faults");
    let rows: BTreeSet<String> = page::rows(&page).into_keys().collect();
    assert!(page::has_present_head(&page), "docs/faults.md begins with another text than tests/src/faults/page.rs");
    assert_eq!(rows, tests(), "write docs/faults.md again with HELIOSTAT_WRITE_FAULTS=1");
}
