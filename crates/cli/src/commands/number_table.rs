//! CSV files of numbers.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use heliostat_files::excerpt;
use heliostat_service::input;

/// Reads a file whose header names all `required` columns, any `optional` ones, and no others.
///
/// Each row holds the required values, then the optional ones, in the order of the arguments. Empty
/// lines and lines that begin with `#` are left out.
///
/// # Errors
/// A file that cannot be read, another header, or a cell that is no number.
pub fn read(file: &str, required: &[&str], optional: &[&str]) -> Result<Vec<Vec<Option<f64>>>> {
    let text = input::read(Path::new(file))?;
    parse(&text, required, optional).with_context(|| format!("in {file}"))
}

fn parse(text: &str, required: &[&str], optional: &[&str]) -> Result<Vec<Vec<Option<f64>>>> {
    let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let mut lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let (_, first) = lines.next().unwrap_or((1, ""));
    let header = cells(first);
    let columns: Vec<&str> = required.iter().chain(optional).copied().collect();
    let known =
        header.iter().enumerate().all(|(index, name)| columns.contains(name) && !header[..index].contains(name));
    let complete = required.iter().all(|name| header.contains(name));
    ensure!(
        known && complete,
        "the header is \"{}\"; expected {}{}",
        excerpt(&header.join(",")),
        required.join(","),
        optional.iter().map(|name| format!("[,{name}]")).collect::<String>()
    );
    let row = |(number, line): (usize, &str)| {
        let cells = cells(line);
        ensure!(cells.len() == header.len(), "line {number} has {} values; expected {}", cells.len(), header.len());
        let value = |name: &&str| {
            let Some(index) = header.iter().position(|found| found == name) else { return Ok(None) };
            let cell = cells[index];
            if cell.is_empty() && optional.contains(name) {
                return Ok(None);
            }
            let number = cell
                .parse()
                .ok()
                .with_context(|| format!("line {number}: {name} is \"{}\"; expected a number", excerpt(cell)));
            number.map(Some)
        };
        columns.iter().map(value).collect()
    };
    lines.map(row).collect()
}

/// The cells of a line; quotation marks around one are left out.
fn cells(line: &str) -> Vec<&str> {
    line.split(',').map(|cell| cell.trim().trim_matches('"')).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_come_in_the_order_of_the_request_whatever_the_order_of_the_file() {
        let text = "# users\n y , x ,z\r\n\n2,1,\n\"4\",3,5\n";
        let rows = parse(text, &["x", "y"], &["z", "heading_deg"]).unwrap();
        assert_eq!(rows, [[Some(1.0), Some(2.0), None, None], [Some(3.0), Some(4.0), Some(5.0), None]]);
    }

    #[test]
    fn another_table_is_refused_with_what_was_expected() {
        for (text, expected) in [
            ("", "the header is \"\"; expected x,y[,z]"),
            ("x\n1\n", "the header is \"x\"; expected x,y[,z]"),
            ("x,y,q\n", "the header is \"x,y,q\""),
            ("x,y,x\n", "the header is \"x,y,x\""),
            ("x,y\n1\n", "line 2 has 1 values; expected 2"),
            ("x,y\n\n1,b\n", "line 3: y is \"b\"; expected a number"),
            ("x,y\n1,\n", "line 2: y is \"\"; expected a number"),
        ] {
            let error = parse(text, &["x", "y"], &["z"]).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
