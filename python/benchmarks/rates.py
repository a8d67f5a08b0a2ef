"""Steps per second of processor time: Rust, Python single, batch of 64, and rooms in NumPy.

    python python/benchmarks/rates.py [--page docs/results/python.md]
    python python/benchmarks/rates.py --installation [--program] [--page docs/results/python.md]

The second form measures the cold build and the sizes of the wheels in place of the rates; each form keeps the part of
the page that the other one wrote.

Needs cargo for the Rust rates. All parts run one after the other, several times in turn; the table has the best of
each, which other processes disturb least. All take the same actions, and no rate includes the start of the rooms.
The batch steps on two cores. Rust steps on one: a single room, and 64 rooms in turn, which do not fit into the cache
of a core.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import time
from pathlib import Path
from typing import Any

CORES = 2
# Before the library starts its threads.
os.environ["RAYON_NUM_THREADS"] = str(CORES)

import bounds
import gymnasium
import heliostat
import installation
import numpy as np
from numpy_room import PaperRoom, StaticRoom

STEPS = {"Static": 8000, "Hall": 1500, "Office": 800, "Paper": 20000}
ROOMS = 64
# Fewer steps of a batch would be too short to time.
MANY_STEPS = 40
RUST_NAMES = {"Static": "static", "Hall": "hall", "Office": "office", "Paper": "paper"}


def rust(name: str, rooms: int) -> float:
    """Steps per second of processor time of rooms that step in turn in the Rust environment."""
    count = max(STEPS[name] // rooms, MANY_STEPS)
    seconds = rust_s(name, count + 1, rooms) - rust_s(name, 1, rooms)
    return count * rooms / seconds


def rust_s(name: str, steps: int, rooms: int) -> float:
    """Processor time in s of the Rust program, the start of its rooms included."""
    root = Path(__file__).parents[2]
    program = root / "target/release/examples/trajectory"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [str(program), str(steps), os.devnull, RUST_NAMES[name], str(rooms)]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def timed(step: Any, count: int, each: int) -> float:
    begun = time.process_time()
    for index in range(count):
        step(index)
    return count * each / (time.process_time() - begun)


def obstacles() -> Any:
    """The obstacles of a room of the default scenario."""
    env = heliostat.HeliostatEnv("specular", overrides={"blockage.bodies": False})
    env.reset(seed=7)
    return env.state()["blockers"]


def speeds(name: str, steps: int, rounds: int) -> tuple[str, tuple[float, float | None]]:
    """The row of an environment, and the figures that have bounds."""
    env = gymnasium.make(f"heliostat/{name}-v0").unwrapped
    many = gymnasium.make_vec(f"heliostat/{name}-v0", num_envs=ROOMS, vectorization_mode="vector_entry_point", copy=False)
    env.reset(seed=7)
    many.reset(seed=7)
    # The actions of the Rust program, which repeat.
    indices, cycle = np.arange(env.action_space.sample().size), 11
    actions = [((indices * 7 + step * 3) % 11 / 10.0 - 0.5).astype(np.float32) for step in range(cycle)]
    batches = [np.tile(action, (ROOMS, 1)) for action in actions]
    numpy_room: Any = {"Paper": lambda: PaperRoom(np.zeros((0, 4))), "Static": lambda: StaticRoom(obstacles())}.get(name)
    room = numpy_room() if numpy_room else None
    best = np.zeros(5)
    for _ in range(rounds):
        single = timed(lambda index: env.step(actions[index % cycle]), steps, 1)
        batch = timed(lambda index: many.step(batches[index % cycle]), max(steps // ROOMS, MANY_STEPS), ROOMS)
        in_numpy = timed(lambda index: room.step(actions[index % cycle]), max(steps // 40, 20), 1) if room else 0.0
        best = np.maximum(best, [rust(name, 1), rust(name, ROOMS), single, batch, in_numpy])
    env.close()
    many.close()
    by_rust, in_turn, single, batch, in_numpy = best
    times = f"{in_numpy:.0f} | {single / in_numpy:.1f} | {batch / in_numpy:.1f}" if room else "| | "
    row = (
        f"| {name} | {by_rust:.0f} | {in_turn:.0f} | {single:.0f} | {single / by_rust:.2f} | {batch:.0f} | {batch / by_rust:.2f} "
        f"| {batch / in_turn:.2f} | {times} |"
    )
    return row, (batch / by_rust, batch / in_numpy if room else None)


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
    parser.add_argument("--installation", action="store_true", help="measure the cold build and the wheels instead")
    parser.add_argument("--program", action="store_true", help="with --installation: also build the wheel of the program")
    arguments = parser.parse_args()
    root = Path(__file__).parents[2]
    if arguments.installation:
        written = installation.section(root, arguments.program)
        print("\n".join(written))
        if arguments.page:
            arguments.page.write_text(installation.replaced(arguments.page, written), encoding="utf-8")
        return
    build = ["cargo", "build", "--release", "--quiet", "-p", "heliostat-environment", "--example", "trajectory"]
    subprocess.run(build, check=True, cwd=root)
    load = os.getloadavg()[0]
    lines = ["# Results: speed of the Python package", ""]
    lines += ["Written by `python python/benchmarks/rates.py`; do not edit. What it measures: [python.md](../python.md).", ""]
    lines += [f"Commit {installation.commit(root)}. Machine: {installation.machine()}.", ""]
    lines += [f"Steps per second of processor time, the best of {arguments.rounds} rounds, without the start of the rooms. A batch steps "
              f"on {CORES} of {os.cpu_count()} cores. The load average at the start was {load:.1f}.", ""]
    rows: list[str] = []
    found: dict[str, tuple[float, float | None]] = {}
    for name, steps in STEPS.items():
        row, found[name] = speeds(name, steps, arguments.rounds)
        print(row, flush=True)
        rows += [row]
    lines += [*bounds.table(found), ""]
    lines += ["What the state of 64 rooms costs in the cache of a core shows in Rust too, in the column of 64 rooms in turn.", ""]
    lines += ["| environment | Rust, 1 room | Rust, 64 rooms in turn | Python single | of Rust, 1 room | batch of 64 | of Rust, 1 room "
              "| of Rust, 64 rooms | NumPy | single over NumPy | batch over NumPy |"]
    lines += ["| " + " | ".join(["---"] * 11) + " |"]
    lines += [*rows, "", memory(arguments.memory_steps)]
    print("\n".join(lines))
    if arguments.page:
        if section := installation.kept(arguments.page):
            lines += ["", *section]
        arguments.page.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
