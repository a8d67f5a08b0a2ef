//! The rules of a driver for a device in Python: `heliostat_array::station` around it.
//!
//! The caller has the session, the clock and the threads. Any thread may receive messages, and one may
//! write the record of the stop meanwhile; all other methods belong to one thread, and none may be called
//! from a method of the device.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};

use heliostat_array::arrivals::Arrivals;
use heliostat_array::content::Content;
use heliostat_array::moment::Moment;
use heliostat_array::station::{Identity, Report, Station as Rules};
use heliostat_array::stop_record::{self, END_UNSETTLED, RecordError, RecordTask, StopRecord, StopStore};
use heliostat_array::{Device, DeviceError, Health, Kit, Watch};
use heliostat_channel::MirrorAngles;
use heliostat_proto::messages::fault;
use heliostat_proto::{Capabilities, Kind, Message, decode, encode};
use numpy::{AllowTypeChange, PyArray1, PyArrayLike1};
use pyo3::exceptions::{PyException, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::error::{failure, guarded};
use crate::exclusive::lock;
use crate::wire;

/// An exception that is no failure of the device, such as `KeyboardInterrupt`.
type Raised = Arc<Mutex<Option<PyErr>>>;

/// A device in Python.
struct PyDevice {
    object: Py<PyAny>,
    capabilities: Capabilities,
    travel_rad: Option<[[f64; 2]; 2]>,
    raised: Raised,
}

impl PyDevice {
    /// Calls a method of the object; an exception is a failure of the device.
    fn call<T>(
        &self,
        method: &str,
        work: impl FnOnce(Python<'_>, &Bound<'_, PyAny>) -> PyResult<T>,
    ) -> Result<T, DeviceError> {
        Python::attach(|py| {
            work(py, self.object.bind(py)).map_err(|error| {
                let problem = format!("{method}: {}", failure(py, &error));
                if !error.is_instance_of::<PyException>(py) {
                    *lock(&self.raised) = Some(error);
                }
                DeviceError::new(&self.capabilities.hardware, problem)
            })
        })
    }
}

impl Device for PyDevice {
    fn capabilities(&self) -> Capabilities {
        self.capabilities.clone()
    }

    fn travel_rad(&self) -> [[f64; 2]; 2] {
        let Capabilities { roll, yaw, .. } = self.capabilities;
        let limits = [roll, yaw].map(|axis| [f64::from(axis.min_rad), f64::from(axis.max_rad)]);
        self.travel_rad.unwrap_or(limits)
    }

    fn connect(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.call("connect", |_, object| object.call_method0("connect").map(drop))
    }

    fn apply(&mut self, _now: Moment, angles: &MirrorAngles) -> Result<(), DeviceError> {
        self.call("turn", |py, object| {
            let angles = (PyArray1::from_slice(py, &angles.roll), PyArray1::from_slice(py, &angles.yaw));
            object.call_method1("turn", angles).map(drop)
        })
    }

    fn measure(&mut self, _now: Moment, into: &mut MirrorAngles) -> Result<bool, DeviceError> {
        self.call("measure", |_, object| {
            let answer = object.call_method0("measure")?;
            if answer.is_none() {
                return Ok(false);
            }
            type List<'py> = PyArrayLike1<'py, f64, AllowTypeChange>;
            let (roll, yaw): (List<'_>, List<'_>) = answer
                .extract()
                .map_err(|_| PyValueError::new_err("expected None, or a pair of lists of angles in rad"))?;
            for (axis, list, target) in [("roll", roll, &mut into.roll), ("yaw", yaw, &mut into.yaw)] {
                let list = list.as_array();
                if list.len() != target.len() {
                    let (found, expected) = (list.len(), target.len());
                    return Err(PyValueError::new_err(format!("{axis} of {found} mirrors: expected {expected}")));
                }
                if let Some(mirror) = list.iter().position(|angle| !angle.is_finite()) {
                    return Err(PyValueError::new_err(format!("{axis} of mirror {mirror} is not finite")));
                }
                target.iter_mut().zip(list).for_each(|(target, angle)| *target = *angle);
            }
            Ok(true)
        })
    }

    fn health(&mut self, _now: Moment) -> Result<Health, DeviceError> {
        let mirrors = self.capabilities.mirrors();
        self.call("health", |_, object| {
            let answer = object.call_method0("health")?;
            let part = |name: &str| {
                answer.getattr(name).map_err(|_| PyValueError::new_err(format!("expected a Health, got {answer:?}")))
            };
            let wrong = |name: &str, expected: &str| PyValueError::new_err(format!("{name}: expected {expected}"));
            let temperature_c: Option<f32> = part("temperature_c")?
                .extract()
                .map_err(|_| wrong("temperature_c", "a number in degrees Celsius, or None"))?;
            let mut broken: Vec<u32> =
                part("broken")?.extract().map_err(|_| wrong("broken", "a list of indices of mirrors"))?;
            broken.sort_unstable();
            broken.dedup();
            if temperature_c.is_some_and(|temperature_c| !temperature_c.is_finite()) {
                return Err(PyValueError::new_err("temperature_c is not finite"));
            }
            if let Some(mirror) = broken.last().filter(|mirror| **mirror as usize >= mirrors) {
                return Err(PyValueError::new_err(format!(
                    "broken has mirror {mirror}: expected 0 to {}",
                    mirrors - 1
                )));
            }
            let bit = |name: &str, bit: u32| part(name)?.is_truthy().map(|set| if set { bit } else { 0 });
            let faults = bit("temperature_fault", fault::TEMPERATURE)? | bit("supply_fault", fault::SUPPLY)?;
            Ok(Health { temperature_c, faults, broken, problem: None })
        })
    }

    fn stop(&mut self, _now: Moment) -> Result<(), DeviceError> {
        self.call("stop", |_, object| object.call_method0("stop").map(drop))
    }
}

/// A store of the emergency stop in Python.
struct PyStore {
    object: Py<PyAny>,
    name: String,
    device: String,
}

impl StopStore for PyStore {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn device(&self) -> &str {
        &self.device
    }

    fn read(&mut self) -> Result<Option<String>, String> {
        let record: PyResult<_> = Python::attach(|py| self.object.call_method0(py, "read")?.extract(py));
        record.map_err(|error| error.to_string())
    }

    fn replace(&mut self, text: &str) -> Result<(), String> {
        let replaced = Python::attach(|py| self.object.call_method1(py, "replace", (text,)).map(drop));
        replaced.map_err(|error| error.to_string())
    }

    fn empty(&mut self) -> Result<(), String> {
        Python::attach(|py| self.object.call_method0(py, "empty").map(drop)).map_err(|error| error.to_string())
    }
}

/// An array with its device, the rules of the contract, and the reports of a driver.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Station {
    received: Arc<Mutex<Arrivals>>,
    rules: Mutex<Rules<PyDevice>>,
    /// Absent while a thread writes the record.
    store: Mutex<Option<PyStore>>,
    /// The write of the record that is due.
    due: Mutex<Option<RecordTask>>,
    /// What became of the last one.
    written: Mutex<Option<Result<(), RecordError>>>,
    raised: Raised,
    /// Why the array starts stopped, if it does.
    advice: Option<String>,
}

impl Station {
    /// The rules, for the one thread that uses them.
    fn rules(&self) -> PyResult<MutexGuard<'_, Rules<PyDevice>>> {
        self.rules.try_lock().map_err(|_| {
            PyRuntimeError::new_err(
                "the station is in use: call it from one thread, and not from a method of the device",
            )
        })
    }

    /// Runs a step, and then raises what a method of the device raised.
    fn step<T>(&self, work: impl FnOnce(&mut Rules<PyDevice>) -> PyResult<T>) -> PyResult<T> {
        let mut rules = self.rules()?;
        let done = guarded(|| work(&mut rules));
        match lock(&self.raised).take() {
            Some(raised) => Err(raised),
            None => done,
        }
    }

    fn received(&self) -> MutexGuard<'_, Arrivals> {
        lock(&self.received)
    }
}

#[pymethods]
impl Station {
    #[new]
    #[pyo3(signature = (
        device, capabilities, travel_rad, store, *, room, array, source, software, start_armed, authenticated, clock
    ))]
    #[expect(clippy::too_many_arguments, reason = "the keywords of a Python constructor")]
    fn new(
        device: Py<PyAny>,
        capabilities: &Bound<'_, PyAny>,
        travel_rad: Option<[[f64; 2]; 2]>,
        store: Bound<'_, PyAny>,
        room: &str,
        array: usize,
        source: u64,
        software: String,
        start_armed: bool,
        authenticated: bool,
        clock: Py<PyAny>,
    ) -> PyResult<Self> {
        let room = wire::room(room)?;
        let capabilities = capabilities_of(capabilities)?;
        let name = stop_record::file_name(&room, array);
        let store = PyStore {
            name: store.call_method1("open", (name,))?.extract()?,
            device: stop_record::device_of(&capabilities),
            object: store.unbind(),
        };
        let (raised, received) = (Raised::default(), Arc::<Mutex<Arrivals>>::default());
        let clock = clock_of(clock, Arc::clone(&raised));
        let now = clock();
        if let Some(raised) = lock(&raised).take() {
            return Err(raised);
        }
        let (record, latch_at_start) = StopRecord::open(store, start_armed, now.room_ns);
        let mut kit = Kit::new(PyDevice { object: device, capabilities, travel_rad, raised: Arc::clone(&raised) });
        let waiting = Arc::clone(&received);
        kit.set_watch(Watch::new(clock, move |is_stop| lock(&waiting).has_stop(is_stop)));
        // Every role may publish under the key of the stop, only operators under that of the
        // re-arm.
        kit.refuse_unnamed_rearm(authenticated);
        let advice = stop_record::advice(&room, &latch_at_start);
        let (plan, store) = record.split();
        let rules = Rules::new(kit, (plan, latch_at_start), Identity { source, array, software }, now);
        Ok(Self {
            received,
            rules: Mutex::new(rules),
            store: Mutex::new(store),
            due: Mutex::default(),
            written: Mutex::default(),
            raised,
            advice,
        })
    }

    /// Adds a message to the queue; `of` is command, stop, stop_repetition, rearm or calibration. Any
    /// thread may call it.
    fn receive(&self, of: &str, payload: &[u8], now: (u64, u64)) -> PyResult<()> {
        let content = match of {
            "command" => Content::Command(decode(payload)),
            "stop" => Content::Stop(decode(payload)),
            "rearm" => Content::Rearm(decode(payload)),
            "stop_repetition" => Content::Repetition(decode(payload)),
            "calibration" => Content::Calibration(decode(payload)),
            _ => return Err(PyValueError::new_err(format!("unknown message {of:?}"))),
        };
        self.received().push(moment(now), content);
        Ok(())
    }

    /// Handles the next message of the queue at a time; false if there was none.
    fn handle_received(&self, now: (u64, u64)) -> PyResult<bool> {
        let next = self.received().pop();
        let Some(arrival) = next else { return Ok(false) };
        self.step(|rules| {
            rules.handle(moment(now), arrival);
            Ok(true)
        })
    }

    /// Notes a problem: another process with this array has joined the room.
    fn note_other_process(&self, problem: String) -> PyResult<()> {
        self.rules()?.note_other_process(problem);
        Ok(())
    }

    /// Sets the number of other processes with this array that are in the room.
    fn set_other_processes(&self, count: u64) -> PyResult<()> {
        self.rules()?.set_other_processes(count);
        Ok(())
    }

    /// Advances to a time; returns whether `write_record` has to be called, on any thread.
    fn advance(&self, now: (u64, u64)) -> PyResult<bool> {
        let dropped = self.received().dropped();
        let written = lock(&self.written).take();
        self.step(|rules| {
            rules.set_dropped(dropped);
            if let Some(result) = &written {
                rules.finish_record(result);
            }
            rules.advance(moment(now));
            // A call of the device may have taken long.
            let now = rules.kit().present(moment(now));
            if let Some(task) = rules.poll_record(now) {
                // Here, because an exception of the device must not lose it.
                *lock(&self.due) = Some(task);
            }
            Ok(())
        })?;
        Ok(lock(&self.due).is_some())
    }

    /// The driver ends: commands, waiting and later ones, are no messages.
    fn end(&self) {
        self.received().end();
    }

    /// Whether no message waits, and the present stops are in the record or could not be written.
    #[getter]
    fn is_settled(&self) -> PyResult<bool> {
        Ok(self.received().is_empty() && self.rules()?.is_settled())
    }

    /// Why the present stops are not in the record, for the last line of a driver that ends before they are.
    #[getter]
    fn unsettled(&self) -> PyResult<String> {
        Ok(self.rules()?.record_problem().unwrap_or(END_UNSETTLED).to_owned())
    }

    /// Writes the record of the emergency stop, and may wait for the disk; returns a line for the log if it could not be
    /// written, or could be after a failure. The next `advance` takes the result.
    fn write_record(&self) -> Option<String> {
        let task = lock(&self.due).take()?;
        // Taken out, because a lock must not be held while the store lets other threads run.
        let mut store = lock(&self.store).take()?;
        let result = task.run(&mut store);
        *lock(&self.store) = Some(store);
        let line = task.line(&result);
        *lock(&self.written) = Some(result);
        line
    }

    /// The payloads that are due, each with the name of its key.
    fn reports<'py>(&self, py: Python<'py>, now: (u64, u64)) -> PyResult<Vec<(&'static str, Bound<'py, PyBytes>)>> {
        self.step(|rules| {
            let mut due = Vec::new();
            while let Some(report) = rules.poll_report(moment(now)) {
                let (name, payload) = match report {
                    Report::Telemetry(telemetry) => ("telemetry", payload(&telemetry)?),
                    Report::Safety(safety) => ("safety", payload(&safety)?),
                    Report::Stops(stops) => ("stops", payload(&stops)?),
                    Report::Capabilities(capabilities) => ("capabilities", payload(&capabilities)?),
                    Report::Status(status) => ("status", payload(&status)?),
                };
                due.push((name, PyBytes::new(py, &payload)));
            }
            Ok(due)
        })
    }

    /// Whether a report is due at this local time, so that no further message is handled before it; a stop that
    /// waits comes first.
    fn is_report_due(&self, local_ns: u64) -> PyResult<bool> {
        Ok(self.rules()?.is_report_due(local_ns))
    }

    /// When `advance` must be called if no message arrives, in local time.
    #[getter]
    fn next_ns(&self) -> PyResult<u64> {
        Ok(self.rules()?.next_ns())
    }

    /// Why the array starts stopped; `None` if it does not.
    #[getter]
    fn advice(&self) -> Option<&str> {
        self.advice.as_deref()
    }

    /// The stops in force, or an empty text.
    #[getter]
    fn stop(&self) -> PyResult<String> {
        let rules = self.rules()?;
        let stops = rules.kit().array().latch().stops().iter();
        let texts = stops.map(|stop| format!("{}, operator {:?}: {:?}", stop.name(), stop.operator, stop.reason));
        Ok(texts.collect::<Vec<_>>().join("; "))
    }

    /// The state of the array: parked, following, holding or stopped.
    #[getter]
    fn state(&self) -> PyResult<&'static str> {
        Ok(self.rules()?.kit().array().state().name())
    }

    /// The counters of the telemetry.
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        wire::to_dictionary(py, self.rules()?.kit().array().counters())
    }

    /// The last problem; empty if there was none.
    #[getter]
    fn last_problem(&self) -> PyResult<String> {
        Ok(self.rules()?.last_problem())
    }
}

fn payload<T: Message>(message: &T) -> PyResult<Vec<u8>> {
    let mut payload = Vec::new();
    encode(message, &mut payload).map_err(|error| wire::refuse(&error))?;
    Ok(payload)
}

/// The clock of the caller, a function without arguments. The step raises what it raises.
fn clock_of(clock: Py<PyAny>, raised: Raised) -> impl Fn() -> Moment + Send + Sync + 'static {
    move || {
        let now: PyResult<(u64, u64)> = Python::attach(|py| clock.call0(py)?.extract(py));
        now.map(moment).unwrap_or_else(|error| {
            *lock(&raised) = Some(error);
            Moment::default()
        })
    }
}

fn moment((local_ns, room_ns): (u64, u64)) -> Moment {
    Moment { local_ns, room_ns }
}

/// The capabilities of an array from a dictionary, by the rules of the contract.
fn capabilities_of(dictionary: &Bound<'_, PyAny>) -> PyResult<Capabilities> {
    let capabilities: Capabilities = wire::from_dictionary(dictionary, Kind::Capabilities)?;
    payload(&capabilities)?;
    heliostat_array::check_capabilities(&capabilities).map_err(|error| wire::Refused::new_err(error.to_string()))?;
    Ok(capabilities)
}

/// Refuses capabilities, a dictionary, that no array can have.
#[pyfunction]
pub(crate) fn check_capabilities(capabilities: &Bound<'_, PyAny>) -> PyResult<()> {
    guarded(|| capabilities_of(capabilities).map(drop))
}

/// The folder of the stop records of a driver that is given none, by environment variables.
#[pyfunction]
pub(crate) fn stop_record_folder(variables: HashMap<String, String>) -> Option<String> {
    stop_record::default_folder(|name| variables.get(name).cloned()).map(|folder| folder.display().to_string())
}
