//! Scenario files: the built-in ones are valid, and each mistake is refused by name, with its line.

use heliostat_scenario::{BUILTIN_NAMES, ChannelMode, MinRate, Scenario, ScenarioError};

#[test]
fn every_built_in_scenario_is_valid_and_bears_its_name() {
    for name in BUILTIN_NAMES {
        assert_eq!(Scenario::builtin(name).unwrap().name, name);
    }
}

#[test]
fn the_default_file_states_every_default() {
    assert_eq!(Scenario::builtin("specular").unwrap(), Scenario::default());
    let stated: toml::Table = toml::from_str(Scenario::builtin_text("specular").unwrap()).unwrap();
    let effective: toml::Table = toml::from_str(&Scenario::default().to_toml()).unwrap();
    assert_eq!(stated, effective, "specular.toml must list every key");
}

#[test]
fn the_effective_configuration_reads_back_unchanged() {
    let scenario = Scenario::builtin("paper-calibrated").unwrap();
    assert_eq!(Scenario::from_toml(&scenario.to_toml()).unwrap(), scenario);
}

#[test]
fn unknown_keys_are_refused_by_name_and_line() {
    let message = Scenario::from_toml("[room]\nheight_m = 3.0\nheigth_m = 3.0\n").unwrap_err().to_string();
    assert!(message.contains("heigth_m") && message.contains("line 3"), "{message}");
}

#[test]
fn a_value_outside_its_domain_is_refused_with_key_line_and_domain() {
    let message = Scenario::from_toml("[mirrors]\nrows = 7\nreflectivity = 1.5\n").unwrap_err().to_string();
    assert!(message.contains("line 3") && message.contains("mirrors.reflectivity = 1.5"), "{message}");
    assert!(message.contains("from 0 to 1"), "{message}");
}

#[test]
fn values_that_contradict_each_other_are_refused() {
    for text in [
        "[users]\ncount = 3\nmin_rate_mbps = [1.0, 2.0]",
        "[users]\ncount = 3\n[blockage]\nforced_users = 4",
        "[users]\nspeed_min_m_s = 2.0\nspeed_max_m_s = 1.0",
        "[channel]\nmode = \"specular\"\ngain_scale = 85.0",
        "[led]\npositions_m = [[0.0, 0.0, 0.1]]",
        "[blockage]\nobstacles_per_m2 = 5.0",
        "[mirrors]\nrows = 1024\ncolumns = 1024",
        "[mirrors]\ncolumns = 19",
        "[mirrors]\nrows = 17",
        "[noise]\nvariance_a2 = 0.0",
        "[noise]\nvariance_a2 = nan",
    ] {
        assert!(matches!(Scenario::from_toml(text), Err(ScenarioError::Invalid { .. })), "{text}");
    }
}

#[test]
fn overrides_reach_any_key() {
    let set = [
        "blockage.forced_users=2",
        "users.count=3",
        "led.power_w=1",
        "channel.mode=paper",
        "streams.positions.rate_hz=10",
    ]
    .map(String::from);
    let scenario = Scenario::default().with_overrides(&set).unwrap();
    assert_eq!(scenario.blockage.forced_users, 2);
    assert_eq!(scenario.users.count, 3);
    assert_eq!(scenario.led.power_w, 1.0);
    assert_eq!(scenario.channel.mode, ChannelMode::Paper);
    assert_eq!(scenario.streams.positions.rate_hz, 10.0);
    let each = ["users.min_rate_mbps=[1, 2.5, 3, 4, 5]".to_string()];
    let rates = Scenario::default().with_overrides(&each).unwrap().users.min_rate_mbps;
    assert_eq!(rates, MinRate::Each(vec![1.0, 2.5, 3.0, 4.0, 5.0]));
}

#[test]
fn overrides_that_mean_nothing_are_refused_by_name() {
    for (text, named) in [
        ("blockage.forced=2", "forced"),
        ("nonsense", "nonsense"),
        ("=3", "=3"),
        ("users.count=many", "users.count=many"),
        ("users.count.deep=1", "users.count.deep=1"),
    ] {
        let message = Scenario::default().with_overrides(&[text.to_string()]).unwrap_err().to_string();
        assert!(message.contains(named), "{text}: {message}");
    }
}

#[test]
fn the_geometry_hash_ignores_power_noise_and_people() {
    let base = Scenario::default();
    let same = ["led.power_w=1", "noise.variance_a2=6.5e-15", "users.count=3", "seed=9"].map(String::from);
    assert_eq!(base.with_overrides(&same).unwrap().geometry_hash(), base.geometry_hash());
    for other in ["mirrors.rows=7", "led.half_power_semi_angle_deg=45", "room.length_y_m=6", "channel.mode=paper"] {
        let changed = base.with_overrides(&[other.to_string()]).unwrap();
        assert_ne!(changed.geometry_hash(), base.geometry_hash(), "{other}");
    }
}

#[test]
fn every_built_in_scenario_makes_a_channel_model() {
    for name in BUILTIN_NAMES {
        let scenario = Scenario::builtin(name).unwrap();
        assert_eq!(scenario.channel_model().unwrap().mirrors.len(), scenario.mirror_count());
    }
    let diversity = ["receiver.preset=angle-diversity".to_string()];
    let model = Scenario::default().with_overrides(&diversity).unwrap().channel_model().unwrap();
    assert_eq!(model.receiver.branches.len(), 7);
}

#[test]
fn the_default_noise_is_the_sum_of_its_items() {
    let variance = Scenario::default().channel_model().unwrap().budget.noise_variance_a2();
    assert!((variance - 4.16e-15).abs() < 1e-18, "{variance}");
}
