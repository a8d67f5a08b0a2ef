"""The batch: equal to single environments, autoreset, buffers and refusals."""

from __future__ import annotations

import os
import threading
import time
from typing import Any

import gymnasium
import heliostat
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import DictInfoToList
from room import LIMIT_S


def batch(mode: AutoresetMode = AutoresetMode.NEXT_STEP, **keywords: Any) -> heliostat.HeliostatVectorEnv:
    return heliostat.HeliostatVectorEnv(num_envs=3, max_episode_steps=4, autoreset_mode=mode, **keywords)


def actions(step: int, count: int = 3) -> Any:
    return np.random.default_rng(step).uniform(-1, 1, (count, 200)).astype(np.float32)


def test_each_environment_of_a_batch_equals_a_single_one() -> None:
    for keywords in ({}, {"scenario": "hall", "dynamics": "closed-loop"}):
        many = heliostat.HeliostatVectorEnv(num_envs=3, **keywords)  # type: ignore[arg-type]
        single = [heliostat.HeliostatEnv(**keywords) for _ in range(3)]  # type: ignore[arg-type]
        seen, _ = many.reset(seed=5)
        for index, env in enumerate(single):
            assert np.array_equal(env.reset(seed=5 + index)[0], seen[index])
        for step in range(10):
            seen, rewards, _, _, info = many.step(actions(step))
            for index, env in enumerate(single):
                observation, reward, _, _, one = env.step(actions(step)[index])
                assert np.array_equal(observation, seen[index]) and reward == rewards[index]
                assert np.array_equal(one["rates_mbps"], info["rates_mbps"][index])


def test_next_step_ignores_the_action_that_restarts() -> None:
    env = batch()
    env.reset(seed=1)
    for step in range(4):
        seen, rewards, terminated, truncated, _ = env.step(actions(step))
        assert not terminated.any() and truncated.all() == (step == 3)
    restarted, rewards, _, truncated, info = env.step(actions(9))
    assert (rewards == 0.0).all() and not truncated.any() and np.isnan(info["rates_mbps"]).all()
    assert not np.array_equal(restarted, seen)
    single = heliostat.HeliostatEnv()
    single.reset(seed=1)
    assert np.array_equal(single.reset()[0], restarted[0]), "the next room of the same seed"


def test_same_step_returns_the_last_observation_apart() -> None:
    env, reference = batch(AutoresetMode.SAME_STEP), batch()
    env.reset(seed=1)
    reference.reset(seed=1)
    for step in range(4):
        seen, rewards, _, truncated, info = env.step(actions(step))
        expected, expected_rewards, *_ = reference.step(actions(step))
    assert truncated.all() and np.array_equal(rewards, expected_rewards)
    assert all(np.array_equal(info["final_obs"][index], expected[index]) for index in range(3))
    restarted, *_ = reference.step(actions(9))
    assert np.array_equal(seen, restarted)


def test_the_information_has_the_masks_of_gymnasium() -> None:
    names = {"sum_rate_mbps", "qos_met", "rates_mbps", "oracle_mbps"}
    # An episode of three steps; environment 1 restarts after the second step, so that it ends later.
    for mode, restart in ((AutoresetMode.NEXT_STEP, 3), (AutoresetMode.SAME_STEP, 2)):
        env = heliostat.HeliostatVectorEnv(num_envs=3, max_episode_steps=3, autoreset_mode=mode, oracle=True)
        single = heliostat.HeliostatEnv(oracle=True)
        single.reset(seed=1)
        listed = DictInfoToList(env)
        assert listed.reset(seed=1)[1] == [{}, {}, {}]
        for step in range(5):
            *_, truncated, infos = listed.step(actions(step))
            figures = single.step(actions(step)[0])[4] if step < 3 else {}
            others = [set(one) - {"final_obs", "final_info"} for one in (infos[0], infos[2])]
            assert others == 2 * [set() if step == restart else names]
            assert set(infos[1]) - {"final_obs", "final_info"} == (set() if step == restart + 2 else names)
            if mode == AutoresetMode.SAME_STEP and step == 2:
                assert truncated.tolist() == [True, False, True] and "final_info" not in infos[1]
                last = infos[0]["final_info"]
                assert set(last) == names and all(np.array_equal(last[name], figures[name]) for name in names)
            else:
                assert not any("final_info" in one for one in infos) or step == 4
                assert step > 2 or all(np.array_equal(infos[0][name], figures[name]) for name in names)
            if step == 1:
                listed.reset(options={"reset_mask": np.array([False, True, False])})


def test_next_step_accepts_any_action_of_an_environment_that_restarts() -> None:
    env, reference = batch(), batch()
    env.reset(seed=1)
    reference.reset(seed=1)
    for step in range(4):
        env.step(actions(step))
        reference.step(actions(step))
    seen, *_ = env.step(np.full((3, 200), np.nan, np.float32))
    assert np.array_equal(seen, reference.step(actions(4))[0])
    with pytest.raises(ValueError, match="environment 0: the action holds NaN"):
        env.step(np.full((3, 200), np.nan, np.float32))


def test_the_first_reset_is_of_all_environments() -> None:
    env = batch()
    with pytest.raises(ValueError, match="reset_mask leaves out environment 1: the first reset must be of all"):
        env.reset(seed=1, options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(actions(0))
    seen, _ = env.reset(seed=1, options={"reset_mask": np.array([True, True, True])})
    assert np.array_equal(seen, batch().reset(seed=1)[0])


def test_disabled_needs_a_reset_of_the_environments_that_ended() -> None:
    env = batch(AutoresetMode.DISABLED)
    env.reset(seed=1)
    env.step(actions(0))
    before, _ = env.reset(options={"reset_mask": np.array([True, False, False])})
    for step in range(3):
        seen, _, _, truncated, _ = env.step(actions(step))
    assert truncated.tolist() == [False, True, True]
    with pytest.raises(RuntimeError, match="environment 1 has ended"):
        env.step(actions(5))
    restarted, _ = env.reset(options={"reset_mask": truncated})
    assert np.array_equal(restarted[0], seen[0]) and not np.array_equal(restarted[1], seen[1])
    env.step(actions(5))


def test_gymnasium_makes_the_batch_by_its_id() -> None:
    env = gymnasium.make_vec("heliostat/Hall-v0", num_envs=2, vectorization_mode="vector_entry_point")
    seen, _ = env.reset(seed=1)
    assert isinstance(env.unwrapped, heliostat.HeliostatVectorEnv) and seen in env.observation_space
    env.close()


def test_buffers_are_allocated_once_without_copies() -> None:
    env = batch(copy=False)
    first, _ = env.reset(seed=1)
    second, rewards, *_ = env.step(actions(0))
    third, more_rewards, *_ = env.step(actions(1))
    assert np.shares_memory(first, second) and np.shares_memory(second, third)
    assert np.shares_memory(rewards, more_rewards)
    own = batch()
    first, _ = own.reset(seed=1)
    assert not np.shares_memory(first, own.step(actions(0))[0])


def test_an_action_that_is_not_valid_stops_all_environments_before_the_step() -> None:
    env, reference = batch(), batch()
    env.reset(seed=1)
    reference.reset(seed=1)
    bad = actions(0)
    bad[2, 5] = np.inf
    with pytest.raises(ValueError, match="environment 2: the action holds inf at index 5"):
        env.step(bad)
    with pytest.raises(ValueError, match="shape"):
        env.step(actions(0)[:2])
    assert np.array_equal(env.step(actions(0))[0], reference.step(actions(0))[0])
    with pytest.raises(ValueError, match="reset_mask"):
        env.reset(options={"reset_mask": np.array([1, 0, 0])})
    env.close()
    with pytest.raises(RuntimeError, match="closed"):
        env.step(actions(0))


@pytest.mark.parametrize(
    ("keywords", "error", "reason"),
    [
        ({"num_envs": 0}, ValueError, "num_envs = 0: expected an integer from 1 to"),
        ({"num_envs": 10**20}, ValueError, "num_envs = 100000000000000000000"),
        ({"num_envs": 1.5}, TypeError, "num_envs = 1.5"),
        ({"num_envs": "4"}, TypeError, "num_envs = '4'"),
        ({"max_episode_steps": 2**70}, ValueError, "max_episode_steps = 1180591620717411303424"),
        ({"max_episode_steps": float("nan")}, TypeError, "max_episode_steps = nan"),
    ],
)
def test_absurd_sizes_are_refused_by_name(keywords: dict[str, Any], error: type[Exception], reason: str) -> None:
    with pytest.raises(error, match=reason):
        heliostat.HeliostatVectorEnv(**keywords)


def test_seeds_of_another_type_are_refused_by_name() -> None:
    env = batch()
    with pytest.raises(TypeError, match="seed = 1.5"):
        env.reset(seed=[1, 1.5, 2])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="dtype complex128"):
        env.reset(seed=1)
        env.step(np.zeros((3, 200), complex))


def test_other_threads_run_while_a_batch_steps() -> None:
    # A step of a larger batch on more processors takes as long.
    count = 16 * (os.cpu_count() or 1)
    env = heliostat.HeliostatVectorEnv("hall", num_envs=count, dynamics="closed-loop", oracle=True)
    env.reset(seed=1)
    ticks: list[float] = []
    stop = threading.Event()

    def tick() -> None:
        while not stop.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.0005)

    thread = threading.Thread(target=tick, daemon=True)
    thread.start()
    last, most = time.monotonic() + LIMIT_S, 0
    # On a busy machine the other thread may get no processor in a step. With the lock held it could have one turn
    # before the step and one after.
    while most < 4 and time.monotonic() < last:
        begun = time.perf_counter()
        env.step(np.zeros((count, 200), np.float32))
        ended = time.perf_counter()
        most = max(most, sum(begun < at < ended for at in ticks))
    stop.set()
    thread.join(LIMIT_S)
    assert most >= 4, f"{most} turns of the other thread in a step"


@pytest.mark.parametrize("count", [-1, 10**9, None])
def test_a_number_of_environments_outside_its_bounds_is_refused(count: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=r"num_envs = .*: expected an integer from 1 to 16384"):
        heliostat.HeliostatVectorEnv("specular", num_envs=count)


@pytest.mark.parametrize("seed", [-1, 2**64, 2.5, "x", [1, -1], [1, "x"]])
def test_a_seed_outside_its_bounds_is_refused(seed: Any) -> None:
    env = heliostat.HeliostatVectorEnv("specular", num_envs=2)
    with pytest.raises((TypeError, ValueError), match=r"seed = .*: expected an integer from 0 to 2\*\*64 - 1"):
        env.reset(seed=seed)
    env.reset(seed=np.array([1, 2]))  # type: ignore[arg-type]
    env.close()
