"""Export, Stable-Baselines3 and scores; skipped where PyTorch or Stable-Baselines3 is absent."""

from __future__ import annotations

import json
import os
import subprocess
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import heliostat
import numpy as np
import pytest


def zero(observation: Any) -> Any:
    return np.zeros(200, np.float32)


def torch_or_skip() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("torch", exc_type=ImportError)


def module_of(env: Any, torch: Any, width: int = 16) -> Any:
    torch.manual_seed(1)
    inputs, outputs = env.observation_space.shape[0], env.action_space.shape[0]
    return torch.nn.Sequential(
        torch.nn.Linear(inputs, width), torch.nn.Tanh(), torch.nn.Linear(width, outputs), torch.nn.Tanh()
    )


def test_a_score_is_that_of_the_held_out_rooms_and_leaves_the_environment_as_it_was() -> None:
    env = heliostat.HeliostatEnv()
    seen, _ = env.reset(seed=4)
    score = heliostat.evaluate(zero, env, states=5)
    assert score.states == 5 and 0.2 < score.ratio_to_oracle < 0.95
    assert score == heliostat.evaluate(zero, env, states=5)
    fresh = heliostat.HeliostatEnv()
    fresh.reset(seed=4)
    assert np.array_equal(env.step(zero(seen))[0], fresh.step(zero(seen))[0])
    with pytest.raises(ValueError, match="static"):
        heliostat.evaluate(zero, heliostat.HeliostatEnv("hall", dynamics="closed-loop"))
    with pytest.raises(TypeError, match="heliostat"):
        heliostat.evaluate(zero, gymnasium.make("CartPole-v1"))


@pytest.mark.parametrize("name", ["heliostat/Static-v0", "heliostat/Paper-v0"])
def test_an_exported_network_gives_the_angles_of_the_environment(name: str, tmp_path: Path) -> None:
    torch = torch_or_skip()
    env = gymnasium.make(name).unwrapped
    assert isinstance(env, heliostat.HeliostatEnv)
    module = module_of(env, torch)
    with torch.no_grad():
        # So that some outputs are beyond the bounds before tanh, and the metadata matters.
        module[2].weight *= 5.0
    path = heliostat.export_onnx(module, env, tmp_path / "own.onnx")
    policy = heliostat.Policy(str(path), env.scenario)
    flat = heliostat.HeliostatEnv(env.scenario, dynamics="static")
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        vector, _ = flat.reset(seed=seed)
        with torch.no_grad():
            action = module(torch.from_numpy(observation)[None])[0].numpy()
        roll, yaw = policy.answer(vector)
        expected = action.astype(np.float64) * env.scenario.range_rad
        assert np.concatenate([roll, yaw]) == pytest.approx(expected, abs=2e-5)
        assert np.ptp(expected) > 0.1


def test_networks_that_no_controller_accepts_are_refused_with_the_reason(tmp_path: Path) -> None:
    torch = torch_or_skip()
    env = heliostat.HeliostatEnv()
    path = tmp_path / "own.onnx"
    with pytest.raises(ValueError, match=r"shape \(1, 7\) for one observation, expected \(1, 200\)"):
        heliostat.export_onnx(torch.nn.Linear(1370, 7), env, path)
    with pytest.raises(ValueError, match="weights"):
        heliostat.export_onnx(module_of(env, torch), heliostat.HeliostatEnv(action="weights"), path)
    with pytest.raises(ValueError, match="belief"):
        heliostat.export_onnx(module_of(env, torch), heliostat.HeliostatEnv(observation="belief"), path)
    diverged = module_of(env, torch)
    with torch.no_grad():
        diverged[0].weight[0, 0] = float("nan")
    with pytest.raises(ValueError, match="not finite"):
        heliostat.export_onnx(diverged, env, path)
    assert not path.exists()
    path.write_bytes(b"no network")
    with pytest.raises(ValueError, match="not an ONNX model"):
        heliostat.Policy(str(path))
    heliostat.export_onnx(module_of(env, torch), env, path)
    with pytest.raises(ValueError, match="optical geometry"):
        heliostat.Policy(str(path), overrides={"room.height_m": 3.2})


def test_the_command_line_gives_an_exported_network_the_same_score(tmp_path: Path) -> None:
    program = os.environ.get("HELIOSTAT_PROGRAM")
    if program is None:
        pytest.skip("HELIOSTAT_PROGRAM names no program")
    torch = torch_or_skip()
    env = heliostat.HeliostatEnv()
    module = module_of(env, torch)
    path = heliostat.export_onnx(module, env, tmp_path / "own.onnx")

    def act(observation: Any) -> Any:
        with torch.no_grad():
            return module(torch.from_numpy(observation)[None])[0].numpy()

    score = heliostat.evaluate(act, env, states=20)
    command = [program, "eval", "--policies", str(path), "--states", "20", "--seeds", "1", "--json"]
    report = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    (row,) = report["policies"].values()
    assert row["ratio_to_oracle"]["mean"] == pytest.approx(score.ratio_to_oracle, abs=0.005)
    assert report["oracle"]["sum_rate_mbps"]["mean"] == pytest.approx(score.oracle_mbps, rel=1e-9)


@pytest.mark.parametrize("name", list(heliostat.envs.IDS))
@pytest.mark.parametrize("action", ["angles", "weights"])
def test_the_checker_of_stable_baselines_accepts_each_environment(name: str, action: str) -> None:
    torch_or_skip()
    checker = pytest.importorskip("stable_baselines3.common.env_checker", exc_type=ImportError)
    checker.check_env(gymnasium.make(name, action=action).unwrapped)
    checker.check_env(gymnasium.make(name, action=action, observation="belief").unwrapped)


def test_stable_baselines_trains_on_the_batch() -> None:
    torch_or_skip()
    sb3 = pytest.importorskip("stable_baselines3", exc_type=ImportError)
    from heliostat.sb3 import HeliostatVecEnv

    env = HeliostatVecEnv(num_envs=4, max_episode_steps=10, action="weights")
    env.seed(3)
    first = env.reset()
    assert np.array_equal(first[1], heliostat.HeliostatEnv(action="weights").reset(seed=4)[0])
    for _ in range(10):
        _, rewards, dones, infos = env.step(np.zeros((4, 10), np.float32))
    assert dones.all() and infos[2]["TimeLimit.truncated"] and infos[2]["terminal_observation"].shape == (1370,)
    model = sb3.PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, seed=1, device="cpu")
    before = [weight.detach().clone() for weight in model.policy.parameters()]
    model.learn(128)
    assert any((one != two).any() for one, two in zip(before, model.policy.parameters(), strict=True))
    env.close()
