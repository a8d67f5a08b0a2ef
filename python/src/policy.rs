//! The policies of the controller, by name or from an ONNX file.
//!
//! A file runs on the engines of the controller: a chain of dense layers in Rust, another graph on
//! ONNX Runtime, whose shared library the package `onnxruntime` brings.

use clap::ValueEnum;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::{Observation, RoomState};
use heliostat_core::policy::actor_file::ActorFile;
use heliostat_core::policy::{self, Actor, PolicyKind, PolicyMemory};
use heliostat_core::safety::Limits;
use heliostat_models::{ActorSource, build, library, load_actor};
use heliostat_scenario::similar;
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arrays::{AnglePair, angles, cylinders, few_users, min_rates_bps, orientations, pair, positions};
use crate::error::{guarded, refused};
use crate::exclusive::Exclusive;
use crate::scenario::Scenario;

/// The names of all policies; a learned one is the actor that is built in for the room.
#[pyfunction]
pub fn policy_names() -> Vec<String> {
    PolicyKind::value_variants().iter().map(|kind| kind.name()).collect()
}

enum Kind {
    /// A learned policy.
    Actor(Box<Actor>),
    Other(Box<dyn policy::Policy>),
}

impl Kind {
    fn as_policy(&mut self) -> &mut dyn policy::Policy {
        match self {
            Self::Actor(actor) => actor.as_mut(),
            Self::Other(policy) => policy.as_mut(),
        }
    }
}

/// Uses this shared library of ONNX Runtime, unless the environment names another.
#[pyfunction]
pub fn use_onnxruntime(path: std::path::PathBuf) {
    if library::candidates().named_by.is_none() {
        library::choose(path);
    }
}

/// A policy for a scenario's room: from users and obstacles to mirror angles.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Policy {
    scenario: heliostat_scenario::Scenario,
    name: String,
    /// The file of a learned policy.
    file: Option<ActorFile>,
    model: ChannelModel,
    min_rate_bps: Vec<f64>,
    limits: Limits,
    policy: Exclusive<Kind>,
}

impl Policy {
    /// A policy, with the file of a learned one.
    fn with_file(room: &heliostat_scenario::Scenario, name: &str, file: Option<ActorFile>) -> PyResult<Self> {
        let policy = match &file {
            Some(file) => Kind::Actor(Box::new(load_actor(file, room).map_err(refused)?)),
            None => Kind::Other(build(found(name)?, room, &ActorSource::Shipped).map_err(refused)?),
        };
        Ok(Self {
            scenario: room.clone(),
            name: name.into(),
            file,
            model: room.channel_model().map_err(refused)?,
            min_rate_bps: room.min_rate_bps(),
            limits: Limits::new(&room.control),
            policy: Exclusive::new(policy),
        })
    }
}

/// The policy of a name.
fn found(name: &str) -> PyResult<PolicyKind> {
    let unknown = || {
        let names = policy_names();
        let (known, hint) = (names.join(", "), similar::hint(name, names.iter().map(String::as_str)));
        format!("unknown policy {name:?}: expected {known}, or the path of a file FILE.onnx{hint}")
    };
    PolicyKind::from_str(name, false).map_err(|_| refused(unknown()))
}

/// The policy of a pickle: with the bytes of its file, and its memory as JSON.
#[pyfunction]
pub fn restored_policy(
    scenario: &Scenario,
    name: &str,
    file: Option<(String, Vec<u8>)>,
    memory: &str,
) -> PyResult<Policy> {
    let memory: PolicyMemory = serde_json::from_str(memory).map_err(refused)?;
    guarded(|| {
        let file = file.map(|(origin, bytes)| ActorFile { origin, bytes: bytes.into() });
        let policy = Policy::with_file(&scenario.inner, name, file)?;
        policy.policy.hold()?.as_policy().restore(&memory);
        Ok(policy)
    })
}

#[pymethods]
impl Policy {
    #[new]
    fn new(scenario: &Scenario, name: &str) -> PyResult<Self> {
        let room = &scenario.inner;
        // A file is built as a learned policy; which one does not matter.
        let (kind, source) = if name.ends_with(".onnx") {
            (PolicyKind::Ddpg, ActorSource::Path(name.into()))
        } else {
            (found(name)?, ActorSource::Shipped)
        };
        guarded(|| {
            let file = if kind.is_learned() { Some(source.fetch(kind, room).map_err(refused)?) } else { None };
            Self::with_file(room, name, file)
        })
    }

    /// For pickles and copies.
    #[expect(clippy::type_complexity, reason = "the arguments of restored_policy")]
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Scenario, String, Option<(String, Bound<'py, PyBytes>)>, String))> {
        let memory = self.policy.hold()?.as_policy().memory();
        let file = self.file.as_ref().map(|file| (file.origin.clone(), PyBytes::new(py, &file.bytes)));
        let memory = serde_json::to_string(&memory).map_err(refused)?;
        let arguments = (Scenario { inner: self.scenario.clone() }, self.name.clone(), file, memory);
        Ok((py.import("heliostat._core")?.getattr("restored_policy")?, arguments))
    }

    /// Roll and yaw of each mirror in rad, within the controller's range, for users at `positions`
    /// (K, 3) in m, `blockers` (N, 4), minimum rates in Mbit/s and normals of the receivers (K, 3).
    #[pyo3(signature = (positions, blockers = None, min_rate_mbps = None, normals = None))]
    fn act<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        blockers: Option<PyReadonlyArray2<'py, f64>>,
        min_rate_mbps: Option<PyReadonlyArray1<'py, f64>>,
        normals: Option<PyReadonlyArray2<'py, f64>>,
    ) -> PyResult<AnglePair<'py>> {
        let places = self::positions(&positions, "positions")?;
        few_users(places.len())?;
        let blockers = cylinders(blockers.as_ref())?;
        let held = normals.as_ref().map(orientations).transpose()?;
        let users = places.len();
        let min_rate_bps = match min_rate_mbps {
            Some(rates) => min_rates_bps(&rates, users)?,
            None => self.min_rate_bps.iter().copied().cycle().take(users).collect::<Vec<_>>(),
        };
        let state = RoomState {
            tick: 0,
            positions: &places,
            orientations: held.as_deref(),
            velocities: &vec![heliostat_channel::Vec3::zeros(); users],
            min_rate_bps: &min_rate_bps,
            blockers: &blockers,
            forced: &vec![false; users],
            measured_los_gain: None,
        };
        let mut angles = MirrorAngles::flat(self.model.mirrors.len());
        py.detach(|| {
            guarded(|| {
                let mut observation = Observation::new(&self.model, users);
                observation.set_state(&self.model, &state);
                let mut policy = self.policy.hold()?;
                policy.as_policy().act(&self.model, &observation, &mut angles).map_err(refused)?;
                self.limits.bound(&observation.angles, f64::INFINITY, &mut angles);
                Ok(())
            })
        })?;
        Ok(pair(py, angles))
    }

    /// Roll and yaw of a learned policy for an observation vector, without limits.
    fn answer<'py>(&self, py: Python<'py>, observation: PyReadonlyArray1<'py, f32>) -> PyResult<AnglePair<'py>> {
        let mut policy = self.policy.hold()?;
        let Kind::Actor(actor) = &mut *policy else {
            return Err(refused("only a learned policy reads an observation; use act"));
        };
        let mut angles = MirrorAngles::flat(self.model.mirrors.len());
        guarded(|| actor.answer(&self.model, observation.as_slice()?, &mut angles).map_err(refused))?;
        Ok(pair(py, angles))
    }

    /// Limits angles in rad to the controller's range.
    fn bound<'py>(
        &self,
        py: Python<'py>,
        roll: PyReadonlyArray1<'py, f64>,
        yaw: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<AnglePair<'py>> {
        let mirrors = self.model.mirrors.len();
        let mut bounded = angles(&roll, &yaw, mirrors)?;
        guarded(|| {
            self.limits.bound(&MirrorAngles::flat(mirrors), f64::INFINITY, &mut bounded);
            Ok(())
        })?;
        Ok(pair(py, bounded))
    }
}
