//! The page `learning`: the learned correction of the belief beside the best model-based policy.

use super::super::table::{Column, Form};
use super::page::{Page, Section};

const COLUMNS: [Column; 6] = [
    Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(4) },
    Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) },
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(4) },
    Column { title: "decision p50 (us)", at: "/decision_us/p50", form: Form::Number(0) },
    Column { title: "decision p99 (us)", at: "/decision_us/p99", form: Form::Number(0) },
];

/// The command of a section: the same belief with and without the learned correction, and the
/// ceilings of the first policy.
macro_rules! in_room {
    ($scenario:literal, $overrides:literal) => {
        concat!(
            "eval --scenario ",
            $scenario,
            " --closed-loop --ceilings --training-seed 1 --policies greedy,residual",
            $overrides
        )
    };
}

/// A section about one room.
const fn room(name: &'static str, title: &'static str, about: &'static str, command: &'static str) -> Section {
    Section::of_policies([name, title, about, command], &COLUMNS)
}

/// The page.
pub static PAGE: Page = Page {
    name: "learning",
    title: "Results: a learned correction of the belief",
    about: "What it means: [learning.md](../learning.md). `greedy` acts on the belief `filter`; `residual` acts on the same belief \
            after a network has corrected it. A difference is to `greedy`, paired state by state. `true-present` and `true-future` \
            know the true room in place of reports. An episode of 20 instants counts as one sample.",
    sections: &[
        room("plain", "hall", "Upright receivers; the room that the controller knows.", in_room!("hall", "")),
        room(
            "pauses",
            "hall with pauses",
            "Users stand for 2 s on average at the points of their walks.",
            in_room!("hall", " --set users.pause_mean_s=2"),
        ),
        room(
            "orientation",
            "hall with unreported orientation",
            "Users hold their receivers at random angles.",
            in_room!("hall", " --set users.orientation={}"),
        ),
        room(
            "orientation-social",
            "hall with unreported orientation, social force",
            "The same for users who avoid each other.",
            in_room!("hall", " --set users.orientation={} --set users.mobility=social-force"),
        ),
        room(
            "orientation-seated",
            "hall with unreported orientation, seated users",
            "The same for users at their places.",
            in_room!("hall", " --set users.orientation={} --set users.mobility=seated"),
        ),
        room(
            "typical",
            "hall with a typical mismatch",
            "Upright receivers; the true room differs from the known one.",
            in_room!("hall", " --set mismatch.level=typical"),
        ),
        room("rough", "hall with a rough mismatch", "The same, more.", in_room!("hall", " --set mismatch.level=rough")),
        room(
            "all",
            "hall with all of these",
            "Social force, unreported orientation and a rough mismatch.",
            in_room!(
                "hall",
                " --set users.mobility=social-force --set users.orientation={} --set mismatch.level=rough"
            ),
        ),
        room("office", "office", "A room, walks and two LEDs that training never has.", in_room!("office", "")),
        room("corridor", "corridor", "The same, for users who pass each other.", in_room!("corridor", "")),
        room(
            "small",
            "hall with 7 x 7 mirrors and unreported orientation",
            "The file is that of 10 x 10 mirrors.",
            in_room!("hall", " --set users.orientation={} --set mirrors.rows=7 --set mirrors.columns=7"),
        ),
        room(
            "crowd",
            "hall with 20 users and unreported orientation",
            "Training has at most 7 users.",
            in_room!("hall", " --set users.orientation={} --set users.count=20"),
        ),
    ],
};
