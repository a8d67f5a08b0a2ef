//! How the cells of a line are separated: by white space, tabs, commas or semicolons.

/// The separator of a text, recognised at its first row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Whitespace,
    Tab,
    Comma,
    Semicolon,
    Bar,
}

impl Separator {
    /// The separator of a row. A semicolon comes before the comma, because a European spreadsheet that
    /// writes it uses the comma as decimal mark. A tab and a bar come before it for the same reason.
    pub(super) fn of(row: &str) -> Self {
        [('|', Self::Bar), (';', Self::Semicolon), ('\t', Self::Tab), (',', Self::Comma)]
            .into_iter()
            .find(|(mark, _)| split(row, *mark).len() > 1)
            .map_or(Self::Whitespace, |(_, separator)| separator)
    }

    /// The cells of a row, without white space and quotation marks around them.
    pub(super) fn cells(self, row: &str) -> Vec<&str> {
        fn bare(cell: &str) -> &str {
            cell.trim().trim_matches('"')
        }
        match self {
            Self::Whitespace => row.split_whitespace().collect(),
            Self::Tab => split(row, '\t').into_iter().map(bare).collect(),
            Self::Comma => split(row, ',').into_iter().map(bare).collect(),
            Self::Semicolon => split(row, ';').into_iter().map(bare).collect(),
            Self::Bar => split(row, '|').into_iter().map(bare).collect(),
        }
    }
}

/// The cells between marks; a mark within quotation marks around a cell separates nothing.
fn split(row: &str, mark: char) -> Vec<&str> {
    let (mut cells, mut start) = (Vec::new(), 0);
    let (mut is_quoted, mut in_quotes, mut last) = (false, false, None);
    for (at, character) in row.char_indices() {
        let begins_cell = matches!(last, None | Some(',' | ';' | '\t' | '|'));
        if character == '"' && (is_quoted || begins_cell) {
            // Two of them within a quoted cell stand for one.
            (is_quoted, in_quotes) = (true, !in_quotes);
        } else if character == mark && !in_quotes {
            cells.push(&row[start..at]);
            (start, is_quoted) = (at + mark.len_utf8(), false);
        }
        if character != ' ' {
            last = Some(character);
        }
    }
    cells.push(&row[start..]);
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_row_shows_the_separator() {
        for (row, separator, cells) in [
            ("7.8e2  1\t2.5", Separator::Tab, vec!["7.8e2  1", "2.5"]),
            ("7.8e2  1 2.5", Separator::Whitespace, vec!["7.8e2", "1", "2.5"]),
            ("0, 1 ,\"x\"", Separator::Comma, vec!["0", "1", "x"]),
            ("0,4;1;2,5", Separator::Semicolon, vec!["0,4", "1", "2,5"]),
            ("0,4|1|\"2|5\"", Separator::Bar, vec!["0,4", "1", "2|5"]),
            ("0,\"hall; \"\"A\"\", east\",5", Separator::Comma, vec!["0", "hall; \"\"A\"\", east", "5"]),
            ("0,4\t\t2,5", Separator::Tab, vec!["0,4", "", "2,5"]),
        ] {
            assert_eq!(Separator::of(row), separator, "{row}");
            assert_eq!(separator.cells(row), cells, "{row}");
        }
    }
}
