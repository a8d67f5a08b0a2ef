//! The results pages as data: what each section runs, shows and promises.

mod actuators;
mod combinations;
mod evaluation;
mod latency;
mod page;
mod rooms;

pub use page::{Page, Section};

/// The pages by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum PageName {
    /// Policies on the same states, beside the oracle: held-out states, sweeps, closed loop
    Evaluation,
    /// Rooms that differ from the scenario hall: mobility, orientation, mismatch
    Rooms,
    /// Each mobility model with each orientation and each mismatch, in the scenario hall
    Combinations,
    /// What each property of the mirrors' drives costs, and calibration
    Actuators,
    /// Decision, loop, mirrors, users, rooms and policies, each beside a reference of the same run
    Latency,
}

impl PageName {
    /// The page's definition.
    pub fn page(self) -> &'static Page {
        match self {
            Self::Evaluation => &evaluation::PAGE,
            Self::Rooms => &rooms::PAGE,
            Self::Combinations => &combinations::PAGE,
            Self::Actuators => &actuators::PAGE,
            Self::Latency => &latency::PAGE,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::Path;

    use clap::{Parser, ValueEnum};

    use super::super::archive::Archive;
    use super::super::document;
    use super::*;
    use crate::cli::Cli;

    #[test]
    fn the_command_line_accepts_every_command_of_every_page() {
        for page in PageName::value_variants().iter().map(|name| name.page()) {
            for section in page.sections {
                for quick in [false, true] {
                    let arguments = section.with_json(&section.arguments(quick));
                    let words = ["heliostat".to_owned()].into_iter().chain(arguments);
                    let parsed = Cli::try_parse_from(words);
                    assert!(parsed.is_ok(), "{}, {}: {}", page.name, section.name, parsed.unwrap_err());
                }
            }
        }
    }

    #[test]
    fn sections_of_a_page_have_names_and_headings_of_their_own() {
        for page in PageName::value_variants().iter().map(|name| name.page()) {
            let names: BTreeSet<_> = page.sections.iter().map(|section| section.name).collect();
            let titles: BTreeSet<_> = page.sections.iter().map(|section| section.title).collect();
            assert_eq!((names.len(), titles.len()), (page.sections.len(), page.sections.len()), "{}", page.name);
        }
    }

    #[test]
    fn a_page_in_docs_is_what_its_json_renders_to() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results");
        for page in PageName::value_variants().iter().map(|name| name.page()) {
            // A page without a JSON file was transcribed by hand and says so.
            let kept = folder.join(page.name).with_extension("json");
            let text = fs::read_to_string(kept.with_extension("md")).expect("every page is in docs/results");
            if kept.exists() {
                let archive = Archive::read(&kept).expect("finished sections");
                let rendered = document::markdown(page, &archive).expect("the output of its commands");
                assert!(text == rendered, "docs/results/{}.md differs from its JSON file", page.name);
            } else {
                assert!(text.contains("transcribed from"), "docs/results/{}.md has no JSON file", page.name);
            }
        }
    }

    #[test]
    fn json_stands_before_the_flags_of_another_process() {
        let section = &latency::PAGE.sections[0];
        let words = |text: &str| text.split(' ').map(String::from).collect::<Vec<_>>();
        assert_eq!(section.with_json(&words("bench loop -- --pin 1")), words("bench loop --json -- --pin 1"));
        assert_eq!(section.with_json(&words("bench loop")), words("bench loop --json"));
    }
}
