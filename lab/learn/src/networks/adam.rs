//! The optimiser Adam (Kingma and Ba, 2015).

use candle_core::{Device, Result, Tensor, backprop::GradStore};

use super::layers::{Linear, assign, parameters};
use crate::training::store::{Persistent, Store};

/// Adam with its state in plain vectors, so that a checkpoint holds all of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    step: u64,
    first_moment: Vec<Vec<f32>>,
    second_moment: Vec<Vec<f32>>,
}

impl Adam {
    const BETA: [f64; 2] = [0.9, 0.999];
    const EPSILON: f32 = 1e-8;

    /// An optimiser for the parameters of one network.
    pub fn new(network: &impl AsRef<[Linear]>) -> Self {
        let zeros: Vec<Vec<f32>> =
            parameters(network.as_ref()).iter().map(|tensor| vec![0.0; tensor.elem_count()]).collect();
        Self { step: 0, first_moment: zeros.clone(), second_moment: zeros }
    }

    /// One step down the gradient at a learning rate.
    ///
    /// # Errors
    /// Errors of candle.
    pub fn step(&mut self, network: &impl AsRef<[Linear]>, gradients: &GradStore, learning_rate: f64) -> Result<()> {
        self.step += 1;
        let power = |beta: f64| 1.0 - beta.powf(self.step as f64);
        let [beta1, beta2] = Self::BETA;
        let rate = (learning_rate * power(beta2).sqrt() / power(beta1)) as f32;
        let (beta1, beta2) = (beta1 as f32, beta2 as f32);
        for (index, parameter) in parameters(network.as_ref()).into_iter().enumerate() {
            let Some(gradient) = gradients.get(parameter) else { continue };
            let gradient = gradient.flatten_all()?.to_vec1::<f32>()?;
            let mut value = parameter.flatten_all()?.to_vec1::<f32>()?;
            let moments = self.first_moment[index].iter_mut().zip(&mut self.second_moment[index]);
            for ((value, gradient), (first, second)) in value.iter_mut().zip(&gradient).zip(moments) {
                *first = beta1 * *first + (1.0 - beta1) * gradient;
                *second = beta2 * *second + (1.0 - beta2) * gradient * gradient;
                *value -= rate * *first / (second.sqrt() + Self::EPSILON);
            }
            assign(parameter, &Tensor::from_vec(value, parameter.shape(), &Device::Cpu)?)?;
        }
        Ok(())
    }
}

impl Persistent for Adam {
    fn save(&self, name: &str, store: &mut Store) -> anyhow::Result<()> {
        store.put(&format!("adam.{name}.steps"), &self.step)?;
        for (kind, moments) in [("first", &self.first_moment), ("second", &self.second_moment)] {
            for (index, moment) in moments.iter().enumerate() {
                store.put_floats(&format!("adam.{name}.{kind}.{index}"), moment)?;
            }
        }
        Ok(())
    }

    fn restore(&mut self, name: &str, store: &Store) -> anyhow::Result<()> {
        for (kind, moments) in [("first", &mut self.first_moment), ("second", &mut self.second_moment)] {
            for (index, moment) in moments.iter_mut().enumerate() {
                let key = format!("adam.{name}.{kind}.{index}");
                let found = store.floats(&key)?;
                let (expected, length) = (moment.len(), found.len());
                anyhow::ensure!(length == expected, "{key} in the checkpoint has {length} values, expected {expected}");
                *moment = found;
            }
        }
        self.step = store.get(&format!("adam.{name}.steps"))?;
        Ok(())
    }
}
