//! The rules of a controller for a function in Python: the decision core around it.
//!
//! The caller has the session, the clock and the thread. The core decides what the function sees,
//! whether a command is due, under which epoch, and what happens where the function fails.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use heliostat_core::core::{DegradedMode, Timing};
use heliostat_core::refusal::Stream;
use heliostat_core::room_core::{Handled, Input, InputChannel, InputKey, Output, Repeater, RoomCore, RoomSettings};
use heliostat_core::tenure::{Tenure, TenureEvent};
use heliostat_environment::function_policy::FunctionPolicy;
use heliostat_proto::NodeStatus;
use numpy::{AllowTypeChange, PyArray1, PyArrayLike1};
use pyo3::exceptions::{PyException, PyRuntimeError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::error::{failure, guarded, refused};
use crate::exclusive::lock;
use crate::scenario::Scenario;
use crate::settings::action_form;

/// An exception that is no failure of the function, such as `KeyboardInterrupt`.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// What the core publishes.
type Published = Vec<(Output, Vec<u8>)>;

/// Payloads, each with the name of its key and the index of its array.
type Payloads<'py> = Vec<(&'static str, usize, Bound<'py, PyBytes>)>;

/// A controller whose policy is a function in Python.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Commander {
    room: Mutex<RoomCore>,
    /// Repeats stops also while the function does not return.
    repeater: Arc<Mutex<Repeater>>,
    /// What the controller assumes of the room.
    scenario: heliostat_scenario::Scenario,
    failures: Arc<AtomicU64>,
    raised: Raised,
    #[pyo3(get)]
    arrays: usize,
    /// Time between two position reports in s, or `control.deadline_ms`.
    #[pyo3(get)]
    deadline_s: f64,
}

/// The name and the array of a key under which a function publishes; `None` for others.
fn place(output: Output) -> Option<(&'static str, usize)> {
    match output {
        Output::Command(array) => Some(("command", array)),
        Output::StopRepetition(array) => Some(("stop_repetition", array)),
        Output::Stop => Some(("stop", 0)),
        Output::Geometry | Output::Belief | Output::Memory => None,
    }
}

/// The key of a message by its name in Python.
fn key(name: &str, array: usize) -> PyResult<InputKey> {
    let stream = match name {
        "users" => Stream::Users,
        "channel" => Stream::Channel,
        "obstacles" => Stream::Obstacles,
        "orientation" => Stream::Orientation,
        "leds" => Stream::Leds,
        "telemetry" => Stream::Telemetry,
        "capabilities" => return Ok(InputKey::Capabilities(array)),
        "safety" => return Ok(InputKey::Safety(array)),
        "stops" => return Ok(InputKey::Stops(array)),
        "stop" => return Ok(InputKey::Stop),
        "room_geometry" => return Ok(InputKey::Geometry),
        other => return Err(refused(format!("a controller reads no message {other:?}"))),
    };
    Ok(InputKey::Report(InputChannel { stream, array }))
}

impl Commander {
    fn room(&self) -> PyResult<MutexGuard<'_, RoomCore>> {
        self.room.try_lock().map_err(|_| {
            PyRuntimeError::new_err("the controller is in use: call it from one thread, and not from its function")
        })
    }

    fn repeater(&self) -> MutexGuard<'_, Repeater> {
        lock(&self.repeater)
    }

    /// Runs a step, and then raises what the function raised.
    fn step(&self, work: impl FnOnce(&mut RoomCore, &mut Published)) -> PyResult<Published> {
        let mut room = self.room()?;
        let mut published = Published::new();
        let done = guarded(|| {
            work(&mut room, &mut published);
            Ok(())
        });
        match lock(&self.raised).take() {
            Some(raised) => Err(raised),
            None => done.map(|()| published),
        }
    }
}

fn payloads(py: Python<'_>, published: Published) -> Payloads<'_> {
    let placed = |(output, payload): (Output, Vec<u8>)| {
        place(output).map(|(name, array)| (name, array, PyBytes::new(py, &payload)))
    };
    published.into_iter().filter_map(placed).collect()
}

#[pymethods]
impl Commander {
    #[new]
    #[pyo3(signature = (scenario, function, action, source, name = "python"))]
    fn new(scenario: &Scenario, function: Py<PyAny>, action: &str, source: u64, name: &str) -> PyResult<Self> {
        let room = &scenario.inner;
        let deadline_s = room.decision_deadline_s();
        let raised = Raised::default();
        let shared = Arc::clone(&raised);
        let call = move |vector: &[f32]| {
            Python::attach(|py| {
                let answer = function.call1(py, (PyArray1::from_slice(py, vector),)).and_then(|answer| {
                    let answer: PyArrayLike1<'_, f32, AllowTypeChange> = answer.extract(py)?;
                    Ok(answer.as_array().to_vec())
                });
                answer.map_err(|error| {
                    let problem = failure(py, &error);
                    if !error.is_instance_of::<PyException>(py) {
                        *lock(&shared) = Some(error);
                    }
                    problem
                })
            })
        };
        let form = action_form(action)?;
        guarded(|| {
            let policy = FunctionPolicy::new(name, room, form, call);
            let failures = policy.failures();
            let interval_s = 1.0 / room.streams.positions.rate_hz;
            let settings = RoomSettings::new(source, Tenure::live(source, (interval_s * 1e9) as u64));
            let core = RoomCore::new(room, Box::new(policy), settings).map_err(refused)?;
            let arrays = core.controller().arrays();
            let (repeater, scenario) = (core.repeater(), room.clone());
            Ok(Self { room: Mutex::new(core), repeater, scenario, failures, raised, arrays, deadline_s })
        })
    }

    /// Handles a payload of a message by its name, and of an array; returns commands for a report that
    /// is too old.
    fn receive<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        array: usize,
        payload: &[u8],
        now: u64,
    ) -> PyResult<Payloads<'py>> {
        if array >= self.arrays {
            return Ok(Vec::new());
        }
        let input = Input::Payload { key: key(name, array)?, bytes: payload };
        let commands = self.step(|room, out| {
            if let Handled::Examination(examination) = room.handle(now, input, out) {
                room.handle(now, examination.run(), out);
            }
        });
        commands.map(|commands| payloads(py, commands))
    }

    /// A process has appeared or left, by its liveliness token.
    fn presence(&self, key: &str, is_alive: bool, now: u64) -> PyResult<()> {
        let input = Input::Presence { token: key, is_alive };
        self.step(|room, out| _ = room.handle(now, input, out)).map(drop)
    }

    /// Decides for the newest position report, if one waits: the function is called.
    fn decide<'py>(&self, py: Python<'py>, now: u64) -> PyResult<Payloads<'py>> {
        let commands = self.step(|room, out| _ = room.decide(now, Timing::InTime, &mut |_| {}, out));
        commands.map(|commands| payloads(py, commands))
    }

    /// Acts where no position report has come, if that is due.
    fn timeout<'py>(&self, py: Python<'py>, now: u64) -> PyResult<Payloads<'py>> {
        let commands = self.step(|room, out| _ = room.handle(now, Input::Wake, out));
        commands.map(|commands| payloads(py, commands))
    }

    /// Notes the payload of an order that has arrived, until `receive` handles it; true for a stop. Any thread may
    /// call it.
    fn note_order(&self, payload: &[u8], now: u64) -> bool {
        self.repeater().note_order(now, payload)
    }

    /// The repetitions of stops that are due. Any thread may call it, also while the function runs.
    fn repetitions<'py>(&self, py: Python<'py>, now: u64) -> Payloads<'py> {
        let mut published = Published::new();
        self.repeater().repeat(now, &mut published);
        payloads(py, published)
    }

    /// The counts so far, by name.
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let room = self.room()?;
        let counters = room.controller().counters();
        let table = PyDict::new(py);
        table.set_item("decisions", counters.decisions)?;
        table.set_item("commands", counters.commands)?;
        table.set_item("exceptions", self.failures.load(Ordering::Relaxed))?;
        table.set_item("superseded", room.superseded())?;
        for (name, mode) in [
            ("fallbacks", DegradedMode::PolicyFailed),
            ("held", DegradedMode::Held),
            ("stale", DegradedMode::StaleReport),
            ("silence", DegradedMode::Silence),
            ("withheld", DegradedMode::Withheld),
            ("standby", DegradedMode::Standby),
        ] {
            table.set_item(name, counters.degraded(mode))?;
        }
        Ok(table)
    }

    /// The counters of the status by name, as those of every controller: of `standby` and `array_unfit` only
    /// whether they hold now. Those of lost drivers have the time of the loss.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let room = self.room()?;
        let controller = room.controller();
        let counters = controller.counters();
        let stands_by = (0..self.arrays).any(|array| controller.tenure(array).is_standing_by());
        let table = PyDict::new(py);
        for (name, count) in [
            (NodeStatus::DECISIONS, counters.decisions),
            ("commands", counters.commands),
            ("exceptions", self.failures.load(Ordering::Relaxed)),
            ("superseded", room.superseded()),
            (NodeStatus::EPOCH, controller.epoch()),
            (NodeStatus::STANDBY, u64::from(stands_by)),
            ("peers", controller.tenure(0).peers().len() as u64),
            (NodeStatus::ARRAY_UNFIT, u64::from(controller.unfit().is_some())),
        ] {
            table.set_item(name, count)?;
        }
        let modes = DegradedMode::ALL.map(|mode| (NodeStatus::DEGRADED, mode.name(), counters.degraded(mode)));
        let events = TenureEvent::ALL.map(|event| (NodeStatus::TENURE, event.name(), counters.tenure(event)));
        for (prefix, name, count) in modes.into_iter().chain(events).filter(|(_, _, count)| *count > 0) {
            table.set_item(format!("{prefix}{name}"), count)?;
        }
        for (name, since_s) in room.lost_drivers().map(|(lost, _)| lost.counter()) {
            table.set_item(name, since_s)?;
        }
        Ok(table)
    }

    /// Why the geometry that the room announces is not that of the scenario; `None` if it is, but for what a
    /// calibration measures, or if no simulator announces one.
    fn geometry_problem(&self, now: u64) -> PyResult<Option<String>> {
        let room = self.room()?;
        let announced = room.announced_geometry(now);
        let difference = announced.and_then(|text| self.scenario.announced_difference(text, "this controller"));
        Ok(difference.and_then(heliostat_scenario::RoomDifference::problem))
    }

    /// Why an array gets no command: it does not fit, or is stopped; else why the last failed decision failed.
    #[getter]
    fn last_problem(&self) -> PyResult<Option<String>> {
        let room = self.room()?;
        let controller = room.controller();
        let unfit = controller.unfit().map(ToString::to_string);
        // The caller makes texts of other processes printable.
        let stops = Some(controller.describe_stops(|text| text.into())).filter(|stops| !stops.is_empty());
        Ok(unfit.or(stops).or_else(|| controller.last_failure().map(ToString::to_string)))
    }
}
