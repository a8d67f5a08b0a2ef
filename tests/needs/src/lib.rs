//! An attribute for tests that need a program which a machine may lack.
//!
//! ```text
//! #[needs("browser")]
//! #[test]
//! fn a_page_is_drawn() {}
//! ```
//!
//! Where the program is missing when the tests are built, the test is reported as ignored, with what to
//! install. The variable `HELIOSTAT_REQUIRE` lists names that may not be ignored, for example
//! `HELIOSTAT_REQUIRE=browser,cxx`; their tests fail where the program is missing.

use proc_macro::TokenStream;

/// Each need, and why its tests are ignored.
const REASONS: &[(&str, Option<&str>)] = include!(concat!(env!("OUT_DIR"), "/reasons.rs"));

/// Ignores a test where what it needs is missing.
///
/// The arguments are strings: some names of `build.rs`.
#[proc_macro_attribute]
pub fn needs(names: TokenStream, test: TokenStream) -> TokenStream {
    let names = names.to_string();
    let mut reason = None;
    for name in names.split(',').map(|name| name.trim().trim_matches('"')) {
        match REASONS.iter().find(|(known, _)| *known == name) {
            Some((_, lacking)) => reason = reason.or(*lacking),
            None => return error(&format!("unknown need {name:?}: expected one of tests/needs/build.rs")),
        }
    }
    let ignored = reason.map(|reason| format!("#[ignore = {reason:?}]").parse::<TokenStream>().expect("an attribute"));
    ignored.into_iter().chain([test]).collect()
}

fn error(message: &str) -> TokenStream {
    format!("compile_error!({message:?});").parse().expect("a macro call")
}
