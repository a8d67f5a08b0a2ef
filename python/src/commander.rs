//! The rules of a controller for a function in Python: the decision core around it.
//!
//! The caller has the session, the clock and the thread. The core decides what the function sees,
//! whether a command is due, under which epoch, and what happens where the function fails.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use heliostat_core::capabilities::{Examiner, Force};
use heliostat_core::core::{Controller, Decision, DegradedMode, Due, Timing};
use heliostat_core::inbox::Message;
use heliostat_core::refusal::{Refusal, Stream};
use heliostat_core::tenure::Tenure;
use heliostat_environment::function_policy::FunctionPolicy;
use heliostat_proto::keys::parse_alive;
use heliostat_proto::{
    Capabilities, ChannelReport, CodecError, EmergencyStop, LedReport, MirrorTelemetry, ObstacleReport,
    OrientationReport, SafetyReport, StopReport, UserReport, decode, encode,
};
use numpy::{AllowTypeChange, PyArray1, PyArrayLike1};
use pyo3::exceptions::{PyException, PyRuntimeError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::error::{guarded, refused};
use crate::scenario::Scenario;
use crate::settings::action_form;

/// An exception that is no failure of the function, such as `KeyboardInterrupt`.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// The payload of a command, with the index of its array.
type Commands = Vec<(usize, Vec<u8>)>;

struct Inner {
    controller: Controller,
    examiner: Examiner,
    is_due: bool,
    superseded: u64,
    unfit_nodes: Vec<u64>,
    /// Why an array gets no command.
    unfit: Option<String>,
}

/// A controller whose policy is a function in Python.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Commander {
    inner: Mutex<Inner>,
    failures: Arc<AtomicU64>,
    raised: Raised,
    #[pyo3(get)]
    arrays: usize,
    /// Time between two position reports in s, or `control.deadline_ms`.
    #[pyo3(get)]
    deadline_s: f64,
}

/// Encodes the commands of a decision.
fn encoded(decision: Decision<'_>) -> PyResult<Commands> {
    let mut commands = Commands::new();
    for (array, command) in decision.commands() {
        let mut payload = Vec::new();
        encode(command, &mut payload).map_err(refused)?;
        commands.push((array, payload));
    }
    Ok(commands)
}

impl Inner {
    /// Gives a report to the core. A payload that does not decode is counted.
    fn report(&mut self, place: (Stream, usize), payload: &[u8], now: u64) -> PyResult<Commands> {
        let (stream, array) = place;
        macro_rules! handled {
            ($report:ty, $message:expr) => {
                decode::<$report>(payload).map(|mut report| self.controller.handle_message(now, $message(&mut report)))
            };
        }
        let due: Result<Due, CodecError> = match stream {
            Stream::Users => handled!(UserReport, Message::Users),
            Stream::Channel => handled!(ChannelReport, Message::Channel),
            Stream::Obstacles => handled!(ObstacleReport, Message::Obstacles),
            Stream::Orientation => handled!(OrientationReport, Message::Orientation),
            Stream::Leds => handled!(LedReport, Message::Leds),
            Stream::Telemetry => handled!(MirrorTelemetry, |report| Message::Telemetry(array, report)),
        };
        match due {
            Ok(Due::Command) => {
                self.superseded += u64::from(std::mem::replace(&mut self.is_due, true));
                Ok(Commands::new())
            }
            Ok(Due::StaleCommand) => encoded(self.controller.poll_stale_command(now)),
            Ok(Due::Nothing) => Ok(Commands::new()),
            Err(error) => {
                self.controller.handle_malformed(place, Refusal::from(&error));
                Ok(Commands::new())
            }
        }
    }

    fn handle(&mut self, name: &str, array: usize, payload: &[u8], now: u64) -> PyResult<Commands> {
        let stream = match name {
            "users" => Stream::Users,
            "channel" => Stream::Channel,
            "obstacles" => Stream::Obstacles,
            "orientation" => Stream::Orientation,
            "leds" => Stream::Leds,
            "telemetry" => Stream::Telemetry,
            "capabilities" => {
                if let Ok(found) = decode::<Capabilities>(payload) {
                    let verdict = self.examiner.examine(array, &found);
                    let unfit = verdict.as_ref().err().map(ToString::to_string);
                    if self.controller.handle_capabilities(array, &found, verdict) {
                        self.unfit = unfit;
                    }
                }
                return Ok(Commands::new());
            }
            "safety" => {
                if let Ok(report) = decode::<SafetyReport>(payload) {
                    self.controller.handle_safety(array, &report);
                }
                return Ok(Commands::new());
            }
            "stops" => {
                if let Ok(report) = decode::<StopReport>(payload) {
                    self.controller.handle_stops(array, &report);
                }
                return Ok(Commands::new());
            }
            "stop" => {
                if let Ok(order) = decode::<EmergencyStop>(payload) {
                    self.controller.handle_stop_order(now, &order);
                }
                return Ok(Commands::new());
            }
            other => return Err(refused(format!("a controller reads no message {other:?}"))),
        };
        self.report((stream, array), payload, now)
    }
}

impl Commander {
    fn inner(&self) -> PyResult<MutexGuard<'_, Inner>> {
        self.inner.try_lock().map_err(|_| {
            PyRuntimeError::new_err("the controller is in use: call it from one thread, and not from its function")
        })
    }

    /// Runs a step, and then raises what the function raised.
    fn step(&self, work: impl FnOnce(&mut Inner) -> PyResult<Commands>) -> PyResult<Commands> {
        let mut inner = self.inner()?;
        let done = guarded(|| work(&mut inner));
        match self.raised.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(raised) => Err(raised),
            None => done,
        }
    }
}

fn payloads<'py>(py: Python<'py>, commands: Commands) -> Vec<(usize, Bound<'py, PyBytes>)> {
    commands.into_iter().map(|(array, payload)| (array, PyBytes::new(py, &payload))).collect()
}

#[pymethods]
impl Commander {
    #[new]
    fn new(scenario: &Scenario, function: Py<PyAny>, action: &str, source: u64) -> PyResult<Self> {
        let room = &scenario.inner;
        let raised = Raised::default();
        let shared = Arc::clone(&raised);
        let call = move |vector: &[f32]| {
            Python::attach(|py| {
                let answer = function.call1(py, (PyArray1::from_slice(py, vector),)).and_then(|answer| {
                    let answer: PyArrayLike1<'_, f32, AllowTypeChange> = answer.extract(py)?;
                    Ok(answer.as_array().to_vec())
                });
                answer.map_err(|error| {
                    let problem = error.to_string();
                    if !error.is_instance_of::<PyException>(py) {
                        *shared.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    }
                    problem
                })
            })
        };
        let form = action_form(action)?;
        guarded(|| {
            let policy = FunctionPolicy::new("python", room, form, call);
            let failures = policy.failures();
            let model = room.channel_model().map_err(refused)?;
            let interval_s = 1.0 / room.streams.positions.rate_hz;
            let deadline_s = if room.control.deadline_ms > 0.0 { 1e-3 * room.control.deadline_ms } else { interval_s };
            let examiner = Examiner::new(room, &model, Force::default());
            let tenure = Tenure::live(source, (interval_s * 1e9) as u64);
            let controller = Controller::new(room, model, Box::new(policy), 0).with_tenure(tenure);
            let arrays = controller.arrays();
            let inner = Inner {
                controller,
                examiner,
                is_due: false,
                superseded: 0,
                unfit_nodes: Vec::new(),
                unfit: None,
            };
            Ok(Self { inner: Mutex::new(inner), failures, raised, arrays, deadline_s })
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
    ) -> PyResult<Vec<(usize, Bound<'py, PyBytes>)>> {
        if array >= self.arrays {
            return Ok(Vec::new());
        }
        self.step(|inner| inner.handle(name, array, payload, now)).map(|commands| payloads(py, commands))
    }

    /// A process has appeared or left, by its liveliness token.
    fn presence(&self, key: &str, is_alive: bool) -> PyResult<()> {
        let mut inner = self.inner()?;
        let Some((node, source)) = parse_alive(key) else { return Ok(()) };
        if is_alive {
            inner.controller.handle_source_found(node, source);
        } else {
            inner.controller.handle_source_lost(node, source);
        }
        let Err(unfit) = inner.examiner.examine_node(node) else { return Ok(()) };
        inner.unfit_nodes.retain(|known| *known != source);
        if is_alive {
            inner.unfit_nodes.push(source);
        }
        let unfit = (!inner.unfit_nodes.is_empty()).then_some(unfit);
        inner.controller.handle_unfit_node(unfit);
        Ok(())
    }

    /// Decides for the newest position report, if one waits: the function is called.
    fn decide<'py>(&self, py: Python<'py>, now: u64) -> PyResult<Vec<(usize, Bound<'py, PyBytes>)>> {
        let commands = self.step(|inner| {
            if !std::mem::take(&mut inner.is_due) {
                return Ok(Commands::new());
            }
            encoded(inner.controller.poll_command(now, Timing::InTime, &mut |_| {}))
        });
        commands.map(|commands| payloads(py, commands))
    }

    /// Acts where no position report has come, if that is due.
    fn timeout<'py>(&self, py: Python<'py>, now: u64) -> PyResult<Vec<(usize, Bound<'py, PyBytes>)>> {
        let commands = self.step(|inner| {
            inner.controller.poll_timeout_command(now).map_or(Ok(Commands::new()), encoded)
        });
        commands.map(|commands| payloads(py, commands))
    }

    /// The counts so far, by name.
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let inner = self.inner()?;
        let counters = inner.controller.counters();
        let table = PyDict::new(py);
        table.set_item("decisions", counters.decisions)?;
        table.set_item("commands", counters.commands)?;
        table.set_item("exceptions", self.failures.load(Ordering::Relaxed))?;
        table.set_item("superseded", inner.superseded)?;
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

    /// Why the last failed decision failed, or why an array gets no command.
    #[getter]
    fn last_problem(&self) -> PyResult<Option<String>> {
        let inner = self.inner()?;
        Ok(inner.unfit.clone().or_else(|| inner.controller.last_failure().map(ToString::to_string)))
    }
}
