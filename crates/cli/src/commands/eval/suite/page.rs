//! The leaderboard, made from the finished tasks and nothing else.

use std::fmt::Write;

use anyhow::Result;
use serde_json::{Value, json};

use super::standing::{COLUMNS, standings};
use super::tasks::{REFERENCE, TASKS, VERSION};
use crate::commands::results::archive::Archive;
use crate::commands::results::document::{QUICK, body, command};
use crate::commands::results::table::{Layout, grid};

/// The name by which finished tasks are kept: tasks of another version do not mix.
pub fn archive_name() -> String {
    format!("suite {VERSION}")
}

/// The leaderboard in Markdown.
///
/// # Errors
/// A finished task whose JSON object is not that of its command.
pub fn markdown(archive: &Archive) -> Result<String> {
    let quick = if archive.quick { " --quick" } else { "" };
    let mut text = format!(
        "# Leaderboard\n\n\
         Written by `heliostat eval --suite{quick} --out docs/leaderboard.md`; do not edit. Tasks, figures, and how to add a policy: \
         [evaluation.md](evaluation.md#the-suite). This is version {VERSION} of the suite.\n\n"
    );
    if archive.quick {
        text.push_str(QUICK);
    }
    let rows = json!({ "rows": standings(archive)? });
    writeln!(
        text,
        "## Standings\n\n\
         Each figure is the mean over the tasks in which a policy takes part. Policies with more tasks come first, then those with the larger ratio. \
         A policy that leaves users without service can gain in ratio: read it beside QoS met. A difference is to `{REFERENCE}` on the same states. \
         `±` is the mean of the half widths of the tasks' 95 % intervals, an upper bound of that of the mean. \
         Outage time covers the tasks in closed loop. Outage p95 and decision times are those of the task where they are largest.\n\n\
         {}",
        Layout::Rows.markdown(&rows, &[], &COLUMNS)?
    )?;
    let mut lines = vec![["task", "room", "configuration", "states"].map(String::from).to_vec()];
    for task in &TASKS {
        let Some(finished) = archive.find(task.name) else { continue };
        let report = &finished.output;
        let cell = |name: &str| report[name].as_str().unwrap_or("-").to_owned();
        let states = format!("{} for each of {} seeds from {}", report["states"], report["seeds"], report["seed"]);
        lines.push(vec![format!("`{}`: {}", task.name, task.title), cell("scenario"), cell("configuration"), states]);
    }
    writeln!(
        text,
        "## Tasks\n\nTwo runs are comparable if the version and the configurations are the same. The configuration is the hash of the effective scenario.\n\n{}",
        grid(&lines)
    )?;
    text.push_str(&body(&TASKS, archive)?.sections);
    Ok(text.trim_end().to_owned() + "\n")
}

/// The leaderboard as one JSON object.
///
/// # Errors
/// As [`markdown`].
pub fn json(archive: &Archive) -> Result<Value> {
    let tasks = archive.sections.iter().map(|finished| {
        json!({
            "task": finished.section, "command": command(&finished.arguments), "made": finished.made,
            "commit": finished.commit, "machine": finished.machine, "seconds": finished.seconds,
            "report": finished.output,
        })
    });
    Ok(json!({
        "suite": VERSION, "quick": archive.quick, "reference": REFERENCE,
        "standings": standings(archive)?, "tasks": tasks.collect::<Vec<_>>(),
    }))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;

    #[test]
    fn the_leaderboard_in_docs_is_what_its_json_renders_to() {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/leaderboard.md");
        let archive = Archive::read(&page.with_extension("json")).expect("finished tasks");
        assert_eq!((archive.page.as_str(), archive.quick), (archive_name().as_str(), false));
        let text = fs::read_to_string(&page).expect("the leaderboard");
        assert!(text == markdown(&archive).unwrap(), "docs/leaderboard.md differs from its JSON file");
    }
}
