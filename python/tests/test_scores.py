"""Scores of functions in held-out rooms, beside those of the command line."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from typing import Any

import gymnasium
import heliostat
import numpy as np
import pytest
from test_learning import lab_of, program_or_skip, report_of, zero


def test_a_score_is_that_of_the_held_out_rooms_and_leaves_the_environment_as_it_was() -> None:
    env = heliostat.HeliostatEnv()
    seen, _ = env.reset(seed=4)
    with pytest.warns(UserWarning, match="from 5 episodes; use at least 10"):
        score = heliostat.evaluate(zero, env, states=5)
    assert score.states == score.episodes == 5 and 0.2 < score.ratio_to_oracle < 0.95
    assert score.ratio_to_oracle_ci95 > 0.0 and score.outage_time is None
    assert score.jain is not None and 0.0 < score.jain <= 1.0
    assert 0.0 <= score.ber < 0.5 and score.conditions == ()
    assert score == heliostat.evaluate(zero, env, states=5) and hash(score) is not None
    ratios = np.array(score.each["ratio_to_oracle"], float)
    assert score.each["states"] == (1,) * 5 and ratios.mean() == pytest.approx(score.ratio_to_oracle)
    missing = [value is None for value in score.each["blocked_rate_mbps"]]
    assert len(missing) == 5 and all(missing) == (score.blocked_rate_mbps is None)
    fresh = heliostat.HeliostatEnv()
    fresh.reset(seed=4)
    assert np.array_equal(env.step(zero(seen))[0], fresh.step(zero(seen))[0])
    with pytest.raises(ValueError, match="states = 0"):
        heliostat.evaluate(zero, env, states=0)
    with pytest.raises(TypeError, match="heliostat"):
        heliostat.evaluate(zero, gymnasium.make("CartPole-v1"))


def test_a_policy_may_return_any_array_or_a_list() -> None:
    env = heliostat.HeliostatEnv(action="weights")
    expected = heliostat.evaluate(lambda _: np.zeros(10, np.float32), env, states=10)
    assert heliostat.evaluate(lambda _: np.zeros(10), env, states=10) == expected
    assert heliostat.evaluate(lambda _: [0.0] * 10, env, states=10) == expected
    assert heliostat.evaluate(lambda _: (0,) * 10, env, states=10) == expected


class _Counting:
    """Counts its calls since the last reset, and serves one user after the other."""

    action = "weights"

    def __init__(self) -> None:
        self.calls, self.resets = 0, 0

    def reset(self) -> None:
        self.calls, self.resets = 0, self.resets + 1

    def __call__(self, _: Any) -> Any:
        self.calls += 1
        return np.eye(10, dtype=np.float32)[self.calls % 5]


@pytest.mark.filterwarnings("ignore:the intervals come from")
def test_a_function_with_a_state_is_reset_where_an_episode_begins() -> None:
    act = _Counting()
    static = heliostat.HeliostatEnv(action="weights")
    first = heliostat.evaluate(act, static, states=3)
    assert (act.calls, act.resets) == (1, 3)
    assert heliostat.evaluate(lambda _: np.eye(10)[1], static, states=3) == first
    hall = gymnasium.make("heliostat/Hall-v0", action="weights")
    first = heliostat.evaluate(act, hall, episodes=2)
    assert act.resets == 5 and heliostat.evaluate(act, hall, episodes=2) == first


def test_a_function_for_another_form_of_actions_is_refused() -> None:
    with pytest.raises(ValueError, match='act.action = "weights", and the actions of the environment are angles'):
        heliostat.evaluate(_Counting(), heliostat.HeliostatEnv(), states=1)


def test_a_ratio_has_no_upper_bound() -> None:
    env = heliostat.HeliostatEnv(action="weights", overrides={"users.min_rate_mbps": 5})
    score = heliostat.evaluate(lambda _: np.zeros(10), env, states=10)
    assert score.ratio_to_oracle < 1.0 < score.ratio_to_oracle + score.ratio_to_oracle_ci95
    assert "ratio_to_oracle" not in score.crossing


def test_a_score_of_exact_states_is_that_of_the_command_line() -> None:
    program = program_or_skip()
    env = heliostat.HeliostatEnv(overrides={"blockage.forced_users": 2})
    score = heliostat.evaluate(lambda _: np.zeros(200, np.float32), env, states=10, seeds=2)
    arguments = ("--scenario", "specular", "--set", "blockage.forced_users=2", "--states", "10", "--seeds", "2")
    row, oracle = report_of(program, "flat", *arguments)
    for figure in ("ratio_to_oracle", "jain", "ber", "blocked_rate_mbps"):
        assert getattr(score, figure) == pytest.approx(row[figure]["mean"], rel=1e-6), figure
        assert getattr(score, f"{figure}_ci95") == pytest.approx(row[figure]["ci95"], rel=1e-6), figure
    assert score.oracle_mbps == pytest.approx(oracle["sum_rate_mbps"]["mean"], rel=1e-9)


def test_the_difference_of_two_scores_is_the_paired_one_of_the_command_line() -> None:
    program = program_or_skip()
    env = heliostat.HeliostatEnv()
    flat = heliostat.evaluate(lambda _: np.zeros(200, np.float32), env, states=10, seeds=2)
    turned = heliostat.evaluate(lambda _: np.full(200, 0.1, np.float32), env, states=10, seeds=2)
    command = [lab_of(program), "eval", "--scenario", "specular", "--policies", "fixed-point,flat", "--json"]
    command += ["--states", "10", "--seeds", "2"]
    report = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    # The program has the difference of `flat` to `fixed-point`; its rooms are those of the score.
    (rates,) = report["each"]["policies"]["flat"]["sum_rate_mbps"]
    assert flat.each["sum_rate_mbps"] == pytest.approx(rates, rel=1e-9)
    (others,) = report["each"]["policies"]["fixed-point"]["sum_rate_mbps"]
    expected = report["policies"]["flat"]["difference_mbps"]
    fixed = dataclasses.replace(flat, each={**flat.each, "sum_rate_mbps": tuple(others)})
    assert flat.minus(fixed, "sum_rate_mbps") == pytest.approx((expected["mean"], expected["ci95"]), rel=1e-6)
    mean, half = turned.minus(flat)
    assert mean == pytest.approx(turned.ratio_to_oracle - flat.ratio_to_oracle) and half > 0.0
    assert flat.minus(flat) == (0.0, 0.0)
    for name in ("states", "outage_time", "rate"):
        with pytest.raises(ValueError, match=f"figure = '{name}': expected one of ber, blocked_rate_mbps, "):
            flat.minus(turned, name)
    with pytest.raises(ValueError, match="different rooms: expected the same scenario"):
        flat.minus(heliostat.evaluate(zero, env, states=20), "qos_met")


def test_a_score_has_the_conditions_of_its_scenario() -> None:
    overrides = {"control.belief": "constant-velocity"}
    with pytest.warns(UserWarning):
        env = heliostat.HeliostatEnv("hall", overrides=overrides, dynamics="closed-loop", action="weights")
    with pytest.warns(UserWarning, match="from 1 episode"):
        score = heliostat.evaluate(lambda _: np.zeros(10), env, episodes=1)
    assert score.conditions == env.conditions
    assert any("constant-velocity" in condition for condition in score.conditions), score.conditions


def test_a_score_of_episodes_has_as_many_for_each_seed() -> None:
    for name, states in (("Static-v0", 1), ("Hall-v0", 20)):
        env = gymnasium.make(f"heliostat/{name}")

        def act(_: Any, flat: Any = np.zeros(env.action_space.shape or (), np.float32)) -> Any:
            return flat

        with pytest.warns(UserWarning, match="from 1 episode; use at least 10"):
            score = heliostat.evaluate(act, env, episodes=1)
        assert (score.episodes, score.states) == (1, states)
        with pytest.raises(ValueError, match="states = 20 and episodes = 1: expected one of them"):
            heliostat.evaluate(act, env, states=20, episodes=1)
        with pytest.raises(ValueError, match="episodes = 0: expected an integer from 1"):
            heliostat.evaluate(act, env, episodes=0)


def test_a_score_in_closed_loop_is_that_of_the_command_line() -> None:
    program = program_or_skip()
    arguments = ("--closed-loop", "--scenario", "hall", "--states", "30", "--seeds", "2")
    env = gymnasium.make("heliostat/Hall-v0")
    flat = np.zeros(env.action_space.shape or (), np.float32)
    env.reset(seed=4)
    score = heliostat.evaluate(lambda _: flat, env, states=30, seeds=2)
    row, oracle = report_of(program, "flat", *arguments)
    assert score.states == 60
    for figure in ("ratio_to_oracle", "sum_rate_mbps", "qos_met", "blocked_rate_mbps", "ber", "jain", "outage_time"):
        assert getattr(score, figure) == pytest.approx(row[figure]["mean"], rel=1e-9), figure
        assert getattr(score, f"{figure}_ci95") == pytest.approx(row[figure]["ci95"], rel=1e-6), figure
    crossing = {name for name, value in row.items() if isinstance(value, dict) and value.get("crosses_bound")}
    assert set(score.crossing) - {"oracle_mbps"} == crossing
    assert score.episodes == 4
    assert score.oracle_mbps == pytest.approx(oracle["sum_rate_mbps"]["mean"], rel=1e-9)
    assert score.each["states"] == (20, 10, 20, 10)
    for figure in ("sum_rate_mbps", "qos_met", "jain", "outage_time", "ber", "oracle_mbps"):
        weights = np.array(score.each["states"], float)
        weighted = np.average(np.array(score.each[figure], float), weights=weights)
        assert weighted == pytest.approx(getattr(score, figure), rel=1e-9), figure
    # The environment is as it was.
    fresh = gymnasium.make("heliostat/Hall-v0")
    fresh.reset(seed=4)
    assert np.array_equal(env.step(flat)[0], fresh.step(flat)[0])
