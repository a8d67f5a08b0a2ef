//! The policies of the controller, by name or from an ONNX file.
//!
//! A graph of dense layers runs on the controller's dense engine, another file on the reference
//! evaluation that verifies engines: the package has no inference library.

use std::sync::{Mutex, PoisonError};

use clap::ValueEnum;
use heliostat_channel::{ChannelModel, MirrorAngles};
use heliostat_core::observation::{Observation, RoomState};
use heliostat_core::policy::{self, Actor, PolicyKind};
use heliostat_core::safety::Limits;
use heliostat_models::{ActorSource, build, load_actor};
use numpy::{PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{AnglePair, angles, cylinders, few_users, numbers, pair, positions};
use crate::error::{guarded, refused};
use crate::scenario::Scenario;

/// The names of all policies; a learned one is the actor that is built in for the room.
#[pyfunction]
pub fn policy_names() -> Vec<String> {
    PolicyKind::value_variants().iter().map(|kind| kind.name()).collect()
}

enum Kind {
    /// A network from the observation to the angles.
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
        // A file is built as a learned policy; which one does not matter.
        let (kind, source) = if name.ends_with(".onnx") {
            (PolicyKind::Ddpg, ActorSource::Path(name.into()))
        } else {
            let unknown = || {
                let known = policy_names().join(", ");
                format!("unknown policy {name:?}: expected {known}, or the path of a file FILE.onnx")
            };
            (PolicyKind::find(name, unknown).map_err(refused)?, ActorSource::Shipped)
        };
        guarded(|| {
            let file = if kind.is_learned() { Some(source.fetch(kind, room).map_err(refused)?) } else { None };
            let policy = match &file {
                Some(file) => Kind::Actor(Box::new(load_actor(file, room).map_err(refused)?)),
                None => Kind::Other(build(kind, room, &source).map_err(refused)?),
            };
            Ok(Self {
                model: room.channel_model().map_err(refused)?,
                min_rate_bps: room.min_rate_bps(),
                limits: Limits::new(&room.control),
                policy: Mutex::new(policy),
            })
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
        few_users(places.len())?;
        let blockers = cylinders(blockers.as_ref())?;
        let users = places.len();
        let min_rate_bps = match min_rate_mbps {
            Some(rates) => numbers(&rates, users, "min_rate_mbps")?.iter().map(|rate| 1e6 * rate).collect(),
            None => self.min_rate_bps.iter().copied().cycle().take(users).collect::<Vec<_>>(),
        };
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
                let mut observation = Observation::new(&self.model, users);
                observation.set_state(&self.model, &state);
                let mut policy = self.policy.lock().unwrap_or_else(PoisonError::into_inner);
                policy.as_policy().act(&self.model, &observation, &mut angles).map_err(refused)?;
                self.limits.bound(&observation.angles, f64::INFINITY, &mut angles);
                Ok(())
            })
        })?;
        Ok(pair(py, angles))
    }

    /// Roll and yaw that an actor's network gives for a flat observation, without limits.
    fn answer<'py>(&self, py: Python<'py>, observation: PyReadonlyArray1<'py, f32>) -> PyResult<AnglePair<'py>> {
        let mut policy = self.policy.lock().unwrap_or_else(PoisonError::into_inner);
        let Kind::Actor(actor) = &mut *policy else {
            return Err(refused("only an actor with angles as its output reads an observation; use act"));
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
        guarded(|| {
            self.limits.bound(&MirrorAngles::flat(mirrors), f64::INFINITY, &mut bounded);
            Ok(())
        })?;
        Ok(pair(py, bounded))
    }
}
