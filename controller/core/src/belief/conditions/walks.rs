//! Walks that the belief's model of motion does not cover.

use heliostat_scenario::{MobilityModel, Scenario, Users};

use crate::{belief::heading, observe::lead::Lead};

/// Standard deviations of a speed, which nearly all drawn ones are within.
const SPEED_DEVIATIONS: f64 = 3.0;

/// Standard deviations of a heading, which 95 % of the believed ones are within.
const HEADING_DEVIATIONS: f64 = 2.0;

/// The models of the users.
pub(super) fn models(users: &Users) -> impl Iterator<Item = MobilityModel> {
    let is_mixed = users.mobility == MobilityModel::Mixture;
    let mixture = if is_mixed { users.mixture.as_slice() } else { &[] };
    mixture.iter().map(|entry| entry.mobility).chain((!is_mixed).then_some(users.mobility))
}

/// The largest speed of a walk in m/s; `None` where all users sit, and for a recorded walk.
fn fastest_m_s(users: &Users) -> Option<f64> {
    let of_model = |model: MobilityModel| match model {
        MobilityModel::Seated => None,
        MobilityModel::SocialForce => {
            let forces = &users.social_force;
            let desired_m_s = forces.desired_speed_m_s + SPEED_DEVIATIONS * forces.desired_speed_std_m_s;
            Some(desired_m_s.clamp(users.speed_min_m_s, users.speed_max_m_s))
        }
        _ => Some(users.speed_max_m_s),
    };
    models(users).filter(|_| users.trace.is_none()).filter_map(of_model).reduce(f64::max)
}

/// The keys by which a user walks farther than the belief expects after a change, until a command follows the next
/// report.
///
/// A walk at the speed v covers v t in the interval and the latency t of the reports. The belief covers three standard
/// deviations: 3 sqrt((s t)^2 + noise^2), with s = `control.walk.speed_m_s`.
pub(super) fn too_fast(scenario: &Scenario) -> Option<String> {
    let (positions, assumed_m_s) = (&scenario.streams.positions, scenario.control.walk.speed_m_s);
    let fastest_m_s = fastest_m_s(&scenario.users)?;
    let time_s = 1.0 / positions.rate_hz + 1e-3 * positions.latency_ms;
    let covered_m = SPEED_DEVIATIONS * (assumed_m_s * time_s).hypot(positions.noise_m);
    let walked_m = fastest_m_s * time_s;
    (walked_m > covered_m).then(|| {
        format!(
            "users walk at up to {fastest_m_s:.2} m/s, {walked_m:.2} m in the interval and the latency of streams.positions, and control.walk.speed_m_s = {assumed_m_s} covers {covered_m:.2} m"
        )
    })
}

/// The keys by which changes of a walk that no report has shown yet move a user out of the light.
///
/// The prediction over the lead L has no change. A user stops within it with the probability P = 1 - exp(-c L), c =
/// `control.walk.changes_per_s`, at a time that is uniform over it. The root mean square error is v L sqrt(P / 3). It is
/// compared with the shortest side of a mirror, whose light is wider, and with the noise of the reports.
pub(super) fn too_far_ahead(scenario: &Scenario) -> Option<String> {
    let (positions, control) = (&scenario.streams.positions, &scenario.control);
    if super::ages::refused_positions(scenario).is_some() {
        return None;
    }
    let lead_s = Lead::new(1.0 / positions.rate_hz).ahead_s(1e-3 * positions.latency_ms);
    let change = -(-control.walk.changes_per_s * lead_s).exp_m1();
    let error_m = fastest_m_s(&scenario.users)? * lead_s * (change / 3.0).sqrt();
    let sides = scenario.mirrors.arrays().iter().flat_map(|array| [array.width_m, array.height_m]);
    let covered_m = sides.fold(f64::INFINITY, f64::min).max(positions.noise_m);
    (error_m > covered_m).then(|| {
        format!(
            "streams.positions.rate_hz = {} and latency_ms = {}: a user is predicted {:.0} ms ahead, in which unreported stops displace the fastest one by {error_m:.2} m (root mean square)",
            positions.rate_hz,
            positions.latency_ms,
            1e3 * lead_s
        )
    })
}

/// The key by which users face elsewhere than the belief assumes, by more than two of its standard deviations.
///
/// On a curve with the turn rate w, a heading that follows with the time constant t is behind by w t, and so is one
/// that a report shows later by t than the positions.
pub(super) fn late_heading(scenario: &Scenario) -> Option<String> {
    let (users, streams) = (&scenario.users, &scenario.streams);
    if !scenario.blockage.bodies && !scenario.has_tilted_receivers() {
        return None;
    }
    let of_model = |model: MobilityModel| match model {
        MobilityModel::Seated => 0.0,
        MobilityModel::SmoothRandom => users.smooth_random.turn_rate_deg_per_s,
        _ => scenario.control.walk.turn_rate_deg_per_s,
    };
    let turn_deg_per_s = models(users).map(of_model).fold(0.0, f64::max);
    let lag_s = if users.trace.is_none() { users.heading_lag_s } else { 0.0 };
    let reported_ms = super::ages::accepted_orientations(scenario).map_or(0.0, |stream| stream.latency_ms);
    let later_s = 1e-3 * (reported_ms - streams.positions.latency_ms);
    let spread_deg = heading::walk_spread_rad().to_degrees();
    let lags = [
        (format!("users.heading_lag_s = {lag_s}"), lag_s),
        (format!("streams.orientation.latency_ms = {reported_ms}"), later_s),
    ];
    let is_late = |(_, lag_s): &(String, f64)| turn_deg_per_s * lag_s > HEADING_DEVIATIONS * spread_deg;
    let (key, lag_s) = lags.into_iter().find(is_late)?;
    let behind_deg = turn_deg_per_s * lag_s;
    Some(format!(
        "{key}: {behind_deg:.1} degrees behind a curve of {turn_deg_per_s} degrees/s, and the belief assumes a standard deviation of {spread_deg:.1} degrees"
    ))
}

#[cfg(test)]
mod tests {
    use heliostat_scenario::BUILTIN_NAMES;

    use super::*;

    fn with(name: &str, overrides: &[&str]) -> Scenario {
        Scenario::builtin(name).unwrap().with_overrides(overrides).unwrap()
    }

    #[test]
    fn the_walks_of_the_builtin_rooms_are_covered() {
        for name in BUILTIN_NAMES {
            let scenario = Scenario::builtin(name).unwrap();
            let found = [too_fast(&scenario), too_far_ahead(&scenario), late_heading(&scenario)];
            assert_eq!(found, [None, None, None], "{name}");
        }
    }

    #[test]
    fn a_speed_is_covered_up_to_three_standard_deviations_of_speed_and_noise() {
        let hall = with("hall", &[]);
        let (positions, walk) = (&hall.streams.positions, &hall.control.walk);
        let time_s = 1.0 / positions.rate_hz + 1e-3 * positions.latency_ms;
        let limit_m_s = 3.0 * (walk.speed_m_s.powi(2) + (positions.noise_m / time_s).powi(2)).sqrt();
        let at = |speed_m_s: f64, more: &[&str]| {
            let speed = format!("users.speed_max_m_s={speed_m_s}");
            too_fast(&with("hall", &[&[speed.as_str()][..], more].concat()))
        };
        assert_eq!(at(limit_m_s - 0.01, &[]), None);
        let found = at(limit_m_s + 0.01, &[]).unwrap();
        assert!(found.contains("control.walk.speed_m_s = 0.8 covers"), "{found}");
        let answers =
            ["control.walk.speed_m_s=1", "users.mobility=seated", "users.mobility=social-force", "users.trace=a.csv"];
        for answer in answers {
            assert_eq!(at(limit_m_s + 0.01, &[answer]), None, "{answer}");
        }
        assert!(at(limit_m_s + 0.01, &["streams.positions.noise_m=0"]).is_some());
        assert_eq!(at(limit_m_s + 0.01, &["streams.positions.rate_hz=20"]), None, "more of it is noise");
    }

    #[test]
    fn a_stop_is_covered_while_the_light_of_a_mirror_or_the_noise_is_wider_than_its_error() {
        let hall = with("hall", &[]);
        let (walk, shape) = (&hall.control.walk, hall.mirrors.first());
        let speed_m_s = hall.users.speed_max_m_s;
        let error_m = |lead_s: f64| speed_m_s * lead_s * ((1.0 - (-walk.changes_per_s * lead_s).exp()) / 3.0).sqrt();
        let side_m = shape.width_m.min(shape.height_m);
        // The first lead, in steps of 10 ms, whose error is larger.
        let lead_s = (1..1000).map(|step| 0.01 * f64::from(step)).find(|lead_s| error_m(*lead_s) > side_m).unwrap();
        let latency_ms = |lead_s: f64| 1e3 * lead_s - 500.0 / hall.streams.positions.rate_hz;
        let at = |lead_s: f64, more: &[&str]| {
            let latency = format!("streams.positions.latency_ms={}", latency_ms(lead_s));
            too_far_ahead(&with("hall", &[&[latency.as_str()][..], more].concat()))
        };
        assert_eq!(at(lead_s - 0.011, &[]), None);
        let found = at(lead_s + 0.001, &[]).unwrap();
        assert!(found.contains(&format!("latency_ms = {}: ", latency_ms(lead_s + 0.001))), "{found}");
        let answers = ["users.speed_max_m_s=0.5", "control.walk.changes_per_s=0.1", "mirrors.height_m=0.15"];
        for answer in answers.into_iter().chain(["streams.positions.noise_m=0.2", "users.mobility=seated"]) {
            assert_eq!(at(lead_s + 0.001, &[answer]), None, "{answer}");
        }
        assert_eq!(at(lead_s + 0.001, &["control.report_age_max_ms=50"]), None, "no command is sent");
        assert!(too_far_ahead(&with("hall", &["streams.positions.rate_hz=1"])).is_some());
    }

    #[test]
    fn a_heading_is_late_where_it_turns_by_more_than_two_standard_deviations_in_its_lag() {
        let hall = with("hall", &[]);
        let spread_deg = heading::walk_spread_rad().to_degrees();
        let limit_s = 2.0 * spread_deg / hall.control.walk.turn_rate_deg_per_s;
        let at = |lag_s: f64, more: &[&str]| {
            let lag = format!("users.heading_lag_s={lag_s}");
            late_heading(&with("hall", &[&[lag.as_str()][..], more].concat()))
        };
        assert_eq!(at(limit_s - 0.001, &[]), None);
        let found = at(limit_s + 0.001, &[]).unwrap();
        assert!(found.contains("behind a curve of 45 degrees/s"), "{found}");
        for answer in ["users.mobility=seated", "blockage.bodies=false", "users.trace=a.csv"] {
            assert_eq!(at(limit_s + 0.001, &[answer]), None, "{answer}");
        }
        assert!(at(limit_s + 0.001, &["blockage.bodies=false", "users.orientation={}"]).is_some());
        let twice = format!("users.smooth_random.turn_rate_deg_per_s={}", 2.0 * hall.control.walk.turn_rate_deg_per_s);
        assert!(at(0.6 * limit_s, &["users.mobility=smooth-random", &twice]).is_some());
    }

    #[test]
    fn an_orientation_report_is_late_by_what_it_comes_after_the_positions() {
        let hall = with("hall", &[]);
        let spread_deg = heading::walk_spread_rad().to_degrees();
        let limit_ms = 2e3 * spread_deg / hall.control.walk.turn_rate_deg_per_s + hall.streams.positions.latency_ms;
        let at =
            |latency_ms: f64| late_heading(&with("hall", &[&format!("streams.orientation.latency_ms={latency_ms}")]));
        assert_eq!(at(limit_ms - 1.0), None);
        let found = at(limit_ms + 1.0).unwrap();
        assert!(found.starts_with("streams.orientation.latency_ms = "), "{found}");
    }
}
