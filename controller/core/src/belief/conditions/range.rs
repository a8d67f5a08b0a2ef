//! Places that the mirrors cannot light within their range.

use heliostat_channel::ChannelModel;
use heliostat_scenario::{ChannelMode, RANGE_DEG, Scenario};

use crate::{
    capabilities::{Examiner, Force},
    safety::Limits,
};

/// A range within which some of the floor gets no light by any mirror.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct SmallRange {
    /// The key of the range, with its value and the share of the floor that mirrors reach.
    pub because: String,
    /// What changes it.
    pub advice: String,
}

/// The smaller range of command and axes, where mirrors do not reach all of the floor within it.
pub(super) fn too_small(scenario: &Scenario, model: &ChannelModel) -> Option<SmallRange> {
    // The angles of the paper's equations aim no real mirror.
    if scenario.channel.mode != ChannelMode::Specular {
        return None;
    }
    let commanded = ("control.range_deg", Limits::new(&scenario.control).range_rad());
    let mechanical = ("actuator.range_deg", scenario.actuator.parameters().range_rad);
    let (key, range_rad) = if mechanical.1 < commanded.1 { mechanical } else { commanded };
    let examiner = Examiner::new(scenario, model, Force::default());
    let share = examiner.reach_of_all(range_rad);
    // Rounded down, so that a part of the floor is not 100 %.
    let (range_deg, percent) = (range_rad.to_degrees(), (share * 100.0).floor());
    (share < 1.0).then(|| SmallRange {
        because: format!("{key} = {range_deg:.1}, within which mirrors reach {percent} % of the floor"),
        advice: match sufficient_deg(&examiner) {
            Some(sufficient_deg) => {
                let smaller = [commanded, mechanical].into_iter().filter(|(_, rad)| rad.to_degrees() < sufficient_deg);
                let keys: Vec<&str> = smaller.map(|(key, _)| key).collect();
                let keys = keys.join(" and ");
                format!("set {keys} to {sufficient_deg} where the mirrors turn as far, or move the mirrors or the LEDs")
            }
            None => "no range reaches all of the floor: move the mirrors or the LEDs, or add an array on another wall"
                .into(),
        },
    })
}

/// The smallest range in whole degrees within which mirrors reach all of the floor; `None` if there is none.
fn sufficient_deg(examiner: &Examiner) -> Option<f64> {
    let reaches_all = |range_deg: u32| examiner.reach_of_all(f64::from(range_deg).to_radians()) >= 1.0;
    let (mut too_small, mut sufficient) = (0, *RANGE_DEG.end() as u32);
    if !reaches_all(sufficient) {
        return None;
    }
    while too_small + 1 < sufficient {
        let middle = u32::midpoint(too_small, sufficient);
        if reaches_all(middle) { sufficient = middle } else { too_small = middle }
    }
    Some(sufficient.into())
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::BUILTIN_NAMES;

    use super::*;

    fn found(scenario: &Scenario) -> Option<String> {
        Some(too_small(scenario, &scenario.channel_model().unwrap())?.because)
    }

    fn hall(overrides: &[&str]) -> Option<String> {
        found(&Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap())
    }

    /// The shares are those of a script that shares no code with this crate.
    #[test]
    fn the_rooms_with_a_shortfall_are_named_with_the_share_of_their_floor() {
        let of_room = |name| Some((name, found(&Scenario::builtin(name).unwrap())?));
        let builtin: Vec<(&str, String)> = BUILTIN_NAMES.into_iter().filter_map(of_room).collect();
        let expected = "control.range_deg = 60.0, within which mirrors reach 48 % of the floor".to_owned();
        assert_eq!(builtin, [("corridor", expected)]);
        let studio = Scenario::from_toml(include_str!("../../../../../deploy/rooms/studio.toml")).unwrap();
        let expected = "control.range_deg = 12.0, within which mirrors reach 86 % of the floor";
        assert_eq!(found(&studio).as_deref(), Some(expected));
    }

    #[test]
    fn the_smaller_of_both_ranges_decides_and_the_angles_of_the_paper_have_none() {
        for key in ["control.range_deg", "actuator.range_deg"] {
            let change = format!("{key}=10");
            let found = hall(&[&change]).unwrap();
            assert!(found.starts_with(&format!("{key} = 10.0, ")), "{found}");
            assert_eq!(hall(&[&change, "channel.mode=paper"]), None);
        }
        assert_eq!(hall(&["control.range_deg=30"]), None, "some mirror reaches each place");
    }

    #[test]
    fn the_advice_names_each_key_and_the_smallest_range_that_suffices() {
        let of = |overrides: &[&str]| {
            let scenario = Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap();
            too_small(&scenario, &scenario.channel_model().unwrap()).unwrap().advice
        };
        let sufficient = |advice: &str, keys: &str| -> u32 {
            let rest = advice.strip_prefix(keys).unwrap_or_else(|| panic!("{advice}"));
            rest.split_whitespace().next().unwrap().parse().unwrap()
        };
        let least = sufficient(&of(&["control.range_deg=10"]), "set control.range_deg to ");
        assert!((11..=30).contains(&least), "{least}");
        let key = |range_deg: u32| format!("control.range_deg={range_deg}");
        assert!(hall(&[&key(least)]).is_none() && hall(&[&key(least - 1)]).is_some(), "{least}");
        let both = of(&["control.range_deg=10", "actuator.range_deg=8"]);
        assert_eq!(sufficient(&both, "set control.range_deg and actuator.range_deg to "), least);
    }

    #[test]
    fn the_mirrors_of_another_wall_reach_more_of_the_floor() {
        let small = "control.range_deg=10";
        let share = |walls: &str| {
            let found = hall(&[small, walls]).unwrap();
            found.split_whitespace().rev().nth(4).unwrap().parse::<u32>().unwrap()
        };
        let [one, two] = ["mirrors=[{rows=10}]", "mirrors=[{rows=10},{rows=10,wall=\"-x\"}]"].map(share);
        assert!(one < two, "{one} {two}");
    }
}
