//! The embedded engine: tract, on the calling thread.
//!
//! A run copies its input and allocates in tract; the tests print how often. [`sizes`] refuses a
//! network whose tensors do not fit into memory before tract computes any of them.

mod sizes;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use heliostat_decide::policy::{Engine, Network, PolicyError};
use tract_onnx::prelude::{Framework, InferenceModelExt, IntoRunnable, Tensor, TractResult, TypedSimplePlan, tvec};

/// Builds networks with tract.
#[derive(Clone, Copy, Debug)]
pub struct Tract;

impl Engine for Tract {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        // tract panics on some malformed networks. No state of ours is in use meanwhile.
        let plan = catch_unwind(AssertUnwindSafe(|| plan(model)))
            .map_err(|_| "it panicked: expected a network of operators that tract supports".to_owned())?;
        // The alternate form has the chain of causes.
        let plan = plan.map_err(|error| format!("{error:#}"))?;
        Ok(Box::new(TractNetwork { plan, input: vec![0.0; input_length], output: Vec::new() }))
    }
}

fn plan(mut model: &[u8]) -> TractResult<Arc<TypedSimplePlan>> {
    let model = tract_onnx::onnx().model_for_read(&mut model)?;
    sizes::check(&model)?;
    model.into_optimized()?.into_runnable()
}

struct TractNetwork {
    plan: Arc<TypedSimplePlan>,
    input: Vec<f32>,
    /// A copy of the last output.
    output: Vec<f32>,
}

impl Network for TractNetwork {
    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        let failed = |error: tract_onnx::prelude::TractError| PolicyError::Inference { message: format!("{error:#}") };
        let input = Tensor::from_shape(&[1, self.input.len()], &self.input).map_err(failed)?;
        // tract panics on an index that a malformed network computes. Each run has a state of its own.
        let run = catch_unwind(AssertUnwindSafe(|| self.plan.run(tvec!(input.into()))));
        let panicked = |_| PolicyError::Inference { message: "the network panicked: repair the actor file".to_owned() };
        let outputs = run.map_err(panicked)?.map_err(failed)?;
        let view = outputs[0].try_as_plain_ram().map_err(failed)?;
        let values = view.as_slice::<f32>().map_err(failed)?;
        self.output.clear();
        self.output.extend_from_slice(values);
        Ok(&self.output)
    }
}
