//! `heliostat._core`: the compiled part of the Python package.
//!
//! It holds no logic of its own. Environments are tasks of `heliostat-environment`, physics is
//! `heliostat-channel`, policies are those of `heliostat-decide`, and recordings are read by
//! `heliostat-record`. Panics and refusals become
//! Python exceptions with their reason.

mod actor;
mod arrays;
mod batch;
mod channel;
mod error;
mod policy;
mod recording;
mod scenario;
mod settings;

use pyo3::prelude::*;

/// The compiled part of the package heliostat.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<scenario::Scenario>()?;
    module.add_class::<settings::Settings>()?;
    module.add_class::<batch::Batch>()?;
    module.add_class::<channel::Channel>()?;
    module.add_class::<policy::Policy>()?;
    module.add_class::<recording::Recording>()?;
    module.add_function(wrap_pyfunction!(actor::finish_actor, module)?)?;
    module.add_function(wrap_pyfunction!(settings::held_out_seed, module)?)?;
    module.add_function(wrap_pyfunction!(settings::oracle_samples, module)?)?;
    module.add_function(wrap_pyfunction!(policy::policy_names, module)?)?;
    module.add("EVIDENCE_FEATURES", heliostat_decide::evidence::FEATURES)?;
    module.add("INSTANTS", heliostat_environment::episodes::INSTANTS)?;
    module.add("BELIEF_COLUMNS", heliostat_environment::believed::COLUMNS.to_vec())?;
    module.add("BUILTIN_SCENARIOS", heliostat_scenario::BUILTIN_NAMES.to_vec())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
