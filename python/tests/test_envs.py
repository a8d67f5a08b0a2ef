"""The environments of Gymnasium: spaces, seeds, observations, refusals and pictures."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, get_args

import gymnasium
import heliostat
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from heliostat.names import ActionForm, Dynamics, ObservationForm, RewardForm
from heliostat.scenario import _toml

IDS = list(heliostat.envs.IDS)
FORMS = [(action, observation) for action in ("angles", "weights") for observation in ("flat", "dict", "belief")]


def make(name: str = "heliostat/Static-v0", **keywords: Any) -> heliostat.HeliostatEnv:
    env = gymnasium.make(name, **keywords).unwrapped
    assert isinstance(env, heliostat.HeliostatEnv)
    return env


def run(env: Any, steps: int, seed: int = 3) -> list[tuple[Any, float, Any]]:
    observation, _ = env.reset(seed=seed)
    rows = [(observation, 0.0, None)]
    generator = np.random.default_rng(5)
    for _ in range(steps):
        action = generator.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observation, reward, _, _, info = env.step(action)
        rows.append((observation, reward, info["rates_mbps"]))
    return rows


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize(("action", "observation"), FORMS)
def test_the_checker_of_gymnasium_accepts_each_form(name: str, action: str, observation: str) -> None:
    env = gymnasium.make(name, action=action, observation=observation)
    is_first = (action, observation) == FORMS[0]
    with warnings.catch_warnings():
        # pygame's own.
        warnings.filterwarnings("ignore", message="pkg_resources is deprecated")
        warnings.filterwarnings("ignore", message="avx2 capable", category=RuntimeWarning)
        check_env(env.unwrapped, skip_render_check=not is_first)
    env.close()


@pytest.mark.parametrize("name", IDS)
def test_the_checker_of_gymnasium_accepts_each_default(name: str) -> None:
    env = gymnasium.make(name)
    expected = "paper" if name == "heliostat/Paper-v0" else "flat"
    assert env.unwrapped.observation_form == expected  # type: ignore[attr-defined]
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_the_parts_of_a_flat_observation_have_names() -> None:
    env = make()
    flat, _ = env.reset(seed=1)
    parts, _ = make(observation="dict").reset(seed=1)
    assert list(env.parts) == list(parts)
    for name, (indices, shape) in env.parts.items():
        assert np.array_equal(flat[indices].reshape(shape), parts[name])


def test_the_parts_of_a_belief_are_its_columns_and_the_observation_of_the_paper_has_none() -> None:
    env = make(observation="belief")
    belief, _ = env.reset(seed=1)
    rows = belief.reshape(-1, len(heliostat.BELIEF_COLUMNS))
    assert list(env.parts) == list(heliostat.BELIEF_COLUMNS)
    for column, (indices, shape) in zip(rows.T, env.parts.values(), strict=True):
        assert np.array_equal(belief[indices].reshape(shape), column)
    with pytest.raises(ValueError, match='parts: the observation "paper" has none'):
        _ = make("heliostat/Paper-v0").parts


def test_an_episode_of_a_comparison_ends_with_its_samples() -> None:
    env = make("heliostat/Hall-v0")
    env.reset(options={"episode": (1, 30, 1)})
    info: dict[str, Any] = {}
    truncated, steps = False, 0
    while not truncated:
        assert "samples" not in info
        _, _, _, truncated, info = env.step(np.zeros(200, np.float32))
        steps += 1
    # 20 states of the first episode, and the other 10 here; about one in a quarter of a second.
    assert info["samples"].shape == (10, 5) and 30 < steps < 45
    env.reset(seed=1)
    assert not env.step(np.zeros(200, np.float32))[3]
    with pytest.raises(ValueError, match="episode 2 of 2"):
        env.reset(options={"episode": (2, 30, 1)})


def test_an_episode_of_a_comparison_of_exact_states_is_one_state() -> None:
    env, held_out = make(), make()
    seen, _ = env.reset(options={"episode": (7, 5, 2)})
    same, _ = held_out.reset(options={"held_out": 2, "held_out_set": env.scenario.seed + 1})
    assert np.array_equal(seen, same)
    _, _, _, truncated, info = env.step(np.zeros(200, np.float32))
    assert truncated and info["samples"].shape == (1, 5)
    assert info["samples"][0, 0] == pytest.approx(info["sum_rate_mbps"]) and info["samples"][0, 1] == info["qos_met"]
    with pytest.raises(ValueError, match="index of the episode = 10"):
        env.reset(options={"episode": (10, 5, 2)})


@pytest.mark.parametrize("name", IDS)
def test_the_same_seed_gives_the_same_run_and_another_seed_another(name: str) -> None:
    first, again, other = run(make(name), 12), run(make(name), 12), run(make(name), 12, seed=4)
    for (one, reward, rates), (two, same_reward, same_rates) in zip(first, again, strict=True):
        assert np.array_equal(one, two) and reward == same_reward
        assert rates is None or np.array_equal(rates, same_rates)
    assert any(reward != other_reward for (_, reward, _), (_, other_reward, _) in zip(first[1:], other[1:], strict=True))


def test_resets_without_a_seed_continue_with_new_rooms_that_depend_on_the_first_seed() -> None:
    def episodes() -> list[Any]:
        env = make()
        return [env.reset(seed=9)[0], env.reset()[0], env.reset()[0]]

    first, again = episodes(), episodes()
    assert all(np.array_equal(one, two) for one, two in zip(first, again, strict=True))
    assert not np.array_equal(first[0], first[1]) and not np.array_equal(first[1], first[2])


def test_the_parts_of_a_dict_are_those_of_the_flat_observation() -> None:
    flat, _ = make().reset(seed=1)
    parts, _ = make(observation="dict").reset(seed=1)
    assert parts["mask"].tolist() == [1] * 5 + [0] * 5
    joined = np.concatenate([parts[name].ravel() for name in parts])
    assert np.array_equal(joined.astype(np.float32), flat)
    assert parts["steering_amplitude"].base is not None, "the parts are views"
    assert np.allclose(parts["positions"][:5], make_state(1)["positions"], atol=1e-6)


def test_amplitudes_and_weights_are_those_of_the_guide() -> None:
    env = make(action="weights", observation="dict")
    parts, _ = env.reset(seed=1)
    before, room = env.state(), heliostat.Room(env.scenario)
    link = room.link(before["positions"], before["roll"], before["yaw"], before["blockers"])
    gains = link["los_gain"] + link["irs_gain"]
    lit = gains > 0.0
    scales = np.sqrt(np.e / (2.0 * np.pi) * link["sinr"][lit]) / gains[lit]
    assert np.allclose(scales, scales[0], rtol=1e-9), "one factor for all users"
    assert np.allclose(parts["los_amplitude"][:5], scales[0] * link["los_gain"], rtol=1e-5)
    steering = room.steering_gain(before["positions"], before["blockers"])
    assert np.allclose(parts["steering_amplitude"][:5], scales[0] * steering, rtol=1e-4, atol=1e-6)
    action = np.random.default_rng(3).uniform(-1, 1, env.slots).astype(np.float32)
    env.step(action)
    weights = np.exp(parts["summary"][-1] + 2.0 * action)[:5]
    roll, yaw = room.decode(before["positions"], weights, before["blockers"])
    after = env.state()
    assert np.allclose(after["roll"], roll, atol=1e-6) and np.allclose(after["yaw"], yaw, atol=1e-6)


def make_state(seed: int) -> dict[str, Any]:
    env = make()
    env.reset(seed=seed)
    return env.state()


def test_a_belief_in_closed_loop_is_uncertain_and_near_the_true_users() -> None:
    env = make("heliostat/Hall-v0", observation="belief")
    env.reset(seed=2)
    for _ in range(30):
        observation, *_ = env.step(np.zeros(200, np.float32))
    rows = observation.reshape(-1, len(heliostat.BELIEF_COLUMNS))
    column = {name: index for index, name in enumerate(heliostat.BELIEF_COLUMNS)}
    present = rows[rows[:, column["present"]] == 1.0]
    assert len(present) == 5
    assert (present[:, column["covariance_xx_m2"]] > 0.0).all()
    errors = np.linalg.norm(present[:, 1:3] - env.state()["positions"][:, :2], axis=1)
    assert 0.0 < np.median(errors) < 0.5


def test_better_angles_give_a_better_reward_and_info_agrees_with_the_physics() -> None:
    env = make(oracle=True)
    env.reset(seed=6)
    state = env.state()
    room = heliostat.Room()
    roll, yaw = room.oracle(state["positions"], state["blockers"], state["min_rates_mbps"])
    best = np.concatenate([roll, yaw]).astype(np.float32) / np.float32(env.scenario.range_rad)
    _, reward, _, _, info = env.step(best)
    assert info["sum_rate_mbps"] == pytest.approx(info["oracle_mbps"], rel=1e-3)
    env.reset(seed=6)
    _, flat_reward, _, _, flat_info = env.step(np.zeros_like(best))
    assert reward > flat_reward
    direct = room.link(state["positions"], np.zeros(100), np.zeros(100), state["blockers"])
    assert flat_info["rates_mbps"] == pytest.approx(direct["rate_mbps"], rel=1e-9)
    assert flat_info["qos_met"] == np.mean(direct["rate_mbps"] >= state["min_rates_mbps"])


def test_a_dictionary_in_an_override_is_a_table_of_toml() -> None:
    mixture = [{"mobility": "seated", "count": 2}, {"mobility": "random-waypoint", "count": np.int64(1)}]
    make("heliostat/Hall-v0", overrides={"users.count": 3, "users.mobility": "mixture", "users.mixture": mixture})
    with pytest.raises(ValueError, match="unknown variant `walking`"):
        make("heliostat/Hall-v0", overrides={"users.mixture": [{"mobility": "walking", "count": 2}]})
    tables = {"text": 'a "b"', "flag": True, "one key": [{"inner": 2.5}]}
    assert _toml("key", tables) == '{"text" = "a \\"b\\"", "flag" = true, "one key" = [{"inner" = 2.5}]}'


def test_scenario_and_overrides_are_keywords() -> None:
    env = make(overrides={"users.count": 3, "mirrors.rows": 4, "link.bandwidth_mhz": 10.0})
    assert env.action_space.shape == (80,)
    assert len(env.reset(seed=1)[0]) == 10 * (17 + 40) + 80
    assert len(env.state()["positions"]) == 3


def test_users_may_come_and_go_in_closed_loop() -> None:
    keys: dict[str, Any] = {
        "users.arrivals.rate_per_min": 60.0,
        "users.arrivals.mean_stay_s": 5.0,
        "users.arrivals.max_users": 8,
    }
    env = make("heliostat/Hall-v0", overrides=keys)
    env.reset(seed=1)
    counts = set()
    for _ in range(200):
        _, reward, _, _, info = env.step(np.zeros(200, np.float32))
        counts.add(int(np.isfinite(info["rates_mbps"]).sum()))
        assert np.isfinite(reward)
    assert len(counts) > 2


@pytest.mark.parametrize(
    ("keywords", "reason"),
    [
        ({"scenario": "hal"}, 'no built-in scenario "hal": .* a similar name exists: hall'),
        ({"overrides": {"users.cout": 3}}, "^users.cout=3: users.cout: unknown field `cout`.* a similar name exists: count"),
        ({"overrides": {"users.count": 0}}, "users.count = 0"),
        ({"overrides": {"users.count": 20}}, "users.count = 20: expected at most 10 in a static room"),
        ({"action": "angle"}, 'action = "angle": expected "angles", "weights"; a similar name exists: angles'),
        ({"observation": "all"}, "observation = "),
        ({"reward": "none"}, "reward = "),
        ({"dynamics": "slow"}, "dynamics = "),
        ({"step_s": 0.0}, "step_s = 0"),
        ({"step_s": 1e300}, "step_s = 1.*up to 86400"),
        ({"penalty": float("nan")}, "penalty = NaN"),
        ({"scenario": "missing.toml"}, "missing.toml"),
        ({"overrides": {"mismatch.level": "rough"}}, "mismatch.level"),
        ({"render_mode": "ansi"}, "render_mode"),
    ],
)
def test_settings_outside_their_domain_are_refused_with_the_reason(keywords: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        heliostat.HeliostatEnv(**keywords)


@pytest.mark.parametrize(
    ("keyword", "names"),
    [("action", ActionForm), ("dynamics", Dynamics), ("observation", ObservationForm), ("reward", RewardForm)],
)
def test_the_types_of_names_are_those_that_the_compiled_part_accepts(keyword: str, names: Any) -> None:
    other: dict[str, Any] = {keyword: "other"}
    with pytest.raises(ValueError, match=f'{keyword} = "other": expected "') as refused:
        heliostat.HeliostatEnv(**other)
    accepted = re.findall(r'"([\w-]+)"', str(refused.value).partition("expected")[2])
    assert sorted(accepted) == sorted(get_args(names))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"held_out": -1}, "held_out = -1: expected an integer from 0"),
        ({"held_out": 0, "held_out_set": 2**64}, "held_out_set = "),
        ({"episode": (0, 0, 1)}, "states = 0"),
        ({"episode": (0, 1)}, "episode = .*: expected the index, the number of states and that of seeds"),
        ({"episode": (-1, 1, 1)}, "index of the episode = -1"),
        ({"episode": (0, 10**18, 1)}, "states = 10+: expected an integer from 1 to 1000000"),
        ({"episode": (0, 10**4, 10**4)}, "10000 states of 10000 seeds: expected at most 1000000 together"),
        ({"other": 1}, "unknown reset options"),
    ],
)
def test_reset_options_outside_their_domain_are_refused(options: dict[str, Any], reason: str) -> None:
    env = heliostat.HeliostatEnv()
    with pytest.raises(ValueError, match=reason):
        env.reset(options=options)
    with pytest.raises(TypeError, match="options: expected a mapping"):
        env.reset(options=3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="states = 'many': expected an integer"):
        heliostat.evaluate(lambda seen: seen, env, states="many")  # type: ignore[arg-type]
    env.close()


def test_a_refused_reset_leaves_the_environment_as_it_was() -> None:
    env, reference = make("heliostat/Hall-v0"), make("heliostat/Hall-v0")
    action = np.zeros(200, np.float32)
    with pytest.raises(ValueError, match="episode 2 of 2"):
        env.reset(options={"episode": (2, 30, 1)})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action)
    env.reset(seed=1)
    reference.reset(seed=1)
    with pytest.raises(ValueError, match="episode 2 of 2"):
        env.reset(options={"episode": (2, 30, 1)})
    assert np.array_equal(env.step(action)[0], reference.step(action)[0])


def test_an_unknown_keyword_is_a_type_error_with_all_that_are_accepted() -> None:
    with pytest.raises(TypeError, match="expected action, .*overrides, .*render_mode, .*scenario, .*: render_mode"):
        heliostat.HeliostatEnv(rendermode="human")
    with pytest.raises(TypeError, match="autoreset_mode, .*num_envs, .*overrides.*: num_envs"):
        heliostat.HeliostatVectorEnv(num_env=2)
    with pytest.raises(TypeError, match="penality.*similar name exists: penalty"):
        heliostat.HeliostatEnv(penality=1.0)


@pytest.mark.parametrize("make_one", [heliostat.HeliostatEnv, heliostat.HeliostatVectorEnv])
def test_overrides_without_an_effect_on_a_static_room_are_refused(make_one: Any) -> None:
    for key, value in {"actuator.stuck_share": 1.0, "streams.positions.latency_ms": 30.0, "control.belief": "none"}.items():
        with pytest.raises(ValueError, match=f"{key}: no effect .*closed-loop"):
            make_one("specular", overrides={key: value})
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="the filter does not apply: control.belief = ")
            make_one("specular", overrides={key: value}, dynamics="closed-loop").close()
    with pytest.raises(ValueError, match="control.belief: no effect"):
        make_one("specular", overrides={"control": {"belief": "none"}})
    for works in ({"control.range_deg": 30.0}, {"control": {"range_deg": 30.0}}):
        make_one("specular", overrides=works).close()


@pytest.mark.parametrize("make_one", [heliostat.HeliostatEnv, heliostat.HeliostatVectorEnv])
def test_a_closed_loop_refuses_the_time_between_two_actions_of_a_static_room(make_one: Any) -> None:
    make_one("specular", step_s=0.1).close()
    for step_s in (0.1, 1.0):
        with pytest.raises(ValueError, match=f"step_s = {step_s}: no effect in a closed loop.*rate_hz"):
            make_one("hall", dynamics="closed-loop", step_s=step_s)


def made_by_gymnasium(scenario: Path | str, **settings: Any) -> Any:
    return gymnasium.make("heliostat/Static-v0", scenario=scenario, **settings)


@pytest.mark.parametrize("make_one", [heliostat.HeliostatEnv, heliostat.HeliostatVectorEnv, made_by_gymnasium])
def test_faults_of_mirrors_and_of_reports_in_a_scenario_are_warnings_of_a_static_room(make_one: Any, tmp_path: Path) -> None:
    file = tmp_path / "room.toml"
    file.write_text("[actuator]\nstuck_share = 0.5\n")
    reports = "the model of late, noisy and lost reports .*a static room, and streams.positions.latency_ms, .*closed-loop"
    for scenario, reason in ((file, "a static room, and actuator.stuck_share: .*closed-loop"), ("hall", reports)):
        with pytest.warns(UserWarning, match=reason) as warned:
            make_one(scenario).close()
        assert [warning.filename for warning in warned] == [__file__]
        make_one(scenario, dynamics="closed-loop").close()


@pytest.mark.parametrize("make_one", [heliostat.HeliostatEnv, heliostat.HeliostatVectorEnv, made_by_gymnasium])
def test_a_range_that_leaves_places_without_light_is_a_warning_of_a_static_room_too(make_one: Any) -> None:
    with pytest.warns(UserWarning, match="control.range_deg = 12.0, within which mirrors reach 91 % of the floor"):
        make_one("specular", overrides={"control.range_deg": 12.0}).close()


def made_in_closed_loop(scenario: str, **settings: Any) -> Any:
    return gymnasium.make("heliostat/Hall-v0", scenario=scenario, **settings)


@pytest.mark.parametrize("make_one", [heliostat.HeliostatEnv, heliostat.HeliostatVectorEnv, made_in_closed_loop])
def test_conditions_of_belief_and_model_are_warnings_of_a_closed_loop(make_one: Any) -> None:
    for key, value, reason in (
        ("mismatch.level", "rough", 'the channel model of belief and policies .*: mismatch.level = "rough"'),
        ("control.belief", "none", 'the filter does not apply: control.belief = "none"'),
        ("streams.channel.rate_hz", 0.5, "the use of measured gains .*: readings become 2100 ms old"),
    ):
        with pytest.warns(UserWarning, match=reason) as warned:
            make_one("hall", overrides={key: value}, dynamics="closed-loop").close()
        assert [warning.filename for warning in warned] == [__file__], key


def test_actions_that_are_not_valid_are_refused_and_change_nothing() -> None:
    env = make()
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(200, np.float32))
    env.reset(seed=1)
    bad = np.zeros(200, np.float32)
    bad[7] = np.nan
    cases: list[tuple[Any, str]] = [
        (np.zeros(7, np.float32), r"shape \(7,\), expected \(200,\)"),
        (np.zeros((1, 200), np.float32), "shape"),
        (bad, "NaN at index 7"),
        (np.zeros(200, np.complex64), "action: dtype complex64, expected real numbers"),
        (np.array(["0.5"] * 200), "action: dtype <U3, expected real numbers"),
        ((np.zeros(200), None), "action: a tuple of unequal parts, expected an array of real numbers; of several values"),
        ([None] * 200, "action: dtype object"),
    ]
    for action, reason in cases:
        with pytest.raises(ValueError, match=reason):
            env.step(action)
    with pytest.raises(ValueError, match="dtype <U2"):
        env.step("up")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)
    with pytest.raises(TypeError, match="seed = 'a': expected an integer from 0"):
        env.reset(seed="a")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="held_out = -1: expected an integer"):
        env.reset(options={"held_out": -1})
    with pytest.raises(ValueError, match="held_in"):
        env.reset(options={"held_in": 1})
    env.reset(seed=1)
    fresh = make()
    fresh.reset(seed=1)
    flat = np.zeros(200)  # float64 is converted
    assert np.array_equal(env.step(flat)[0], fresh.step(flat)[0])  # type: ignore[arg-type]


def test_a_score_of_absurd_size_is_refused_before_it_needs_memory() -> None:
    with pytest.raises(ValueError, match="states = 1000000000000"):
        heliostat.evaluate(lambda _: np.zeros(200, np.float32), make(), 10**12)
    with pytest.raises(ValueError, match="seeds = 0"):
        heliostat.evaluate(lambda _: np.zeros(200, np.float32), make(), 10, 0)


def test_a_closed_environment_refuses_steps() -> None:
    env = make()
    env.reset(seed=1)
    env.close()
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(np.zeros(200, np.float32))
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()


def test_a_picture_shows_users_where_they_are_and_whether_they_are_served() -> None:
    env = make(render_mode="rgb_array")
    env.reset(seed=1)
    for _ in range(5):
        env.step(np.zeros(200, np.float32))
    picture, state = env.render(), env.state()
    assert picture.dtype == np.uint8 and picture.shape == (400, 400, 3)
    scale = (400 - 32) / env.scenario.room_m[1]
    link = heliostat.Room(env.scenario).link(state["positions"], state["roll"], state["yaw"], state["blockers"])
    met = link["rate_mbps"] >= state["min_rates_mbps"]
    for place, is_met in zip(state["positions"], met, strict=True):
        column = round(16 + (place[0] + env.scenario.room_m[0] / 2) * scale)
        row = round(16 + (env.scenario.room_m[1] / 2 - place[1]) * scale)
        red, green, _ = picture[row, column].astype(int)
        assert (green > red) == is_met, (place, picture[row, column])
    assert met.any() and not met.all()


def test_a_vector_environment_whose_constructor_refused_its_arguments_can_be_closed() -> None:
    with pytest.raises(ValueError, match="num_envs = 0: expected an integer from 1"):
        heliostat.HeliostatVectorEnv(num_envs=0)
    heliostat.HeliostatVectorEnv.__new__(heliostat.HeliostatVectorEnv).close()
