//! The tasks of the suite: rooms, overrides, seeds and states, all fixed. A change of this file is a
//! new version.

use crate::commands::results::pages::Section;
use crate::commands::results::table::{Column, Form, Layout};

/// Version of the suite: figures of different versions must not be compared.
pub const VERSION: &str = "1";

/// The policy from which the others are subtracted.
pub const REFERENCE: &str = "greedy";

/// The policies that `all` stands for. `exhaustive` is for rooms with a few mirrors, and `hold`
/// without an earlier policy is `flat`.
pub const POLICIES: [&str; 16] = [
    REFERENCE,
    "oracle",
    "fixed-point",
    "ddpg",
    "analytic",
    "nearest",
    "codebook",
    "dql",
    "q-learning",
    "sarsa",
    "ddpg-raw",
    "pso",
    "sine-cosine",
    "flat",
    "random",
    "no-irs",
];

const COLUMNS: [Column; 12] = [
    Column { title: "training seeds", at: "/training_seeds", form: Form::Text },
    Column { title: "sum rate (Mbit/s)", at: "/sum_rate_mbps", form: Form::Interval(1) },
    Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(3) },
    Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) },
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(3) },
    Column { title: "Jain", at: "/jain", form: Form::Interval(3) },
    Column { title: "outage time", at: "/outage_time", form: Form::Interval(3) },
    Column { title: "outages per user minute", at: "/outages/per_user_minute", form: Form::Number(1) },
    Column { title: "outage p95 (s)", at: "/outages/p95_s", form: Form::Number(2) },
    Column { title: "decision p50 (us)", at: "/decision_us/p50", form: Form::Number(0) },
    Column { title: "decision p99 (us)", at: "/decision_us/p99", form: Form::Number(0) },
];

/// A task: its name, its heading, what it asks of a policy, and its command without policies.
const fn task([name, title, about, command]: [&'static str; 4]) -> Section {
    Section {
        name,
        title,
        about,
        command,
        full: "--states 100 --seeds 10",
        quick: "--states 2 --seeds 2",
        layout: Layout::Policies,
        columns: &COLUMNS,
        bounds: &[],
    }
}

/// The tasks.
pub static TASKS: [Section; 14] = [
    task([
        "exact",
        "Exact states",
        "Each policy sees held-out states exactly, and its mirrors turn at once. Two of five users have no direct path.",
        "eval --scenario specular --blocked 2",
    ]),
    task([
        "paper",
        "The paper's equations",
        "The same under the equations of the paper with calibrated gains, in which no mirror concentrates light.",
        "eval --scenario paper-calibrated --blocked 2",
    ]),
    task([
        "hall",
        "Hall",
        "Late and noisy reports, obstacles that no report mentions, fast-steering mirrors.",
        "eval --scenario hall --closed-loop",
    ]),
    task([
        "hall-later",
        "Hall, 30 s after the start",
        "The belief has had time to learn where obstacles stand.",
        "eval --scenario hall --closed-loop --warm 30",
    ]),
    task([
        "hall-blocked",
        "Hall, all direct paths blocked",
        "Every user depends on the mirrors.",
        "eval --scenario hall --closed-loop --blocked 5",
    ]),
    task([
        "hall-standing",
        "Hall, users who stand",
        "Users pause for 2 s on average, turned to a direction drawn at random.",
        "eval --scenario hall --closed-loop --set users.pause_mean_s=2",
    ]),
    task([
        "hall-tilted",
        "Hall, tilted receivers",
        "Users hold their receivers at measured angles, which no report states.",
        "eval --scenario hall --closed-loop --set users.orientation={}",
    ]),
    task([
        "hall-rough",
        "Hall, rough mismatch",
        "The true room differs from the room that the controller knows, as after an installation without alignment tools.",
        "eval --scenario hall --closed-loop --set mismatch.level=rough",
    ]),
    task([
        "hall-crowd",
        "Hall, 10 users",
        "Twice as many users.",
        "eval --scenario hall --closed-loop --set users.count=10",
    ]),
    task([
        "two-arrays",
        "Hall, two arrays",
        "Two arrays of 5 x 10 mirrors on two walls, with one command each.",
        "eval --scenario hall --closed-loop --set mirrors=[{rows=5,columns=10},{rows=5,columns=10,wall=\"-x\"}]",
    ]),
    task([
        "office",
        "Office",
        "Seated users, and users who walk between the desks; receivers at measured angles.",
        "eval --scenario office --closed-loop",
    ]),
    task([
        "atrium",
        "Atrium",
        "Users arrive and leave; receivers at measured angles.",
        "eval --scenario atrium --closed-loop",
    ]),
    task([
        "corridor",
        "Corridor",
        "Users who pass each other; receivers at measured angles.",
        "eval --scenario corridor --closed-loop",
    ]),
    task([
        "lab",
        "Lab",
        "A bench at a scale of 1:4 with mirrors on hobby servos.",
        "eval --scenario lab --closed-loop",
    ]),
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use heliostat_learn::comparison::EvaluatedPolicy;

    use super::*;

    #[test]
    fn all_policies_take_part() {
        let left_out = ["exhaustive", "hold", "actor"];
        let known: BTreeSet<String> =
            EvaluatedPolicy::names().into_iter().filter(|name| !left_out.contains(&name.as_str())).collect();
        assert_eq!(known, POLICIES.map(String::from).into());
    }

    #[test]
    fn tasks_have_names_and_commands_of_their_own() {
        let names: BTreeSet<_> = TASKS.iter().map(|task| task.name).collect();
        let commands: BTreeSet<_> = TASKS.iter().map(|task| task.command).collect();
        assert_eq!((names.len(), commands.len()), (TASKS.len(), TASKS.len()));
    }
}
