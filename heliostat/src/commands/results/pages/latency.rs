//! The page `latency`: times beside a reference of the same run.

use super::super::bound::{Bound, Limit};
use super::super::table::{Column, Form, Layout};
use super::page::{Page, Section};

const fn us(title: &'static str, at: &'static str) -> Column {
    Column { title, at, form: Form::Number(0) }
}

const fn text(title: &'static str, at: &'static str) -> Column {
    Column { title, at, form: Form::Text }
}

const HZ: Column = text("reports/s", "/hz");
const POLICY: Column = text("policy", "/policy");
const P50: Column = us("p50", "/measured_us/p50");
const P90: Column = us("p90", "/measured_us/p90");
const P99: Column = us("p99", "/measured_us/p99");
const P999: Column = us("p99.9", "/measured_us/p999");
const MAX: Column = us("max", "/measured_us/max");
const REFERENCE_P50: Column = us("reference p50", "/reference_us/p50");
const REFERENCE_P99: Column = us("reference p99", "/reference_us/p99");
const RATIO_P50: Column = Column { title: "ratio p50", at: "/ratio_p50", form: Form::Number(2) };
const RATIO_P99: Column = Column { title: "ratio p99", at: "/ratio_p99", form: Form::Number(2) };
const COUNT: Column = text("count", "/count");
const OVER: Column = text("over 0.5 ms", "/over_budget");
const LOST: Column = text("lost", "/lost");
const DECISION_P50: Column = us("decision p50", "/decision_us/p50");
const DECISION_P99: Column = us("decision p99", "/decision_us/p99");

const LOOP: [Column; 15] = [
    HZ,
    P50,
    P90,
    P99,
    P999,
    MAX,
    REFERENCE_P50,
    REFERENCE_P99,
    RATIO_P50,
    RATIO_P99,
    DECISION_P50,
    DECISION_P99,
    COUNT,
    OVER,
    LOST,
];
const DECISION: [Column; 13] =
    [HZ, POLICY, P50, P90, P99, P999, MAX, REFERENCE_P50, REFERENCE_P99, RATIO_P50, RATIO_P99, COUNT, OVER];
const MISSES: [Column; 9] = [
    P50,
    P99,
    P999,
    COUNT,
    OVER,
    text("wait", "/over_budget_by/wait"),
    text("observe", "/over_budget_by/observe"),
    text("infer", "/over_budget_by/infer"),
    text("publish", "/over_budget_by/publish"),
];
const MIRRORS: [Column; 9] = [text("mirrors", "/mirrors"), P50, P90, P99, P999, RATIO_P50, RATIO_P99, COUNT, OVER];
const USERS: [Column; 9] = [text("users", "/users"), P50, P90, P99, P999, RATIO_P50, RATIO_P99, COUNT, OVER];
const ROOMS: [Column; 11] = [
    text("rooms", "/rooms"),
    P50,
    P99,
    REFERENCE_P50,
    REFERENCE_P99,
    RATIO_P50,
    RATIO_P99,
    DECISION_P50,
    DECISION_P99,
    COUNT,
    LOST,
];
const STEPS: [Column; 8] = [
    text("mode", "/mode"),
    text("LED", "/led"),
    text("users", "/users"),
    text("mirrors", "/mirrors"),
    text("bodies", "/bodies"),
    us("steps/s", "/steps_per_s"),
    us("reference/s", "/reference_steps_per_s"),
    Column { title: "ratio", at: "/ratio", form: Form::Number(1) },
];
const SOLVER: [Column; 11] = [
    text("mode", "/mode"),
    text("users", "/users"),
    text("mirrors", "/mirrors"),
    text("minimum rates", "/qos"),
    us("oracle p50", "/oracle/p50_us"),
    us("oracle p99", "/oracle/p99_us"),
    us("fixed-point p50", "/fixed_point/p50_us"),
    us("fixed-point p99", "/fixed_point/p99_us"),
    us("greedy p50", "/greedy/p50_us"),
    us("greedy p99", "/greedy/p99_us"),
    Column { title: "oracle/greedy", at: "/oracle_over_greedy", form: Form::Number(1) },
];

/// The page.
pub static PAGE: Page = Page {
    name: "latency",
    title: "Results: latency and speed",
    about: "How to read it: [latency.md](../latency.md). Times are in us; a ratio is to the reference of the same run. A \
            dash under \"reports/s\" stands for no pause between reports.",
    summary: None,
    sections: &[
        Section {
            name: "loop-nearest",
            title: "Loop, nearest",
            about: "From the publication of a report to the arrival of the command that answers it, between two processes; the reference is an echo.",
            command: "bench loop --policy nearest",
            full: "--seconds 6",
            quick: "--seconds 1 --hz 100",
            layout: Layout::Rows,
            columns: &LOOP,
            bounds: &[
                Bound {
                    what: "p50 at most 1.3 times that of the echo",
                    policy: "",
                    at: "/ratio_p50",
                    limit: Limit::AtMost(1.3),
                },
                Bound {
                    what: "p99 at most 1.5 times that of the echo",
                    policy: "",
                    at: "/ratio_p99",
                    limit: Limit::AtMost(1.5),
                },
            ],
        },
        Section {
            name: "loop-fixed-point",
            title: "Loop, fixed-point",
            about: "From the publication of a report to the arrival of the command that answers it, between two processes; the reference is an echo.",
            command: "bench loop --policy fixed-point",
            full: "--seconds 6",
            quick: "--seconds 1 --hz 100",
            layout: Layout::Rows,
            columns: &LOOP,
            bounds: &[
                Bound {
                    what: "p50 at most 1.3 times that of the echo",
                    policy: "",
                    at: "/ratio_p50",
                    limit: Limit::AtMost(1.3),
                },
                Bound {
                    what: "p99 at most 1.5 times that of the echo",
                    policy: "",
                    at: "/ratio_p99",
                    limit: Limit::AtMost(1.5),
                },
            ],
        },
        Section {
            name: "loop-ddpg",
            title: "Loop, ddpg",
            about: "From the publication of a report to the arrival of the command that answers it, between two processes; the reference is an echo.",
            command: "bench loop --policy ddpg",
            full: "--seconds 6",
            quick: "--seconds 1 --hz 100",
            layout: Layout::Rows,
            columns: &LOOP,
            bounds: &[
                Bound {
                    what: "p50 at most 1.3 times that of the echo",
                    policy: "",
                    at: "/ratio_p50",
                    limit: Limit::AtMost(1.3),
                },
                Bound {
                    what: "p99 at most 1.5 times that of the echo",
                    policy: "",
                    at: "/ratio_p99",
                    limit: Limit::AtMost(1.5),
                },
            ],
        },
        Section {
            name: "decide",
            title: "Decision",
            about: "The decision without transport; the reference is the inference engine alone.",
            command: "bench decide",
            full: "--seconds 6",
            quick: "--seconds 1",
            layout: Layout::Rows,
            columns: &DECISION,
            bounds: &[Bound {
                what: "p50 at most 2.5 times that of the inference",
                policy: "",
                at: "/ratio_p50",
                limit: Limit::AtMost(2.5),
            }],
        },
        Section {
            name: "misses-ddpg",
            title: "Over budget, ddpg",
            about: "Decisions of more than 0.5 ms at 1000 reports a second, by their longest stage.",
            command: "bench decide --hz 1000 --policy ddpg",
            full: "--decisions 100000",
            quick: "--decisions 500",
            layout: Layout::Rows,
            columns: &MISSES,
            bounds: &[Bound {
                what: "at most 1 decision of 10,000 takes more than 0.5 ms",
                policy: "",
                at: "/over_budget",
                limit: Limit::ShareAtMost(1e-4, "/count"),
            }],
        },
        Section {
            name: "misses-nearest",
            title: "Over budget, nearest",
            about: "Decisions of more than 0.5 ms at 1000 reports a second, by their longest stage.",
            command: "bench decide --hz 1000 --policy nearest",
            full: "--decisions 100000",
            quick: "--decisions 500",
            layout: Layout::Rows,
            columns: &MISSES,
            bounds: &[Bound {
                what: "at most 1 decision of 10,000 takes more than 0.5 ms",
                policy: "",
                at: "/over_budget",
                limit: Limit::ShareAtMost(1e-4, "/count"),
            }],
        },
        Section {
            name: "misses-hold",
            title: "Over budget, hold",
            about: "The same with the policy hold, which publishes the last angles again: the share that the machine itself causes.",
            command: "bench decide --hz 1000 --policy hold",
            full: "--decisions 100000",
            quick: "--decisions 500",
            layout: Layout::Rows,
            columns: &MISSES,
            bounds: &[],
        },
        Section {
            name: "policies",
            title: "Policies",
            about: "The decision of each policy without transport at 100 reports a second.",
            command: "bench policies",
            full: "--seconds 6",
            quick: "--decisions 50",
            layout: Layout::Rows,
            columns: &DECISION,
            bounds: &[],
        },
        Section {
            name: "mirrors",
            title: "Mirrors",
            about: "The same wall divided into 49 to 4096 mirrors under a point LED; the reference is the wall of 49.",
            command: "bench mirrors --policy nearest",
            full: "--seconds 6",
            quick: "--seconds 1",
            layout: Layout::Rows,
            columns: &MIRRORS,
            bounds: &[
                Bound { what: "p99 at most 500 us", policy: "", at: "/measured_us/p99", limit: Limit::AtMost(500.0) },
                Bound {
                    what: "p50 grows no faster than the number of mirrors (83.6 times from 49 to 4096)",
                    policy: "",
                    at: "/ratio_p50",
                    limit: Limit::AtMost(83.6),
                },
            ],
        },
        Section {
            name: "users",
            title: "Users",
            about: "1 to 50 users; the reference is one user.",
            command: "bench users --policy fixed-point",
            full: "--seconds 6",
            quick: "--seconds 1",
            layout: Layout::Rows,
            columns: &USERS,
            bounds: &[],
        },
        Section {
            name: "rooms-nearest",
            title: "Rooms, nearest",
            about: "Rooms on one controller process at 100 reports a second each; the reference is an echo for as many.",
            command: "bench rooms --policy nearest",
            full: "--seconds 6 --rooms 1,8,32",
            quick: "--seconds 1 --rooms 1,2",
            layout: Layout::Rows,
            columns: &ROOMS,
            bounds: &[
                Bound {
                    what: "decision p99 at most 500 us",
                    policy: "",
                    at: "/decision_us/p99",
                    limit: Limit::AtMost(500.0),
                },
                Bound {
                    what: "loop p99 at most 500 us",
                    policy: "",
                    at: "/measured_us/p99",
                    limit: Limit::AtMost(500.0),
                },
            ],
        },
        Section {
            name: "rooms-fixed-point",
            title: "Rooms, fixed-point",
            about: "Rooms on one controller process at 100 reports a second each; the reference is an echo for as many.",
            command: "bench rooms --policy fixed-point",
            full: "--seconds 6 --rooms 1,8,32",
            quick: "--seconds 1 --rooms 1,2",
            layout: Layout::Rows,
            columns: &ROOMS,
            bounds: &[
                Bound {
                    what: "decision p99 at most 500 us",
                    policy: "",
                    at: "/decision_us/p99",
                    limit: Limit::AtMost(500.0),
                },
                Bound {
                    what: "loop p99 at most 500 us",
                    policy: "",
                    at: "/measured_us/p99",
                    limit: Limit::AtMost(500.0),
                },
            ],
        },
        Section {
            name: "rooms-ddpg",
            title: "Rooms, ddpg",
            about: "Rooms on one controller process at 100 reports a second each; the reference is an echo for as many.",
            command: "bench rooms --policy ddpg",
            full: "--seconds 6 --rooms 1,8,32",
            quick: "--seconds 1 --rooms 1,2",
            layout: Layout::Rows,
            columns: &ROOMS,
            bounds: &[
                Bound {
                    what: "decision p99 at most 500 us",
                    policy: "",
                    at: "/decision_us/p99",
                    limit: Limit::AtMost(500.0),
                },
                Bound {
                    what: "loop p99 at most 500 us",
                    policy: "",
                    at: "/measured_us/p99",
                    limit: Limit::AtMost(500.0),
                },
            ],
        },
        Section {
            name: "environment",
            title: "Environment steps",
            about: "Steps a second on one core; the reference is a straightforward scalar implementation.",
            command: "bench env",
            full: "--seconds 1",
            quick: "--seconds 0.05",
            layout: Layout::Rows,
            columns: &STEPS,
            bounds: &[],
        },
        Section {
            name: "solver",
            title: "Solver",
            about: "One solution of the oracle, of fixed-point and of greedy, without and with minimum rates.",
            command: "bench oracle",
            full: "--seconds 1",
            quick: "--seconds 0.05",
            layout: Layout::Rows,
            columns: &SOLVER,
            bounds: &[],
        },
    ],
};
