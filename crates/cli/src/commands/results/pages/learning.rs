//! The page `learning`: the learned correction of the belief beside the best model-based policy.

use super::super::bound::{Bound, Limit};
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

/// A section that compares the built-in actor with one that was trained in this room only: the name of
/// the latter, the section's name and heading, and the room.
macro_rules! beside_specialised {
    ($name:literal, $section:literal, $title:literal, $room:expr) => {
        Section {
            bounds: &[Bound {
                what: "the actor for this room: at most 0.01 above the ratio of the built-in one",
                policy: concat!("training/for-", $name, "/residual.onnx"),
                at: "/difference_ratio/mean",
                limit: Limit::AtMost(0.01),
            }],
            ..room(
                $section,
                $title,
                ONE_ROOM,
                concat!(
                    "eval --closed-loop --policies residual,training/for-",
                    $name,
                    "/residual.onnx,greedy --training-seed 1 --scenario ",
                    $room
                ),
            )
        }
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

/// A section about an actor that was trained without what the room has: the name of the actor, what is
/// left out, and the room.
macro_rules! left_out {
    ($name:literal, $title:literal, $about:expr, $overrides:literal) => {
        Section {
            bounds: &[Bound {
                what: "the actor that never had it: ratio at least 0.01 above that of greedy",
                policy: concat!("training/without-", $name, "/residual.onnx"),
                at: "/difference_ratio/mean",
                limit: Limit::AtLeast(0.01),
            }],
            ..room(
                concat!("without-", $name),
                concat!("Left out of training: ", $title),
                $about,
                concat!(
                    "eval --scenario hall --closed-loop --policies greedy,training/episodes-10/residual.onnx,training/without-",
                    $name,
                    "/residual.onnx --set users.orientation={}",
                    $overrides
                ),
            )
        }
    };
}

/// A section about one room.
const fn room(name: &'static str, title: &'static str, about: &'static str, command: &'static str) -> Section {
    Section::of_policies([name, title, about, command], &COLUMNS)
}

/// A section about one room as the controller knows it, with the bound for such rooms.
const fn known_room(name: &'static str, title: &'static str, about: &'static str, command: &'static str) -> Section {
    Section { bounds: &[NO_LOSS], ..room(name, title, about, command) }
}

/// A section about a room that differs from the one that the controller knows, with the bound for such
/// rooms.
const fn other_room(name: &'static str, title: &'static str, about: &'static str, command: &'static str) -> Section {
    Section { bounds: &[GAIN], ..room(name, title, about, command) }
}

const NO_LOSS: Bound = Bound {
    what: "residual: ratio at most 0.002 below that of greedy",
    policy: "residual",
    at: "/difference_ratio/mean",
    limit: Limit::AtLeast(-0.002),
};

const GAIN: Bound = Bound {
    what: "residual: ratio at least 0.03 above that of greedy",
    policy: "residual",
    at: "/difference_ratio/mean",
    limit: Limit::AtLeast(0.03),
};

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
                        users. `for-` actors had 30 episodes, in this room only. A difference is to the built-in actor.";

/// What the sections about an actor that was trained without one mobility model compare.
const WALK: &str = "Trained on the other walks and evaluated on this one, with unreported orientation.";

/// What the sections about an actor that was trained without one kind of mismatch compare.
const KIND: &str = "Trained on the other kinds of mismatch and evaluated on a rough one of this kind.";

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
            after a network has corrected it. A difference is to the first policy of a table, `greedy` in most, paired state by state. `true-present` and `true-future` \
            know the true room in place of reports. An episode of 20 instants counts as one sample.",
    summary: None,
    sections: &[
        known_room("plain", "hall", "Upright receivers; the room that the controller knows.", in_room!("hall", "")),
        known_room(
            "pauses",
            "hall with pauses",
            "Users stand for 2 s on average at the points of their walks.",
            in_room!("hall", " --set users.pause_mean_s=2"),
        ),
        known_room(
            "random-direction",
            "hall with random directions",
            "Users walk in a direction until it changes.",
            in_room!("hall", " --set users.mobility=random-direction"),
        ),
        known_room(
            "gauss-markov",
            "hall with Gauss-Markov walks",
            "Speed and direction change in small correlated steps.",
            in_room!("hall", " --set users.mobility=gauss-markov"),
        ),
        known_room(
            "smooth-random",
            "hall with smooth random walks",
            "Users turn and accelerate within bounds.",
            in_room!("hall", " --set users.mobility=smooth-random"),
        ),
        known_room(
            "social-force",
            "hall with social force",
            "Users avoid each other.",
            in_room!("hall", " --set users.mobility=social-force"),
        ),
        known_room(
            "seated",
            "hall with seated users",
            "Users at their places.",
            in_room!("hall", " --set users.mobility=seated"),
        ),
        room(
            "orientation",
            "hall with unreported orientation",
            "Users hold their receivers at random angles.",
            in_room!("hall", " --set users.orientation={}"),
        ),
        room(
            "orientation-upright",
            "hall with unreported orientation that the belief takes for upright",
            "The same; `control.tilt` states upright receivers, so the belief does not infer tilted ones.",
            in_room!("hall", " --set users.orientation={} --set control.tilt={walking_deg=0.0,sitting_deg=0.0}"),
        ),
        room(
            "orientation-social",
            "hall with unreported orientation, social force",
            "Users hold their receivers at random angles and avoid each other.",
            in_room!("hall", " --set users.orientation={} --set users.mobility=social-force"),
        ),
        room(
            "orientation-seated",
            "hall with unreported orientation, seated users",
            "The same for users at their places.",
            in_room!("hall", " --set users.orientation={} --set users.mobility=seated"),
        ),
        room(
            "seated-upright",
            "hall with seated users and orientation that the belief takes for upright",
            "The same; `control.tilt` states upright receivers.",
            in_room!(
                "hall",
                " --set users.orientation={} --set users.mobility=seated --set control.tilt={walking_deg=0.0,sitting_deg=0.0}"
            ),
        ),
        room(
            "typical",
            "hall with a typical mismatch",
            "Upright receivers; the true room differs from the known one.",
            in_room!("hall", " --set mismatch.level=typical"),
        ),
        room("rough", "hall with a rough mismatch", "The same, more.", in_room!("hall", " --set mismatch.level=rough")),
        other_room(
            "typical-orientation",
            "hall with a typical mismatch and unreported orientation",
            "Receivers at random angles; the true room differs from the known one.",
            in_room!("hall", " --set users.orientation={} --set mismatch.level=typical"),
        ),
        other_room(
            "rough-orientation",
            "hall with a rough mismatch and unreported orientation",
            "The same, more.",
            in_room!("hall", " --set users.orientation={} --set mismatch.level=rough"),
        ),
        other_room(
            "all",
            "hall with all of these",
            "Social force, unreported orientation and a rough mismatch.",
            in_room!(
                "hall",
                " --set users.mobility=social-force --set users.orientation={} --set mismatch.level=rough"
            ),
        ),
        known_room("office", "office", "A room, walks and two LEDs that training never has.", in_room!("office", "")),
        known_room("corridor", "corridor", "The same, for users who pass each other.", in_room!("corridor", "")),
        beside_specialised!("small", "small", "7 x 7 mirrors, unreported orientation", small!()),
        beside_specialised!("large", "large", "20 x 20 mirrors, unreported orientation", large!()),
        beside_specialised!("one-user", "one-user", "One user, unreported orientation", one_user!()),
        beside_specialised!("crowd", "crowd", "20 users, unreported orientation", crowd!()),
        beside_specialised!(
            "two-arrays",
            "two-arrays",
            "Two arrays on two walls, unreported orientation",
            two_arrays!()
        ),
        beside_specialised!("office", "one-office", "office, and an actor for it", "office"),
        beside_specialised!("corridor", "one-corridor", "corridor, and an actor for it", "corridor"),
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
        left_out!("random-waypoint", "random waypoint", WALK, ""),
        left_out!("pauses", "random waypoint with pauses", WALK, " --set users.pause_mean_s=3"),
        left_out!("random-direction", "random direction", WALK, " --set users.mobility=random-direction"),
        left_out!("gauss-markov", "Gauss-Markov", WALK, " --set users.mobility=gauss-markov"),
        left_out!("smooth-random", "smooth random", WALK, " --set users.mobility=smooth-random"),
        left_out!(
            "social-force",
            "social force",
            WALK,
            " --set users.mobility=social-force --set users.pause_mean_s=2"
        ),
        left_out!("seated", "seated users", WALK, " --set users.mobility=seated"),
        left_out!(
            "bodies",
            "mismatch of bodies",
            KIND,
            " --set mismatch.level=rough --set mismatch.kinds=[\"bodies\"]"
        ),
        left_out!(
            "tilt",
            "mismatch of tilt of the receivers",
            KIND,
            " --set mismatch.level=rough --set mismatch.kinds=[\"tilt\"]"
        ),
        left_out!(
            "mirrors",
            "mismatch of mirrors",
            KIND,
            " --set mismatch.level=rough --set mismatch.kinds=[\"mirrors\"]"
        ),
        left_out!("led", "mismatch of LED", KIND, " --set mismatch.level=rough --set mismatch.kinds=[\"led\"]"),
        left_out!(
            "receiver",
            "mismatch of received power",
            KIND,
            " --set mismatch.level=rough --set mismatch.kinds=[\"receiver\"]"
        ),
        left_out!(
            "floor",
            "mismatch of height of the floor",
            KIND,
            " --set mismatch.level=rough --set mismatch.kinds=[\"floor\"]"
        ),
        left_out!(
            "tracker",
            "mismatch of tracker",
            KIND,
            " --set mismatch.level=rough --set mismatch.kinds=[\"tracker\"]"
        ),
    ],
};
