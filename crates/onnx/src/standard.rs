//! The part of the ONNX standard that is known here: versions of the format and of the operators,
//! and the domain of the operators.

use thiserror::Error;

use crate::{GraphProto, ModelProto, NodeProto};

/// IR versions with the fields that are read: opsets are declared from version 3 on, and 14 is the
/// last in `proto/onnx.proto3`.
const IR_VERSIONS: std::ops::RangeInclusive<i64> = 3..=14;

/// Opsets whose operators are known: broadcasting has its present form from 7 on, and ONNX 1.23
/// defines 28.
///
/// Source: <https://github.com/onnx/onnx/blob/main/docs/Changelog.md>.
pub const OPSETS: std::ops::RangeInclusive<i64> = 7..=28;

/// Why the version of a file is not known.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum VersionError {
    /// The file has another format.
    #[error(
        "the IR version {found}, expected {} to {}; export it again with a current version of ONNX",
        IR_VERSIONS.start(), IR_VERSIONS.end()
    )]
    IrVersion {
        /// The version found.
        found: i64,
    },
    /// The operators have another definition, or an unknown one.
    #[error(
        "{}, expected an opset from {} to {}; export it again, for example with opset 17",
        found.map_or("no opset".to_owned(), |found| format!("the opset {found}")), OPSETS.start(), OPSETS.end()
    )]
    Opset {
        /// The opset found.
        found: Option<i64>,
    },
}

/// Whether a domain is that of the standard operators.
pub fn is_standard(domain: &str) -> bool {
    domain.is_empty() || domain == "ai.onnx"
}

/// Checks that the versions of a file are known.
///
/// # Errors
/// [`VersionError`] with the version found and the versions expected.
pub fn check_versions(model: &ModelProto) -> Result<(), VersionError> {
    if !IR_VERSIONS.contains(&model.ir_version) {
        return Err(VersionError::IrVersion { found: model.ir_version });
    }
    let mut opsets = model.opset_import.iter().filter(|set| is_standard(&set.domain)).map(|set| set.version);
    match opsets.clone().find(|version| !OPSETS.contains(version)) {
        None if opsets.next().is_some() => Ok(()),
        found => Err(VersionError::Opset { found }),
    }
}

/// The first node of a graph, or of a graph inside it, for which a condition holds.
pub fn find_node<'a>(graph: &'a GraphProto, holds: &dyn Fn(&NodeProto) -> bool) -> Option<&'a NodeProto> {
    graph.node.iter().find_map(|node| {
        let mut inner = node.attribute.iter().flat_map(|attribute| attribute.g.iter().chain(&attribute.graphs));
        if holds(node) { Some(node) } else { inner.find_map(|graph| find_node(graph, holds)) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AttributeProto, OperatorSetIdProto};

    fn model(ir_version: i64, opsets: &[(&str, i64)]) -> ModelProto {
        let set = |(domain, version): &(&str, i64)| OperatorSetIdProto { domain: (*domain).into(), version: *version };
        ModelProto { ir_version, opset_import: opsets.iter().map(set).collect(), ..ModelProto::default() }
    }

    #[test]
    fn unknown_versions_are_refused_with_those_expected() {
        for known in [model(3, &[("", 7)]), model(8, &[("ai.onnx", 17), ("com.example", 99)]), model(14, &[("", 28)])] {
            assert_eq!(check_versions(&known), Ok(()));
        }
        let unknown = [
            (model(2, &[("", 7)]), "IR version 2, expected 3 to 14"),
            (model(15, &[("", 17)]), "IR version 15"),
            (model(8, &[]), "no opset, expected an opset from 7 to 28"),
            (model(8, &[("com.example", 17)]), "no opset"),
            (model(8, &[("", 6)]), "the opset 6"),
            (model(8, &[("", 17), ("ai.onnx", 29)]), "the opset 29"),
        ];
        for (model, words) in unknown {
            let refusal = check_versions(&model).expect_err(words).to_string();
            assert!(refusal.contains(words) && refusal.contains("export it again"), "{refusal}");
        }
    }

    #[test]
    fn a_node_is_found_inside_graphs_too() {
        let node = |domain: &str| NodeProto { op_type: "Relu".into(), domain: domain.into(), ..NodeProto::default() };
        let graph = |node| GraphProto { node: vec![node], ..GraphProto::default() };
        let is_foreign = |node: &NodeProto| !is_standard(&node.domain);
        assert_eq!(find_node(&graph(node("ai.onnx")), &is_foreign), None);
        let body = AttributeProto { g: Some(graph(node("com.example"))), ..AttributeProto::default() };
        for foreign in [node("com.example"), NodeProto { attribute: vec![body], ..node("") }] {
            assert_eq!(find_node(&graph(foreign), &is_foreign), Some(&node("com.example")));
        }
    }
}
