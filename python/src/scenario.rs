//! Scenarios: built-in ones by name, files by path, with overrides.

use std::hash::{DefaultHasher, Hash, Hasher};

use heliostat_scenario::{Scenario as Checked, ScenarioArgs};
use pyo3::prelude::*;

use crate::error::{guarded, refused};

/// The description of a room, checked: a built-in name or the path of a TOML file, with overrides
/// by key, or of the form "table.key=value".
#[pyclass(frozen, module = "heliostat._core")]
pub struct Scenario {
    pub inner: Checked,
}

impl Scenario {
    fn checked(text: &str, overrides: &[String]) -> PyResult<Self> {
        guarded(|| Ok(Self { inner: Checked::from_toml_with(text, overrides).map_err(refused)? }))
    }

    /// Largest angle of an axis in rad, plus and minus.
    pub fn range(&self) -> f64 {
        heliostat_core::safety::Limits::new(&self.inner.control).range_rad()
    }
}

/// Overrides as texts: a list of them, or a mapping of keys to values.
fn texts(overrides: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    if let Ok(texts) = overrides.extract::<Vec<String>>() {
        return Ok(texts);
    }
    let texts = overrides.py().import("heliostat.scenario")?.call_method1("override_texts", (overrides,))?;
    texts.extract::<Vec<String>>()
}

#[pymethods]
impl Scenario {
    #[new]
    #[pyo3(signature = (source, overrides = None))]
    fn new(source: &str, overrides: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let overrides = overrides.map_or_else(|| Ok(Vec::new()), texts)?;
        let named = ScenarioArgs { scenario: source.into(), overrides, seed: None };
        let mut scenario = Self::checked(&named.text().map_err(refused)?, &named.overrides)?;
        named.find_trace(&mut scenario.inner);
        Ok(scenario)
    }

    /// The checked scenario of a text in TOML.
    #[staticmethod]
    fn of_toml(text: &str) -> PyResult<Self> {
        Self::checked(text, &[])
    }

    /// The name of the scenario.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// The seed of the scenario.
    #[getter]
    fn seed(&self) -> u64 {
        self.inner.seed
    }

    /// Number of mirrors of all arrays.
    #[getter]
    fn mirrors(&self) -> usize {
        self.inner.mirror_count()
    }

    /// Number of users at the start.
    #[getter]
    fn users(&self) -> usize {
        self.inner.users.count
    }

    /// Length of the room along x, length along y, and height, in m.
    #[getter]
    fn room_m(&self) -> (f64, f64, f64) {
        let room = &self.inner.room;
        (room.length_x_m, room.length_y_m, room.height_m)
    }

    /// Positions of the LEDs in m.
    #[getter]
    fn leds_m(&self) -> Vec<[f64; 3]> {
        self.inner.led.positions_m.clone()
    }

    /// Largest angle of an axis in rad, plus and minus.
    #[getter]
    fn range_rad(&self) -> f64 {
        self.range()
    }

    /// Whether the users hold their receivers tilted, at random angles.
    #[getter]
    fn has_tilted_receivers(&self) -> bool {
        self.inner.has_tilted_receivers()
    }

    /// The hash of the effective configuration.
    #[getter]
    fn hash(&self) -> String {
        self.inner.hash()
    }

    /// The effective configuration as TOML.
    fn to_toml(&self) -> String {
        self.inner.to_toml()
    }

    /// The effective configuration as nested dictionaries.
    fn tables<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let text = serde_json::to_string(&self.inner).map_err(refused)?;
        py.import("json")?.call_method1("loads", (text,))
    }

    /// For pickles: the effective configuration.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        Ok((slf.get_type().getattr("of_toml")?, (slf.get().to_toml(),)))
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| other.get().inner == self.inner)
    }

    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        self.inner.hash().hash(&mut hasher);
        hasher.finish()
    }

    fn __repr__(&self) -> String {
        format!("Scenario(name={:?}, users={}, mirrors={})", self.inner.name, self.users(), self.mirrors())
    }
}
