//! The contents of a checkpoint: tensors and JSON values by name.

use std::collections::HashMap;

use anyhow::Context;
use candle_core::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

/// A part of a run's state that a checkpoint holds.
pub trait Persistent {
    /// Writes the part under a name.
    ///
    /// # Errors
    /// Errors of candle, or a value that JSON cannot hold.
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()>;

    /// Reads the part that [`Persistent::save`] wrote under a name.
    ///
    /// # Errors
    /// The store lacks the part, or its shape differs.
    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()>;
}

/// The state of a run as named parts.
#[derive(Debug, Default)]
pub struct Store {
    pub(super) tensors: HashMap<String, Tensor>,
    pub(super) values: Map<String, Value>,
}

impl Store {
    /// Keeps a value as JSON.
    ///
    /// # Errors
    /// JSON cannot hold the value.
    pub fn put(&mut self, name: &str, value: &impl Serialize) -> anyhow::Result<()> {
        self.values.insert(name.into(), serde_json::to_value(value)?);
        Ok(())
    }

    /// The value of that name.
    ///
    /// # Errors
    /// The value is missing, or it has another type.
    pub fn get<T: DeserializeOwned>(&self, name: &str) -> anyhow::Result<T> {
        let value = self.values.get(name).with_context(|| format!("the checkpoint lacks {name}"))?;
        serde_json::from_value(value.clone()).with_context(|| format!("{name} in the checkpoint"))
    }

    /// Keeps a tensor.
    pub fn put_tensor(&mut self, name: String, tensor: Tensor) {
        self.tensors.insert(name, tensor);
    }

    /// The tensor of that name.
    ///
    /// # Errors
    /// The tensor is missing.
    pub fn tensor(&self, name: &str) -> anyhow::Result<&Tensor> {
        self.tensors.get(name).with_context(|| format!("the checkpoint lacks {name}"))
    }

    /// Keeps floats.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn put_floats(&mut self, name: &str, values: &[f32]) -> anyhow::Result<()> {
        self.put_tensor(name.into(), Tensor::from_slice(values, values.len(), &Device::Cpu)?);
        Ok(())
    }

    /// The floats of that name.
    ///
    /// # Errors
    /// The floats are missing.
    pub fn floats(&self, name: &str) -> anyhow::Result<Vec<f32>> {
        Ok(self.tensor(name)?.to_vec1()?)
    }

    /// Keeps the state of a random generator.
    ///
    /// # Errors
    /// JSON cannot hold the state; this does not happen.
    pub fn put_generator(&mut self, generator: &ChaCha8Rng) -> anyhow::Result<()> {
        self.put("generator", &(generator.get_seed(), generator.get_word_pos().to_string()))
    }

    /// The random generator in the state that was kept.
    ///
    /// # Errors
    /// The state is missing or not readable.
    pub fn generator(&self) -> anyhow::Result<ChaCha8Rng> {
        let (seed, position): ([u8; 32], String) = self.get("generator")?;
        let mut generator = ChaCha8Rng::from_seed(seed);
        generator.set_word_pos(position.parse().context("the generator's position is not a number")?);
        Ok(generator)
    }

    /// The name of a tensor that holds a value which is not finite, where there is one.
    pub(super) fn not_finite(&self) -> anyhow::Result<Option<&str>> {
        for (name, tensor) in &self.tensors {
            if tensor.dtype().is_float()
                && !tensor.flatten_all()?.to_vec1::<f32>()?.iter().all(|value| value.is_finite())
            {
                return Ok(Some(name));
            }
        }
        Ok(None)
    }
}

/// A number is kept as JSON.
macro_rules! persistent_numbers {
    ($($number:ty),*) => {
        $(impl Persistent for $number {
            fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
                store.put(name, self)
            }

            fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
                *self = store.get(name)?;
                Ok(())
            }
        })*
    };
}

persistent_numbers!(usize, f64);
