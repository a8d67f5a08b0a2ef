"""Export, Stable-Baselines3 and scores; skipped where PyTorch or Stable-Baselines3 is absent."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import heliostat
import numpy as np
import pytest
from heliostat.names import ActionForm


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


def test_an_exported_network_of_weights_gives_the_angles_of_the_environment(tmp_path: Path) -> None:
    torch = torch_or_skip()
    for name, settings in [("heliostat/Static-v0", {}), ("heliostat/Paper-v0", {"observation": "flat"})]:
        env = gymnasium.make(name, action="weights", **settings).unwrapped  # type: ignore[arg-type]
        assert isinstance(env, heliostat.HeliostatEnv)
        module = module_of(env, torch)
        policy = heliostat.Policy(str(heliostat.export_onnx(module, env, tmp_path / "own.onnx")), env.scenario)
        for seed in range(5):
            observation, _ = env.reset(seed=seed)
            roll, yaw = policy.answer(observation)
            with torch.no_grad():
                env.step(module(torch.from_numpy(observation)[None])[0].numpy())
            turned = env.state()
            assert np.concatenate([roll, yaw]) == pytest.approx(np.concatenate([turned["roll"], turned["yaw"]]), abs=2e-5)
            assert np.ptp(roll) > 0.1


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
    refused: list[tuple[dict[str, Any], str]] = [
        ({"observation": "belief"}, 'observation = .belief.: expected "flat" or "paper"'),
    ]
    for settings, reason in refused:
        with pytest.raises(ValueError, match=reason):
            heliostat.export_onnx(module_of(env, torch), heliostat.HeliostatEnv(**settings), path)
    diverged = module_of(env, torch)
    with torch.no_grad():
        diverged[0].weight[0, 0] = float("nan")
    with pytest.raises(ValueError, match="not finite"):
        heliostat.export_onnx(diverged, env, path)
    assert not path.exists()
    path.write_bytes(b"no network")
    with pytest.raises(ValueError, match="not an ONNX model"):
        heliostat.Policy(str(path))
    path.write_bytes(b"<!DOCTYPE html>")
    with pytest.raises(ValueError, match="it is a web page"):
        heliostat.Policy(str(path))
    heliostat.export_onnx(module_of(env, torch), env, path)
    with pytest.raises(ValueError, match="optical geometry"):
        heliostat.Policy(str(path), overrides={"room.height_m": 3.2})


class Sampling:
    """Makes modules that sample, as during a training."""

    @staticmethod
    def module(env: Any, torch: Any) -> Any:
        class Noisy(torch.nn.Module):  # type: ignore[misc]
            def __init__(self) -> None:
                super().__init__()
                self.mean = module_of(env, torch)

            def forward(self, observation: Any, deterministic: bool = False) -> Any:
                mean = self.mean(observation)
                return mean if deterministic else torch.tanh(mean + 0.3 * torch.randn_like(mean))

        return Noisy()


def test_what_is_no_module_of_actions_is_refused_with_what_to_pass(tmp_path: Path) -> None:
    torch = torch_or_skip()
    env = heliostat.HeliostatEnv()
    noisy = Sampling.module(env, torch)

    class Drawing(torch.nn.Module):  # type: ignore[misc, name-defined]
        def forward(self, observation: Any) -> Any:
            return noisy(observation)

    class Several(torch.nn.Module):  # type: ignore[misc, name-defined]
        def forward(self, observation: Any) -> Any:
            return observation[:, :200], 0.0, 0.0

    with pytest.raises(ValueError, match="Drawing samples: .*deterministic"):
        heliostat.export_onnx(Drawing(), env, tmp_path / "own.onnx")
    with pytest.raises(ValueError, match=r"Several returns 3 values: .*ppo\.py"):
        heliostat.export_onnx(Several(), env, tmp_path / "own.onnx")
    with pytest.raises(TypeError, match="expected a torch.nn.Module, found <lambda>"):
        heliostat.export_onnx(lambda seen: seen, env, tmp_path / "own.onnx")
    with pytest.raises(ValueError, match="on the device meta: pass module.cpu"):
        heliostat.export_onnx(torch.nn.Linear(1370, 200, device="meta"), env, tmp_path / "own.onnx")
    assert not (tmp_path / "own.onnx").exists()
    # The deterministic action of a module that has one.
    policy = heliostat.Policy(str(heliostat.export_onnx(noisy, env, tmp_path / "own.onnx")))
    observation, _ = env.reset(seed=1)
    with torch.no_grad():
        expected = noisy.mean(torch.from_numpy(observation)[None])[0].numpy() * env.scenario.range_rad
    assert np.concatenate(policy.answer(observation)) == pytest.approx(expected, abs=2e-5)


def program_or_skip() -> str:
    program = os.environ.get("HELIOSTAT_PROGRAM")
    if program is None:
        pytest.skip("HELIOSTAT_PROGRAM names no program")
    return program


def lab_of(program: str) -> str:
    """The program of the laboratory, beside `heliostat`."""
    return str(Path(program).with_name("heliostat-lab"))


def report_of(program: str, policy: str, *arguments: str) -> tuple[Any, Any]:
    """The rows of a policy and of the oracle."""
    command = [lab_of(program), "eval", "--policies", policy, "--json", *arguments]
    report = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    (row,) = report["policies"].values()
    return row, report["oracle"]


FORMS = [
    ("heliostat/Static-v0", {}),
    ("heliostat/Static-v0", {"action": "weights"}),
    ("heliostat/Hall-v0", {}),
    ("heliostat/Hall-v0", {"action": "weights"}),
]


def exported(name: str, settings: Any, torch: Any, path: Path) -> tuple[heliostat.HeliostatEnv, Any]:
    """An environment with a network for it, which is in the file, and its actions."""
    env = gymnasium.make(name, **settings).unwrapped
    assert isinstance(env, heliostat.HeliostatEnv)
    module = module_of(env, torch)
    heliostat.export_onnx(module, env, path)

    def act(observation: Any) -> Any:
        rows = torch.from_numpy(observation).reshape(1, -1)
        with torch.no_grad():
            return module(rows).numpy().ravel()

    return env, act


@pytest.mark.parametrize(("name", "settings"), FORMS)
def test_the_command_line_gives_an_exported_network_the_same_score(name: str, settings: Any, tmp_path: Path) -> None:
    torch, program = torch_or_skip(), program_or_skip()
    env, act = exported(name, settings, torch, tmp_path / "own.onnx")
    score = heliostat.evaluate(act, env, states=20)
    room = ["--scenario", "specular"] if env.is_static else ["--closed-loop", "--scenario", "hall"]
    row, oracle = report_of(program, str(tmp_path / "own.onnx"), *room, "--states", "20", "--seeds", "1")
    assert row["ratio_to_oracle"]["mean"] == pytest.approx(score.ratio_to_oracle, abs=0.005)
    assert oracle["sum_rate_mbps"]["mean"] == pytest.approx(score.oracle_mbps, rel=1e-9)
    # An action of zero has another score: the network matters.
    assert abs(heliostat.evaluate(lambda seen: 0 * act(seen), env, states=20).ratio_to_oracle - score.ratio_to_oracle) > 1e-4


@pytest.mark.parametrize("settings", [{}, {"action": "weights"}])
def test_an_exported_network_moves_the_mirrors_of_the_demo(settings: Any, tmp_path: Path) -> None:
    torch, program = torch_or_skip(), program_or_skip()
    exported("heliostat/Hall-v0", settings, torch, tmp_path / "own.onnx")
    command = [program, "demo", "--scenario", "hall", "--model", str(tmp_path / "own.onnx"), "--seconds", "3"]
    shown = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rates = dict(re.findall(r"^(\S.*?)\s{2,}(\d+\.\d\d)\s+\d\.\d+$", shown, re.MULTILINE))
    own, flat = (float(rate) for name, rate in rates.items() if name in ("ddpg", "flat"))
    assert own != flat, shown
    assert int(re.search(r"commands (\d+)", shown)[1]) > 10, shown  # type: ignore[index]


CHECKED: list[dict[str, Any]] = [
    {},
    *({"action": action, "observation": form} for action in ("angles", "weights") for form in ("flat", "belief", "dict")),
]


@pytest.mark.parametrize(("name", "settings"), [(name, form) for name in heliostat.envs.IDS for form in CHECKED])
def test_the_checker_of_stable_baselines_accepts_each_environment(name: str, settings: dict[str, Any]) -> None:
    torch_or_skip()
    checker = pytest.importorskip("stable_baselines3.common.env_checker", exc_type=ImportError)
    with warnings.catch_warnings():
        if settings.get("observation") == "dict":
            # Its MultiInputPolicy flattens the parts.
            warnings.filterwarnings("ignore", message="Your observation .* has an unconventional shape")
        checker.check_env(gymnasium.make(name, **settings).unwrapped)


def stable_baselines_or_skip() -> Any:
    torch_or_skip()
    return pytest.importorskip("stable_baselines3", exc_type=ImportError)


@pytest.mark.parametrize("oracle", [False, True])
def test_the_information_of_each_environment_has_the_figures_of_the_batch(oracle: bool) -> None:
    stable_baselines_or_skip()
    from heliostat.sb3 import HeliostatVecEnv

    settings: dict[str, Any] = {"num_envs": 3, "max_episode_steps": 2, "action": "weights", "oracle": oracle}
    env, batch = HeliostatVecEnv(**settings), heliostat.HeliostatVectorEnv(**settings, autoreset_mode="SameStep")
    env.seed(5)
    env.reset()
    batch.reset(seed=5)
    names = {"sum_rate_mbps", "qos_met", "rates_mbps"} | ({"oracle_mbps"} if oracle else set())
    for _ in range(2):
        _, _, dones, infos = env.step(np.zeros((3, 10), np.float32))
        expected = batch.step(np.zeros((3, 10), np.float32))[4]
        for index, info in enumerate(infos):
            assert set(info) - {"TimeLimit.truncated", "terminal_observation"} == names
            for name in names:
                assert np.array_equal(info[name], expected[name][index], equal_nan=True) and np.isfinite(info[name]).any()
    assert dones.all() and infos[0]["rates_mbps"].shape == (batch.step(np.zeros((3, 10), np.float32))[4]["rates_mbps"].shape[1],)
    assert len({info["sum_rate_mbps"] for info in infos}) == 3
    env.close()
    batch.close()


def test_stable_baselines_trains_on_the_parts_of_observations() -> None:
    sb3 = stable_baselines_or_skip()
    from heliostat.sb3 import HeliostatVecEnv

    env = HeliostatVecEnv(num_envs=2, max_episode_steps=10, action="weights", observation="dict")
    model = sb3.PPO("MultiInputPolicy", env, n_steps=16, batch_size=16, n_epochs=1, seed=1, device="cpu")
    model.learn(32)
    assert model.num_timesteps == 32
    env.close()


def test_options_of_a_reset_are_refused_by_the_batch_and_not_ignored() -> None:
    stable_baselines_or_skip()
    from heliostat.sb3 import HeliostatVecEnv

    env = HeliostatVecEnv(num_envs=2, action="weights")
    env.set_options({"held_out": 0})
    with pytest.raises(ValueError, match="have no options of a reset"):
        env.reset()
    assert env.reset().shape == (2, 1370), "the next reset has none"
    env.close()


def test_stable_baselines_trains_on_the_batch() -> None:
    sb3 = stable_baselines_or_skip()
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


EXAMPLES = Path(__file__).parents[1] / "examples"


def ran(script: str, *arguments: object) -> str:
    """What an example prints."""
    command = [sys.executable, str(EXAMPLES / script), *map(str, arguments)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def assert_acts(path: Path, scenario: str, action: ActionForm) -> None:
    """An exported file turns the mirrors of its room, and in another way than an action of zeros."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the model of late, noisy and lost reports does not apply")
        env = heliostat.HeliostatEnv(scenario, action=action)
    observation, _ = env.reset(seed=1)
    angles = np.concatenate(heliostat.Policy(str(path), env.scenario).answer(observation))
    assert env.action_space.shape is not None
    env.step(np.zeros(env.action_space.shape, np.float32))
    zero = env.state()
    assert np.abs(angles - np.concatenate([zero["roll"], zero["yaw"]])).max() > 1e-3


@pytest.mark.parametrize(
    ("script", "room", "arguments"),
    [
        ("ppo.py", ("hall", "weights"), ("--steps", 1024, "--states", 4)),
        ("ddpg_continuous_action.py", ("specular", "angles"), (1600,)),
    ],
)
def test_an_example_trains_scores_and_exports(script: str, room: Any, arguments: Any, tmp_path: Path) -> None:
    stable_baselines_or_skip()
    printed = ran(script, tmp_path / "own.onnx", *arguments)
    found = re.search(r"sum rate over the oracle's: (\d\.\d+)", printed)
    assert found and 0.1 < float(found[1]) < 1.0, printed
    assert_acts(tmp_path / "own.onnx", *room)


def test_the_example_of_soft_actor_critic_trains_and_reports_its_checkpoints(tmp_path: Path) -> None:
    stable_baselines_or_skip()
    folder, page = tmp_path / "training", tmp_path / "page.md"
    ran("sac.py", "train", folder, "--steps", 1200)
    ran("sac.py", "report", folder, "--states", 4, "--seeds", 1, "--page", page)
    checkpoints = json.loads((folder / "checkpoints.json").read_text())
    assert checkpoints[-1]["steps"] == 1200
    written = page.read_text()
    outcome = re.search(r"ratio (\d\.\d{4}) to the oracle. That is (\S+).* the ratio (\d\.\d{4}) of action 0", written)
    assert outcome, written
    own, zero = float(outcome[1]), float(outcome[3])
    assert outcome[2] == ("below" if own < zero else "above") or own == zero
    assert written.count("| 1200 | ") == 1 and f"for 1200 steps, and {checkpoints[-1]['processor_s']:.0f} s" in written
    assert_acts(folder / "own.onnx", "hall", "weights")
    # A program that refuses the file: its message is printed, and no checkpoint is scored before.
    lab = tmp_path / "heliostat-lab"
    lab.write_text("#!/bin/sh\necho 'error: own.onnx is refused' >&2\nexit 2\n")
    lab.chmod(0o755)
    command = [sys.executable, str(EXAMPLES / "sac.py"), "report", str(folder), "--program", str(tmp_path / "heliostat")]
    refused = subprocess.run(command, check=False, capture_output=True, text=True)
    assert refused.returncode == 1 and "Traceback" not in refused.stderr, refused.stderr
    assert "error: own.onnx is refused\nexit status 2, expected 0: " in refused.stderr, refused.stderr
    assert " steps: " not in refused.stdout, refused.stdout


def test_the_optional_part_that_exports_networks_brings_the_library_that_runs_them() -> None:
    required = importlib.metadata.requires("heliostat") or []
    exported = [line for line in required if "export" in line.partition("extra")[2]]
    assert any(line.startswith("onnxruntime") for line in exported), required
