//! What a file is that holds no network.

/// How the bytes of some files begin, what such a file is, and what to do.
const BEGINNINGS: [(&[u8], &str, &str); 6] = [
    (b"version https://git-lfs", "is a pointer of git-lfs", "run `git lfs pull`"),
    (b"\x1f\x8b", "is compressed with gzip", "unpack it"),
    (b"PK\x03\x04", "is a zip archive, as `torch.save` writes", "export the module with `torch.onnx.export`"),
    (b"\x80\x02", "is a pickle of Python", "export the module with `torch.onnx.export`"),
    (b"\x80\x04", "is a pickle of Python", "export the module with `torch.onnx.export`"),
    (b"\x89HDF", "is an HDF5 file", "convert it with tf2onnx"),
];

/// What the bytes are instead of an ONNX model, with what to do; `None` where they may be one.
pub fn foreign(bytes: &[u8]) -> Option<String> {
    if bytes.is_empty() {
        return Some("is empty, expected an ONNX file: copy or export it again".into());
    }
    if let Some((_, what, advice)) = BEGINNINGS.iter().find(|(beginning, ..)| bytes.starts_with(beginning)) {
        return Some(format!("{what}, expected an ONNX file: {advice}"));
    }
    let text = bytes.trim_ascii_start();
    let is_tag = |byte: &u8| byte.is_ascii_alphabetic() || *byte == b'!' || *byte == b'?';
    if text.first() == Some(&b'<') && text.get(1).is_some_and(is_tag) {
        let word: String =
            text.iter().take_while(|byte| byte.is_ascii_graphic()).take(16).map(|byte| *byte as char).collect();
        return Some(format!("begins with {word}: it is a web page, expected an ONNX file: download the file itself"));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::foreign;

    #[test]
    fn files_that_hold_no_network_are_named_with_what_to_do() {
        for (bytes, words) in [
            (&b""[..], "is empty"),
            (
                b"version https://git-lfs.github.com/spec/v1\noid",
                "pointer of git-lfs, expected an ONNX file: run `git lfs pull`",
            ),
            (b"\n <!DOCTYPE html>\n<html>", "begins with <!DOCTYPE: it is a web page"),
            (b"<html>", "begins with <html>: it is a web page"),
            (b"\x1f\x8b\x08", "gzip"),
            (b"PK\x03\x04x", "zip archive"),
        ] {
            let found = foreign(bytes).unwrap_or_default();
            assert!(found.contains(words), "{words}: {found}");
        }
        assert_eq!(foreign(b"\x08\x08\x12\x07pytorch"), None);
        assert_eq!(foreign(b"< 3"), None);
    }
}
