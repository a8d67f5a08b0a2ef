//! The page `learning`: the learned correction of the belief beside the best model-based policy.

use super::super::table::{Column, Form, Layout};
use super::page::{Page, Section};

pub use trainings::TRAININGS;

/// The scenarios of arrays and numbers of users that the training of the built-in actor never has.
macro_rules! small {
    () => {
        "hall --set users.orientation={} --set mirrors.rows=7 --set mirrors.columns=7"
    };
}
macro_rules! large {
    () => {
        "hall --set users.orientation={} --set mirrors.rows=20 --set mirrors.columns=20 --set mirrors.width_m=0.2 \
         --set mirrors.height_m=0.05"
    };
}
macro_rules! one_user {
    () => {
        "hall --set users.orientation={} --set users.count=1"
    };
}
macro_rules! crowd {
    () => {
        "hall --set users.orientation={} --set users.count=20"
    };
}
// With the reports of `hall`.
macro_rules! two_arrays {
    () => {
        "deploy/rooms/two-arrays.toml --set users.orientation={} --set actuator.profile=mems --set control.range_deg=60 \
         --set control.validity_ms=400 --set streams.positions.rate_hz=10 --set streams.positions.latency_ms=100 \
         --set streams.positions.noise_m=0.05 --set streams.positions.velocity_noise_m_s=0.1 \
         --set streams.channel.rate_hz=10 --set streams.channel.latency_ms=100 \
         --set streams.channel.noise_relative=0.05 --set streams.obstacles.rate_hz=0"
    };
}

/// The command of a section that compares the built-in actor with one that was trained in this room only.
macro_rules! beside_specialised {
    ($name:literal, $room:expr) => {
        concat!(
            "eval --closed-loop --policies greedy,residual,training/for-",
            $name,
            "/residual.onnx --training-seed 1 --scenario ",
            $room
        )
    };
}

mod trainings;

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

/// The command of a section that compares actors in one room.
macro_rules! of_actors {
    ($policies:literal, $overrides:literal) => {
        concat!("eval --scenario hall --closed-loop --policies ", $policies, $overrides)
    };
}

/// The command of a section about an actor that was trained without what the room has.
macro_rules! left_out {
    ($name:literal, $overrides:literal) => {
        concat!(
            "eval --scenario hall --closed-loop --policies greedy,training/episodes-10/residual.onnx,training/without-",
            $name,
            "/residual.onnx --set users.orientation={}",
            $overrides
        )
    };
}

/// A section about one room.
const fn room(name: &'static str, title: &'static str, about: &'static str, command: &'static str) -> Section {
    Section::of_policies([name, title, about, command], &COLUMNS)
}

/// Columns for each policy of a sweep.
const SWEPT: [Column; 2] = [
    Column { title: "ratio", at: "/ratio_to_oracle", form: Form::Interval(3) },
    Column { title: "ratio, difference", at: "/difference_ratio", form: Form::Interval(4) },
];

/// What the sections about several actors compare.
const ACTORS: &str = "`residual` is the built-in actor: supervised, 100 episodes. `analytic` and `ddpg` fine-tune it on the true future rate. \
                      `episodes-N` have less training data; those `without` features have 10 episodes.";

/// What the sections about one room compare.
const ONE_ROOM: &str = "`residual` is the built-in actor, one file for every room: it was trained with 10 x 10 mirrors on one wall and 2 to 7 \
                        users. `for-` actors were trained as long, in this room only.";

/// The command of a section about several actors.
macro_rules! actors {
    ($overrides:literal) => {
        of_actors!(
            "greedy,residual,training/analytic/residual.onnx,training/ddpg/residual.onnx,training/episodes-10/residual.onnx,\
             training/episodes-30/residual.onnx,training/without-residuals/residual.onnx,\
             training/without-history/residual.onnx,training/without-neighbours/residual.onnx --training-seed 1",
            $overrides
        )
    };
}

/// The command of a section about the actor that was fine-tuned by a gradient.
macro_rules! fine_tuned {
    ($room:literal) => {
        concat!(
            "eval --closed-loop --policies greedy,residual,training/analytic/residual.onnx --training-seed 1 --scenario ",
            $room
        )
    };
}

/// What these sections compare.
const FINE: &str = "The supervised actor, and the one that `--fine-tune analytic` makes from it.";

/// The page.
pub static PAGE: Page = Page {
    name: "learning",
    title: "Results: a learned correction of the belief",
    about: "What it means: [learning.md](../learning.md). `greedy` acts on the belief `filter`; `residual` acts on the same belief \
            after a network has corrected it. A difference is to `greedy`, paired state by state. `true-present` and `true-future` \
            know the true room in place of reports. An episode of 20 instants counts as one sample.",
    summary: None,
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
        room("small", "7 x 7 mirrors, unreported orientation", ONE_ROOM, beside_specialised!("small", small!())),
        room("large", "20 x 20 mirrors, unreported orientation", ONE_ROOM, beside_specialised!("large", large!())),
        room("one-user", "One user, unreported orientation", ONE_ROOM, beside_specialised!("one-user", one_user!())),
        room("crowd", "20 users, unreported orientation", ONE_ROOM, beside_specialised!("crowd", crowd!())),
        room(
            "two-arrays",
            "Two arrays on two walls, unreported orientation",
            ONE_ROOM,
            beside_specialised!("two-arrays", two_arrays!()),
        ),
        room("one-office", "office, and an actor for it", ONE_ROOM, beside_specialised!("office", "office")),
        room("one-corridor", "corridor, and an actor for it", ONE_ROOM, beside_specialised!("corridor", "corridor")),
        Section {
            layout: Layout::Sweep,
            columns: &SWEPT,
            ..room(
                "users",
                "hall with 1 to 10 users and unreported orientation",
                "Training has 2 to 7 users.",
                of_actors!(
                    "greedy,residual",
                    " --training-seed 1 --set users.orientation={} --sweep users.count=1,2,5,10"
                ),
            )
        },
        room("actors-orientation", "Actors: unreported orientation", ACTORS, actors!(" --set users.orientation={}")),
        room(
            "actors-social",
            "Actors: unreported orientation, social force",
            ACTORS,
            actors!(" --set users.orientation={} --set users.mobility=social-force"),
        ),
        room(
            "actors-all",
            "Actors: social force, unreported orientation and a rough mismatch",
            ACTORS,
            actors!(" --set users.orientation={} --set users.mobility=social-force --set mismatch.level=rough"),
        ),
        room("fine-hall", "Fine-tuned: hall", FINE, fine_tuned!("hall")),
        room("fine-typical", "Fine-tuned: typical mismatch", FINE, fine_tuned!("hall --set mismatch.level=typical")),
        room("fine-rough", "Fine-tuned: rough mismatch", FINE, fine_tuned!("hall --set mismatch.level=rough")),
        room("fine-office", "Fine-tuned: office", FINE, fine_tuned!("office")),
        room("fine-corridor", "Fine-tuned: corridor", FINE, fine_tuned!("corridor")),
        room("fine-foyer", "Fine-tuned: foyer", FINE, fine_tuned!("deploy/rooms/foyer.toml")),
        room(
            "seeds-orientation",
            "Three training seeds: unreported orientation",
            "The supervised actors of the training seeds 1 to 3. An interval contains the spread over the seeds.",
            of_actors!("greedy,residual", " --set users.orientation={}"),
        ),
        room(
            "seeds-social",
            "Three training seeds: unreported orientation, social force",
            "The supervised actors of the training seeds 1 to 3. An interval contains the spread over the seeds.",
            of_actors!("greedy,residual", " --set users.orientation={} --set users.mobility=social-force"),
        ),
        room(
            "seeds-all",
            "Three training seeds: social force, unreported orientation and a rough mismatch",
            "The supervised actors of the training seeds 1 to 3. An interval contains the spread over the seeds.",
            of_actors!(
                "greedy,residual",
                " --set users.orientation={} --set users.mobility=social-force --set mismatch.level=rough"
            ),
        ),
        room(
            "seeds-seated",
            "Three training seeds: unreported orientation, seated users",
            "The supervised actors of the training seeds 1 to 3. An interval contains the spread over the seeds.",
            of_actors!("greedy,residual", " --set users.orientation={} --set users.mobility=seated"),
        ),
        room(
            "without-random-waypoint",
            "Left out of training: random waypoint",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("random-waypoint", ""),
        ),
        room(
            "without-pauses",
            "Left out of training: random waypoint with pauses",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("pauses", " --set users.pause_mean_s=3"),
        ),
        room(
            "without-random-direction",
            "Left out of training: random direction",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("random-direction", " --set users.mobility=random-direction"),
        ),
        room(
            "without-gauss-markov",
            "Left out of training: Gauss-Markov",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("gauss-markov", " --set users.mobility=gauss-markov"),
        ),
        room(
            "without-smooth-random",
            "Left out of training: smooth random",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("smooth-random", " --set users.mobility=smooth-random"),
        ),
        room(
            "without-social-force",
            "Left out of training: social force",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("social-force", " --set users.mobility=social-force --set users.pause_mean_s=2"),
        ),
        room(
            "without-seated",
            "Left out of training: seated users",
            "Trained on the other walks and evaluated on this one, with unreported orientation.",
            left_out!("seated", " --set users.mobility=seated"),
        ),
        room(
            "without-bodies",
            "Left out of training: mismatch of bodies",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("bodies", " --set mismatch.level=rough --set mismatch.kinds=[\"bodies\"]"),
        ),
        room(
            "without-tilt",
            "Left out of training: mismatch of tilt of the receivers",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("tilt", " --set mismatch.level=rough --set mismatch.kinds=[\"tilt\"]"),
        ),
        room(
            "without-mirrors",
            "Left out of training: mismatch of mirrors",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("mirrors", " --set mismatch.level=rough --set mismatch.kinds=[\"mirrors\"]"),
        ),
        room(
            "without-led",
            "Left out of training: mismatch of LED",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("led", " --set mismatch.level=rough --set mismatch.kinds=[\"led\"]"),
        ),
        room(
            "without-receiver",
            "Left out of training: mismatch of received power",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("receiver", " --set mismatch.level=rough --set mismatch.kinds=[\"receiver\"]"),
        ),
        room(
            "without-floor",
            "Left out of training: mismatch of height of the floor",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("floor", " --set mismatch.level=rough --set mismatch.kinds=[\"floor\"]"),
        ),
        room(
            "without-tracker",
            "Left out of training: mismatch of tracker",
            "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.",
            left_out!("tracker", " --set mismatch.level=rough --set mismatch.kinds=[\"tracker\"]"),
        ),
    ],
};
