//! The page `latency`: times beside a reference of the same run.

use super::super::bound::{Bound, Limit};
use super::super::table::{Column, Form, Layout};
use super::page::{Page, Section};

const fn us(title: &'static str, at: &'static str) -> Column {
    Column { title, at, form: Form::Number(0) }
}

const fn tenths(title: &'static str, at: &'static str) -> Column {
    Column { title, at, form: Form::Number(1) }
}

const fn share(title: &'static str, at: &'static str) -> Column {
    Column { title, at, form: Form::Number(4) }
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
const DECISION: [Column; 14] = [
    HZ,
    POLICY,
    text("engine", "/engine"),
    P50,
    P90,
    P99,
    P999,
    MAX,
    REFERENCE_P50,
    REFERENCE_P99,
    RATIO_P50,
    RATIO_P99,
    COUNT,
    OVER,
];
const WAIT: Column = text("wait", "/over_budget_by/wait");
const DECODE: Column = text("decode", "/over_budget_by/decode");
const OBSERVE: Column = text("observe", "/over_budget_by/observe");
const INFER: Column = text("infer", "/over_budget_by/infer");
const SAFE: Column = text("safe", "/over_budget_by/safe");
const PUBLISH: Column = text("publish", "/over_budget_by/publish");
const MISSES: [Column; 11] = [P50, P99, P999, COUNT, OVER, WAIT, DECODE, OBSERVE, INFER, SAFE, PUBLISH];
const DEMO: [Column; 14] = [
    text("busy processes", "/busy"),
    POLICY,
    P50,
    P99,
    COUNT,
    OVER,
    share("share", "/share"),
    share("share above hold", "/above_hold"),
    WAIT,
    DECODE,
    OBSERVE,
    INFER,
    SAFE,
    PUBLISH,
];
const BELIEF: [Column; 11] = [
    text("room", "/room"),
    tenths("users", "/users"),
    text("mirrors", "/mirrors"),
    tenths("channel report p50", "/channel_us/p50"),
    tenths("p99", "/channel_us/p99"),
    tenths("position report p50", "/positions_us/p50"),
    tenths("observation p50", "/observation_us/p50"),
    tenths("position report and observation p50", "/decision_us/p50"),
    tenths("p99", "/decision_us/p99"),
    tenths("reference p50", "/reference_us/p50"),
    tenths("channel report, ratio", "/channel_ratio"),
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

/// A bound on every row.
const fn at_most(what: &'static str, at: &'static str, limit: f64) -> Bound {
    Bound { what, policy: "", at, limit: Limit::AtMost(limit) }
}

const ECHO: [Bound; 2] = [
    at_most("p50 at most 1.3 times that of the echo", "/ratio_p50", 1.3),
    at_most("p99 at most 1.5 times that of the echo", "/ratio_p99", 1.5),
];
const FEW_MISSES: [Bound; 1] = [Bound {
    what: "at most 1 decision of 10,000 takes more than 0.5 ms",
    policy: "",
    at: "/over_budget",
    limit: Limit::ShareAtMost(1e-4, "/count"),
}];
const OF_ROOMS: [Bound; 2] = [
    at_most("decision p99 at most 500 us", "/decision_us/p99", 500.0),
    at_most("loop p99 at most 500 us", "/measured_us/p99", 500.0),
];

/// A section: its name, its heading and its command; what it measures; further arguments of a full and of
/// a quick run; its table and its bounds.
const fn section(
    [name, title, command]: [&'static str; 3],
    about: &'static str,
    [full, quick]: [&'static str; 2],
    columns: &'static [Column],
    bounds: &'static [Bound],
) -> Section {
    Section { name, title, about, command, full, quick, layout: Layout::Rows, columns, bounds }
}

const fn loop_of(words: [&'static str; 3]) -> Section {
    let about = "From the publication of a report to the arrival of the command that answers it, between two processes; the reference is an echo.";
    section(words, about, ["--seconds 3", "--seconds 1 --hz 100"], &LOOP, &ECHO)
}

const fn decision(words: [&'static str; 3], about: &'static str, bounds: &'static [Bound]) -> Section {
    section(words, about, ["--seconds 4", "--seconds 1"], &DECISION, bounds)
}

const fn misses(words: [&'static str; 3], about: &'static str, bounds: &'static [Bound]) -> Section {
    section(words, about, ["--decisions 20000", "--decisions 500"], &MISSES, bounds)
}

const fn rooms(words: [&'static str; 3]) -> Section {
    let about = "Rooms on one controller process at 100 reports a second each; the reference is an echo for as many.";
    section(words, about, ["--seconds 4 --rooms 1,8,32", "--seconds 1 --rooms 1,2"], &ROOMS, &OF_ROOMS)
}

/// What two sections of decisions over budget measure.
const LATE: &str = "Decisions of more than 0.5 ms at 1000 reports a second, by their longest stage.";
/// What the sections of single policies measure.
const PACED: &str = "The decision without transport at 100 reports a second and without pauses; the reference is the inference \
                     engine alone on the actor of `ddpg`, or on the policy's own file.";

/// The page.
pub static PAGE: Page = Page {
    name: "latency",
    title: "Results: latency and speed",
    about: "How to read it: [latency.md](../latency.md). Times are in us; a ratio is to the reference of the same run. A \
            dash under \"reports/s\" stands for no pause between reports.",
    summary: None,
    sections: &[
        loop_of(["loop-nearest", "Loop, nearest", "bench loop --policy nearest"]),
        loop_of(["loop-fixed-point", "Loop, fixed-point", "bench loop --policy fixed-point"]),
        loop_of(["loop-ddpg", "Loop, ddpg", "bench loop --policy ddpg"]),
        decision(
            ["decide", "Decision", "bench decide"],
            "The decision without transport; the reference is the inference engine alone.",
            &[at_most("p50 at most 2.5 times that of the inference", "/ratio_p50", 2.5)],
        ),
        decision(
            ["decide-fixed-point", "Decision, fixed-point", "bench decide --policy fixed-point --hz 100,0"],
            PACED,
            &[],
        ),
        decision(["decide-greedy", "Decision, greedy", "bench decide --policy greedy --hz 100,0"], PACED, &[]),
        section(
            ["belief", "Belief and observation", "bench belief"],
            "What reports and an observation cost while caches are warm. The reference is one evaluation of the channel model.",
            ["--seconds 1", "--seconds 0.1"],
            &BELIEF,
            &[
                Bound {
                    what: "hall: position report and observation together at most 15 us (p50)",
                    policy: "hall",
                    at: "/decision_us/p50",
                    limit: Limit::AtMost(15.0),
                },
                Bound {
                    what: "hall: channel report at most 50 us (p50)",
                    policy: "hall",
                    at: "/channel_us/p50",
                    limit: Limit::AtMost(50.0),
                },
            ],
        ),
        section(
            ["demo", "Demo", "bench demo"],
            "Decisions of more than 0.5 ms of `heliostat demo` with each policy, on the machine as it is and beside as many busy \
             processes as processors, by their longest stage. `hold` publishes the last angles again: its share is what the \
             machine itself causes.",
            ["--seconds 25", "--seconds 2"],
            &DEMO,
            &[Bound {
                what: "fixed-point: share of decisions over 0.5 ms at most 0.002 above that of hold",
                policy: "fixed-point",
                at: "/above_hold",
                limit: Limit::AtMost(0.002),
            }],
        ),
        misses(["misses-ddpg", "Over budget, ddpg", "bench decide --hz 1000 --policy ddpg"], LATE, &FEW_MISSES),
        misses(
            ["misses-nearest", "Over budget, nearest", "bench decide --hz 1000 --policy nearest"],
            LATE,
            &FEW_MISSES,
        ),
        misses(
            ["misses-hold", "Over budget, hold", "bench decide --hz 1000 --policy hold"],
            "The same with the policy hold, which publishes the last angles again: the share that the machine itself causes.",
            &[],
        ),
        section(
            ["policies", "Policies", "bench policies"],
            "The decision of each policy without transport at 100 reports a second.",
            ["--seconds 2", "--decisions 50"],
            &DECISION,
            &[],
        ),
        section(
            ["mirrors", "Mirrors", "bench mirrors --policy nearest"],
            "The same wall divided into 49 to 4096 mirrors under a point LED; the reference is the wall of 49.",
            ["--seconds 3", "--seconds 1"],
            &MIRRORS,
            &[
                at_most("p99 at most 500 us", "/measured_us/p99", 500.0),
                at_most(
                    "p50 grows no faster than the number of mirrors (83.6 times from 49 to 4096)",
                    "/ratio_p50",
                    83.6,
                ),
            ],
        ),
        section(
            ["users", "Users", "bench users --policy fixed-point"],
            "1 to 50 users; the reference is one user.",
            ["--seconds 3", "--seconds 1"],
            &USERS,
            &[],
        ),
        rooms(["rooms-nearest", "Rooms, nearest", "bench rooms --policy nearest"]),
        rooms(["rooms-fixed-point", "Rooms, fixed-point", "bench rooms --policy fixed-point"]),
        rooms(["rooms-ddpg", "Rooms, ddpg", "bench rooms --policy ddpg"]),
        Section {
            layout: Layout::RowsAndMoving,
            ..section(
                ["environment", "Environment steps", "bench env"],
                "Steps a second on one core; the reference is a straightforward scalar implementation. The second table has \
                 users of `hall` who hold tilted receivers, avoid each other, or do both; the reference is the same room with \
                 upright receivers and random waypoint walks.",
                ["--seconds 0.5", "--seconds 0.05"],
                &STEPS,
                &[Bound {
                    what: "orientation, social force or both: at least 0.5 times the steps with upright receivers and random waypoint",
                    policy: "moving",
                    at: "/ratio",
                    limit: Limit::AtLeast(0.5),
                }],
            )
        },
        section(
            ["solver", "Solver", "bench oracle"],
            "One solution of the oracle, of fixed-point and of greedy, without and with minimum rates.",
            ["--seconds 0.5", "--seconds 0.05"],
            &SOLVER,
            &[],
        ),
    ],
};
