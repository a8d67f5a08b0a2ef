//! The page `rooms`: policies in rooms that differ from the scenario `hall`.

mod summary;

use super::super::table::{Column, Form};
use super::page::{Page, Section};

const COLUMNS: [Column; 10] = [
    Column { title: "sum rate (Mbit/s)", at: "/sum_rate_mbps", form: Form::Interval(1) },
    Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(3) },
    Column { title: "QoS met", at: "/qos_met", form: Form::Interval(3) },
    Column { title: "QoS met, difference", at: "/difference_qos_met", form: Form::Interval(3) },
    Column { title: "Jain", at: "/jain", form: Form::Interval(3) },
    Column { title: "outage time", at: "/outage_time", form: Form::Interval(3) },
    Column { title: "outages per user minute", at: "/outages/per_user_minute", form: Form::Number(1) },
    Column { title: "outage p50 (s)", at: "/outages/p50_s", form: Form::Number(2) },
    Column { title: "outage p95 (s)", at: "/outages/p95_s", form: Form::Number(2) },
];

/// The command of a section about `hall`: three policies with two beliefs, and the ceilings of the
/// first.
macro_rules! in_hall {
    ($overrides:literal) => {
        concat!(
            "eval --scenario hall --closed-loop --ceilings --training-seed 1 --beliefs filter,constant-velocity ",
            "--policies greedy,fixed-point,ddpg",
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
    name: "rooms",
    title: "Results: rooms that are not the plain hall",
    about: "How to read it: [evaluation.md](../evaluation.md). The sections about `hall` name what they change. A difference is to the \
            first row, paired state by state. `true-present` and `true-future` know the true room in place of reports. An \
            episode of 20 instants counts as one sample.",
    summary: Some(summary::write),
    sections: &[
        room(
            "plain",
            "hall",
            "Random waypoint walks, upright receivers, and the room that the controller knows.",
            in_hall!(""),
        ),
        room(
            "pauses",
            "Mobility: random waypoint with pauses of 2 s",
            "Users stand at the points of their walks, turned to a direction drawn at random.",
            in_hall!(" --set users.pause_mean_s=2"),
        ),
        room(
            "random-direction",
            "Mobility: random direction",
            "Users walk in a direction until it changes, and walls reflect.",
            in_hall!(" --set users.mobility=random-direction"),
        ),
        room(
            "gauss-markov",
            "Mobility: Gauss-Markov",
            "Speed and direction change in small correlated steps.",
            in_hall!(" --set users.mobility=gauss-markov"),
        ),
        room(
            "smooth-random",
            "Mobility: smooth random",
            "Acceleration and turn rate are bounded.",
            in_hall!(" --set users.mobility=smooth-random"),
        ),
        room(
            "social-force",
            "Mobility: social force",
            "Users walk to goals and avoid users, walls and obstacles.",
            in_hall!(" --set users.mobility=social-force"),
        ),
        room(
            "seated",
            "Mobility: seated users",
            "Users stay at their places and turn at random times.",
            in_hall!(" --set users.mobility=seated"),
        ),
        room(
            "orientation",
            "Orientation of the receivers",
            "Users hold their receivers at measured angles, without orientation reports.",
            in_hall!(" --set users.orientation={}"),
        ),
        room(
            "orientation-assumed",
            "Orientation of the receivers, assumed",
            "The controller assumes the mean angle of users who walk.",
            in_hall!(" --set users.orientation={} --set control.tilt={}"),
        ),
        room(
            "orientation-social-force",
            "Orientation of the receivers, social force",
            "Unreported angles of users who avoid each other.",
            in_hall!(" --set users.orientation={} --set users.mobility=social-force"),
        ),
        room(
            "orientation-seated",
            "Orientation of the receivers, seated users",
            "Unreported angles of users who sit.",
            in_hall!(" --set users.orientation={} --set users.mobility=seated"),
        ),
        room(
            "orientation-reported",
            "Orientation of the receivers, reported",
            "The devices report their angles ten times a second with an error of 2 degrees.",
            in_hall!(
                " --set users.orientation={} --set streams.orientation.rate_hz=10 --set streams.orientation.noise_deg=2"
            ),
        ),
        room(
            "orientation-seated-reported",
            "Orientation of the receivers, seated users, reported",
            "The same for users who sit; reports are 100 ms old like those of positions.",
            in_hall!(
                " --set users.orientation={} --set users.mobility=seated --set streams.orientation.rate_hz=10 --set streams.orientation.latency_ms=100 --set streams.orientation.noise_deg=2"
            ),
        ),
        room(
            "typical",
            "Mismatch: typical",
            "The true room differs from the room that the controller knows, as after a careful installation.",
            in_hall!(" --set mismatch.level=typical"),
        ),
        room(
            "rough",
            "Mismatch: rough",
            "The same after an installation without alignment tools.",
            in_hall!(" --set mismatch.level=rough"),
        ),
        room(
            "rough-bodies",
            "Mismatch: rough, bodies only",
            "Radius, height and place of the users' bodies.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"bodies\"]"),
        ),
        room(
            "rough-tilt",
            "Mismatch: rough, tilt of the receivers only",
            "A fixed tilt of each user's receiver.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"tilt\"]"),
        ),
        room(
            "rough-mirrors",
            "Mismatch: rough, mirrors only",
            "The angles of each mirror, and the reflectivity.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"mirrors\"]"),
        ),
        room(
            "rough-led",
            "Mismatch: rough, LED only",
            "Position and half-power semi-angle of the LED.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"led\"]"),
        ),
        room(
            "rough-receiver",
            "Mismatch: rough, received power only",
            "A factor on all gains.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"receiver\"]"),
        ),
        room(
            "rough-floor",
            "Mismatch: rough, height of the floor only",
            "The height of LED and mirrors above the floor of the tracker.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"floor\"]"),
        ),
        room(
            "rough-tracker",
            "Mismatch: rough, tracker only",
            "Twice the noise of positions and velocities that the controller knows.",
            in_hall!(" --set mismatch.level=rough --set mismatch.kinds=[\"tracker\"]"),
        ),
        room(
            "all",
            "All at once",
            "Social force, unreported orientation and a rough mismatch.",
            in_hall!(" --set users.mobility=social-force --set users.orientation={} --set mismatch.level=rough"),
        ),
        room(
            "office",
            "The scenario office",
            "Seated users and users who walk between them.",
            "eval --scenario office --closed-loop --ceilings --beliefs filter,constant-velocity --policies greedy,fixed-point",
        ),
        room(
            "office-reported",
            "The scenario office, with reported orientations",
            "Its devices report their angles ten times a second, 100 ms late and with an error of 2 degrees.",
            "eval --scenario office --closed-loop --ceilings --beliefs filter,constant-velocity --policies greedy,fixed-point --set streams.orientation.rate_hz=10 --set streams.orientation.latency_ms=100 --set streams.orientation.noise_deg=2",
        ),
        room(
            "corridor",
            "The scenario corridor",
            "Users who pass each other.",
            "eval --scenario corridor --closed-loop --ceilings --beliefs filter,constant-velocity --policies greedy,fixed-point",
        ),
        room(
            "atrium",
            "The scenario atrium",
            "A larger room with more users, who enter and leave.",
            "eval --scenario atrium --closed-loop --ceilings --beliefs filter,constant-velocity --policies greedy,fixed-point",
        ),
        room(
            "lab",
            "The scenario lab",
            "A bench at a quarter of the size, with servos.",
            "eval --scenario lab --closed-loop --ceilings --beliefs filter,constant-velocity --policies greedy,fixed-point",
        ),
    ],
};
