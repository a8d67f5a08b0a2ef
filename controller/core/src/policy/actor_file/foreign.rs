//! What a file is that holds no network.

use heliostat_files::foreign_file;

/// How the bytes of files begin that hold a network in another form, what such a file is, and what to do.
const NETWORKS: [(&[u8], &str, &str); 4] = [
    (b"PK\x03\x04", "is a zip archive, as `torch.save` writes", "export the module with `torch.onnx.export`"),
    (b"\x80\x02", "is a pickle of Python", "export the module with `torch.onnx.export`"),
    (b"\x80\x04", "is a pickle of Python", "export the module with `torch.onnx.export`"),
    (b"\x89HDF", "is an HDF5 file", "convert it with tf2onnx"),
];

const EXPECTED: &str = "an ONNX file";

/// What the bytes are instead of an ONNX model, with what to do; `None` where they may be one.
pub fn foreign(bytes: &[u8]) -> Option<String> {
    let network = NETWORKS.iter().find(|(beginning, ..)| bytes.starts_with(beginning));
    match network {
        Some((_, what, advice)) => Some(format!("{what}, expected {EXPECTED}: {advice}")),
        None => foreign_file(bytes, EXPECTED).or_else(|| {
            is_text(bytes).then(|| format!("is a text file, expected {EXPECTED}: name the file of the network"))
        }),
    }
}

/// Whether the bytes are text. A model begins with the control character of its first field.
fn is_text(bytes: &[u8]) -> bool {
    let is_of_text = |letter: char| !letter.is_control() || letter.is_ascii_whitespace();
    std::str::from_utf8(bytes).is_ok_and(|text| text.chars().all(is_of_text))
}
