//! The command-line flags that select a scenario.

use std::path::Path;

use crate::builtin::{BUILTIN_NAMES, DEFAULT_SCENARIO};
use crate::error::ScenarioError;
use crate::scenario::Scenario;
use heliostat_files::read_text;

/// A scenario and its overrides.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ScenarioArgs {
    /// Scenario file (TOML), or a built-in one: specular, paper, paper-calibrated, hall, office, corridor, atrium, lab
    #[arg(long, value_name = "FILE", default_value = DEFAULT_SCENARIO)]
    pub scenario: String,
    /// Override any key of the scenario, for example --set blockage.forced_users=2 (repeatable)
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Seed of every random choice, in place of the scenario's
    #[arg(long)]
    pub seed: Option<u64>,
}

/// A scenario that a viewer draws instead of the geometry that the room announces.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ViewerScenarioArgs {
    /// Draw this scenario file (TOML) or built-in one, instead of the geometry that the room announces
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<String>,
    /// Override any key of that scenario, for example --set mirrors.rows=8 (repeatable)
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Accepted as for the other commands; a viewer makes no random choice
    #[arg(long, hide = true)]
    pub seed: Option<u64>,
}

impl ViewerScenarioArgs {
    /// The scenario that the flags name; `None` without a flag.
    ///
    /// # Errors
    /// As [`ScenarioArgs::load_arrays`].
    pub fn load(&self) -> Result<Option<Scenario>, ScenarioError> {
        if self.scenario.is_none() && self.overrides.is_empty() {
            return Ok(None);
        }
        let scenario = self.scenario.clone().unwrap_or_else(|| DEFAULT_SCENARIO.into());
        let args = ScenarioArgs { scenario, overrides: self.overrides.clone(), seed: self.seed };
        args.load_arrays().map(Some)
    }
}

impl ScenarioArgs {
    /// Reads the scenario of a room with one mirror array and applies the overrides.
    ///
    /// # Errors
    /// As [`ScenarioArgs::load_arrays`], and for a scenario with several mirror arrays.
    pub fn load(&self) -> Result<Scenario, ScenarioError> {
        self.load_arrays()?.require_one_array()
    }

    /// Reads the scenario of a room with any number of mirror arrays and applies the overrides.
    ///
    /// # Errors
    /// [`ScenarioError`] if the file cannot be read, or if the file or an override is invalid.
    pub fn load_arrays(&self) -> Result<Scenario, ScenarioError> {
        let mut overrides = self.overrides.clone();
        overrides.extend(self.seed.map(|seed| format!("seed={seed}")));
        let in_file = |error| match error {
            ScenarioError::Parse { origin, reason } if origin == "scenario" => {
                ScenarioError::Parse { origin: self.scenario.clone(), reason }
            }
            ScenarioError::Parse { reason, .. } => {
                ScenarioError::Parse { origin: format!("--set {}", overrides.join(" --set ")), reason }
            }
            other => other,
        };
        let mut scenario = Scenario::from_toml_with(&self.text()?, &overrides).map_err(in_file)?;
        self.find_trace(&mut scenario);
        Ok(scenario)
    }

    /// A relative path of a trace starts at the folder of the file; in an override it starts at the
    /// working directory.
    pub fn find_trace(&self, scenario: &mut Scenario) {
        let by_flag = |text: &String| text.split_once('=').is_some_and(|(key, _)| key.trim() == "users.trace");
        if let Some(trace) = &mut scenario.users.trace
            && !self.overrides.iter().any(by_flag)
            && let Some(folder) = Path::new(&self.scenario).parent()
        {
            *trace = folder.join(&trace).to_string_lossy().into_owned();
        }
    }

    /// The text of the file or of the built-in scenario. The names of built-in scenarios are theirs: a
    /// file or folder `hall` in the working directory does not change what `hall` means, and
    /// `./hall` names it.
    ///
    /// # Errors
    /// [`ScenarioError::Read`] or [`ScenarioError::UnknownBuiltin`].
    pub fn text(&self) -> Result<String, ScenarioError> {
        let path = Path::new(&self.scenario);
        let is_bare_name = path.extension().is_none() && path.components().count() == 1;
        if BUILTIN_NAMES.contains(&self.scenario.as_str()) || (is_bare_name && !path.exists()) {
            return Scenario::builtin_text(&self.scenario).map(String::from);
        }
        read_text(path).map_err(|error| ScenarioError::Read { path: self.scenario.clone(), message: error.to_string() })
    }
}
