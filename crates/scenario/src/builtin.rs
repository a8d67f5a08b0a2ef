//! The built-in scenarios.

/// The scenario of a command that runs or judges a room, where no other is named: a realistic one.
pub const DEFAULT_SCENARIO: &str = "hall";

/// The scenario of training, benchmarks, link budgets and calibration, where no other is named: the
/// room of the built-in actors of `ddpg`, with reports at 100 Hz.
pub const STUDY_SCENARIO: &str = "specular";

/// The names of the built-in scenarios; the file of the first has every key.
pub const BUILTIN_NAMES: [&str; 8] =
    ["specular", "paper", "paper-calibrated", "hall", "office", "corridor", "atrium", "lab"];

/// The text of a built-in scenario; `None` for a name that is not in [`BUILTIN_NAMES`].
pub(crate) fn text(name: &str) -> Option<&'static str> {
    match name {
        "specular" => Some(include_str!("../../../deploy/scenarios/specular.toml")),
        "paper" => Some(include_str!("../../../deploy/scenarios/paper.toml")),
        "paper-calibrated" => Some(include_str!("../../../deploy/scenarios/paper-calibrated.toml")),
        "hall" => Some(include_str!("../../../deploy/scenarios/hall.toml")),
        "office" => Some(include_str!("../../../deploy/scenarios/office.toml")),
        "corridor" => Some(include_str!("../../../deploy/scenarios/corridor.toml")),
        "atrium" => Some(include_str!("../../../deploy/scenarios/atrium.toml")),
        "lab" => Some(include_str!("../../../deploy/scenarios/lab.toml")),
        _ => None,
    }
}
