//! The embedded engine: tract, on the calling thread.
//!
//! A run copies its input and allocates in tract; the tests print how often. [`sizes`] refuses a
//! network whose tensors do not fit into memory before tract computes any of them. Graphs that
//! tract would misread are refused before it sees them.

mod sizes;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use heliostat_core::policy::{Engine, Network, PolicyError};
use heliostat_onnx::{ModelProto, standard::foreign_operator, uncomputed_output};
use prost::Message;
use tract_hir::infer::{Factoid, InferenceFact};
use tract_hir::internal::DimLike;
use tract_hir::prelude::{DatumType, InferenceModel, TDim};
use tract_onnx::prelude::{
    Framework, InferenceModelExt, IntoRunnable, Tensor, TractError, TractResult, TypedSimplePlan, tvec,
};

use crate::batch::Batch;

/// The name of this engine.
pub const TRACT: &str = "tract";

/// The number of rows for which the sizes of a network are checked that takes any number.
const ROWS_CHECKED: usize = 64;

/// Builds networks with tract.
#[derive(Clone, Copy, Debug)]
pub struct Tract;

impl Engine for Tract {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        check(model)?;
        // tract panics on some malformed networks. No state of ours is in use meanwhile.
        let network = catch_unwind(AssertUnwindSafe(|| network(model, input_length)))
            .map_err(|_| "it panicked: expected a network of operators that tract supports".to_owned())?;
        // The alternate form has the chain of causes.
        Ok(Box::new(network.map_err(|error| format!("{error:#}"))?))
    }
}

/// Refuses operators of another domain, which tract takes for the standard ones, and an output that
/// no node computes, on which tract panics.
fn check(model: &[u8]) -> Result<(), String> {
    let model = ModelProto::decode(model).map_err(|error| format!("it is not an ONNX model: {error}"))?;
    let graph = model.graph.ok_or("it holds no graph: expected a network")?;
    if let Some(foreign) = foreign_operator(&graph) {
        return Err(format!("the operator {foreign}: expected operators of the domain \"ai.onnx\""));
    }
    match uncomputed_output(&graph) {
        Some(output) => Err(format!("no node computes the output {output:?}: expected a network that ends in it")),
        None if graph.output.is_empty() => Err("the graph has no output: expected one".into()),
        None => Ok(()),
    }
}

fn network(bytes: &[u8], input_length: usize) -> TractResult<TractNetwork> {
    let model = tract_onnx::onnx().model_for_read(&mut &*bytes)?;
    let rows = model.input_fact(0).ok().map_or(Some(1), first_extent);
    let model = match rows {
        Some(_) => {
            sizes::check(&model)?;
            model
        }
        None => {
            // The shapes of the results follow from that of the input.
            let shapes_left_open = tract_onnx::onnx().with_ignore_output_shapes(true).with_ignore_value_info(true);
            let model = shapes_left_open.model_for_read(&mut &*bytes)?;
            sizes::check(&with_rows(model.clone(), ROWS_CHECKED.into(), input_length)?)?;
            let rows = model.symbols.new_with_prefix("rows").into();
            with_rows(model, rows, input_length)?
        }
    };
    let plan = model.into_optimized()?.into_runnable()?;
    Ok(TractNetwork { plan, batch: Batch::new(input_length, rows) })
}

/// The first extent of a shape; `None` where it is open.
fn first_extent(fact: &InferenceFact) -> Option<usize> {
    fact.shape.dim(0)?.concretize()?.to_usize().ok()
}

/// The model for an input of this many rows.
fn with_rows(model: InferenceModel, rows: TDim, input_length: usize) -> TractResult<InferenceModel> {
    let shape = [rows, input_length.into()];
    model.with_input_fact(0, InferenceFact::dt_shape(DatumType::F32, shape))
}

struct TractNetwork {
    plan: Arc<TypedSimplePlan>,
    batch: Batch,
}

impl Network for TractNetwork {
    fn engine(&self) -> &'static str {
        TRACT
    }

    fn set_rows(&mut self, rows: usize) -> Result<(), PolicyError> {
        self.batch.set_rows(rows)
    }

    fn input_mut(&mut self) -> &mut [f32] {
        self.batch.input_mut()
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        let failed = |error: TractError| PolicyError::Inference { message: format!("{error:#}") };
        self.batch.run(|shape, input, output| {
            let input = Tensor::from_shape(&shape, input).map_err(failed)?;
            // tract panics on an index that a malformed network computes. Each run has a state of
            // its own.
            let run = catch_unwind(AssertUnwindSafe(|| self.plan.run(tvec!(input.into()))));
            let panicked =
                |_| PolicyError::Inference { message: "the network panicked: repair the actor file".to_owned() };
            let outputs = run.map_err(panicked)?.map_err(failed)?;
            let view = outputs[0].try_as_plain_ram().map_err(failed)?;
            output.extend_from_slice(view.as_slice::<f32>().map_err(failed)?);
            Ok(())
        })
    }
}
