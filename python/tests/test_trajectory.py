"""Runs of the package against runs of the Rust environments, bit for bit.

HELIOSTAT_TRAJECTORY names the file that `cargo run --release -p heliostat-environment --example trajectory --
1000 FILE` wrote; without it the test is skipped.
"""

from __future__ import annotations

import os
from typing import Any

import gymnasium
import heliostat
import numpy as np
import pytest

STEPS = 1000
ENVIRONMENTS: list[tuple[str, dict[str, Any]]] = [
    ("heliostat/Static-v0", {}),
    ("heliostat/Static-v0", {"action": "weights"}),
    ("heliostat/Hall-v0", {}),
    ("heliostat/Hall-v0", {"action": "weights"}),
    ("heliostat/Office-v0", {}),
    ("heliostat/Paper-v0", {}),
]


def test_a_thousand_steps_of_each_environment_equal_those_of_rust() -> None:
    path = os.environ.get("HELIOSTAT_TRAJECTORY")
    if path is None:
        pytest.skip("HELIOSTAT_TRAJECTORY names no file")
    at = 0
    with open(path, "rb") as file:
        expected = file.read()
    for name, keywords in ENVIRONMENTS:
        env = gymnasium.make(name, **keywords).unwrapped
        assert isinstance(env, heliostat.HeliostatEnv)
        env.reset(seed=7)
        indices = np.arange(env.action_space.shape[0])  # type: ignore[index]
        for step in range(STEPS):
            # In f32, as in Rust.
            action = ((indices * 7 + step * 3) % 11).astype(np.float32) / np.float32(10.0) - np.float32(0.5)
            observation, reward, _, _, info = env.step(action)
            row = np.array([reward, info["sum_rate_mbps"]]).tobytes() + observation.tobytes()
            assert row == expected[at : at + len(row)], f"{name} {keywords}, step {step}"
            at += len(row)
    assert at == len(expected)
