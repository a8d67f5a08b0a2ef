//! The page `anchors`: newer algorithms from the literature beside the best model-based policy.

use super::super::table::{Column, Form};
use super::page::{Page, Section, Training};

const COLUMNS: [Column; 7] = [
    Column { title: "sum rate (Mbit/s)", at: "/sum_rate_mbps", form: Form::Interval(1) },
    Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(4) },
    Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) },
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(4) },
    Column { title: "decision p50 (us)", at: "/decision_us/p50", form: Form::Number(0) },
    Column { title: "decision p99 (us)", at: "/decision_us/p99", form: Form::Number(0) },
];

/// The training runs whose actors the page evaluates, at the default size of each algorithm.
pub static TRAININGS: [Training; 4] = [
    Training { name: "td3", command: "train td3" },
    Training { name: "sac", command: "train sac" },
    Training { name: "ppo", command: "train ppo" },
    Training { name: "lstm", command: "train lstm --scenario hall" },
];

/// A section with 100 states in each of 10 rooms.
const fn section(words: [&'static str; 4]) -> Section {
    Section { full: "--states 100 --seeds 10", ..Section::of_policies(words, &COLUMNS) }
}

/// The command that compares all of them, with two beliefs.
macro_rules! all {
    ($overrides:literal) => {
        concat!(
            "eval --scenario hall --closed-loop --beliefs filter,constant-velocity --policies greedy,mirror-codebook,\
             training/td3/td3-specular-10x10.onnx,training/sac/sac-specular-10x10.onnx,training/ppo/ppo-specular-10x10.onnx,\
             training/lstm/lstm.onnx",
            $overrides
        )
    };
}

/// The command that compares the predictions of positions.
macro_rules! places {
    ($overrides:literal) => {
        concat!(
            "eval --scenario hall --closed-loop --beliefs constant-velocity,none,filter \
             --policies greedy,training/lstm/lstm.onnx",
            $overrides
        )
    };
}

/// The page.
pub static PAGE: Page = Page {
    name: "anchors",
    title: "Results: newer algorithms from the literature",
    about: "What the policies do: [evaluation.md](../evaluation.md). Behind the plus sign stands the belief. `lstm` replaces the \
            places of the belief by its own prediction, and takes headings and gains from the belief. `td3`, `sac` and `ppo` \
            are trained in `specular` on exact states. A difference is to the row that has none, paired state by state. \
            Each learned policy has one actor, of training seed 1. An episode of 20 instants counts as one sample.",
    summary: None,
    sections: &[
        section([
            "hall",
            "hall",
            "Users walk by the random waypoint model, on which `lstm` was not trained.",
            all!(""),
        ]),
        section([
            "gauss-markov",
            "hall with Gauss-Markov walks",
            "Users walk by the model on which `lstm` was trained.",
            all!(" --set users.mobility=gauss-markov"),
        ]),
        section(["places", "Predicted places: hall", "Differences to `greedy` with reported velocities.", places!("")]),
        section([
            "places-gauss-markov",
            "Predicted places: hall with Gauss-Markov walks",
            "The same for the walks on which `lstm` was trained.",
            places!(" --set users.mobility=gauss-markov"),
        ]),
    ],
};
