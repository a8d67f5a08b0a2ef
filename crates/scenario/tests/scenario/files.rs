//! Scenario files: the built-in files are valid, and each error states key and line.

use heliostat_scenario::renames::{RENAMES, Rename};
use heliostat_scenario::{BUILTIN_NAMES, ChannelMode, MinRate, Scenario, ScenarioArgs, ScenarioError};

#[test]
fn every_built_in_scenario_is_valid_and_has_its_name() {
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
fn each_refusal_names_its_line() {
    for (text, line, named) in [
        ("name = \"x\"\nroom.height_m = \"three\"\n", "line 2", "height_m"),
        ("[room]\nheight_m = 3.0\n\n[rom]\n", "line 4", "rom"),
        ("[room]\nheight_m = 3.0\nheight_m = 4.0\n", "line 3", "height_m"),
        ("[room\n", "line 1", "[room"),
        ("[users]\ncount = 5\n\nmin_rate_mbps = [1.0]\n", "line 4", "users.min_rate_mbps"),
        ("[streams.positions]\nlatency_ms = 1.0\nrate_hz = 0.0\n", "line 3", "streams.positions.rate_hz"),
        (
            "[receiver]\nbranches = [\n  { tilt_deg = 200.0, azimuth_deg = 0.0, fov_deg = 35.0 },\n]\n",
            "line 2",
            "tilt_deg",
        ),
        ("[streams.channel]\nrate_hz = 50.0\nbranches = true\n", "line 3", "angle-diversity"),
        ("[actuator]\nscale_error_relative = 0.5\n", "line 2", "actuator.scale_error_relative"),
        ("[actuator]\nhysteresis_deg = -0.1\n", "line 2", "actuator.hysteresis_deg"),
        ("[actuator]\nstuck_share = 1.5\n", "line 2", "actuator.stuck_share"),
        ("[users]\nheading_lag_s = -1.0\n", "line 2", "users.heading_lag_s"),
        ("[users]\ngauss_markov = { memory = 1.0 }\n", "line 2", "users.gauss_markov.memory"),
        ("[users.smooth_random]\nturn_rate_deg_per_s = 0.0\n", "line 2", "users.smooth_random.turn_rate_deg_per_s"),
        ("[users.social_force]\nforce = 2.0\n", "line 2", "force"),
        ("[users]\nmobility = \"levy\"\n", "line 2", "social-force"),
        ("[users]\nseats_m = [\n  [0.0, 0.0],\n  [0.0, 2.6],\n]\n", "line 2", "users.seats_m = [0, 2.6]"),
        ("[led]\n# high up\npositions_m = [[0.0, 0.0, 3.5]]\n", "line 3", "led.positions_m"),
    ] {
        let message = Scenario::from_toml(text).unwrap_err().to_string();
        assert!(message.contains(line) && message.contains(named), "{text}: {message}");
    }
}

#[test]
fn both_speeds_may_be_zero_but_not_one_alone() {
    let with = |min: f64, max: f64| {
        Scenario::from_toml(&format!("[users]\nspeed_min_m_s = {min:?}\nspeed_max_m_s = {max:?}")).is_ok()
    };
    assert!(with(0.0, 0.0) && with(0.5, 0.5));
    assert!(!with(0.0, 1.0) && !with(1.0, 0.0) && !with(-1.0, 0.0));
}

#[test]
fn a_relative_trace_path_starts_at_the_folder_of_its_file() {
    let folder = std::env::temp_dir().join(format!("heliostat-scenario-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join("room.toml");
    std::fs::write(&file, "[users]\ntrace = \"walk.csv\"\n").unwrap();
    let mut args = ScenarioArgs { scenario: file.display().to_string(), ..ScenarioArgs::default() };
    let trace = |args: &ScenarioArgs| args.load().unwrap().users.trace.unwrap();
    assert_eq!(trace(&args), folder.join("walk.csv").display().to_string());
    args.overrides = vec!["users.trace=other.csv".into()];
    assert_eq!(trace(&args), "other.csv");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn the_hash_ignores_the_folder_of_a_recorded_walk_and_keeps_its_name() {
    let with = |trace: &str| Scenario::default().with_overrides(&[format!("users.trace={trace:?}")]).unwrap();
    let here = with("walk.csv");
    for folder in ["rooms/", "../", "/home/ann/"] {
        let there = with(&format!("{folder}walk.csv"));
        assert_eq!((there.hash(), there.to_shared_toml()), (here.hash(), here.to_toml()), "{folder}");
        // A recording holds the text, and a replay computes the hash from it.
        assert_eq!(Scenario::hash_of(&there.to_shared_toml()), there.hash());
    }
    assert_ne!(with("other.csv").hash(), here.hash());
    let without = Scenario::default();
    assert_ne!(without.hash(), here.hash());
    assert_eq!(without.hash(), Scenario::hash_of(&without.to_toml()));
}

/// The largest value that a refusal names is accepted, and the next one is not.
#[test]
fn a_refusal_states_the_bound_that_is_enforced() {
    for (others, key, refused) in [
        (&[] as &[&str], "mirrors.columns", "1024"),
        (&["mirrors.gap_m=0"], "mirrors.columns", "1024"),
        (&["mirrors.width_m=0.001", "mirrors.gap_m=0"], "mirrors.columns", "99999"),
        (&["mirrors.centre_height_m=2.5"], "mirrors.rows", "0"),
        (&["mirrors.columns=1"], "mirrors.width_m", "99"),
        (&["mirrors.rows=1"], "mirrors.centre_height_m", "99"),
        (&[], "blockage.obstacles_per_m2", "99"),
        (
            &["room.length_x_m=100", "room.length_y_m=100", "blockage.obstacles_per_m2=0"],
            "blockage.obstacles_per_m2",
            "99",
        ),
        (&["streams.channel.loss_burst_reports=2"], "streams.channel.loss", "2"),
        (&[], "streams.channel.loss", "2"),
    ] {
        let with = |value: &str| {
            let set = format!("{key}={value}");
            Scenario::default().with_overrides(&[others, &[set.as_str()]].concat())
        };
        let message = with(refused).unwrap_err().to_string();
        let most = message.split(" to ").nth(1).and_then(|rest| rest.split([':', ';']).next()).expect("a bound");
        assert!(message.starts_with(&format!("{key} = ")), "{message}");
        assert!(with(most).is_ok(), "{message}");
        let most: f64 = most.parse().expect("a number");
        let beyond = if message.contains("an integer") { most + 1.0 } else { most * 1.01 };
        assert!(with(&beyond.to_string()).is_err(), "{message}: {beyond}");
    }
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
        "[users]\nmobility = \"mixture\"",
        "[users]\nmixture = [{ mobility = \"seated\", share = 0.5 }]",
        "[users]\nmixture = [{ mobility = \"mixture\", share = 1.0 }]",
        "[users]\nmixture = [{ mobility = \"seated\", share = 1.5 }, { mobility = \"seated\", share = -0.5 }]",
        "[users]\nmixture = [{ mobility = \"seated\", count = 2, share = 1.0 }]",
        "[users]\nmixture = [{ mobility = \"seated\", count = 99 }]",
        "[users]\nmixture = [{ mobility = \"seated\", share = 1.0, orientation = { sitting_polar_mean_deg = 91.0 } }]",
        "[users]\nmixture = [{ mobility = \"seated\", count = 9223372036854775807 }, \
         { mobility = \"seated\", count = 9223372036854775807 }, { mobility = \"seated\", count = 7 }]",
        "[users]\ncount = 5\nmobility = \"mixture\"\nmixture = [{ mobility = \"seated\", count = 2 }]",
        "[users]\ncount = 5\nmixture = [{ mobility = \"seated\", count = 2 }, { mobility = \"social-force\", share = 0.6 }]",
        "[users]\nmobility = \"seated\"\nseats_m = [[0.0, 0.0], [1.0, 0.0]]",
        "[users]\ncount = 2\nmobility = \"seated\"\nseats_m = [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]",
        "[users]\ncount = 2\nmobility = \"mixture\"\nmixture = [{ mobility = \"seated\", count = 2 }]\nseats_m = [[0.0, 0.0]]",
        "[streams.channel]\nresolution_bits = 10",
        "[streams.channel]\nloss = 0.7\nloss_burst_reports = 2.0",
        "[streams.positions]\nloss_burst_reports = 0.5",
        "[streams.positions]\nloss = 1.0",
        "[noise]\nvariance_a2 = 0.0",
        "[noise]\nvariance_a2 = nan",
        "[users]\narrivals = { rate_per_min = -0.0 }",
        "[streams.positions]\nloss_burst_reports = -0.0",
        "[actuator]\nlow_pass_hz = 1e-308",
        "[actuator]\nnatural_frequency_hz = 1e-60",
        "[receiver]\nfilter_gain = 0.0",
    ] {
        assert!(matches!(Scenario::from_toml(text), Err(ScenarioError::Invalid { .. })), "{text}");
    }
}

#[test]
fn a_refused_place_is_named_as_it_was_written_with_the_bounds_of_each_coordinate() {
    for (set, expected) in [
        (
            "led.positions_m=[[1, 1, 2.5], [9, 0, 2]]",
            "led.positions_m = [9, 0, 2]: expected x from -2.5 to 2.5 m, y from -2 to 2 m, z from 0.5 to 3 m",
        ),
        (
            "mismatch.unknown_leds_m=[[0, 0, 0.25]]",
            "mismatch.unknown_leds_m = [0, 0, 0.25]: expected x from -2.5 to 2.5 m, y from -2 to 2 m, z from 0.5 to 3 m",
        ),
        ("users.seats_m=[[0, 3]]", "users.seats_m = [0, 3]: expected x from -2.5 to 2.5 m, y from -2 to 2 m"),
    ] {
        let room = ["room.length_y_m=4", "receiver.height_m=0.5", set];
        let refused = Scenario::default().with_overrides(&room).expect_err(set);
        assert_eq!(refused.to_string(), expected);
    }
}

#[test]
fn gains_can_be_told_from_none_above_the_noise_and_half_a_step() {
    let channel = |text: &str| Scenario::from_toml(&format!("[streams.channel]\n{text}")).unwrap().streams.channel;
    assert_eq!((channel("").detectable_gain(), channel("").gain_variance()), (0.0, 0.0));
    let fine = channel("noise_gain = 1e-8\nresolution_bits = 10\nfull_scale_gain = 1.023e-6");
    assert!((fine.step_gain() / 1e-9 - 1.0).abs() < 1e-12);
    assert!((fine.detectable_gain() / 3e-8 - 1.0).abs() < 1e-12);
    assert!((fine.gain_variance() / (1e-16 + 1e-18 / 12.0) - 1.0).abs() < 1e-12);
    let coarse = channel("noise_gain = 1e-8\nresolution_bits = 3\nfull_scale_gain = 7e-7");
    assert!((coarse.detectable_gain() / 5e-8 - 1.0).abs() < 1e-12);
}

#[test]
fn an_override_of_an_entry_that_does_not_exist_names_list_and_entry() {
    let set = |text: &str, set: &str| Scenario::from_toml_with(text, &[set]).map_err(|error| error.to_string());
    let none =
        "users.mixture has no entry 0: expected the complete list, as users.mixture=[...], since none is written";
    for text in ["", "[users]\nmixture = []\n"] {
        assert_eq!(set(text, "users.mixture.0.count=1").expect_err("no entry"), none);
    }
    let one = "[users]\nmobility = \"mixture\"\n[[users.mixture]]\nmobility = \"seated\"\nshare = 1.0\n";
    let refused = set(one, "users.mixture.1.share=0.5").expect_err("one entry");
    assert_eq!(refused, "users.mixture has no entry 1: expected an index from 0 to 0");
    assert_eq!(set(one, "users.mixture.0.mobility=seated").expect("an entry").users.mixture.len(), 1);
}

#[test]
fn a_mixture_can_be_written_as_tables() {
    let text = "[users]\nmobility = \"mixture\"\n[[users.mixture]]\nmobility = \"seated\"\nshare = 0.25\n\
                [[users.mixture]]\nmobility = \"social-force\"\nshare = 0.75\n[users.social_force]\nrelaxation_s = 0.4\n";
    let users = Scenario::from_toml(text).unwrap().users;
    assert_eq!((users.mixture.len(), users.mixture[1].share), (2, 0.75));
    assert_eq!((users.social_force.relaxation_s, users.social_force.desired_speed_m_s), (0.4, 1.34));
}

#[test]
fn overrides_reach_any_key() {
    let set = [
        "blockage.forced_users=2",
        "users.count=3",
        "led.power_w=1",
        "channel.mode=paper",
        "streams.positions.rate_hz=10",
    ];
    let scenario = Scenario::default().with_overrides(&set).unwrap();
    assert_eq!(scenario.blockage.forced_users, 2);
    assert_eq!(scenario.users.count, 3);
    assert_eq!(scenario.led.power_w, 1.0);
    assert_eq!(scenario.channel.mode, ChannelMode::Paper);
    assert_eq!(scenario.streams.positions.rate_hz, 10.0);
    let each = "users.min_rate_mbps=[1, 2.5, 3, 4, 5]";
    let rates = Scenario::default().with_overrides(&[each]).unwrap().users.min_rate_mbps;
    assert_eq!(rates, MinRate::Each(vec![1.0, 2.5, 3.0, 4.0, 5.0]));
}

#[test]
fn a_decision_without_a_deadline_has_the_time_between_two_reports() {
    let deadline_s = |deadline: &str| {
        let set = ["streams.positions.rate_hz=20", deadline];
        Scenario::default().with_overrides(&set).unwrap().decision_deadline_s()
    };
    assert_eq!(["control.deadline_ms=0", "control.deadline_ms=500"].map(deadline_s), [0.05, 0.5]);
}

#[test]
fn a_misspelt_scenario_or_key_is_refused_with_the_similar_name_and_without_a_flag() {
    let of = |scenario: &str| ScenarioArgs { scenario: scenario.into(), ..ScenarioArgs::default() };
    for (named, hint) in [
        ("hal", "; a similar name exists: hall"),
        ("hall.toml", "; the built-in scenario hall is named without folder and suffix"),
        ("./hall", "; the built-in scenario hall is named without folder and suffix"),
        ("nowhere/kitchen.toml", "(os error 2)"),
    ] {
        let message = of(named).load_arrays().unwrap_err().to_string();
        assert!(message.ends_with(hint), "{message}");
    }
    let message = Scenario::default().with_overrides(&["users.cont=3"]).unwrap_err().to_string();
    assert!(message.starts_with("users.cont=3: users.cont: unknown field `cont`, expected one of "), "{message}");
    assert!(message.ends_with("; a similar name exists: count"), "{message}");
    let args = ScenarioArgs { overrides: vec!["users.cont=3".into()], ..of("hall") };
    assert!(args.load_arrays().unwrap_err().to_string().starts_with("--set users.cont=3: "));
    let message = Scenario::from_toml("[users]\ncont = 3\n").unwrap_err().to_string();
    assert!(message.contains("; a similar name exists: count"), "{message}");
}

#[test]
fn invalid_overrides_are_refused_by_name() {
    for (text, named) in [
        ("blockage.forced=2", "forced"),
        ("nonsense", "nonsense"),
        ("=3", "=3"),
        ("users.count=many", "users.count = \"many\""),
        ("users.count.deep=1", "users.count.deep=1"),
    ] {
        let message = Scenario::default().with_overrides(&[text]).unwrap_err().to_string();
        assert!(message.contains(named), "{text}: {message}");
    }
}

#[test]
fn the_geometry_hash_ignores_power_noise_and_users() {
    let base = Scenario::default();
    let same = ["led.power_w=1", "noise.variance_a2=6.5e-15", "users.count=3", "seed=9"];
    assert_eq!(base.with_overrides(&same).unwrap().geometry_hash(), base.geometry_hash());
    for other in ["mirrors.rows=7", "led.half_power_semi_angle_deg=45", "room.length_y_m=6", "channel.mode=paper"] {
        let changed = base.with_overrides(&[other]).unwrap();
        assert_ne!(changed.geometry_hash(), base.geometry_hash(), "{other}");
    }
}

#[test]
fn every_built_in_scenario_makes_a_channel_model() {
    for name in BUILTIN_NAMES {
        let scenario = Scenario::builtin(name).unwrap();
        assert_eq!(scenario.channel_model().unwrap().mirrors.len(), scenario.mirror_count());
    }
    let model =
        Scenario::default().with_overrides(&["receiver.preset=angle-diversity"]).unwrap().channel_model().unwrap();
    assert_eq!(model.receiver.branches.len(), 7);
}

#[test]
fn the_default_noise_is_the_sum_of_its_items() {
    let variance = Scenario::default().channel_model().unwrap().budget.noise_variance_a2();
    assert!((variance - 4.16e-15).abs() < 1e-18, "{variance}");
}

#[test]
fn a_recorded_scenario_is_read_and_checked() {
    let scenario = Scenario::builtin("hall").unwrap();
    assert_eq!(Scenario::from_recorded_toml(&scenario.to_toml()).unwrap(), scenario);
    let message = Scenario::from_recorded_toml("[mirrors]\nrows = 0\n").unwrap_err().to_string();
    assert!(message.starts_with("line 2: mirrors.rows = 0: expected an integer from 1 to 16: "), "{message}");
    let message = Scenario::from_recorded_toml("[room]\nheigth_m = 3.0\n").unwrap_err().to_string();
    assert!(message.starts_with("recorded scenario: ") && message.contains("heigth_m"), "{message}");
}

#[test]
fn a_removed_action_for_a_policy_timeout_is_refused_in_a_file_and_read_as_hold_in_a_recording() {
    for removed in ["last-good", "park"] {
        let text = format!("[control]\nwhen_unanswered = \"{removed}\"\n");
        let message = Scenario::from_toml(&text).unwrap_err().to_string();
        let refused = format!("line 2: control.when_unanswered = {removed}: expected hold, ");
        assert!(message.starts_with(&refused) && message.ends_with("delete the key"), "{message}");
        assert_eq!(Scenario::from_recorded_toml(&text).unwrap(), Scenario::default());
    }
}

#[test]
fn every_new_name_of_a_rename_exists() {
    let effective: toml::Value = Scenario::default().to_toml().parse::<toml::Table>().unwrap().into();
    let find = |path: &str| path.split('.').try_fold(&effective, |table, key| table.get(key));
    for rename in RENAMES {
        match rename {
            Rename::Key { old, new } => {
                assert!(find(new).is_some(), "{new}");
                assert!(find(old).is_none(), "{old}");
            }
            Rename::Value { key, new, .. } => {
                let set = [format!("{key}={new}")];
                assert!(Scenario::default().with_overrides(&set).is_ok(), "{key} = {new}");
            }
        }
    }
}

#[test]
fn receivers_are_tilted_where_their_angles_are_drawn() {
    let of = |name: &str, overrides: &[&str]| {
        let scenario = Scenario::builtin(name).unwrap().with_overrides(overrides).unwrap();
        scenario.has_tilted_receivers()
    };
    assert!(of("office", &[]) && of("hall", &["users.orientation={}"]));
    assert!(!of("hall", &[]) && !of("office", &["users.orientation.model=up"]));
    let one = "users.mixture=[{mobility=\"seated\",count=1,orientation={}},{mobility=\"seated\",share=1}]";
    assert!(!of("hall", &[one]) && of("hall", &["users.mobility=mixture", one]));
}

#[test]
fn the_orientation_of_an_entry_of_a_mixture_is_refused_with_its_key_and_line_and_written_only_where_it_is_set() {
    let text = "[users]\nmobility = \"mixture\"\n[[users.mixture]]\nmobility = \"seated\"\nshare = 1.0\n";
    let own = |angle: &str| format!("{text}[users.mixture.orientation]\nsitting_polar_mean_deg = {angle}\n");
    let refused = Scenario::from_toml(&own("91.0")).expect_err("beyond the horizon").to_string();
    assert!(refused.starts_with("line 7: users.mixture.0.orientation.sitting_polar_mean_deg = 91: "), "{refused}");
    let [without, with] = [text, &own("20.0")].map(|text| Scenario::from_toml(text).expect("a scenario"));
    assert!(!without.to_toml().contains("sitting_polar_mean_deg"));
    assert_eq!(Scenario::from_toml(&with.to_toml()), Ok(with));
}
