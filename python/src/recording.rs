//! Recordings of rooms as arrays: the files of `heliostat record`.

use std::path::Path;

use heliostat_proto::{MirrorCommand, MirrorTelemetry, Room};
use heliostat_record::file::open;
use heliostat_record::received::{Received, Unreadable};
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{guarded, refused};

/// A message, with its arrival at the recorder in ns, and its array.
struct Arrived {
    arrived_ns: u64,
    array: usize,
    received: Received,
}

/// The messages of a recording up to its end, or to its last complete chunk.
#[pyclass(frozen, module = "heliostat._core")]
pub struct Recording {
    messages: Vec<Arrived>,
    #[pyo3(get)]
    room: String,
    /// The effective scenario as TOML.
    #[pyo3(get)]
    scenario: String,
    #[pyo3(get)]
    software: String,
    /// The counts of received and missing messages as JSON; None in a file that was cut.
    #[pyo3(get)]
    account: Option<String>,
    /// The first process of the room whose scenario is not the recorded one, as text; None without any.
    #[pyo3(get)]
    other_scenario: Option<String>,
    unreadable: Unreadable,
}

/// A time in ns with a sign, so that differences of columns do not wrap; at most that of the year 2262.
fn signed_ns(time_ns: u64) -> i64 {
    i64::try_from(time_ns).unwrap_or(i64::MAX)
}

/// One value of each row as an array.
fn column<'py, T: Element, R>(py: Python<'py>, rows: &[R], value: impl Fn(&R) -> T) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_iter(py, rows.iter().map(value)).into_any())
}

/// Several values of each row as an array of shape (rows, width).
fn columns<'py, T: Element + Copy, R>(
    py: Python<'py>,
    rows: &[R],
    width: usize,
    values: impl Fn(&R) -> &[T],
) -> PyResult<Bound<'py, PyAny>> {
    let all: Vec<T> = rows.iter().flat_map(|row| values(row).iter().copied()).collect();
    let table: Bound<'py, PyArray2<T>> = PyArray1::from_vec(py, all).reshape([rows.len(), width])?;
    Ok(table.into_any())
}

/// A dictionary of arrays by name.
fn table<'py, const N: usize>(
    py: Python<'py>,
    entries: [(&str, PyResult<Bound<'py, PyAny>>); N],
) -> PyResult<Bound<'py, PyDict>> {
    let table = PyDict::new(py);
    for (name, values) in entries {
        table.set_item(name, values?)?;
    }
    Ok(table)
}

impl Recording {
    fn read(path: &str) -> PyResult<Self> {
        let unreadable = |error: &dyn std::fmt::Display| refused(format!("{path}: {error}"));
        let mut reading = open(Path::new(path)).map_err(|error| unreadable(&error))?;
        let header = reading.header().clone();
        let room = Room::new(&header.room).map_err(|error| unreadable(&error))?;
        let (mut messages, mut failed) = (Vec::new(), Unreadable::default());
        while let Some(entry) = reading.entry().map_err(|error| unreadable(&error))? {
            if !entry.topic.starts_with("heliostat/") {
                continue;
            }
            if let Some(received) = failed.read(&room, &entry.topic, &entry.data) {
                let (array, _) = room.first_array_key(&entry.topic);
                messages.push(Arrived { arrived_ns: entry.arrived_ns, array, received });
            }
        }
        let account = reading.account().map(str::to_owned);
        let other = |message: &Arrived| other_scenario(&message.received, &header.scenario_hash);
        let other_scenario = messages.iter().find_map(other);
        Ok(Self {
            messages,
            room: header.room,
            scenario: header.scenario,
            software: header.software,
            account,
            other_scenario,
            unreadable: failed,
        })
    }

    /// The messages of one kind, with their arrival in ns.
    fn of<'a, T>(&'a self, select: impl Fn(&'a Received) -> Option<&'a T>) -> Vec<(u64, &'a T)> {
        let messages = self.messages.iter();
        messages.filter_map(|message| select(&message.received).map(|found| (message.arrived_ns, found))).collect()
    }

    /// The messages of one kind of an array.
    fn of_array<'a, T>(&'a self, array: usize, select: impl Fn(&'a Received) -> Option<&'a T>) -> Vec<(u64, &'a T)> {
        let messages = self.messages.iter().filter(|message| message.array == array);
        messages.filter_map(|message| select(&message.received).map(|found| (message.arrived_ns, found))).collect()
    }
}

/// A process whose status names another scenario than the recorded one.
fn other_scenario(received: &Received, recorded: &str) -> Option<String> {
    let Received::Status(status) = received else { return None };
    let differs = !status.scenario.is_empty() && status.scenario != recorded;
    differs.then(|| format!("{} uses scenario {}, the recording holds {recorded}", status.node, status.scenario))
}

/// The number of mirrors of all messages.
fn mirrors(mut lengths: impl Iterator<Item = usize>) -> PyResult<usize> {
    let first = lengths.next().unwrap_or(0);
    match lengths.find(|length| *length != first) {
        Some(other) => Err(refused(format!("the recording has messages for {first} and for {other} mirrors"))),
        None => Ok(first),
    }
}

#[pymethods]
impl Recording {
    #[new]
    fn new(py: Python<'_>, path: &str) -> PyResult<Self> {
        py.detach(|| guarded(|| Self::read(path)))
    }

    /// Number of payloads that do not decode, and what is wrong with the first one, as text; None without any.
    #[getter]
    fn unreadable(&self) -> Option<String> {
        (self.unreadable.count > 0).then(|| self.unreadable.to_string())
    }

    /// Number of messages.
    #[getter]
    fn messages(&self) -> usize {
        self.messages.len()
    }

    /// Time from the first message to the last in s.
    #[getter]
    fn duration_s(&self) -> f64 {
        let arrived = self.messages.iter().map(|message| message.arrived_ns);
        let (first, last) = (arrived.clone().min().unwrap_or(0), arrived.max().unwrap_or(0));
        (last - first) as f64 * 1e-9
    }

    /// One row for each user of each position report.
    fn reports<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let reports = self.of(|received| match received {
            Received::Users(report) => Some(report),
            _ => None,
        });
        let rows: Vec<_> =
            reports.iter().flat_map(|(at, report)| report.users.iter().map(move |user| (*at, *report, user))).collect();
        table(
            py,
            [
                ("arrived_ns", column(py, &rows, |row| signed_ns(row.0))),
                ("time_ns", column(py, &rows, |row| signed_ns(row.1.stamp.time_ns))),
                ("tick", column(py, &rows, |row| row.1.tick)),
                ("user", column(py, &rows, |row| row.2.user)),
                ("position_m", columns(py, &rows, 3, |row| &row.2.position_m[..])),
                ("velocity_m_s", columns(py, &rows, 2, |row| &row.2.velocity_m_s[..])),
                ("min_rate_mbps", column(py, &rows, |row| 1e-6 * f64::from(row.2.min_rate_bps))),
            ],
        )
    }

    /// One row for each user of each channel report.
    fn channels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let reports = self.of(|received| match received {
            Received::Channel(report) => Some(report),
            _ => None,
        });
        let rows: Vec<_> =
            reports.iter().flat_map(|(at, report)| report.users.iter().map(move |user| (*at, *report, user))).collect();
        table(
            py,
            [
                ("arrived_ns", column(py, &rows, |row| signed_ns(row.0))),
                ("time_ns", column(py, &rows, |row| signed_ns(row.1.stamp.time_ns))),
                ("tick", column(py, &rows, |row| row.1.tick)),
                ("user", column(py, &rows, |row| row.2.user)),
                ("los_gain", column(py, &rows, |row| row.2.los_gain)),
                ("irs_gain", column(py, &rows, |row| row.2.irs_gain)),
                ("sinr", column(py, &rows, |row| row.2.sinr)),
            ],
        )
    }

    /// One row for each command to an array.
    fn commands<'py>(&self, py: Python<'py>, array: usize) -> PyResult<Bound<'py, PyDict>> {
        let rows: Vec<(u64, &MirrorCommand)> = self.of_array(array, |received| match received {
            Received::Command(command) => Some(command),
            _ => None,
        });
        let mirrors = mirrors(rows.iter().map(|row| row.1.roll.len()))?;
        table(
            py,
            [
                ("arrived_ns", column(py, &rows, |row| signed_ns(row.0))),
                ("time_ns", column(py, &rows, |row| signed_ns(row.1.time_ns))),
                ("epoch", column(py, &rows, |row| row.1.epoch)),
                ("sequence", column(py, &rows, |row| row.1.sequence)),
                ("answers", column(py, &rows, |row| row.1.answers)),
                ("validity_ms", column(py, &rows, |row| row.1.validity_ms)),
                ("roll", columns(py, &rows, mirrors, |row| &row.1.roll[..])),
                ("yaw", columns(py, &rows, mirrors, |row| &row.1.yaw[..])),
            ],
        )
    }

    /// One row for each telemetry message of an array.
    fn telemetry<'py>(&self, py: Python<'py>, array: usize) -> PyResult<Bound<'py, PyDict>> {
        let rows: Vec<(u64, &MirrorTelemetry)> = self.of_array(array, |received| match received {
            Received::Telemetry(telemetry) => Some(telemetry),
            _ => None,
        });
        let mirrors = mirrors(rows.iter().map(|row| row.1.roll_commanded.len()))?;
        table(
            py,
            [
                ("arrived_ns", column(py, &rows, |row| signed_ns(row.0))),
                ("time_ns", column(py, &rows, |row| signed_ns(row.1.stamp.time_ns))),
                ("answers", column(py, &rows, |row| row.1.answers)),
                ("applied_ns", column(py, &rows, |row| signed_ns(row.1.applied_ns))),
                ("faults", column(py, &rows, |row| row.1.faults)),
                ("roll", columns(py, &rows, mirrors, |row| &row.1.roll_commanded[..])),
                ("yaw", columns(py, &rows, mirrors, |row| &row.1.yaw_commanded[..])),
            ],
        )
    }

    /// One row for each user of each message with the truth of a simulated room.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let truths = self.of(|received| match received {
            Received::Truth(truth) => Some(truth),
            _ => None,
        });
        let rows: Vec<_> =
            truths.iter().flat_map(|(at, truth)| truth.users.iter().map(move |user| (*at, *truth, user))).collect();
        table(
            py,
            [
                ("arrived_ns", column(py, &rows, |row| signed_ns(row.0))),
                ("time_ns", column(py, &rows, |row| signed_ns(row.1.stamp.time_ns))),
                ("tick", column(py, &rows, |row| row.1.tick)),
                ("user", column(py, &rows, |row| row.2.user)),
                ("position_m", columns(py, &rows, 3, |row| &row.2.position_m[..])),
                ("heading_rad", column(py, &rows, |row| row.2.heading_rad)),
                ("blocked", column(py, &rows, |row| row.2.los_blocked)),
                ("rate_mbps", column(py, &rows, |row| 1e-6 * f64::from(row.2.rate_bps))),
                ("min_rate_mbps", column(py, &rows, |row| 1e-6 * f64::from(row.2.min_rate_bps))),
                ("oracle_sum_rate_mbps", column(py, &rows, |row| 1e-6 * row.1.sum_rate_bps.oracle)),
            ],
        )
    }

    /// One row for each user of each message with the belief of a controller.
    fn belief<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let beliefs = self.of(|received| match received {
            Received::Belief(belief) => Some(belief),
            _ => None,
        });
        let rows: Vec<_> =
            beliefs.iter().flat_map(|(at, belief)| belief.users.iter().map(move |user| (*at, *belief, user))).collect();
        table(
            py,
            [
                ("arrived_ns", column(py, &rows, |row| signed_ns(row.0))),
                ("time_ns", column(py, &rows, |row| signed_ns(row.1.stamp.time_ns))),
                ("holds_ns", column(py, &rows, |row| signed_ns(row.1.holds_ns))),
                ("tick", column(py, &rows, |row| row.1.tick)),
                ("source", column(py, &rows, |row| row.1.stamp.source)),
                ("user", column(py, &rows, |row| row.2.user)),
                ("position_m", columns(py, &rows, 3, |row| &row.2.position_m[..])),
                ("velocity_m_s", columns(py, &rows, 2, |row| &row.2.velocity_m_s[..])),
                ("xx_m2", column(py, &rows, |row| row.2.xx_m2)),
                ("xy_m2", column(py, &rows, |row| row.2.xy_m2)),
                ("yy_m2", column(py, &rows, |row| row.2.yy_m2)),
                ("heading_rad", column(py, &rows, |row| row.2.heading_rad)),
                ("heading_certainty", column(py, &rows, |row| row.2.heading_certainty)),
                ("blocked_probability", column(py, &rows, |row| row.2.blocked_probability)),
            ],
        )
    }
}
