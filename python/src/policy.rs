//! The policies of the controller, by name or from an ONNX file.
//!
//! A graph of dense layers runs on the controller's dense engine, another file on the reference
//! evaluation that verifies engines: the package has no inference library.

use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Instant;

use clap::ValueEnum;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_decide::observation::{Observation, RoomState};
use heliostat_decide::policy::actor_file::{ActorFile, INPUT_NAME};
use heliostat_decide::policy::{self, Actor, DenseEngine, Engine, Network, PolicyError, PolicyKind, Resources};
use heliostat_decide::safety::Limits;
use heliostat_onnx::ModelProto;
use heliostat_onnx::reference::Reference;
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use prost::Message;
use pyo3::prelude::*;

use crate::arrays::{AnglePair, angles, cylinders, numbers, pair, positions};
use crate::error::{guarded, refused};
use crate::scenario::Scenario;

/// Evaluates dense graphs by the dense engine, and others by plain loops.
struct PlainEngine;

struct ReferenceNetwork {
    reference: Reference,
    input_length: usize,
    input: Vec<f32>,
    output: Vec<f32>,
}

impl Engine for PlainEngine {
    fn load(&self, model: &[u8], input_length: usize) -> Result<Box<dyn Network>, String> {
        if let Ok(network) = DenseEngine.load(model, input_length) {
            return Ok(network);
        }
        let model = ModelProto::decode(model).map_err(|error| error.to_string())?;
        let reference = Reference::new(&model)?;
        Ok(Box::new(ReferenceNetwork { reference, input_length, input: vec![0.0; input_length], output: Vec::new() }))
    }
}

impl Network for ReferenceNetwork {
    fn engine(&self) -> &'static str {
        "reference"
    }

    fn set_rows(&mut self, rows: usize) -> Result<(), PolicyError> {
        self.input.resize(rows * self.input_length, 0.0);
        Ok(())
    }

    fn input_mut(&mut self) -> &mut [f32] {
        &mut self.input
    }

    fn run(&mut self) -> Result<&[f32], PolicyError> {
        self.output.clear();
        for row in self.input.chunks_exact(self.input_length) {
            let run = self.reference.run(INPUT_NAME, row);
            self.output.extend(run.map_err(|message| PolicyError::Inference { message })?);
        }
        Ok(&self.output)
    }
}

/// The names of the policies that need no file.
#[pyfunction]
pub fn policy_names() -> Vec<String> {
    PolicyKind::value_variants().iter().filter(|kind| !kind.is_learned()).map(|kind| kind.name()).collect()
}

fn monotonic_ns() -> u64 {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64
}

enum Kind {
    Named(Box<dyn policy::Policy>),
    File(Box<Actor>),
}

impl Kind {
    fn as_policy(&mut self) -> &mut dyn policy::Policy {
        match self {
            Self::Named(policy) => policy.as_mut(),
            Self::File(actor) => actor.as_mut(),
        }
    }
}

/// A policy for a scenario's room: from users and obstacles to mirror angles.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Policy {
    model: ChannelModel,
    min_rate_bps: Vec<f64>,
    limits: Limits,
    policy: Mutex<Kind>,
}

#[pymethods]
impl Policy {
    #[new]
    fn new(scenario: &Scenario, name: &str) -> PyResult<Self> {
        let room = &scenario.inner;
        let policy = if name.ends_with(".onnx") {
            let bytes = std::fs::read(name).map_err(|error| refused(format!("{name}: {error}")))?;
            let file = ActorFile { origin: name.into(), bytes: bytes.into() };
            Kind::File(Box::new(Actor::load(&file, room, &PlainEngine).map_err(refused)?))
        } else {
            let known = policy_names();
            let kind = PolicyKind::from_str(name, false).ok().filter(|kind| !kind.is_learned());
            let kind = kind.ok_or_else(|| {
                refused(format!(
                    "unknown policy {name:?}: expected {}, or the path of a file FILE.onnx",
                    known.join(", ")
                ))
            })?;
            let resources = Resources { actor: None, engine: &PlainEngine, monotonic_ns };
            Kind::Named(policy::build(kind, room, &resources).map_err(refused)?)
        };
        Ok(Self {
            model: room.channel_model().map_err(refused)?,
            min_rate_bps: room.min_rate_bps(),
            limits: Limits::new(&room.control),
            policy: Mutex::new(policy),
        })
    }

    /// Roll and yaw of each mirror in rad, within the controller's range, for users at `positions`
    /// (K, 3) in m, `blockers` (N, 4) and minimum rates in Mbit/s.
    #[pyo3(signature = (positions, blockers = None, min_rate_mbps = None))]
    fn act<'py>(
        &self,
        py: Python<'py>,
        positions: PyReadonlyArray2<'py, f64>,
        blockers: Option<PyReadonlyArray2<'py, f64>>,
        min_rate_mbps: Option<PyReadonlyArray1<'py, f64>>,
    ) -> PyResult<AnglePair<'py>> {
        let places = self::positions(&positions, "positions")?;
        let blockers = cylinders(blockers.as_ref())?;
        let users = places.len();
        let min_rate_bps = match min_rate_mbps {
            Some(rates) => numbers(&rates, users, "min_rate_mbps")?.iter().map(|rate| 1e6 * rate).collect(),
            None => self.min_rate_bps.iter().copied().cycle().take(users).collect::<Vec<_>>(),
        };
        let mut observation = Observation::new(&self.model, users);
        let state = RoomState {
            tick: 0,
            positions: &places,
            orientations: None,
            velocities: &vec![heliostat_channel::Vec3::zeros(); users],
            min_rate_bps: &min_rate_bps,
            blockers: &blockers,
            forced: &vec![false; users],
            measured_los_gain: None,
        };
        let mut angles = MirrorAngles::flat(self.model.mirrors.len());
        py.detach(|| {
            guarded(|| {
                observation.set_state(&self.model, &state);
                let mut policy = self.policy.lock().unwrap_or_else(PoisonError::into_inner);
                policy.as_policy().act(&self.model, &observation, &mut angles).map_err(refused)?;
                self.limits.bound(&observation.angles, f64::INFINITY, &mut angles);
                Ok(())
            })
        })?;
        Ok(pair(py, angles))
    }

    /// Roll and yaw that the network of a file gives for a flat observation, as the file gives them.
    fn answer<'py>(&self, py: Python<'py>, observation: PyReadonlyArray1<'py, f32>) -> PyResult<AnglePair<'py>> {
        let mut policy = self.policy.lock().unwrap_or_else(PoisonError::into_inner);
        let Kind::File(actor) = &mut *policy else {
            return Err(refused("only a policy from a file reads an observation; use act"));
        };
        let expected = actor.info().encoder().len();
        if observation.len() != expected {
            return Err(refused(format!("an observation of length {}, expected {expected}", observation.len())));
        }
        let mut angles = MirrorAngles::flat(self.model.mirrors.len());
        guarded(|| actor.answer(observation.as_slice()?, &mut angles).map_err(refused))?;
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
        self.limits.bound(&MirrorAngles::flat(mirrors), f64::INFINITY, &mut bounded);
        Ok(pair(py, bounded))
    }
}
