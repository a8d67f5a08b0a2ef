//! Places that the mirrors cannot light within their range.

use heliostat_channel::ChannelModel;
use heliostat_scenario::{ChannelMode, Scenario};

use crate::{
    capabilities::{Examiner, Force},
    safety::Limits,
};

/// The key of a range within which some of the floor gets no light by any mirror, with the share that does.
pub(super) fn too_small(scenario: &Scenario, model: &ChannelModel) -> Option<String> {
    // The angles of the paper's equations aim no real mirror.
    if scenario.channel.mode != ChannelMode::Specular {
        return None;
    }
    let commanded = ("control.range_deg", Limits::new(&scenario.control).range_rad());
    let mechanical = ("actuator.range_deg", scenario.actuator.parameters().range_rad);
    let (key, range_rad) = if mechanical.1 < commanded.1 { mechanical } else { commanded };
    let share = Examiner::new(scenario, model, Force::default()).reach_of_all(range_rad);
    // Rounded down, so that a part of the floor is not 100 %.
    let (range_deg, percent) = (range_rad.to_degrees(), (share * 100.0).floor());
    (share < 1.0).then(|| format!("{key} = {range_deg:.1}, within which mirrors reach {percent} % of the floor"))
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::BUILTIN_NAMES;

    use super::*;

    fn found(scenario: &Scenario) -> Option<String> {
        too_small(scenario, &scenario.channel_model().unwrap())
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
