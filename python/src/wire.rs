//! Messages of the contract as dictionaries, and the keys of a room.
//!
//! The bytes are those of `heliostat-proto`. A message is a dictionary with the fields of
//! CONTRACT.md, an enumeration is its number, and `bytes` are `bytes`.

use heliostat_proto::{
    CodecError, ControllerMemory, Kind, MAX_ARRAYS, Message, NodeKind, Room, codec, decode as decode_message, encode,
};
use pyo3::create_exception;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyString};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Number, Value};

use crate::error::guarded;

create_exception!(heliostat, Refused, PyValueError, "A payload or a message that the contract does not allow.");

/// Kinds by the last part of their key, with that of a control named after its receiver.
pub const KINDS: [(&str, Kind); 22] = [
    ("users", Kind::UserReport),
    ("channel", Kind::ChannelReport),
    ("obstacles", Kind::ObstacleReport),
    ("command", Kind::MirrorCommand),
    ("telemetry", Kind::MirrorTelemetry),
    ("status", Kind::NodeStatus),
    ("truth", Kind::RoomTruth),
    ("capabilities", Kind::Capabilities),
    ("stop", Kind::EmergencyStop),
    ("calibration", Kind::Calibration),
    ("simulator_control", Kind::SimulatorControl),
    ("controller_control", Kind::ControllerControl),
    ("rearm", Kind::Rearm),
    ("safety", Kind::SafetyReport),
    ("geometry", Kind::RoomGeometry),
    ("belief", Kind::BeliefReport),
    ("memory", Kind::ControllerMemory),
    ("orientation", Kind::OrientationReport),
    ("branches", Kind::BranchReport),
    ("stops", Kind::StopReport),
    ("stop_repetition", Kind::StopRepetition),
    ("leds", Kind::LedReport),
];

/// Refuses a payload or a message.
pub fn refuse(error: &CodecError) -> PyErr {
    Refused::new_err(error.to_string())
}

/// Calls a generic function for the message of a kind.
macro_rules! for_kind {
    ($kind:expr, $function:ident $arguments:tt, [$($message:ident)*]) => {
        match $kind {
            $( Kind::$message => $function::<heliostat_proto::$message> $arguments, )*
        }
    };
    ($kind:expr, $function:ident $arguments:tt) => {
        for_kind!($kind, $function $arguments, [
            UserReport ChannelReport ObstacleReport MirrorCommand MirrorTelemetry NodeStatus RoomTruth Capabilities
            EmergencyStop Calibration SimulatorControl ControllerControl Rearm SafetyReport RoomGeometry BeliefReport
            ControllerMemory OrientationReport BranchReport StopReport StopRepetition LedReport
        ])
    };
}

/// The message of a payload: a dictionary with the fields of this kind.
#[pyfunction]
pub fn decode<'py>(py: Python<'py>, payload: &[u8], kind: i64) -> PyResult<Bound<'py, PyAny>> {
    guarded(|| for_kind!(known(kind)?, decoded(py, payload)))
}

/// The payload of a message, a dictionary with the fields of this kind.
#[pyfunction(name = "encode")]
pub fn encode_message<'py>(py: Python<'py>, message: &Bound<'py, PyAny>, kind: i64) -> PyResult<Bound<'py, PyBytes>> {
    guarded(|| {
        let kind = known(kind)?;
        let value = from_python(message, kind.name())?;
        for_kind!(kind, encoded(py, value, kind))
    })
}

/// The number of the kind that a payload announces.
#[pyfunction]
pub fn kind_of(payload: &[u8]) -> PyResult<u8> {
    guarded(|| codec::kind_of(payload).map(Kind::number).map_err(|error| refuse(&error)))
}

/// The keys of a process in a room, with the array of this index: one for each message by name, and
/// the patterns of liveliness tokens.
#[pyfunction]
pub fn keys<'py>(py: Python<'py>, room: &str, node: &str, source: u64, array: i64) -> PyResult<Bound<'py, PyDict>> {
    let room = self::room(room)?;
    let node = NodeKind::from_name(node).ok_or_else(|| PyValueError::new_err(format!("unknown process {node:?}")))?;
    let index = usize::try_from(array).ok().filter(|index| *index < MAX_ARRAYS);
    let index =
        index.ok_or_else(|| PyValueError::new_err(format!("array = {array}: expected 0 to {}", MAX_ARRAYS - 1)))?;
    let own = room.array(index);
    let (alive, status) = match node {
        NodeKind::Driver => (own.driver_alive(source), own.driver_status()),
        _ => (room.alive(node, source), room.status(node)),
    };
    let keys = PyDict::new(py);
    for (name, key) in [
        ("users", room.users()),
        ("channel", room.channel()),
        ("obstacles", room.obstacles()),
        ("orientation", room.orientation()),
        ("branches", room.branches()),
        ("leds", room.leds()),
        ("geometry", room.all_geometry()),
        ("room_geometry", room.geometry(NodeKind::SimNode)),
        ("stop", room.stop()),
        ("rearm", room.rearm()),
        ("command", own.command()),
        ("telemetry", own.telemetry()),
        ("capabilities", own.capabilities()),
        ("calibration", own.calibration()),
        ("safety", own.safety()),
        ("stops", own.stops()),
        ("stop_repetition", own.stop_repetition()),
        ("status", status),
        ("alive", alive),
        ("drivers", own.drivers_alive()),
        ("simulators", room.alive_of(NodeKind::SimNode)),
        ("processes", room.all_alive()),
    ] {
        keys.set_item(name, key)?;
    }
    Ok(keys)
}

/// The name of a room, checked.
pub fn room(name: &str) -> PyResult<Room> {
    Room::new(name).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// A message or a structure of one as a dictionary.
pub fn to_dictionary<'py>(py: Python<'py>, message: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let value = serde_json::to_value(message).map_err(|error| Refused::new_err(error.to_string()))?;
    to_python(py, &value)
}

/// A message from a dictionary; the contract has not checked it.
pub fn from_dictionary<T: DeserializeOwned>(message: &Bound<'_, PyAny>, kind: Kind) -> PyResult<T> {
    typed(from_python(message, kind.name())?, kind)
}

fn known(kind: i64) -> PyResult<Kind> {
    let found =
        u8::try_from(kind).map_err(|_| Refused::new_err(format!("kind {kind}: expected a number of one byte")))?;
    Kind::from_number(found).ok_or_else(|| refuse(&CodecError::UnknownKind { found }))
}

fn typed<T: DeserializeOwned>(value: Value, kind: Kind) -> PyResult<T> {
    serde_json::from_value(value).map_err(|error| Refused::new_err(format!("{}: {error}", kind.name())))
}

fn decoded<'py, T: Message + Serialize>(py: Python<'py>, payload: &[u8]) -> PyResult<Bound<'py, PyAny>> {
    if T::KIND == Kind::ControllerMemory {
        // Its state is the one field of bytes.
        let mut memory: ControllerMemory = decode_message(payload).map_err(|error| refuse(&error))?;
        let state = PyBytes::new(py, &std::mem::take(&mut memory.state));
        let message = to_dictionary(py, &memory)?;
        message.set_item("state", state)?;
        return Ok(message);
    }
    to_dictionary(py, &decode_message::<T>(payload).map_err(|error| refuse(&error))?)
}

fn encoded<T: Message + DeserializeOwned>(py: Python<'_>, value: Value, kind: Kind) -> PyResult<Bound<'_, PyBytes>> {
    let mut payload = Vec::new();
    encode(&typed::<T>(value, kind)?, &mut payload).map_err(|error| refuse(&error))?;
    Ok(PyBytes::new(py, &payload))
}

fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(value) => PyBool::new(py, *value).to_owned().into_any(),
        Value::Number(number) => match (number.as_u64(), number.as_f64()) {
            (Some(number), _) => number.into_pyobject(py)?.into_any(),
            (None, number) => PyFloat::new(py, number.unwrap_or(f64::NAN)).into_any(),
        },
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Array(entries) => {
            let entries = entries.iter().map(|entry| to_python(py, entry)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, entries)?.into_any()
        }
        Value::Object(fields) => {
            let dictionary = PyDict::new(py);
            for (name, value) in fields {
                dictionary.set_item(name, to_python(py, value)?)?;
            }
            dictionary.into_any()
        }
    })
}

/// `place` names the value in refusals.
fn from_python(value: &Bound<'_, PyAny>, place: &str) -> PyResult<Value> {
    let refused = |problem: String| Refused::new_err(format!("{place}: {problem}"));
    if value.is_none() {
        return Ok(Value::Null);
    }
    if let Ok(value) = value.cast::<PyBool>() {
        return Ok(Value::Bool(value.is_true()));
    }
    if value.is_instance_of::<PyInt>() {
        let number: Result<u64, _> = value.extract();
        return number.map(Value::from).map_err(|_| refused(format!("{value}: expected 0 to 2^64 - 1")));
    }
    if let Ok(text) = value.cast::<PyString>() {
        return Ok(Value::from(text.to_str()?));
    }
    if let Ok(bytes) = value.cast::<PyBytes>() {
        return Ok(Value::from(bytes.as_bytes()));
    }
    if let Ok(fields) = value.cast::<PyDict>() {
        let mut object = Map::new();
        for (name, value) in fields {
            let name: String = name.extract().map_err(|_| refused("expected texts as names of fields".into()))?;
            let inner = from_python(&value, &format!("{place}: {name}"))?;
            object.insert(name, inner);
        }
        return Ok(Value::Object(object));
    }
    // Numbers and arrays of NumPy too.
    if let Ok(number) = value.extract::<f64>() {
        return Number::from_f64(number).map(Value::Number).ok_or_else(|| refused(format!("{number} is not finite")));
    }
    let entries = value.try_iter().map_err(|_| refused(format!("a {} is no value of a field", value.get_type())))?;
    entries
        .enumerate()
        .map(|(index, entry)| from_python(&entry?, &format!("{place}[{index}]")))
        .collect::<PyResult<Vec<_>>>()
        .map(Value::Array)
}
