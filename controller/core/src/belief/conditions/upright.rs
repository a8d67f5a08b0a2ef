//! Receivers that users tilt and that count as facing up, and the reverse.

use heliostat_channel::ChannelModel;
use heliostat_scenario::{Belief, MobilityModel, Scenario};

use super::walks;
use crate::belief::{
    HEADING_CERTAIN,
    heading::{self, Heading},
    occupancy::Occupancy,
    tilt,
};

/// The keys that say how receivers are held are absent.
const UNKNOWN: &str = "users.orientation, without accepted reports of streams.orientation and without control.tilt";

const ADVICE: &str = "every receiver counts as facing up; add the table [control.tilt], or report orientations";

/// The assumed tilt of receivers of several branches or of a narrow field of view has no effect on what their gains
/// show.
const ADVICE_TO_REPORT: &str = "every receiver counts as facing up; report orientations";

/// Gains show a tilt only while a heading is uncertain.
const ADVICE_TO_WALKING: &str = "every receiver counts as facing up until a heading is uncertain; add the table [control.tilt], or report orientations";

/// Position reports after which the certainty of a walk's heading no longer grows.
const WALK_REPORTS: usize = 200;

/// Why the receivers that users tilt count as facing up, and what to do; `None` where the controller knows how they
/// are held, or finds it by measured gains.
pub(super) fn counted_upright(scenario: &Scenario, model: &ChannelModel) -> Option<(String, &'static str)> {
    let control = &scenario.control;
    let is_reported = super::ages::accepted_orientations(scenario).is_some();
    if !scenario.has_tilted_receivers() || is_reported || control.tilt.is_some() {
        return None;
    }
    if control.belief != Belief::Filter {
        return Some((format!("{UNKNOWN}, and control.belief = \"{}\"", control.belief), ADVICE));
    }
    if !tilt::is_single_open_detector(model) {
        return Some((UNKNOWN.to_owned(), ADVICE_TO_REPORT));
    }
    if !scenario.blockage.bodies {
        return Some((UNKNOWN.to_owned(), ADVICE));
    }
    let speed_m_s = scenario.users.speed_min_m_s;
    let because = || {
        format!(
            "{UNKNOWN}, and all users walk at users.speed_min_m_s = {speed_m_s} or faster, among reported obstacles"
        )
    };
    is_heading_always_certain(scenario).then(|| (because(), ADVICE_TO_WALKING))
}

/// The key by which receivers that all face up count as tilted; `None` where some are tilted or their orientations are
/// reported.
pub(super) fn counted_tilted(scenario: &Scenario) -> Option<String> {
    let assumed = scenario.control.tilt?;
    if scenario.has_tilted_receivers() || super::ages::accepted_orientations(scenario).is_some() {
        return None;
    }
    let angles = [("walking", assumed.walking_deg), ("sitting", assumed.sitting_deg)];
    let (posture, angle_deg) = angles.into_iter().find(|(_, angle_deg)| *angle_deg > super::TILT_DIFFERENCE_DEG)?;
    Some(format!("control.tilt.{posture}_deg = {angle_deg}, and without users.orientation every receiver faces up"))
}

/// Whether no user stands and no map of obstacles is kept: the gains over the mirrors and the tilt are then evaluated
/// only while a heading is uncertain.
fn is_heading_always_certain(scenario: &Scenario) -> bool {
    let users = &scenario.users;
    let stands = users.pause_mean_s > 0.0 || walks::models(users).any(|model| model == MobilityModel::Seated);
    let interval_s = 1.0 / scenario.streams.positions.rate_hz;
    !stands
        && users.trace.is_none()
        && !Occupancy::is_needed(scenario)
        && is_heading_certain(users.speed_min_m_s, interval_s)
}

/// Whether a straight walk at this speed shows its heading, with reports at this interval.
fn is_heading_certain(speed_m_s: f64, interval_s: f64) -> bool {
    let (directions, mut heading) = (heading::directions(), Heading::default());
    (0..WALK_REPORTS).for_each(|_| heading.handle_velocity(interval_s, [speed_m_s, 0.0], &directions));
    heading.mean(&directions).norm() > HEADING_CERTAIN
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(overrides: &[&str]) -> Option<(String, &'static str)> {
        let scenario = Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap();
        counted_upright(&scenario, &scenario.channel_model().unwrap())
    }

    /// Users who walk fast enough to show where they face, in a room without obstacles.
    const WALKING: [&str; 3] = ["users.orientation={}", "blockage.obstacles_per_m2=0", "users.speed_min_m_s=0.5"];

    #[test]
    fn receivers_of_users_who_all_walk_count_as_facing_up() {
        let (because, consequence) = of(&WALKING).unwrap();
        assert!(because.contains("users.speed_min_m_s = 0.5 or faster"), "{because}");
        assert!(consequence.contains("until a heading is uncertain"), "{consequence}");
        let reported = ["users.orientation={}", "users.speed_min_m_s=0.5", "streams.obstacles.rate_hz=1"];
        assert!(of(&reported).is_some(), "reported obstacles need no map");
    }

    #[test]
    fn an_uncertain_heading_a_map_of_obstacles_and_a_known_tilt_let_the_belief_decide() {
        for change in [
            "users.speed_min_m_s=0.05",
            "users.pause_mean_s=2",
            "users.mobility=seated",
            "blockage.obstacles_per_m2=0.08",
            "control.tilt={}",
            "streams.orientation.rate_hz=10",
            "users.orientation.model=up",
            "users.trace=walk.csv",
        ] {
            assert_eq!(of(&[&WALKING[..], &[change]].concat()), None, "{change}");
        }
        assert_eq!(of(&WALKING[1..]), None, "no user tilts a receiver");
        let mixture = "users.mixture=[{mobility=\"seated\",count=1},{mobility=\"random-waypoint\",share=1}]";
        assert_eq!(of(&[&WALKING[..], &["users.mobility=mixture", mixture]].concat()), None, "one user sits");
    }

    #[test]
    fn receivers_that_face_up_count_as_tilted_by_the_assumed_angles() {
        let of =
            |overrides: &[&str]| counted_tilted(&Scenario::builtin("hall").unwrap().with_overrides(overrides).unwrap());
        let found = of(&["control.tilt={}"]).unwrap();
        assert!(found.starts_with("control.tilt.walking_deg = 29.67, and"), "{found}");
        let up = ["control.tilt.walking_deg=0", "control.tilt.sitting_deg=0"];
        for answer in [&up[..], &["control.tilt={}", "users.orientation={}"]] {
            assert_eq!(of(answer), None, "{answer:?}");
        }
        let reported = ["control.tilt={}", "streams.orientation.rate_hz=10"];
        assert_eq!([of(&[]), of(&reported)], [None, None]);
    }

    #[test]
    fn without_the_filter_no_gain_shows_a_tilt() {
        for belief in ["none", "constant-velocity"] {
            let belief = format!("control.belief={belief}");
            assert!(of(&["users.orientation={}", &belief]).unwrap().0.contains("and control.belief = "), "{belief}");
            assert_eq!(of(&["users.orientation={}", &belief, "control.tilt={}"]), None, "{belief}");
        }
    }

    #[test]
    fn a_walk_is_certain_from_a_speed_on_that_falls_with_the_rate_of_the_reports() {
        let slowest = |interval_s: f64| (1..100).find(|speed| is_heading_certain(0.01 * f64::from(*speed), interval_s));
        assert!(slowest(0.01).unwrap() < slowest(0.1).unwrap());
    }
}
