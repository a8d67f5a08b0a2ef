//! The physics of a room as functions on arrays.

use heliostat_channel::link::ber_ook;
use heliostat_channel::{ChannelModel, MirrorAngles, Scene, Solver, decode};
use heliostat_environment::held_out::best_angles;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{AnglePair, angles, cylinders, few_users, min_rates_bps, numbers, orientations, pair, positions};
use crate::error::{guarded, refused};
use crate::scenario::Scenario;

/// Largest number of pairs of user and mirror of a call: their tables need about 1 GB.
const PAIRS_MAX: usize = 1 << 25;

/// The channel of a scenario's room: gains, SINR and rates of users under mirror angles, the
/// decoder and the oracle.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Channel {
    scenario: heliostat_scenario::Scenario,
    model: ChannelModel,
    min_rate_bps: Vec<f64>,
}

impl Channel {
    fn scene(
        &self,
        places: &PyReadonlyArray2<'_, f64>,
        blockers: Option<&PyReadonlyArray2<'_, f64>>,
        normals: Option<&PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Scene> {
        let places = positions(places, "positions")?;
        let most = PAIRS_MAX / self.model.mirrors.len();
        if places.len() > most {
            return Err(refused(format!("positions holds {} users, expected at most {most} at once", places.len())));
        }
        let blockers = cylinders(blockers)?;
        let held = normals.map(orientations).transpose()?;
        guarded(|| {
            let mut scene = Scene::new(&self.model, places.len());
            let forced = vec![false; places.len()];
            match &held {
                Some(held) => scene.update_turned(&self.model, &places, held, &blockers, &forced),
                None => scene.update(&self.model, &places, &blockers, &forced),
            }
            Ok(scene)
        })
    }
}

#[pymethods]
impl Channel {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        let model = guarded(|| scenario.inner.channel_model().map_err(refused))?;
        Ok(Self { scenario: scenario.inner.clone(), model, min_rate_bps: scenario.inner.min_rate_bps() })
    }

    /// For pickles and copies.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (Scenario,)) {
        (slf.get_type().into_any(), (Scenario { inner: slf.get().scenario.clone() },))
    }

    /// Number of mirrors.
    #[getter]
    fn mirrors(&self) -> usize {
        self.model.mirrors.len()
    }

    /// Centres of the mirrors in m, shape (M, 3).
    #[getter]
    fn mirror_positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let arrays = self.model.mirrors.arrays().iter();
        let values: Vec<f64> = arrays.flat_map(|array| array.positions()).flat_map(|at| [at.x, at.y, at.z]).collect();
        PyArray1::from_vec(py, values).reshape([self.mirrors(), 3])
    }

    /// Gains, SINR, rates and bit error rates of users under mirror angles: arrays of shape (K,).
    ///
    /// `positions`: (K, 3) in m. `roll`, `yaw`: (M,) in rad. `blockers`: (N, 4), x, y, radius and
    /// height in m. `sharing`: the number of users that share the bandwidth, K if absent. `normals`, here and below:
    /// (K, 3), the directions in which the receivers face; up if absent.
    #[pyo3(signature = (positions, roll, yaw, blockers = None, sharing = None, normals = None))]
    #[expect(clippy::too_many_arguments, reason = "the arguments of a Python method")]
    fn link<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        roll: PyReadonlyArray1<'py, f64>,
        yaw: PyReadonlyArray1<'py, f64>,
        blockers: Option<PyReadonlyArray2<'py, f64>>,
        sharing: Option<usize>,
        normals: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let scene = self.scene(&positions, blockers.as_ref(), normals.as_ref())?;
        let angles = angles(&roll, &yaw, self.mirrors())?;
        let sharing = sharing.unwrap_or(scene.users());
        if sharing == 0 {
            return Err(refused("sharing = 0: expected at least one user"));
        }
        let [mut irs_gain, mut sinr] = [vec![0.0; scene.users()], vec![0.0; scene.users()]];
        py.detach(|| {
            guarded(|| {
                scene.irs_gain(&self.model, &angles, &mut irs_gain);
                scene.sinr(&self.model, &angles, &mut sinr);
                Ok(())
            })
        })?;
        let out = PyDict::new(py);
        out.set_item("los_gain", PyArray1::from_slice(py, scene.los_gain()))?;
        out.set_item("irs_gain", PyArray1::from_vec(py, irs_gain))?;
        let rate = |sinr: &f64| 1e-6 * self.model.budget.rate_bps(*sinr, sharing);
        out.set_item("rate_mbps", PyArray1::from_iter(py, sinr.iter().map(rate)))?;
        out.set_item("ber", PyArray1::from_iter(py, sinr.iter().map(|sinr| ber_ook(*sinr))))?;
        out.set_item("sinr", PyArray1::from_vec(py, sinr))?;
        out.set_item("blocked", PyArray1::from_slice(py, scene.los_blocked()))?;
        Ok(out)
    }

    /// The gain of each mirror for each user if it were aimed at that user: shape (K, M).
    #[pyo3(signature = (positions, blockers = None, normals = None))]
    fn steering_gain<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        blockers: Option<PyReadonlyArray2<'py, f64>>,
        normals: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let scene = self.scene(&positions, blockers.as_ref(), normals.as_ref())?;
        PyArray1::from_slice(py, scene.steering_gain()).reshape([scene.users(), scene.mirrors()])
    }

    /// The decoder: roll and yaw of each mirror in rad from one weight per user, not negative.
    #[pyo3(signature = (positions, weights, blockers = None, normals = None))]
    fn decode<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        weights: PyReadonlyArray1<'py, f64>,
        blockers: Option<PyReadonlyArray2<'py, f64>>,
        normals: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<AnglePair<'py>> {
        let scene = self.scene(&positions, blockers.as_ref(), normals.as_ref())?;
        let weights = numbers(&weights, scene.users(), "weights")?;
        if let Some(weight) = weights.iter().find(|weight| **weight < 0.0) {
            return Err(refused(format!("weights holds {weight}, expected numbers from 0")));
        }
        let mut angles = MirrorAngles::flat(self.mirrors());
        py.detach(|| {
            guarded(|| {
                decode::decode(&self.model, &scene, &weights, &mut angles);
                Ok(())
            })
        })?;
        Ok(pair(py, angles))
    }

    /// The angles of the oracle with minimum rates in Mbit/s; those of the scenario if absent.
    #[pyo3(signature = (positions, blockers = None, min_rate_mbps = None, normals = None))]
    fn oracle<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        blockers: Option<PyReadonlyArray2<'py, f64>>,
        min_rate_mbps: Option<PyReadonlyArray1<'py, f64>>,
        normals: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<AnglePair<'py>> {
        let scene = self.scene(&positions, blockers.as_ref(), normals.as_ref())?;
        few_users(scene.users())?;
        let min_rate_bps = match min_rate_mbps {
            Some(rates) => min_rates_bps(&rates, scene.users())?,
            None => self.min_rate_bps.iter().copied().cycle().take(scene.users()).collect::<Vec<_>>(),
        };
        let angles = py.detach(|| {
            guarded(|| {
                let mut solver = Solver::new(scene.users(), scene.mirrors());
                Ok(best_angles(&mut solver, &self.model, &scene, &min_rate_bps))
            })
        })?;
        Ok(pair(py, angles))
    }
}
