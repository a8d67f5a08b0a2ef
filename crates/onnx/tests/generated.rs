//! The committed Rust types are those of the committed definition.

use std::fs;
use std::path::Path;

/// Set to write `src/generated.rs` instead of comparing it.
const WRITE: &str = "HELIOSTAT_ONNX_GENERATE";

/// The Rust types of `proto/onnx.proto3`, from a protobuf compiler in Rust: no `protoc` is needed.
fn generated() -> String {
    let definitions = Path::new(env!("CARGO_MANIFEST_DIR")).join("proto");
    let files = protox::compile(["onnx.proto3"], [definitions]).expect("the definition compiles");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let mut config = prost_build::Config::new();
    // The definition documents every field. Its comments are not Rust documentation.
    config.out_dir(folder).disable_comments(["."]);
    config.compile_fds(files).expect("the types are written");
    let types = fs::read_to_string(folder.join("onnx.rs")).expect("the generated file is readable");
    format!(
        "// SPDX-License-Identifier: Apache-2.0\n// Generated from ONNX's onnx.proto3 by tests/generated.rs.\n\n{types}"
    )
}

#[test]
fn the_committed_types_are_those_of_the_published_definition() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/generated.rs");
    if std::env::var_os(WRITE).is_some() {
        fs::write(&path, generated()).expect("src/generated.rs is writable");
    }
    let committed = fs::read_to_string(&path).expect("src/generated.rs is readable");
    assert!(committed == generated(), "src/generated.rs is out of date; run this test once with {WRITE}=1");
}
