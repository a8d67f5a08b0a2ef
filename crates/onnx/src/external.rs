//! Tensors whose values are in a second file beside the model, as exporters write large ones.

use crate::tensor_proto::DataLocation;
use crate::{ModelProto, StringStringEntryProto, TensorProto};

/// Whether the values of a tensor are in a second file.
fn is_external(tensor: &TensorProto) -> bool {
    tensor.data_location == DataLocation::External as i32
}

/// Replaces each reference to a second file by its part of that file, which `read` returns by its
/// name. Whether there was any.
///
/// # Errors
/// That of `read`, or a part that the file does not hold.
pub fn inline(model: &mut ModelProto, read: &mut dyn FnMut(&str) -> Result<Vec<u8>, String>) -> Result<bool, String> {
    let mut cached: Option<(String, Vec<u8>)> = None;
    let mut found = false;
    let tensors = model.graph.iter_mut().flat_map(|graph| &mut graph.initializer);
    for tensor in tensors.filter(|tensor| is_external(tensor)) {
        found = true;
        let entry = |key: &str| {
            let entries: &[StringStringEntryProto] = &tensor.external_data;
            entries.iter().find(|entry| entry.key == key).map(|entry| entry.value.clone())
        };
        let name =
            entry("location").ok_or_else(|| format!("the tensor {} names no file of its values", tensor.name))?;
        let number = |key: &str| entry(key).and_then(|value| value.parse::<usize>().ok());
        let (offset, length) = (number("offset").unwrap_or(0), number("length"));
        if cached.as_ref().is_none_or(|(known, _)| *known != name) {
            cached = Some((name.clone(), read(&name)?));
        }
        let bytes = cached.as_ref().map_or(&[][..], |(_, bytes)| bytes.as_slice());
        let end = length.map_or(Some(bytes.len()), |length| offset.checked_add(length));
        let part = end.and_then(|end| bytes.get(offset..end));
        tensor.raw_data = part
            .ok_or_else(|| format!("{name} is shorter than the tensor {} needs: copy it again", tensor.name))?
            .into();
        tensor.external_data.clear();
        tensor.data_location = DataLocation::Default as i32;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::{Ends, Graph};
    use prost::Message;

    fn model() -> ModelProto {
        let mut graph = Graph::default();
        let weights = graph.constant("w", &[2], &[0.0, 0.0]);
        graph.node("Mul", &["x", &weights]);
        let bytes = graph.finish(&Ends { name: "test", input: ("x", 2), output: ("y", 2) }, &[]);
        let mut model = ModelProto::decode(&bytes[..]).expect("just written");
        let tensor = &mut model.graph.as_mut().expect("a graph").initializer[0];
        let entry = |key: &str, value: &str| StringStringEntryProto { key: key.into(), value: value.into() };
        tensor.raw_data.clear();
        tensor.data_location = DataLocation::External as i32;
        tensor.external_data = vec![entry("location", "w.data"), entry("offset", "4"), entry("length", "8")];
        model
    }

    #[test]
    fn values_come_from_their_part_of_the_second_file() {
        let (mut model, file) = (model(), [9, 9, 9, 9, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        assert_eq!(inline(&mut model, &mut |name| Ok([name.as_bytes(), &file[6..]].concat())), Ok(true));
        assert_eq!(model.graph.expect("a graph").initializer[0].raw_data, b"ta\x03\x04\x05\x06\x07\x08");
    }

    #[test]
    fn a_missing_or_short_file_is_an_error() {
        assert_eq!(inline(&mut model(), &mut |name| Err(name.into())), Err("w.data".into()));
        let short = inline(&mut model(), &mut |_| Ok(vec![0; 11])).expect_err("one byte is missing");
        assert!(short.contains("w.data is shorter"), "{short}");
    }
}
