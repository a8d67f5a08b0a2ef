//! The page `evaluation`: policies beside the oracle.

use super::super::bound::{Bound, Limit};
use super::super::table::{Column, Form, Layout};
use super::page::{Page, Section};

const RATE: Column = Column { title: "sum rate (Mbit/s)", at: "/sum_rate_mbps", form: Form::Interval(1) };
const RATIO: Column = Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) };
const QOS: Column = Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) };
const TRAINED: Column = Column { title: "training seeds", at: "/training_seeds", form: Form::Text };

const POLICY: [Column; 8] = [
    TRAINED,
    RATE,
    RATIO,
    Column { title: "ratio, 5th percentile", at: "/ratio_to_oracle/p5", form: Form::Number(3) },
    QOS,
    Column { title: "Jain", at: "/jain", form: Form::Interval(3) },
    Column { title: "decision p50 (us)", at: "/decision_us/p50", form: Form::Number(0) },
    Column { title: "decision p99 (us)", at: "/decision_us/p99", form: Form::Number(0) },
];
const SWEPT: [Column; 2] = [RATIO, QOS];
const LOOP: [Column; 6] = [
    TRAINED,
    RATE,
    RATIO,
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(3) },
    QOS,
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(3) },
];

/// `greedy` with the filter has at least this ratio to the oracle.
const fn greedy_ratio(what: &'static str, least: f64) -> Bound {
    Bound { what, policy: "greedy+filter", at: "/ratio_to_oracle/mean", limit: Limit::AtLeast(least) }
}

/// `greedy` with the filter meets at least this share of the minimum rates.
const fn greedy_qos(what: &'static str, least: f64) -> Bound {
    Bound { what, policy: "greedy+filter", at: "/qos_met/mean", limit: Limit::AtLeast(least) }
}

/// A section in closed loop, 20 instants in each of 100 episodes: its name, its heading, what it measures,
/// and its command.
const fn in_loop([name, title, about, command]: [&'static str; 4], bounds: &'static [Bound]) -> Section {
    let layout = Layout::PoliciesAndBeliefs;
    Section { layout, bounds, ..Section::of_policies([name, title, about, command], &LOOP) }
}

/// The page.
pub static PAGE: Page = Page {
    name: "evaluation",
    title: "Results: policies beside the oracle",
    about: "How to read it: [evaluation.md](../evaluation.md). A figure is a mean with its 95 % interval; the ratio is to \
            the sum rate of the oracle with minimum rates. In closed loop an episode of 20 instants counts as one sample. A \
            difference is to the first policy of the table, paired state by state; a second table measures the beliefs themselves.",
    summary: None,
    sections: &[
        Section {
            name: "specular-2",
            title: "Held-out states: specular, 2 of 5 users blocked",
            about: "User bodies and two obstacles on average stand in the room, so the oracle cannot serve every user.",
            command: "eval --set noise.variance_a2=6.5e-15 --blocked 2 --policies ddpg,analytic,ddpg-raw,greedy,fixed-point,nearest,codebook,dql,q-learning,sarsa,pso,sine-cosine,flat,random,no-irs",
            full: "--states 200 --seeds 3",
            quick: "--states 4 --seeds 2",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[
                Bound {
                    what: "ddpg: ratio to the oracle at least 0.97",
                    policy: "ddpg",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.97),
                },
                Bound {
                    what: "greedy: ratio to the oracle at least 0.995",
                    policy: "greedy",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.995),
                },
                Bound {
                    what: "ddpg: share of minimum rates met at most 0.02 below that of the oracle",
                    policy: "ddpg",
                    at: "/qos_met/mean",
                    limit: Limit::BelowOracleAtMost(0.02),
                },
            ],
        },
        Section {
            name: "specular-5",
            title: "Held-out states: specular, all 5 users blocked",
            about: "The same room; no user has a direct path.",
            command: "eval --set noise.variance_a2=6.5e-15 --blocked 5 --policies ddpg,analytic,ddpg-raw,greedy,fixed-point,nearest,codebook,dql,q-learning,sarsa,pso,sine-cosine,flat,random,no-irs",
            full: "--states 200 --seeds 3",
            quick: "--states 4 --seeds 2",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[
                Bound {
                    what: "ddpg: ratio to the oracle at least 0.95",
                    policy: "ddpg",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.95),
                },
                Bound {
                    what: "greedy: ratio to the oracle at least 0.98",
                    policy: "greedy",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.98),
                },
                Bound {
                    what: "ddpg: share of minimum rates met at most 0.02 below that of the oracle",
                    policy: "ddpg",
                    at: "/qos_met/mean",
                    limit: Limit::BelowOracleAtMost(0.02),
                },
            ],
        },
        Section {
            name: "paper-calibrated",
            title: "Held-out states: paper-calibrated",
            about: "The paper's equations (2) and (3) with a calibrated factor and noise.",
            command: "eval --scenario paper-calibrated --policies ddpg,analytic,ddpg-raw,greedy,fixed-point,nearest,codebook,dql,q-learning,sarsa,pso,sine-cosine,flat,random,no-irs",
            full: "--states 200 --seeds 3",
            quick: "--states 4 --seeds 2",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[
                Bound {
                    what: "analytic: ratio to the oracle at least 0.99",
                    policy: "analytic",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.99),
                },
                Bound {
                    what: "ddpg: ratio to the oracle at least 0.98",
                    policy: "ddpg",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.98),
                },
                Bound {
                    what: "fixed-point: ratio to the oracle at least 0.99",
                    policy: "fixed-point",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.99),
                },
                Bound {
                    what: "ddpg: share of minimum rates met at most 0.02 below that of the oracle",
                    policy: "ddpg",
                    at: "/qos_met/mean",
                    limit: Limit::BelowOracleAtMost(0.02),
                },
            ],
        },
        Section {
            name: "empty-2",
            title: "Empty room, 2 of 5 users blocked",
            about: "No bodies and no obstacles: nearly every minimum rate can be met.",
            command: "eval --set noise.variance_a2=6.5e-15 --set blockage.bodies=false --set blockage.obstacles_per_m2=0 --blocked 2 --policies ddpg,analytic,greedy,fixed-point,nearest,flat",
            full: "--states 200 --seeds 3",
            quick: "--states 4 --seeds 2",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[Bound {
                what: "ddpg: share of minimum rates met at most 0.02 below that of the oracle",
                policy: "ddpg",
                at: "/qos_met/mean",
                limit: Limit::BelowOracleAtMost(0.02),
            }],
        },
        Section {
            name: "empty-5",
            title: "Empty room, 5 of 5 users blocked",
            about: "No bodies and no obstacles: nearly every minimum rate can be met.",
            command: "eval --set noise.variance_a2=6.5e-15 --set blockage.bodies=false --set blockage.obstacles_per_m2=0 --blocked 5 --policies ddpg,analytic,greedy,fixed-point,nearest,flat",
            full: "--states 200 --seeds 3",
            quick: "--states 4 --seeds 2",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[Bound {
                what: "ddpg: share of minimum rates met at most 0.02 below that of the oracle",
                policy: "ddpg",
                at: "/qos_met/mean",
                limit: Limit::BelowOracleAtMost(0.02),
            }],
        },
        Section {
            name: "search-paper",
            title: "Metaheuristics with 2000 trials: paper-calibrated",
            about: "The time limit of a search is off.",
            command: "eval --scenario paper-calibrated --set control.search_time_us=0 --policies pso,sine-cosine,flat",
            full: "--states 100 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[],
        },
        Section {
            name: "search-specular",
            title: "Metaheuristics with 2000 trials: specular, 2 of 5 users blocked",
            about: "The time limit of a search is off.",
            command: "eval --set noise.variance_a2=6.5e-15 --blocked 2 --set control.search_time_us=0 --policies pso,sine-cosine,flat",
            full: "--states 50 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[],
        },
        Section {
            name: "exhaustive",
            title: "Exhaustive search with 9 mirrors",
            about: "Every assignment of 9 mirrors to 3 users is tried.",
            command: "eval --set noise.variance_a2=6.5e-15 --set mirrors.rows=3 --set mirrors.columns=3 --set users.count=3 --blocked 2 --policies exhaustive,greedy,fixed-point",
            full: "--states 200 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Policies,
            columns: &POLICY,
            bounds: &[],
        },
        Section {
            name: "sweep-users",
            title: "Sweep: number of users",
            about: "One actor serves all values of the key; it was trained for a range of them.",
            command: "eval --set noise.variance_a2=6.5e-15 --policies ddpg,fixed-point,flat,no-irs --sweep users.count=1..10",
            full: "--states 30 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Sweep,
            columns: &SWEPT,
            bounds: &[],
        },
        Section {
            name: "sweep-blocked",
            title: "Sweep: blocked users",
            about: "One actor serves all values of the key; it was trained for a range of them.",
            command: "eval --set noise.variance_a2=6.5e-15 --policies ddpg,fixed-point,flat,no-irs --sweep blockage.forced_users=0..5",
            full: "--states 50 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Sweep,
            columns: &SWEPT,
            bounds: &[],
        },
        Section {
            name: "sweep-obstacles",
            title: "Sweep: obstacles per m2",
            about: "One actor serves all values of the key; it was trained for a range of them.",
            command: "eval --set noise.variance_a2=6.5e-15 --policies ddpg,fixed-point,flat,no-irs --blocked 2 --sweep blockage.obstacles_per_m2=0,0.04,0.08,0.16,0.24",
            full: "--states 50 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Sweep,
            columns: &SWEPT,
            bounds: &[],
        },
        Section {
            name: "sweep-noise",
            title: "Sweep: noise variance in A2",
            about: "One actor serves all values of the key; it was trained for a range of them.",
            command: "eval --blocked 2 --policies ddpg,fixed-point,flat,no-irs --sweep noise.variance_a2=1e-15,2e-15,4e-15,6.5e-15,2e-14,9e-14,2e-13",
            full: "--states 50 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Sweep,
            columns: &SWEPT,
            bounds: &[],
        },
        Section {
            name: "sweep-speed",
            title: "Sweep: largest speed of the users in m/s, closed loop",
            about: "Reports, delays, noise and mirrors of the scenario `hall`.",
            command: "eval --scenario hall --closed-loop --policies ddpg,fixed-point,flat,no-irs --sweep users.speed_max_m_s=0.25,0.5,1,2,3",
            full: "--states 60 --seeds 3",
            quick: "--states 2 --seeds 1",
            layout: Layout::Sweep,
            columns: &SWEPT,
            bounds: &[],
        },
        in_loop(
            [
                "hall",
                "Closed loop: hall, with each belief",
                "The oracle of the ratio knows the true state and its mirrors turn at once; the policy `oracle` solves the same problem from the reports.",
                "eval --scenario hall --closed-loop --beliefs filter,constant-velocity,none --policies greedy,oracle,fixed-point,ddpg,analytic,nearest,dql,q-learning,sarsa,ddpg-raw,pso,sine-cosine,flat,random,no-irs,hold",
            ],
            &[
                greedy_ratio("greedy with the filter: ratio to the oracle at least 0.962", 0.962),
                greedy_qos("greedy with the filter: share of minimum rates met at least 0.878", 0.878),
                Bound {
                    what: "ddpg with the filter: ratio to the oracle at least 0.955",
                    policy: "ddpg+filter",
                    at: "/ratio_to_oracle/mean",
                    limit: Limit::AtLeast(0.955),
                },
                Bound {
                    what: "filter: at least 0.92 of the true places within the 95 % ellipse",
                    policy: "filter",
                    at: "/coverage_95/mean",
                    limit: Limit::AtLeast(0.92),
                },
                Bound {
                    what: "filter: at most 0.98 of the true places within the 95 % ellipse",
                    policy: "filter",
                    at: "/coverage_95/mean",
                    limit: Limit::AtMost(0.98),
                },
            ],
        ),
        in_loop(
            [
                "hall-exact-gains",
                "Closed loop: hall, exact gains",
                "Without the noise of measured gains.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --set streams.channel.noise_relative=0",
            ],
            &[],
        ),
        in_loop(
            [
                "hall-pauses",
                "Closed loop: hall, users who stand",
                "Users stand at the points of their walks, turned to a direction drawn at random.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --set users.pause_mean_s=2",
            ],
            &[],
        ),
        in_loop(
            [
                "hall-warm",
                "Closed loop: hall, 30 s after the start",
                "The belief has had time to learn where obstacles stand.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --warm 30",
            ],
            &[
                greedy_ratio("greedy with the filter: ratio to the oracle at least 0.973", 0.973),
                greedy_qos("greedy with the filter: share of minimum rates met at least 0.872", 0.872),
            ],
        ),
        in_loop(
            [
                "hall-noise",
                "Closed loop: hall, twice the noise of the tracker",
                "Positions and velocities have twice the noise that the controller knows.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --set mismatch.level=rough --set mismatch.kinds=[\"tracker\"]",
            ],
            &[greedy_ratio("greedy with the filter: ratio to the oracle at least 0.94", 0.94)],
        ),
        in_loop(
            [
                "hall-latency",
                "Closed loop: hall, positions 200 ms late",
                "Twice the latency of the position reports.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --set streams.positions.latency_ms=200",
            ],
            &[greedy_ratio("greedy with the filter: ratio to the oracle at least 0.95", 0.95)],
        ),
        in_loop(
            [
                "hall-rate",
                "Closed loop: hall, 30 position reports a second",
                "Three times as many position reports.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --set streams.positions.rate_hz=30",
            ],
            &[greedy_ratio("greedy with the filter: ratio to the oracle at least 0.97", 0.97)],
        ),
        in_loop(
            [
                "hall-users",
                "Closed loop: hall, 10 users",
                "Twice as many users.",
                "eval --scenario hall --closed-loop --beliefs constant-velocity,filter --policies greedy --set users.count=10",
            ],
            &[greedy_ratio("greedy with the filter: ratio to the oracle at least 0.954", 0.954)],
        ),
        in_loop(
            [
                "specular-loop",
                "Closed loop: specular",
                "Exact reports at 100 Hz: a filter has nothing to win, and the difference is what it loses.",
                "eval --scenario specular --closed-loop --beliefs constant-velocity,filter --policies greedy,fixed-point",
            ],
            &[Bound {
                what: "greedy loses at most 0.001 of the ratio by the filter",
                policy: "greedy+filter",
                at: "/difference_ratio/mean",
                limit: Limit::AtLeast(-0.001),
            }],
        ),
    ],
};
