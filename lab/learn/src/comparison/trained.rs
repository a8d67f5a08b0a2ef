//! The actors of several training seeds: that of seed 1 is the program's own, and those of other
//! seeds, which only a comparison needs, are in `lab/actors`.

use heliostat_core::policy::{PolicyKind, actor_file::ActorFile};
use heliostat_models::{ActorSource, shipped};
use heliostat_scenario::Scenario;

include!(concat!(env!("OUT_DIR"), "/actors.rs"));

/// Largest training seed of an actor.
const SEEDS_MAX: u32 = 10;

/// The training seeds with an actor for a scenario, in ascending order.
pub(super) fn seeds(policy: PolicyKind, scenario: &Scenario) -> Vec<u32> {
    let exists = |seed: &u32| {
        let expected = shipped::file_name(policy, scenario, u64::from(*seed));
        shipped::names().chain(names()).any(|name| name == expected)
    };
    (1..=SEEDS_MAX).filter(exists).collect()
}

/// The actor of a training seed. One that does not exist is refused where it is read.
pub(super) fn source(policy: PolicyKind, scenario: &Scenario, seed: u32) -> ActorSource {
    let expected = shipped::file_name(policy, scenario, u64::from(seed));
    match ACTORS.iter().find(|(name, _)| *name == expected) {
        Some((name, bytes)) => {
            ActorSource::Bytes(ActorFile { origin: format!("lab/actors/{name}"), bytes: (*bytes).into() })
        }
        None => ActorSource::ShippedSeed(seed),
    }
}

fn names() -> impl Iterator<Item = &'static str> {
    ACTORS.iter().map(|(name, _)| *name)
}

#[cfg(test)]
mod tests {
    use heliostat_core::policy::Finding;
    use heliostat_models::build_tried;

    use super::*;

    #[test]
    fn every_actor_fits_a_room_and_agrees_with_the_reference() {
        use PolicyKind::{Analytic, Ddpg, DdpgRaw, Dql, QLearning, Sarsa};
        let mut tried = 0;
        for mode in ["specular", "paper-calibrated"] {
            let scenario = Scenario::builtin(mode).expect("built in");
            for kind in [Ddpg, DdpgRaw, Analytic, Dql, QLearning, Sarsa] {
                for seed in seeds(kind, &scenario).into_iter().filter(|seed| *seed > 1) {
                    let actor = source(kind, &scenario, seed);
                    assert!(matches!(actor, ActorSource::Bytes(_)), "{kind:?} {mode} {seed}");
                    let (_, findings) = build_tried(kind, &scenario, &actor).expect("it fits");
                    let differs = |finding: &Finding| format!("{finding:?}").contains("reference");
                    assert!(!findings.iter().any(differs), "{kind:?} {mode} {seed}: {findings:?}");
                    tried += 1;
                }
            }
        }
        assert_eq!(tried, names().count());
    }
}
