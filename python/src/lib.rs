//! `heliostat._core`: the compiled part of the Python package.
//!
//! It holds no logic of its own. Environments are tasks of `heliostat-environment`, physics is
//! `heliostat-channel`, and policies are those of `heliostat-core`. Messages are those of
//! `heliostat-proto`, the rules of a driver are those of `heliostat-array`, and recordings are read
//! by `heliostat-record`. Panics and refusals become Python exceptions with their reason.

mod actor;
mod arrays;
mod batch;
mod channel;
mod commander;
mod error;
mod exclusive;
mod others;
mod policy;
mod recording;
mod scenario;
mod settings;
mod station;
mod threads;
mod wire;

use std::collections::BTreeMap;

use pyo3::prelude::*;

/// The compiled part of the package heliostat.
#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<scenario::Scenario>()?;
    module.add_class::<settings::Settings>()?;
    module.add_class::<batch::Batch>()?;
    module.add_class::<channel::Channel>()?;
    module.add_class::<policy::Policy>()?;
    module.add_class::<station::Station>()?;
    module.add_class::<others::Others>()?;
    module.add_class::<commander::Commander>()?;
    module.add_class::<recording::Recording>()?;
    module.add_function(wrap_pyfunction!(actor::check_input, module)?)?;
    module.add_function(wrap_pyfunction!(actor::finish_actor, module)?)?;
    module.add_function(wrap_pyfunction!(policy::use_onnxruntime, module)?)?;
    module.add_function(wrap_pyfunction!(settings::check_exact, module)?)?;
    module.add_function(wrap_pyfunction!(settings::closed_loop_conditions, module)?)?;
    module.add_function(wrap_pyfunction!(settings::half_width, module)?)?;
    module.add_function(wrap_pyfunction!(settings::held_out_seed, module)?)?;
    module.add_function(wrap_pyfunction!(settings::score, module)?)?;
    module.add_function(wrap_pyfunction!(settings::restored_settings, module)?)?;
    module.add_function(wrap_pyfunction!(batch::restored_batch, module)?)?;
    module.add_function(wrap_pyfunction!(policy::restored_policy, module)?)?;
    module.add_function(wrap_pyfunction!(policy::policy_names, module)?)?;
    module.add_function(wrap_pyfunction!(wire::decode, module)?)?;
    module.add_function(wrap_pyfunction!(wire::encode_message, module)?)?;
    module.add_function(wrap_pyfunction!(wire::keys, module)?)?;
    module.add_function(wrap_pyfunction!(wire::kind_of, module)?)?;
    let kinds = wire::KINDS.map(|(name, kind)| (name, kind.number()));
    module.add("KINDS", BTreeMap::from(kinds))?;
    module.add("ARRAYS_MAX", heliostat_proto::MAX_ARRAYS)?;
    module.add("USERS_MAX", heliostat_proto::MAX_USERS)?;
    module.add("CLOCK_LEAD_MAX_NS", heliostat_proto::CLOCK_LEAD_MAX_NS)?;
    module.add("MIRRORS_MAX", heliostat_proto::MAX_MIRRORS)?;
    module.add("STOP_RECORD_MAX", heliostat_array::stop_record::RECORD_MAX)?;
    module.add("STOP_RECORD_END_WAIT_NS", heliostat_array::stop_record::END_WAIT_NS)?;
    module.add_function(wrap_pyfunction!(station::stop_record_folder, module)?)?;
    module.add_function(wrap_pyfunction!(station::check_capabilities, module)?)?;
    module.add("Refused", module.py().get_type::<wire::Refused>())?;
    module.add("RoomTaken", module.py().get_type::<others::RoomTaken>())?;
    module.add("INSTANTS", heliostat_environment::episodes::INSTANTS)?;
    module.add("BELIEF_COLUMNS", heliostat_environment::believed::COLUMNS.to_vec())?;
    module.add("BUILTIN_SCENARIOS", heliostat_scenario::BUILTIN_NAMES.to_vec())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
