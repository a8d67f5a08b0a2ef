//! Operators that select and arrange values, and pooling along columns.

use crate::reference::call::{Call, around, axis_of};
use crate::tensor::{Data, Tensor};
use crate::tensor_proto::DataType;

/// The output of an operator that arranges values; `None` for any other.
pub fn evaluate(call: &Call<'_>) -> Option<Tensor> {
    match call.node.op_type.as_str() {
        "Identity" | "Dropout" => call.input(0).cloned(),
        "Constant" => Tensor::read(call.attribute("value")?.t.as_ref()?),
        "Cast" => cast(call),
        "Concat" => concat(call),
        "Flatten" => flatten(call),
        "Gather" => gather(call),
        "Reshape" => reshape(call),
        "Slice" => slice(call),
        "Squeeze" | "Unsqueeze" => squeeze(call),
        "Transpose" => transpose(call),
        _ => None,
    }
}

impl Tensor {
    /// The values at these indices, in another shape.
    fn picked(&self, shape: Vec<usize>, indices: impl Iterator<Item = usize>) -> Self {
        let data = match &self.data {
            Data::Floats(values) => Data::Floats(indices.map(|index| values[index]).collect()),
            Data::Integers(values) => Data::Integers(indices.map(|index| values[index]).collect()),
        };
        Self { shape, data }
    }

    fn reshaped(&self, shape: Vec<usize>) -> Option<Self> {
        let product = |shape: &[usize]| shape.iter().try_fold(1_usize, |product, extent| product.checked_mul(*extent));
        (product(&shape)? == product(&self.shape)?).then(|| Self { shape, data: self.data.clone() })
    }
}

fn cast(call: &Call<'_>) -> Option<Tensor> {
    let tensor = call.input(0)?;
    let data = match (DataType::try_from(call.integer("to", 0) as i32).ok()?, &tensor.data) {
        (DataType::Float, Data::Integers(values)) => Data::Floats(values.iter().map(|value| *value as f32).collect()),
        (DataType::Int64, Data::Floats(values)) => Data::Integers(values.iter().map(|value| *value as i64).collect()),
        (DataType::Float, Data::Floats(_)) | (DataType::Int64, Data::Integers(_)) => tensor.data.clone(),
        _ => return None,
    };
    Some(Tensor { shape: tensor.shape.clone(), data })
}

fn concat(call: &Call<'_>) -> Option<Tensor> {
    let tensors = call.inputs.iter().copied().collect::<Option<Vec<&Tensor>>>()?;
    let first = *tensors.first()?;
    let axis = axis_of(call.integer("axis", 0), first.shape.len())?;
    let mut shape = first.shape.clone();
    shape[axis] = tensors.iter().map(|tensor| tensor.shape.get(axis)).sum::<Option<usize>>()?;
    let fits = |tensor: &&Tensor| {
        tensor.shape.len() == shape.len()
            && (0..shape.len()).all(|other| other == axis || tensor.shape[other] == shape[other])
    };
    if !tensors.iter().all(fits) {
        return None;
    }
    let before = around(&shape, axis).0;
    let mut all = Tensor {
        shape,
        data: match first.data {
            Data::Floats(_) => Data::Floats(vec![]),
            Data::Integers(_) => Data::Integers(vec![]),
        },
    };
    for block in 0..before {
        for tensor in &tensors {
            let (_, at, after) = around(&tensor.shape, axis);
            let range = block * at * after..(block + 1) * at * after;
            match (&mut all.data, &tensor.data) {
                (Data::Floats(all), Data::Floats(values)) => all.extend_from_slice(&values[range]),
                (Data::Integers(all), Data::Integers(values)) => all.extend_from_slice(&values[range]),
                _ => return None,
            }
        }
    }
    Some(all)
}

fn flatten(call: &Call<'_>) -> Option<Tensor> {
    let tensor = call.input(0)?;
    let axis = usize::try_from(call.integer("axis", 1)).ok().filter(|axis| *axis <= tensor.shape.len())?;
    let (outer, inner) = tensor.shape.split_at(axis);
    tensor.reshaped(vec![outer.iter().product(), inner.iter().product()])
}

fn gather(call: &Call<'_>) -> Option<Tensor> {
    let (table, places, indices) = (call.input(0)?, call.input(1)?, call.integers(1)?);
    let axis = axis_of(call.integer("axis", 0), table.shape.len())?;
    let (before, at, after) = around(&table.shape, axis);
    let indices = indices.iter().map(|index| axis_of(*index, at)).collect::<Option<Vec<_>>>()?;
    let shape = [&table.shape[..axis], &places.shape, &table.shape[axis + 1..]].concat();
    let rows = (0..before).flat_map(|block| indices.iter().map(move |index| (block * at + index) * after));
    Some(table.picked(shape, rows.flat_map(|start| start..start + after)))
}

fn reshape(call: &Call<'_>) -> Option<Tensor> {
    let (tensor, expected) = (call.input(0)?, call.integers(1)?);
    if call.integer("allowzero", 0) != 0 {
        return None;
    }
    let mut shape = Vec::new();
    for (axis, extent) in expected.iter().enumerate() {
        shape.push(match extent {
            0 => *tensor.shape.get(axis)?,
            // Filled in below.
            -1 => 1,
            extent => usize::try_from(*extent).ok()?,
        });
    }
    if let Some(open) = expected.iter().position(|extent| *extent == -1) {
        let known = shape.iter().try_fold(1_usize, |product, extent| product.checked_mul(*extent))?;
        shape[open] = tensor.shape.iter().product::<usize>().checked_div(known)?;
    }
    tensor.reshaped(shape)
}

fn slice(call: &Call<'_>) -> Option<Tensor> {
    let mut tensor = call.input(0)?.clone();
    let (starts, ends) = (call.integers(1)?, call.integers(2)?);
    let counted: Vec<i64> = (0..starts.len() as i64).collect();
    let axes = if call.input(3).is_some() { call.integers(3)? } else { &counted };
    if call.input(4).is_some() && call.integers(4)?.iter().any(|step| *step != 1) {
        return None;
    }
    for ((start, end), axis) in starts.iter().zip(ends).zip(axes) {
        let axis = axis_of(*axis, tensor.shape.len())?;
        let (before, at, after) = around(&tensor.shape, axis);
        let within =
            |bound: i64| (if bound < 0 { bound.saturating_add(at as i64) } else { bound }).clamp(0, at as i64) as usize;
        let (start, end) = (within(*start), within(*end));
        let mut shape = tensor.shape.clone();
        shape[axis] = end.saturating_sub(start);
        let blocks = (0..before).flat_map(|block| (block * at + start) * after..(block * at + end.max(start)) * after);
        tensor = tensor.picked(shape, blocks);
    }
    Some(tensor)
}

/// Removes axes of extent 1, or inserts them.
fn squeeze(call: &Call<'_>) -> Option<Tensor> {
    let (tensor, axes) = (call.input(0)?, call.integers(1)?);
    let mut shape = tensor.shape.clone();
    if call.node.op_type == "Unsqueeze" {
        let rank = shape.len() + axes.len();
        let mut axes = axes.iter().map(|axis| axis_of(*axis, rank)).collect::<Option<Vec<_>>>()?;
        axes.sort_unstable();
        if axes.windows(2).any(|pair| pair[0] == pair[1]) {
            return None;
        }
        axes.into_iter().for_each(|axis| shape.insert(axis, 1));
    } else {
        let axes = axes.iter().map(|axis| axis_of(*axis, shape.len())).collect::<Option<Vec<_>>>()?;
        shape = shape.iter().enumerate().filter(|(axis, _)| !axes.contains(axis)).map(|(_, extent)| *extent).collect();
    }
    tensor.reshaped(shape)
}

fn transpose(call: &Call<'_>) -> Option<Tensor> {
    let tensor = call.input(0)?;
    let [rows, columns] = tensor.shape[..] else { return None };
    if call.attribute("perm").is_some_and(|perm| perm.ints != [1, 0]) {
        return None;
    }
    let indices = (0..columns).flat_map(|column| (0..rows).map(move |row| row * columns + column));
    Some(tensor.picked(vec![columns, rows], indices))
}

/// The maximum of each column of an image and its index, as [`crate::graph::Graph::best_row`] uses
/// the operator.
pub fn max_pool(call: &Call<'_>) -> Option<Vec<Tensor>> {
    let [1, 1, rows, columns] = call.input(0)?.shape[..] else { return None };
    let only = call.node.attribute.iter().all(|attribute| attribute.name == "kernel_shape");
    if !only || call.attribute("kernel_shape")?.ints != [rows as i64, 1] || rows == 0 {
        return None;
    }
    let values = call.floats(0)?;
    let at = |row: usize, column: usize| values[row * columns + column];
    let best =
        |column: usize| (1..rows).fold(0, |best, row| if at(row, column) > at(best, column) { row } else { best });
    let rows: Vec<usize> = (0..columns).map(best).collect();
    let shape = vec![1, 1, 1, columns];
    let best = rows.iter().enumerate().map(|(column, row)| at(*row, column)).collect();
    let index = rows.iter().enumerate().map(|(column, row)| (row * columns + column) as i64).collect();
    Some(vec![Tensor { shape: shape.clone(), data: Data::Floats(best) }, Tensor { shape, data: Data::Integers(index) }])
}
