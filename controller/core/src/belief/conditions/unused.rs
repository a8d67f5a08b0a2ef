//! Keys that a scenario sets to no effect, because another key replaces them or excludes their use.

use heliostat_scenario::{
    ChannelMode, Mismatch, MismatchLevel, MobilityModel, NoiseBudget, Receiver, ReceiverPreset, Scenario, Streams,
    Users,
};

use super::{Condition, walks};

/// The keys of a scenario that are not at their defaults and change nothing.
pub fn unused_keys(scenario: &Scenario) -> Vec<Condition> {
    let of_mismatch = of_mismatch(&scenario.mismatch).into_iter().collect();
    let users = &scenario.users;
    let of_streams = of_streams(&scenario.streams);
    [of_users(users), of_walks(users), of_tables(users), of_link(scenario), of_streams, of_mismatch].concat()
}

fn unused(key: &str, because: impl Into<String>, consequence: impl Into<String>) -> Condition {
    Condition { method: key.into(), because: because.into(), consequence: consequence.into() }
}

/// Lists of users that their model does not read.
fn of_users(users: &Users) -> Vec<Condition> {
    let is_mixed = users.mobility == MobilityModel::Mixture;
    let is_seated = |model: MobilityModel| model == MobilityModel::Seated;
    let some_sit = is_seated(users.mobility) || users.mixture.iter().any(|entry| is_seated(entry.mobility));
    let mixture = (!users.mixture.is_empty() && !is_mixed).then(|| {
        unused(
            "users.mixture",
            "users.mobility is another model",
            "all users walk by that model; set users.mobility to \"mixture\"",
        )
    });
    let seats = (!users.seats_m.is_empty() && !some_sit).then(|| {
        unused(
            "users.seats_m",
            "no user of users.mobility or users.mixture is seated",
            "the places have no effect; set users.mobility to \"seated\", or to \"mixture\" with an entry \"seated\" in users.mixture",
        )
    });
    let has_own = is_mixed && users.mixture.iter().any(|entry| entry.orientation.is_some());
    let of_entries = (has_own && users.trace.is_some()).then(|| {
        unused(
            "orientation in users.mixture",
            "users.trace replaces the models",
            "all users hold their receivers as in users.orientation; set users.orientation",
        )
    });
    let is_replaced = users.orientations().iter().all(|(key, _)| key != "users.orientation");
    let of_room = (users.orientation.is_some() && is_replaced).then(|| {
        unused(
            "users.orientation",
            "each entry of users.mixture has an orientation of its own",
            "the table has no effect; remove it, or the orientation of an entry",
        )
    });
    mixture.into_iter().chain(seats).chain(of_entries).chain(of_room).collect()
}

/// Keys of walks that no model of the users reads.
fn of_walks(users: &Users) -> Vec<Condition> {
    let default = Users::default();
    let is_read = |reads: fn(MobilityModel) -> bool| users.trace.is_none() && walks::models(users).any(reads);
    let moves = |model: MobilityModel| model != MobilityModel::Seated;
    let pauses = |model: MobilityModel| {
        use MobilityModel::{RandomDirection, RandomWaypoint, SocialForce};
        matches!(model, RandomDirection | RandomWaypoint | SocialForce)
    };
    let keys = [
        ("users.speed_min_m_s", users.speed_min_m_s != default.speed_min_m_s, is_read(moves)),
        ("users.speed_max_m_s", users.speed_max_m_s != default.speed_max_m_s, is_read(moves)),
        ("users.pause_mean_s", users.pause_mean_s != default.pause_mean_s, is_read(pauses)),
        // Users who sit turn, and their headings follow.
        ("users.heading_lag_s", users.heading_lag_s != default.heading_lag_s, users.trace.is_none()),
    ];
    let because = if users.trace.is_none() { "no model of a user reads it" } else { "users.trace replaces the models" };
    let unread = keys.into_iter().filter(|(_, is_set, is_read)| *is_set && !is_read);
    unread.map(|(key, ..)| unused(key, because, "the key has no effect; remove it, or choose another model")).collect()
}

/// Keys of losses and of the converter that need another key.
fn of_streams(Streams { positions, channel, .. }: &Streams) -> Vec<Condition> {
    let bursts = [
        ("streams.positions", positions.loss, positions.loss_burst_reports),
        ("streams.channel", channel.loss, channel.loss_burst_reports),
    ];
    let unread = bursts.into_iter().filter(|(_, loss, burst)| *loss == 0.0 && *burst != 0.0).map(|(table, ..)| {
        let (key, because) = (format!("{table}.loss_burst_reports"), format!("{table}.loss = 0"));
        unused(&key, because, "no report is lost; set the probability of a loss, or remove the key")
    });
    let full_scale = (channel.resolution_bits == 0 && channel.full_scale_gain != 0.0).then(|| {
        unused(
            "streams.channel.full_scale_gain",
            "streams.channel.resolution_bits = 0",
            "gains have no steps and no largest value; set resolution_bits, or remove the key",
        )
    });
    unread.chain(full_scale).collect()
}

/// Parts of the room that would differ from the model.
fn of_mismatch(mismatch: &Mismatch) -> Option<Condition> {
    (mismatch.level == MismatchLevel::None && !mismatch.kinds.is_empty()).then(|| {
        unused(
            "mismatch.kinds",
            "mismatch.level = \"none\"",
            "the room is the model; set mismatch.level to \"typical\" or \"rough\"",
        )
    })
}

/// Tables of models of movement that no user has.
fn of_tables(users: &Users) -> Vec<Condition> {
    let default = Users::default();
    let tables = [
        (
            "users.random_direction",
            "random-direction",
            MobilityModel::RandomDirection,
            users.random_direction != default.random_direction,
        ),
        ("users.gauss_markov", "gauss-markov", MobilityModel::GaussMarkov, users.gauss_markov != default.gauss_markov),
        (
            "users.smooth_random",
            "smooth-random",
            MobilityModel::SmoothRandom,
            users.smooth_random != default.smooth_random,
        ),
        ("users.social_force", "social-force", MobilityModel::SocialForce, users.social_force != default.social_force),
        ("users.seated", "seated", MobilityModel::Seated, users.seated != default.seated),
    ];
    let is_used = |of: MobilityModel| users.trace.is_none() && walks::models(users).any(|model| model == of);
    let unread = tables.into_iter().filter(|(_, _, model, is_set)| *is_set && !is_used(*model));
    let because = if users.trace.is_none() { "no user has this model" } else { "users.trace replaces the model" };
    let condition = |(key, name, ..): (&str, &str, MobilityModel, bool)| {
        unused(key, because, format!("the table has no effect; remove it, or let users walk by the model \"{name}\""))
    };
    unread.map(condition).collect()
}

/// Keys of receiver, noise and channel that another key replaces.
fn of_link(Scenario { receiver, noise, channel, .. }: &Scenario) -> Vec<Condition> {
    let default = Receiver::default();
    let is_replaced = receiver.preset != ReceiverPreset::Single || !receiver.branches.is_empty();
    let field = (is_replaced && receiver.fov_deg != default.fov_deg).then(|| {
        unused(
            "receiver.fov_deg",
            "receiver.preset or receiver.branches has fields of view of its own",
            "the key has no effect; set fov_deg of each entry of receiver.branches",
        )
    });
    let index = (!receiver.concentrator && receiver.concentrator_index != default.concentrator_index).then(|| {
        unused(
            "receiver.concentrator_index",
            "receiver.concentrator = false",
            "the key has no effect; set receiver.concentrator to true",
        )
    });
    let has_terms = NoiseBudget { variance_a2: None, ..noise.clone() } != NoiseBudget::default();
    let terms = (has_terms && noise.variance_a2.is_some()).then(|| {
        unused(
            "the sum of the terms of noise",
            "noise.variance_a2 replaces it",
            "the terms have no effect; remove noise.variance_a2, or the terms",
        )
    });
    let literal = (channel.literal && channel.mode == ChannelMode::Specular).then(|| {
        unused(
            "channel.literal",
            "channel.mode = \"specular\"",
            "the law of reflection has one interpretation; set channel.mode to \"paper\" or \"paper-calibrated\"",
        )
    });
    [field, index, terms, literal].into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_is_set_to_no_effect_is_named_and_a_key_that_is_used_is_not() {
        let of = |changes: &[&str]| {
            let changes = [&["users.count=1"][..], changes].concat();
            let scenario =
                Scenario::builtin("hall").and_then(|hall| hall.with_overrides(&changes)).expect("a scenario");
            unused_keys(&scenario).into_iter().map(|condition| condition.method).collect::<Vec<_>>()
        };
        assert_eq!(of(&[]), [""; 0]);
        let seated = "users.mobility=seated";
        for (change, key, use_of_it) in [
            ("users.mixture=[{mobility=\"seated\",share=1}]", "users.mixture", "users.mobility=mixture"),
            ("users.seats_m=[[1,1]]", "users.seats_m", seated),
            ("users.seated.turn_mean_s=5", "users.seated", seated),
            ("users.gauss_markov.memory=0.5", "users.gauss_markov", "users.mobility=gauss-markov"),
            ("users.smooth_random.turn_rate_deg_per_s=45", "users.smooth_random", "users.mobility=smooth-random"),
            ("users.social_force.sight_deg=180", "users.social_force", "users.mobility=social-force"),
            (
                "users.random_direction.travel_time_mean_s=2",
                "users.random_direction",
                "users.mobility=random-direction",
            ),
            ("receiver.concentrator_index=1.7", "receiver.concentrator_index", "receiver.concentrator=true"),
            ("channel.literal=true", "channel.literal", "channel.mode=paper"),
            ("mismatch.kinds=[\"led\"]", "mismatch.kinds", "mismatch.level=rough"),
            (
                "streams.positions.loss_burst_reports=5",
                "streams.positions.loss_burst_reports",
                "streams.positions.loss=0.1",
            ),
            (
                "streams.channel.full_scale_gain=2e-5",
                "streams.channel.full_scale_gain",
                "streams.channel.resolution_bits=10",
            ),
        ] {
            assert_eq!(of(&[change]), [key], "{change}");
            assert_eq!(of(&[change, use_of_it]), [""; 0], "{change} {use_of_it}");
        }
        for (change, excluding, key) in [
            ("receiver.fov_deg=40", "receiver.preset=angle-diversity", "receiver.fov_deg"),
            ("noise.thermal_a2_per_hz=1e-23", "noise.variance_a2=1e-15", "the sum of the terms of noise"),
            ("users.speed_max_m_s=1", seated, "users.speed_max_m_s"),
            ("users.speed_min_m_s=0.5", "users.trace=walk.csv", "users.speed_min_m_s"),
            ("users.pause_mean_s=2", "users.mobility=gauss-markov", "users.pause_mean_s"),
            ("users.heading_lag_s=1", "users.trace=walk.csv", "users.heading_lag_s"),
        ] {
            assert_eq!([of(&[change]), of(&[excluding])], [[""; 0], [""; 0]], "{change}");
            assert_eq!(of(&[change, excluding]), [key], "{change}");
        }
    }
}
