//! The command-line flags that select a scenario.

use std::path::Path;

use crate::bounded_file::read_text;
use crate::builtin::BUILTIN_NAMES;
use crate::error::ScenarioError;
use crate::scenario::Scenario;

/// A scenario and its overrides.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ScenarioArgs {
    /// Scenario file (TOML), or the name of a built-in one: specular, paper, paper-calibrated, hall
    #[arg(long, value_name = "FILE", default_value = BUILTIN_NAMES[0])]
    pub scenario: String,
    /// Override any key of the scenario, for example --set blockage.forced_users=2 (repeatable)
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Seed of every random choice, in place of the scenario's
    #[arg(long)]
    pub seed: Option<u64>,
}

impl ScenarioArgs {
    /// Reads the scenario and applies the overrides.
    ///
    /// # Errors
    /// [`ScenarioError`] if the file cannot be read, or if the file or an override is invalid.
    pub fn load(&self) -> Result<Scenario, ScenarioError> {
        let mut overrides = self.overrides.clone();
        overrides.extend(self.seed.map(|seed| format!("seed={seed}")));
        let in_file = |error| match error {
            ScenarioError::Parse { origin, message } if origin == "scenario" => {
                ScenarioError::Parse { origin: self.scenario.clone(), message }
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

    /// The text of the file or of the built-in scenario.
    ///
    /// # Errors
    /// [`ScenarioError::Read`] or [`ScenarioError::UnknownBuiltin`].
    pub fn text(&self) -> Result<String, ScenarioError> {
        let path = Path::new(&self.scenario);
        if !path.exists() && path.extension().is_none() && path.components().count() == 1 {
            return Scenario::builtin_text(&self.scenario).map(String::from);
        }
        read_text(path).map_err(|error| ScenarioError::Read { path: self.scenario.clone(), message: error.to_string() })
    }
}
