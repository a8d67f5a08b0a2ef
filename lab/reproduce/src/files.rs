//! The files of a report: the text, and SVG, CSV and JSON for each figure.

use std::path::Path;

use anyhow::{Context, Result};
use heliostat_service::whole_file;

use crate::document;
use crate::draw::svg;
use crate::figure::Figure;
use crate::report::Report;

/// The text of a report, which shows the SVG files beside it.
pub const REPORT: &str = "report.md";

/// Writes all files of a report into a folder.
///
/// # Errors
/// A file that cannot be written.
pub fn write(report: &Report, out: &Path) -> Result<()> {
    for figure in &report.figures {
        let file = |extension: &str| out.join(format!("{}.{extension}", figure.stem()));
        whole_file::write(&file("svg"), svg::draw(figure).with_context(|| figure.stem())?.as_bytes())?;
        whole_file::write(&file("csv"), &csv(figure)?)?;
        whole_file::write(&file("json"), &serde_json::to_vec(figure)?)?;
    }
    whole_file::write(&out.join("report.json"), &serde_json::to_vec(report)?)?;
    whole_file::write(&out.join(REPORT), document::markdown(&document::reduced(report), true).as_bytes())
}

/// One line for each point; for a floor one for each cell.
fn csv(figure: &Figure) -> Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(["panel", "series", &figure.x.label, &figure.y.label, "ci95", "ci95 of x"])?;
    for panel in &figure.panels {
        for series in &panel.series {
            for point in &series.points {
                let [ci95, x_ci95] =
                    [point.ci95, point.x_ci95].map(|half| half.map_or(String::new(), |half| half.to_string()));
                let [x, y] = [point.x, point.y].map(|value| value.to_string());
                writer.write_record([&panel.title, &series.name, &x, &y, &ci95, &x_ci95])?;
            }
        }
        let Some(floor) = &panel.floor else { continue };
        for (index, value) in floor.values.iter().enumerate() {
            let [x, y] = floor.centre(index % floor.columns, index / floor.columns);
            let name = format!("{}: {value}", floor.label);
            writer.write_record([&panel.title, &name, &x.to_string(), &y.to_string(), "", ""])?;
        }
    }
    writer.into_inner().context("the table cannot be written")
}
