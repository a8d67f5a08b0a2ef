"""The environments for several learners: the checks of PettingZoo, and agreement with the environment of one learner."""

from __future__ import annotations

from typing import Any

import heliostat
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

pytest.importorskip("pettingzoo", reason="pettingzoo is not installed")
from heliostat.multiagent import parallel_env
from heliostat.names import Agents
from pettingzoo.test import parallel_api_test, parallel_seed_test

FEW: dict[str, Any] = {"overrides": {"users.count": 3, "mirrors.rows": 2, "mirrors.columns": 3}}
HALL: dict[str, Any] = {"scenario": "hall", "dynamics": "closed-loop", **FEW}
TWO_WALLS = """
name = "two-walls"
[[mirrors]]
rows = 2
columns = 3
[[mirrors]]
rows = 1
columns = 2
wall = "-x"
"""


@pytest.mark.parametrize("agents", ["users", "arrays"])
@pytest.mark.parametrize("settings", [FEW, HALL])
def test_the_checks_of_pettingzoo_pass(agents: Agents, settings: dict[str, Any]) -> None:
    env = parallel_env(agents, max_steps=20, **settings)
    parallel_api_test(env, num_cycles=100)
    env.close()
    parallel_seed_test(lambda: parallel_env(agents, max_steps=20, **settings), num_cycles=20)


def test_users_as_agents_choose_the_weights_of_one_learner_and_see_their_own_row_first() -> None:
    env, one = parallel_env("users", max_steps=5, **HALL), heliostat.HeliostatEnv(action="weights", observation="belief", **HALL)
    with pytest.raises(ResetNeeded, match="before the first state"):
        env.state()
    seen, _ = env.reset(seed=4)
    expected, _ = one.reset(seed=4)
    generator = np.random.default_rng(2)
    assert env.possible_agents == ["user_0", "user_1", "user_2"] and one.slots > 3
    for step in range(1, 6):
        rows = expected.reshape(one.slots, -1)
        np.testing.assert_array_equal(env.state(), expected)
        assert env.state_space.contains(env.state()), "the state of all agents"
        assert not rows[3:].any(), "users have the first slots"
        for slot in range(3):
            own = seen[f"user_{slot}"].reshape(3, -1)
            np.testing.assert_array_equal(own[0], rows[slot])
            np.testing.assert_array_equal(np.sort(own, axis=0), np.sort(rows[:3], axis=0))
        weights = np.zeros(one.slots, np.float32)
        weights[:3] = generator.uniform(-1, 1, 3)
        seen, rewards, terminations, truncations, infos = env.step({f"user_{slot}": weights[slot : slot + 1] for slot in range(3)})
        expected, reward, _, _, info = one.step(weights)
        assert set(rewards.values()) == {reward} and not any(terminations.values())
        assert set(truncations.values()) == {step == 5}
        assert infos["user_0"]["sum_rate_mbps"] == info["sum_rate_mbps"]
    assert env.agents == []
    with pytest.raises(ValueError, match="expected reset"):
        env.step({})


def test_arrays_as_agents_choose_and_see_their_own_mirrors(tmp_path: Any) -> None:
    file = tmp_path / "two.toml"
    file.write_text(TWO_WALLS, encoding="utf-8")
    env, one = parallel_env("arrays", scenario=file), heliostat.HeliostatEnv(file)
    assert env.possible_agents == ["array_0", "array_1"]
    assert [env.action_space(agent).shape for agent in env.possible_agents] == [(12,), (4,)]
    env.reset(seed=1)
    one.reset(seed=1)
    roll, yaw = np.linspace(-0.5, 0.5, 8, dtype=np.float32), np.linspace(0.3, -0.3, 8, dtype=np.float32)
    seen, rewards, *_ = env.step(
        {"array_0": np.concatenate([roll[:6], yaw[:6]]), "array_1": np.concatenate([roll[6:], yaw[6:]])}
    )
    flat, reward, *_ = one.step(np.concatenate([roll, yaw]))
    assert rewards == {"array_0": reward, "array_1": reward}
    indices, shape = one.parts["angles"]
    angles = flat[indices].reshape(shape)
    np.testing.assert_array_equal(seen["array_0"][-12:], angles[:, :6].reshape(-1))
    np.testing.assert_array_equal(seen["array_1"][-4:], angles[:, 6:].reshape(-1))
    assert angles[0, 7] != angles[0, 0]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [({"agents": "mirrors"}, 'expected "users" or "arrays"'), ({"action": "angles"}, "agents choose"), ({"max_steps": 0}, "max_steps")],
)
def test_settings_that_do_not_fit_are_refused(arguments: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        parallel_env(**arguments)


def test_actions_that_do_not_fit_are_refused_with_the_agent() -> None:
    env = parallel_env("users", **FEW)
    env.reset(seed=1)
    actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    with pytest.raises(ValueError, match="no action of user_2"):
        env.step({agent: action for agent, action in actions.items() if agent != "user_2"})
    with pytest.raises(ValueError, match=r"an action of user_1 of shape \(2,\), expected \(1,\)"):
        env.step({**actions, "user_1": np.zeros(2, np.float32)})


def test_a_warning_about_the_scenario_names_the_code_that_makes_the_environment(tmp_path: Any) -> None:
    file = tmp_path / "room.toml"
    file.write_text("[actuator]\nstuck_share = 0.5\n")
    with pytest.warns(UserWarning, match="a static room") as warned:
        parallel_env("users", scenario=file).close()
    assert [warning.filename for warning in warned] == [__file__]
