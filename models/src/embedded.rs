//! The inference library that this build embeds.

use heliostat_core::policy::{Engine, Network};

#[cfg(feature = "onnxruntime")]
pub use crate::onnxruntime::{ORT as EMBEDDED, OnnxRuntime as EmbeddedEngine};
#[cfg(not(any(feature = "tract", feature = "onnxruntime")))]
pub use crate::reference::{REFERENCE as EMBEDDED, Reference as EmbeddedEngine};
#[cfg(all(feature = "tract", not(feature = "onnxruntime")))]
pub use crate::tract::{TRACT as EMBEDDED, Tract as EmbeddedEngine};

/// Builds the network of an ONNX model on the embedded engine.
///
/// # Errors
/// The engine's own message where it refuses the model.
pub fn embedded_network(model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
    EmbeddedEngine.load(model, input_length)
}
