//! Where figures come from: program, commit and configuration, for each file of a comparison.

use anyhow::Result;
use heliostat_learn::comparison::Report;
use heliostat_reproduce::machine;
use heliostat_service::printable::printable;
use serde_json::{Value, json};

use super::differences;

/// The program that made a file.
pub fn program() -> String {
    format!("heliostat-lab {}", env!("CARGO_PKG_VERSION"))
}

/// A report as a JSON object with program, commit and the figures of each episode.
///
/// # Errors
/// None for a report.
pub fn in_json(report: &Report) -> Result<Value> {
    let mut object = serde_json::to_value(report)?;
    object["program"] = json!(program());
    object["commit"] = json!(machine::COMMIT);
    object["each"] = differences::in_episodes(report);
    Ok(object)
}

/// An SVG file with the origin as its description.
pub fn in_svg(svg: &str, report: &Report) -> String {
    let text = format!(
        "{}, commit {}, scenario {}, configuration {}",
        program(),
        machine::COMMIT,
        report.scenario,
        report.configuration
    );
    let text = printable(&text).replace('&', "&amp;").replace('<', "&lt;");
    match svg.find("<svg").and_then(|begin| Some(begin + svg[begin..].find('>')? + 1)) {
        Some(end) => format!("{}\n<desc>{text}</desc>{}", &svg[..end], &svg[end..]),
        None => svg.to_owned(),
    }
}
