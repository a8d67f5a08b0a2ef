"""Copies, pickles and saved states of environments, and processes that are forked."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import heliostat
import numpy as np
import pytest
from heliostat.names import Dynamics

SMALL: dict[str, Any] = {"overrides": {"mirrors.rows": 3, "mirrors.columns": 3, "users.count": 2}}
# Generous, for a busy machine.
LIMIT_S = 120.0

COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "copy": copy.copy,
    "pickle": lambda value: pickle.loads(pickle.dumps(value)),
}


def actions(env: Any, count: int, seed: int = 0) -> list[Any]:
    generator = np.random.default_rng(seed)
    return [generator.uniform(-1, 1, env.action_space.shape).astype(np.float32) for _ in range(count)]


def listed(value: Any) -> Any:
    """With lists in place of arrays of arrays, which NumPy does not compare."""
    if isinstance(value, dict):
        return {name: listed(part) for name, part in value.items()}
    return list(value) if isinstance(value, np.ndarray) and value.dtype == object else value


def equal_steps(one: Any, other: Any, count: int = 6) -> None:
    """Both continue alike: observation, reward, end and figures."""
    for action in actions(one, count, seed=9):
        steps = [env.step(action) for env in (one, other)]
        for first, second in zip(*steps, strict=True):
            np.testing.assert_equal(listed(first), listed(second))


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("name", ["Static", "Hall", "Office", "Paper"])
def test_a_copy_of_an_environment_continues_as_its_original(name: str, way: str) -> None:
    keywords = {} if name == "Paper" else SMALL
    env = gymnasium.make(f"heliostat/{name}-v0", **keywords)
    env.reset(seed=3)
    for action in actions(env, 5):
        env.step(action)
    made = COPIES[way](env.unwrapped)
    assert made is not env.unwrapped
    equal_steps(env.unwrapped, made)
    # The next room of both is the same, too.
    np.testing.assert_array_equal(env.unwrapped.reset()[0], made.reset()[0])
    equal_steps(env.unwrapped, made)


@pytest.mark.parametrize("way", ["deepcopy", "pickle"])
def test_a_copy_includes_wrappers_and_the_specification(way: str) -> None:
    env: Any = gymnasium.make("heliostat/Hall-v0", max_episode_steps=4, scenario=heliostat.load_scenario("hall"))
    env.reset(seed=3)
    env.step(actions(env, 1)[0])
    made = COPIES[way](env)
    equal_steps(env, made, 3)
    again: Any = gymnasium.make(COPIES[way](env.spec)).unwrapped
    assert again.scenario == env.unwrapped.scenario


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("dynamics", ["static", "closed-loop"])
def test_a_copy_of_a_batch_continues_as_its_original_across_ends_of_episodes(
    dynamics: Dynamics, mode: str, way: str
) -> None:
    scenario = "specular" if dynamics == "static" else "hall"
    batch = heliostat.HeliostatVectorEnv(
        scenario, num_envs=3, dynamics=dynamics, max_episode_steps=4, autoreset_mode=mode, **SMALL
    )
    batch.reset(seed=3)
    for action in actions(batch, 6):
        batch.step(action)
    equal_steps(batch, COPIES[way](batch), 9)


def test_an_episode_of_a_comparison_is_copied_with_its_samples() -> None:
    env: Any = heliostat.HeliostatEnv("hall", dynamics="closed-loop", action="weights")
    env.reset(options={"episode": (0, 20, 1)})
    zero = np.zeros(env.action_space.shape, np.float32)
    for _ in range(20):
        env.step(zero)
    made = [make(env) for make in COPIES.values()]
    samples = []
    for one in (env, *made):
        info: dict[str, Any] = {}
        while "samples" not in info:
            info = one.step(zero)[4]
        samples.append(info["samples"])
    for other in samples[1:]:
        np.testing.assert_array_equal(samples[0], other)


@pytest.mark.parametrize("make", [
    lambda: heliostat.HeliostatEnv("hall", dynamics="closed-loop", **SMALL),
    lambda: heliostat.HeliostatVectorEnv("hall", num_envs=2, dynamics="closed-loop", max_episode_steps=5, **SMALL),
])
def test_a_state_is_restored_as_often_as_needed_and_in_another_environment(make: Any) -> None:
    env, other = make(), make()
    env.reset(seed=5)
    for action in actions(env, 3):
        env.step(action)
    state = env.clone_state()
    first = [env.step(action) for action in actions(env, 6, seed=2)]
    other.restore_state(pickle.loads(pickle.dumps(state)))
    for one in (env, other):
        if one is env:
            one.restore_state(state)
        again = [one.step(action) for action in actions(env, 6, seed=2)]
        np.testing.assert_equal(again, first)
    with pytest.raises(ValueError, match="of another environment: hash of the scenario"):
        heliostat.HeliostatEnv("specular").restore_state(heliostat.HeliostatEnv("paper").clone_state())
    with pytest.raises(TypeError, match="clone_state"):
        env.restore_state({})


@pytest.mark.parametrize("kind", [heliostat.HeliostatEnv, heliostat.HeliostatVectorEnv])
def test_a_state_fits_where_a_default_is_stated_and_a_refusal_names_what_differs(kind: Any) -> None:
    state = kind("specular", action="weights", **SMALL).clone_state()
    kind("specular", action="weights", penalty=1, settle_s=20.0, dynamics="static", **SMALL).restore_state(state)
    with pytest.raises(ValueError, match=r"another environment: penalty = 1\.0 and not 2\.0; expected the same"):
        kind("specular", action="weights", penalty=2.0, **SMALL).restore_state(state)
    other: Any = heliostat.HeliostatEnv if kind is heliostat.HeliostatVectorEnv else heliostat.HeliostatVectorEnv
    with pytest.raises(ValueError, match="form = "):
        other("specular", action="weights", **SMALL).restore_state(state)


def test_objects_of_the_package_are_copied_and_pickled() -> None:
    scenario = heliostat.load_scenario("hall", {"users.count": 3})
    users = np.array([[1.0, 0.5, 0.85], [-1.5, 1.0, 0.85], [0.5, -1.0, 0.85]])
    room, flat = heliostat.Room(scenario), np.zeros(100)
    policies = [heliostat.Policy(name, scenario) for name in ("fixed-point", "greedy", "ddpg", "random")]
    for way in COPIES.values():
        made = way(scenario)
        assert made == scenario and made.hash == scenario.hash and hash(made) == hash(scenario)
        np.testing.assert_equal(way(room).link(users, flat, flat), room.link(users, flat, flat))
        for policy in policies:
            policy.act(users)
            np.testing.assert_equal(way(policy).act(users + 0.1), policy.act(users + 0.1))
    assert scenario != heliostat.load_scenario("hall")


def test_a_recording_is_copied_and_pickled_by_its_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    golden = Path(__file__).parents[2] / "tests/data/golden.mcap"
    if not golden.exists():
        pytest.skip("the recording is in the repository only")
    monkeypatch.chdir(golden.parent)
    recording = heliostat.Recording(golden.name)
    pickled = pickle.dumps(recording)
    monkeypatch.chdir(tmp_path)
    for made in (copy.deepcopy(recording), pickle.loads(pickled)):
        np.testing.assert_equal(made.commands(), recording.commands())


def test_a_recorded_walk_is_in_the_pickle(tmp_path: Any) -> None:
    walk = tmp_path / "walk.csv"
    walk.write_text("time,user,x,y\n0,0,0,0\n9,0,1,1\n")
    overrides = {**SMALL["overrides"], "users.count": 1, "users.trace": str(walk)}
    env = heliostat.HeliostatEnv("hall", dynamics="closed-loop", overrides=overrides)
    env.reset(seed=1)
    data = pickle.dumps(env)
    walk.unlink()
    equal_steps(env, pickle.loads(data))


def _steps(seed: int) -> float:
    many = heliostat.HeliostatVectorEnv("specular", num_envs=4, **SMALL)
    many.reset(seed=seed)
    return float(many.step(actions(many, 1)[0])[1].mean())


def _evaluates(_: int) -> float:
    env: Any = heliostat.HeliostatEnv("hall", dynamics="closed-loop", action="weights")
    zero = np.zeros(env.action_space.shape, np.float32)
    return heliostat.evaluate(lambda _: zero, env, states=20).ratio_to_oracle


needs_fork = pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
pytestmark = pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")


@needs_fork
@pytest.mark.parametrize("work", [_steps, _evaluates])
def test_a_forked_worker_works_after_a_batch_of_its_parent(work: Any) -> None:
    expected = [_steps(2), _evaluates(0)][work is _evaluates]
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found = pool.map_async(work, [2, 2]).get(LIMIT_S)
    assert found == [expected] * 2


@needs_fork
def test_a_forked_worker_continues_with_the_batch_of_its_parent_and_forks_again() -> None:
    many = heliostat.HeliostatVectorEnv("specular", num_envs=4, **SMALL)
    many.reset(seed=3)
    action = actions(many, 1)[0]
    expected = copy.deepcopy(many).step(action)[1].tolist()
    context = multiprocessing.get_context("fork")
    results = context.Queue()

    def grandchild() -> None:
        results.put(many.step(action)[1].tolist())

    def child() -> None:
        _steps(1)
        one = context.Process(target=grandchild)
        one.start()
        one.join(LIMIT_S)
        results.put(many.step(action)[1].tolist())

    process = context.Process(target=child)
    process.start()
    found = [results.get(timeout=LIMIT_S) for _ in range(2)]
    process.join(LIMIT_S)
    assert process.exitcode == 0 and found == [expected] * 2


@needs_fork
def test_a_batch_that_another_thread_steps_during_the_fork_is_refused_or_works_and_never_hangs() -> None:
    many: Any = heliostat.HeliostatVectorEnv("hall", num_envs=16, dynamics="closed-loop", action="weights")
    many.reset(seed=3)
    action = np.zeros(many.action_space.shape, np.float32)
    ended = threading.Event()

    def step_on() -> None:
        while not ended.is_set():
            many.step(action)

    thread = threading.Thread(target=step_on)
    thread.start()
    context = multiprocessing.get_context("fork")
    refused = 0
    try:
        for _ in range(8):
            results = context.Queue()

            def child(results: Any = results) -> None:
                try:
                    many.step(action)
                    results.put("")
                except RuntimeError as problem:
                    results.put(str(problem))

            process = context.Process(target=child)
            process.start()
            found = results.get(timeout=LIMIT_S)
            process.join(LIMIT_S)
            assert process.exitcode == 0
            assert found == "" or "forked" in found
            refused += found != ""
    finally:
        ended.set()
        thread.join()
    assert refused > 0, "the thread held the batch in no fork"


@needs_fork
def test_forked_workers_end_with_a_parent_that_is_killed(tmp_path: Any) -> None:
    script = tmp_path / "parent.py"
    script.write_text(
        "import multiprocessing, os, sys\n"
        "import heliostat\n"
        "def work(seed):\n"
        "    many = heliostat.HeliostatVectorEnv('specular', num_envs=4)\n"
        "    many.reset(seed=seed)\n"
        "    return os.getpid()\n"
        "if __name__ == '__main__':\n"
        "    work(1)\n"
        "    with multiprocessing.get_context('fork').Pool(2) as pool:\n"
        "        print(*set(pool.map(work, range(8), chunksize=1)), flush=True)\n"
        "        sys.stdin.read()\n"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, str(script)], stdin=pipe, stdout=pipe, text=True) as parent:
        assert parent.stdout is not None
        workers = [int(word) for word in parent.stdout.readline().split()]
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    end = time.monotonic() + LIMIT_S
    while any(_runs(worker) for worker in workers):
        assert time.monotonic() < end, f"the workers {workers} outlive their parent"
        time.sleep(0.05)
    assert workers


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    try:
        with open(f"/proc/{process}/stat", encoding="utf-8") as status:
            return status.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
