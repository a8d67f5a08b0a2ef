"""Steps per second of processor time: Rust, Python single, batch of 64, and the paper's room in NumPy.

    python python/benchmarks/rates.py

Needs cargo for the Rust rates. All parts run one after the other, several times in turn; the table has the best of
each, which other processes disturb least.
"""

from __future__ import annotations

import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium
import heliostat
import numpy as np
from numpy_room import NumpyRoom

ROUNDS = 5
STEPS = {"Static": 8000, "Hall": 1500, "Office": 800, "Paper": 20000}
RUST_NAMES = {"Static": "static", "Hall": "hall", "Office": "office", "Paper": "paper"}


def rust(name: str) -> float:
    """Steps per second of processor time of the Rust environment, its start included."""
    root = Path(__file__).parents[2]
    with tempfile.TemporaryDirectory() as folder:
        program = root / "target/release/examples/trajectory"
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        subprocess.run([program, str(STEPS[name]), os.devnull, RUST_NAMES[name]], check=True, capture_output=True, cwd=folder)
        return STEPS[name] / (resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)


def timed(step: Any, count: int, each: int) -> float:
    begun = time.process_time()
    for _ in range(count):
        step()
    return count * each / (time.process_time() - begun)


def main() -> None:
    root = Path(__file__).parents[2]
    build = ["cargo", "build", "--release", "--quiet", "-p", "heliostat-environment", "--example", "trajectory"]
    subprocess.run(build, check=True, cwd=root)
    print("steps per second of processor time, the best of", ROUNDS)
    print("environment        Rust  Python single   of Rust  batch of 64   of Rust")
    for name, steps in STEPS.items():
        env = gymnasium.make(f"heliostat/{name}-v0").unwrapped
        many = gymnasium.make_vec(f"heliostat/{name}-v0", num_envs=64, vectorization_mode="vector_entry_point", copy=False)
        env.reset(seed=7)
        many.reset(seed=7)
        action, actions = env.action_space.sample(), many.action_space.sample()
        best = np.zeros(3)
        for _ in range(ROUNDS):
            single = timed(lambda: env.step(action), steps, 1)
            batch = timed(lambda: many.step(actions), max(steps // 64, 4), 64)
            best = np.maximum(best, [rust(name), single, batch])
        print(f"{name:11} {best[0]:11.0f} {best[1]:14.0f} {best[1] / best[0]:9.2f} {best[2]:12.0f} {best[2] / best[0]:9.2f}")
        if name == "Paper":
            room = NumpyRoom(np.zeros((0, 4)))
            rate = max(timed(lambda: room.step(action), 2000, 1) for _ in range(ROUNDS))
            print(f"{'in NumPy':11} {rate:11.0f}; Python single over NumPy {best[1] / rate:.1f}")
        env.close()
        many.close()
    env = heliostat.HeliostatEnv()
    env.reset(seed=1)
    action = env.action_space.sample()
    sizes = []
    for index in range(1_000_001):
        env.step(action)
        if index in (100_000, 1_000_000):
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    print(f"largest memory after 1e5 and 1e6 steps: {sizes[0]} and {sizes[1]} KiB")


if __name__ == "__main__":
    main()
