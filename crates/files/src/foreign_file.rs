//! What a file is that holds something else than its user expects.

/// How the bytes of some files begin, what such a file is, and what to do.
const BEGINNINGS: [(&[u8], &str, &str); 10] = [
    (b"version https://git-lfs", "is a pointer of git-lfs", "run `git lfs pull`"),
    (b"\x1f\x8b", "is compressed with gzip", "unpack it"),
    (b"\x28\xb5\x2f\xfd", "is compressed with zstd", "unpack it"),
    (b"\xfd7zXZ\0", "is compressed with xz", "unpack it"),
    (b"BZh91AY&SY", "is compressed with bzip2", "unpack it"),
    (b"PK\x03\x04", "is a zip archive", "unpack it"),
    (b"PAR1", "is a Parquet file", "convert it"),
    (b"\x89HDF", "is an HDF5 file", "convert it"),
    (b"\xff\xfe", "is text in UTF-16", "save it in UTF-8"),
    (b"\xfe\xff", "is text in UTF-16", "save it in UTF-8"),
];

/// A binary file has a zero among its first bytes; the lost end of a text may have more.
const BINARY_WITHIN: usize = 64;

/// What a file is instead of what was expected, and what to do, from its first bytes; `None` where it may
/// be what was expected. The sentence begins with a verb, for the name of the file before it.
///
/// ```
/// use heliostat_files::foreign_file;
///
/// let found = foreign_file(b"\x1f\x8b\x08", "a recording").expect("no recording");
/// assert_eq!(found, "is compressed with gzip, expected a recording: unpack it");
/// ```
pub fn foreign_file(beginning: &[u8], expected: &str) -> Option<String> {
    if beginning.is_empty() {
        return Some(format!("is empty, expected {expected}: copy or export it again"));
    }
    if is_of_office(beginning) {
        return Some(format!("is a document of an office program, expected {expected}: export it, a table as CSV"));
    }
    if let Some((_, what, advice)) = BEGINNINGS.iter().find(|(bytes, ..)| beginning.starts_with(bytes)) {
        return Some(format!("{what}, expected {expected}: {advice}"));
    }
    let text = beginning.trim_ascii_start();
    let is_tag = |byte: &u8| byte.is_ascii_alphabetic() || *byte == b'!' || *byte == b'?';
    if text.first() == Some(&b'<') && text.get(1).is_some_and(is_tag) {
        let word: String =
            text.iter().take_while(|byte| byte.is_ascii_graphic()).take(16).map(|byte| *byte as char).collect();
        return Some(format!("begins with {word}: it is a web page, expected {expected}: download the file itself"));
    }
    None
}

/// As [`foreign_file`] where a text in UTF-8 is expected: a recording is named too, and what begins with zero bytes.
///
/// ```
/// use heliostat_files::foreign_text;
///
/// assert_eq!(foreign_text(b"time,user,x,y"), None);
/// assert!(foreign_text(b"\x89MCAP0\r\n").is_some_and(|found| found.starts_with("is a recording")));
/// ```
pub fn foreign_text(beginning: &[u8]) -> Option<String> {
    const EXPECTED: &str = "a text in UTF-8";
    if beginning.starts_with(b"\x89MCAP") {
        return Some(format!("is a recording, expected {EXPECTED}: `heliostat-lab trace export` writes its walk"));
    }
    let is_binary = || beginning.iter().take(BINARY_WITHIN).any(|byte| *byte == 0);
    foreign_file(beginning, EXPECTED).or_else(|| {
        let what = "holds zero bytes, as a binary file or a text in UTF-16";
        is_binary().then(|| format!("{what}, expected {EXPECTED}: name a text, or save it in UTF-8"))
    })
}

/// Whether a file is one of a spreadsheet or a text program: a zip archive whose first entry says so, or the older
/// binary format.
fn is_of_office(beginning: &[u8]) -> bool {
    // The name of the first entry follows 26 further bytes.
    let first = beginning.strip_prefix(b"PK\x03\x04").and_then(|rest| rest.get(26..));
    let is_of_office =
        |first: &[u8]| first.starts_with(b"[Content_Types].xml") || first.starts_with(b"mimetypeapplication/vnd.");
    first.is_some_and(is_of_office) || beginning.starts_with(b"\xd0\xcf\x11\xe0")
}

#[cfg(test)]
mod tests {
    use super::{foreign_file, foreign_text};

    #[test]
    fn files_of_other_kinds_are_named_with_what_to_do() {
        for (bytes, words) in [
            (&b""[..], "is empty"),
            (
                b"version https://git-lfs.github.com/spec/v1\noid",
                "pointer of git-lfs, expected a table: run `git lfs pull`",
            ),
            (b"\n <!DOCTYPE html>\n<html>", "begins with <!DOCTYPE: it is a web page"),
            (b"<html>", "begins with <html>: it is a web page"),
            (b"\x1f\x8b\x08", "gzip"),
            (b"\x28\xb5\x2f\xfd\x04", "is compressed with zstd, expected a table: unpack it"),
            (b"\xfd7zXZ\0\0", "is compressed with xz"),
            (b"BZh91AY&SY\0", "is compressed with bzip2"),
            (b"PK\x03\x04x", "zip archive"),
            (b"PAR1\x15\0", "is a Parquet file, expected a table: convert it"),
            (b"\x89HDF\r\n", "is an HDF5 file"),
            (
                b"PK\x03\x04\x14\0\x06\0\x08\0\0\0!\0\0\0\0\0\0\0\0\0\0\0\0\0\x13\0\0\0[Content_Types].xml",
                "is a document of an office program, expected a table: export it, a table as CSV",
            ),
            (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a document of an office program"),
            (b"\xff\xfet\0i\0", "is text in UTF-16, expected a table: save it in UTF-8"),
            (b"\xfe\xff\0t", "UTF-16"),
        ] {
            let found = foreign_file(bytes, "a table").unwrap_or_default();
            assert!(found.contains(words), "{words}: {found}");
        }
        assert_eq!(foreign_file(b"\x08\x08\x12\x07pytorch", "an ONNX file"), None);
        assert_eq!(foreign_file(b"< 3", "an ONNX file"), None);
    }

    #[test]
    fn what_is_no_text_is_named() {
        for (bytes, words) in [
            (&b"\x89MCAP0\r\n"[..], "is a recording, expected a text in UTF-8: `heliostat-lab trace export`"),
            (b"\x08\x0a\0\x12", "holds zero bytes, as a binary file or a text in UTF-16, expected a text"),
            (b"t\0i\0m\0e\0", "holds zero bytes"),
            (b"PAR1", "is a Parquet file"),
        ] {
            let found = foreign_text(bytes).unwrap_or_default();
            assert!(found.starts_with(words), "{words}: {found}");
        }
        let padded = [&[b'0'; 100][..], &[0; 100]].concat();
        assert_eq!(foreign_text(&padded), None);
    }
}
