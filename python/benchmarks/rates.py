"""Steps per second of processor time: Rust, Python single, batch of 64, and rooms in NumPy.

    python python/benchmarks/rates.py [--page docs/results/python.md]

Needs cargo for the Rust rates. All parts run one after the other, several times in turn; the table has the best of
each, which other processes disturb least.
"""

from __future__ import annotations

import argparse
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
from numpy_room import PaperRoom, StaticRoom

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


def obstacles() -> Any:
    """The obstacles of a room of the default scenario."""
    env = heliostat.HeliostatEnv("specular", overrides={"blockage.bodies": False})
    env.reset(seed=7)
    return env.state()["blockers"]


def speeds(name: str, steps: int, rounds: int) -> str:
    """The row of an environment."""
    env = gymnasium.make(f"heliostat/{name}-v0").unwrapped
    many = gymnasium.make_vec(f"heliostat/{name}-v0", num_envs=64, vectorization_mode="vector_entry_point", copy=False)
    env.reset(seed=7)
    many.reset(seed=7)
    action, actions = env.action_space.sample(), many.action_space.sample()
    numpy_room: Any = {"Paper": lambda: PaperRoom(np.zeros((0, 4))), "Static": lambda: StaticRoom(obstacles())}.get(name)
    room = numpy_room() if numpy_room else None
    best = np.zeros(4)
    for _ in range(rounds):
        single = timed(lambda: env.step(action), steps, 1)
        batch = timed(lambda: many.step(actions), max(steps // 64, 4), 64)
        in_numpy = timed(lambda: room.step(action), max(steps // 40, 20), 1) if room else 0.0
        best = np.maximum(best, [rust(name), single, batch, in_numpy])
    env.close()
    many.close()
    by_rust, single, batch, in_numpy = best
    times = f"{in_numpy:.0f} | {single / in_numpy:.1f} | {batch / in_numpy:.1f}" if room else "| | "
    return f"| {name} | {by_rust:.0f} | {single:.0f} | {single / by_rust:.2f} | {batch:.0f} | {batch / by_rust:.2f} | {times} |"


def memory(steps: int) -> str:
    """The largest memory of the process after a tenth of the steps and after all."""
    env = heliostat.HeliostatEnv()
    env.reset(seed=1)
    action = env.action_space.sample()
    sizes = []
    for index in range(steps + 1):
        env.step(action)
        if index in (steps // 10, steps):
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    env.close()
    return f"Largest memory after {steps // 10} and {steps} steps of `Static`: {sizes[0]} and {sizes[1]} KiB."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="repetitions, of which the best counts")
    parser.add_argument("--memory-steps", type=int, default=1_000_000)
    parser.add_argument("--page", type=Path, help="the page to write")
    arguments = parser.parse_args()
    root = Path(__file__).parents[2]
    build = ["cargo", "build", "--release", "--quiet", "-p", "heliostat-environment", "--example", "trajectory"]
    subprocess.run(build, check=True, cwd=root)
    load = os.getloadavg()[0]
    lines = ["# Results: speed of the Python package", ""]
    lines += ["Written by `python python/benchmarks/rates.py`; do not edit. What it measures: [python.md](../python.md).", ""]
    lines += [f"Steps per second of processor time, the best of {arguments.rounds} rounds on {os.cpu_count()} cores. The load average at the "
              f"start was {load:.1f}."]
    lines += ["Bounds: a batch of 64 at least 0.9 of Rust, and at least 50 times NumPy.", ""]
    lines += ["| environment | Rust | Python single | of Rust | batch of 64 | of Rust | NumPy | single over NumPy | batch over NumPy |"]
    lines += ["| --- | --- | --- | --- | --- | --- | --- | --- | --- |"]
    for name, steps in STEPS.items():
        lines += [speeds(name, steps, arguments.rounds)]
        print(lines[-1], flush=True)
    lines += ["", memory(arguments.memory_steps)]
    print("\n".join(lines))
    if arguments.page:
        arguments.page.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
