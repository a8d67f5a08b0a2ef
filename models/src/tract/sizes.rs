//! Whether the tensors of a network fit into memory, from their shapes alone.
//!
//! A file of a few hundred bytes can name operators whose results have any size. tract computes the
//! value of an operator as soon as its inputs are constant, and then checks its size. This pass
//! visits the operators in the order of evaluation: shapes first, a bound on them, then the value.

use tract_hir::infer::InferenceFact;
use tract_hir::internal::{TVec, TractResult, anyhow, bail, ensure};
use tract_hir::prelude::InferenceModel;

/// Largest number of values of all tensors of a network together, 256 MiB of 32-bit floats.
const VALUES_MAX: usize = 1 << 26;
/// Largest number of operators: the time to optimise a network grows faster than their number.
const OPERATORS_MAX: usize = 10_000;

/// Refuses a network with too many operators, or with tensors that are too large or of unknown
/// size.
pub(super) fn check(model: &InferenceModel) -> TractResult<()> {
    let operators = model.nodes().len();
    ensure!(operators <= OPERATORS_MAX, "it has {operators} operators, expected at most {OPERATORS_MAX}");
    let mut facts: Vec<TVec<InferenceFact>> =
        model.nodes().iter().map(|node| node.outputs.iter().map(|output| output.fact.clone()).collect()).collect();
    let mut left = VALUES_MAX;
    for id in model.eval_order()? {
        let node = model.node(id);
        let inputs: TVec<InferenceFact> =
            node.inputs.iter().map(|outlet| facts[outlet.node][outlet.slot].clone()).collect();
        let observed = node.op.observe_outlets(model, node)?;
        let observed: TVec<InferenceFact> =
            observed.iter().map(|outlet| facts[outlet.node][outlet.slot].clone()).collect();
        let mut op = node.op.clone();
        let known = facts[id].clone();
        let (_, outputs, _) =
            op.infer_facts(inputs.iter().collect(), known.iter().collect(), observed.iter().collect())?;
        for fact in &outputs {
            let volume =
                volume(fact).map_err(|error| anyhow!("operator {} ({}): {error}", node.name, node.op.name()))?;
            let Some(rest) = left.checked_sub(volume) else {
                bail!(
                    "operator {} ({}): its result has {volume} values, expected at most {VALUES_MAX} in the complete network",
                    node.name,
                    node.op.name()
                );
            };
            left = rest;
        }
        // The same again with the value, where the inputs are constant.
        let (_, outputs, _) = op.infer(inputs.iter().collect(), known.iter().collect(), observed.iter().collect())?;
        facts[id] = outputs;
    }
    Ok(())
}

/// Number of values of a tensor.
fn volume(fact: &InferenceFact) -> TractResult<usize> {
    let Some(shape) = fact.shape.as_concrete_finite()? else {
        bail!("its result has a shape that is not known: expected fixed shapes");
    };
    let volume = shape.iter().try_fold(1_usize, |volume, extent| volume.checked_mul(*extent));
    volume.ok_or_else(|| anyhow!("its result has the shape {shape:?}, which no memory holds"))
}
