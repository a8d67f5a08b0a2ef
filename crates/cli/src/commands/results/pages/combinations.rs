//! The page `combinations`: each mobility model with each orientation and each mismatch, in `hall`.

mod summary;

use super::super::table::{Column, Form};
use super::page::{Page, Section};

const COLUMNS: [Column; 4] = [
    Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(3) },
    Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) },
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(3) },
];

/// One section. Each of mobility, orientation and mismatch is a part of the section's name, a part of its
/// heading, and overrides of the scenario.
macro_rules! section {
    (
        [$mobility:literal $walks:literal $move:literal]
        [$orientation:literal $receivers:literal $hold:literal]
        [$mismatch:literal $room:literal $differ:literal]
    ) => {
        Section::of_policies(
            [
                concat!($mobility, $orientation, $mismatch),
                concat!($walks, ", ", $receivers, $room),
                concat!("The scenario `hall` with: ", $walks, ", ", $receivers, $room, "."),
                concat!(
                    "eval --scenario hall --closed-loop --ceilings --training-seed 1 --beliefs filter,constant-velocity ",
                    "--policies greedy,fixed-point",
                    $move,
                    $hold,
                    $differ
                ),
            ],
            &COLUMNS,
        )
    };
}

/// The sections of each mobility model: both orientations, each with every mismatch of
/// [`summary::MISMATCHES`] in this order.
macro_rules! sections {
    ($($mobility:tt)*) => {
        &[$(
            section!($mobility ["" "upright" ""] ["" "" ""]),
            section!($mobility ["" "upright" ""] ["-typical" ", mismatch typical" " --set mismatch.level=typical"]),
            section!($mobility ["" "upright" ""] ["-rough" ", mismatch rough" " --set mismatch.level=rough"]),
            section!($mobility ["-orientation" "orientation" " --set users.orientation={}"] ["" "" ""]),
            section!(
                $mobility
                ["-orientation" "orientation" " --set users.orientation={}"]
                ["-typical" ", mismatch typical" " --set mismatch.level=typical"]
            ),
            section!(
                $mobility
                ["-orientation" "orientation" " --set users.orientation={}"]
                ["-rough" ", mismatch rough" " --set mismatch.level=rough"]
            ),
        )*]
    };
}

/// The page.
pub static PAGE: Page = Page {
    name: "combinations",
    title: "Results: mobility, orientation and mismatch together",
    about: "How to read it: [evaluation.md](../evaluation.md). Every section is the scenario `hall` with one mobility model, \
            one orientation of the receivers and one mismatch. With `upright` the receivers are upright. With `orientation` \
            users hold them at measured angles that no report contains. A difference is to the first row, paired state by \
            state. An episode of 20 instants counts as one sample.",
    summary: Some(summary::write),
    sections: sections!(
        ["random-waypoint" "Random waypoint" ""]
        ["pauses" "Random waypoint with pauses of 2 s" " --set users.pause_mean_s=2"]
        ["random-direction" "Random direction" " --set users.mobility=random-direction"]
        ["gauss-markov" "Gauss-Markov" " --set users.mobility=gauss-markov"]
        ["smooth-random" "Smooth random" " --set users.mobility=smooth-random"]
        ["social-force" "Social force" " --set users.mobility=social-force"]
        ["seated" "Seated" " --set users.mobility=seated"]
    ),
};
