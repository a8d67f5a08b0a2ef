//! The training runs of the page `learning`.

use super::super::page::Training;

/// A run in one scenario, in place of rooms that are drawn around it.
macro_rules! for_one_room {
    ($name:literal, $room:expr) => {
        Training {
            name: concat!("for-", $name),
            command: concat!("train residual --option scenario_only=true --episodes 30 --scenario ", $room),
        }
    };
}

/// The training runs whose actors the page evaluates, all with training seed 1.
pub static TRAININGS: [Training; 28] = [
    Training { name: "analytic", command: "train residual --scenario hall --fine-tune analytic" },
    Training { name: "ddpg", command: "train residual --scenario hall --fine-tune ddpg" },
    Training { name: "episodes-10", command: "train residual --scenario hall --episodes 10" },
    Training { name: "episodes-30", command: "train residual --scenario hall --episodes 30" },
    Training {
        name: "without-residuals",
        command: "train residual --scenario hall --option without=residuals --episodes 10",
    },
    Training {
        name: "without-history",
        command: "train residual --scenario hall --option without=history --episodes 10",
    },
    Training {
        name: "without-neighbours",
        command: "train residual --scenario hall --option without=neighbours --episodes 10",
    },
    Training {
        name: "without-random-waypoint",
        command: "train residual --scenario hall --option walks=[\"pauses\",\"random-direction\",\"gauss-markov\",\"smooth-random\",\"social-force\",\"seated\"] --episodes 10",
    },
    Training {
        name: "without-pauses",
        command: "train residual --scenario hall --option walks=[\"random-waypoint\",\"random-direction\",\"gauss-markov\",\"smooth-random\",\"social-force\",\"seated\"] --episodes 10",
    },
    Training {
        name: "without-random-direction",
        command: "train residual --scenario hall --option walks=[\"random-waypoint\",\"pauses\",\"gauss-markov\",\"smooth-random\",\"social-force\",\"seated\"] --episodes 10",
    },
    Training {
        name: "without-gauss-markov",
        command: "train residual --scenario hall --option walks=[\"random-waypoint\",\"pauses\",\"random-direction\",\"smooth-random\",\"social-force\",\"seated\"] --episodes 10",
    },
    Training {
        name: "without-smooth-random",
        command: "train residual --scenario hall --option walks=[\"random-waypoint\",\"pauses\",\"random-direction\",\"gauss-markov\",\"social-force\",\"seated\"] --episodes 10",
    },
    Training {
        name: "without-social-force",
        command: "train residual --scenario hall --option walks=[\"random-waypoint\",\"pauses\",\"random-direction\",\"gauss-markov\",\"smooth-random\",\"seated\"] --episodes 10",
    },
    Training {
        name: "without-seated",
        command: "train residual --scenario hall --option walks=[\"random-waypoint\",\"pauses\",\"random-direction\",\"gauss-markov\",\"smooth-random\",\"social-force\"] --episodes 10",
    },
    Training {
        name: "without-bodies",
        command: "train residual --scenario hall --option mismatch=[\"tilt\",\"mirrors\",\"led\",\"receiver\",\"floor\",\"tracker\"] --episodes 10",
    },
    Training {
        name: "without-tilt",
        command: "train residual --scenario hall --option mismatch=[\"bodies\",\"mirrors\",\"led\",\"receiver\",\"floor\",\"tracker\"] --episodes 10",
    },
    Training {
        name: "without-mirrors",
        command: "train residual --scenario hall --option mismatch=[\"bodies\",\"tilt\",\"led\",\"receiver\",\"floor\",\"tracker\"] --episodes 10",
    },
    Training {
        name: "without-led",
        command: "train residual --scenario hall --option mismatch=[\"bodies\",\"tilt\",\"mirrors\",\"receiver\",\"floor\",\"tracker\"] --episodes 10",
    },
    Training {
        name: "without-receiver",
        command: "train residual --scenario hall --option mismatch=[\"bodies\",\"tilt\",\"mirrors\",\"led\",\"floor\",\"tracker\"] --episodes 10",
    },
    Training {
        name: "without-floor",
        command: "train residual --scenario hall --option mismatch=[\"bodies\",\"tilt\",\"mirrors\",\"led\",\"receiver\",\"tracker\"] --episodes 10",
    },
    Training {
        name: "without-tracker",
        command: "train residual --scenario hall --option mismatch=[\"bodies\",\"tilt\",\"mirrors\",\"led\",\"receiver\",\"floor\"] --episodes 10",
    },
    for_one_room!("small", small!()),
    for_one_room!("large", large!()),
    for_one_room!("one-user", one_user!()),
    for_one_room!("crowd", crowd!()),
    for_one_room!("two-arrays", two_arrays!()),
    for_one_room!("office", "office"),
    for_one_room!("corridor", "corridor"),
];
