"""A function in Python that commands a room: what it sees, what is counted, and what happens when it fails."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import heliostat
import numpy as np
import pytest
from heliostat import wire
from heliostat._core import Commander

pytest.importorskip("zenoh")
from heliostat.controller import _QUEUE_MAX, RunSummary, _has_only_failed, _Run, _Tokens
from heliostat.peer import PeerError, Settings, connection_problem, endpoints
from heliostat.tracker import Tracker, User
from room import LIMIT_S, Observer, free_endpoint, needs_program, observer, wait_until
from room import heliostat as program

SCENARIO = heliostat.load_scenario("hall")
UTC_NS = 1_800_000_000_000_000_000
# A pause of a busy machine makes no report stale and no decision late.
PATIENT = heliostat.load_scenario("hall", {"control.report_age_max_ms": 60_000.0, "control.deadline_ms": 60_000.0})


def _own(endpoint: str) -> str:
    """The endpoint of the simulator beside that of the observer: peers do not pass messages on."""
    return f"{endpoint}.room"


@contextmanager
def simulator(endpoint: str) -> Iterator[None]:
    """A simulated room in real time, which the observer and the run both know."""
    ends = ("--connect", endpoint, "--listen", _own(endpoint))
    command = [os.environ["HELIOSTAT_PROGRAM"], "sim-node", "--scenario", "hall", *ends]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


@contextmanager
def running(act: Any, endpoint: str, scenario: Any = PATIENT) -> Iterator[list[heliostat.RunSummary]]:
    """A run in a thread; it ends with the block, and its summary is then in the list."""
    stop, summaries = threading.Event(), []

    def work() -> None:
        summaries.append(heliostat.run(act, connect=[endpoint, _own(endpoint)], scenario=scenario, stop=stop))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield summaries
    finally:
        stop.set()
        thread.join(LIMIT_S)
        assert not thread.is_alive()


@needs_program
def test_a_function_commands_the_mirrors_of_a_room() -> None:
    endpoint = free_endpoint()
    seen: list[Any] = []

    def act(observation: Any) -> Any:
        seen.append(observation.copy())
        return np.full(200, 0.25, np.float32)

    with observer(endpoint, "demo") as room, simulator(endpoint), running(act, endpoint) as summaries:

        def turned() -> bool:
            roll = room.latest.get("telemetry", {}).get("roll_commanded", [0.0])
            return bool(abs(roll[0] - 0.25 * SCENARIO.range_rad) < 1e-5)

        wait_until("command of the function", turned)
        wait_until("status", lambda: room.latest.get("status", {}).get("policy") == "python" or len(seen) > 100)
    summary = summaries[0]
    env = heliostat.HeliostatEnv(SCENARIO, dynamics="closed-loop")
    assert seen[0].shape == env.observation_space.shape and seen[0].dtype == np.float32
    assert summary.decisions >= len(seen) > 0 and summary.commands > 0
    assert summary.exceptions == summary.fallbacks == 0 and summary.last_problem == ""


@needs_program
@pytest.mark.parametrize(
    ("answer", "part"),
    [
        (lambda: 1 / 0, "division by zero"),
        (lambda: np.full(200, np.nan), "finite"),
        (lambda: np.zeros(3), "length 3"),
        (lambda: np.zeros((1, 200)), "an action of shape (1, 200), expected one dimension"),
        (lambda: None, "action: dtype object, expected real numbers"),
    ],
)
def test_a_function_that_fails_is_counted_and_the_fallback_turns_the_mirrors(answer: Any, part: str) -> None:
    endpoint = free_endpoint()
    with (
        pytest.warns(RuntimeWarning, match="no mirror by the function, control.fallback decided each time: "),
        observer(endpoint, "demo") as room,
        simulator(endpoint),
        running(lambda _: answer(), endpoint) as summaries,
    ):

        def turned() -> bool:
            roll = room.latest.get("telemetry", {}).get("roll_commanded", [])
            return bool(roll) and all(np.isfinite(roll)) and max(map(abs, roll)) > 0.01

        wait_until("command of the fallback", turned)
    summary = summaries[0]
    assert summary.exceptions == summary.fallbacks > 0 and part in summary.last_problem, summary
    assert "<lambda>" in summary.last_problem, summary


def test_a_function_has_only_failed_where_the_fallback_decided_after_each_call_whatever_the_standby() -> None:
    counts = dict.fromkeys(RunSummary.__dataclass_fields__, 0)
    counts |= {"decisions": 30, "commands": 28, "exceptions": 28, "fallbacks": 28, "standby": 2}
    summary = RunSummary(**{**counts, "last_problem": ""})  # type: ignore[arg-type]
    assert _has_only_failed(28, summary)
    assert not _has_only_failed(29, summary)


@needs_program
def test_a_run_with_the_scenario_of_another_room_reports_what_differs() -> None:
    endpoint, differs = free_endpoint(), "room and controller differ: room."
    with (
        observer(endpoint, "demo") as room,
        simulator(endpoint),
        running(lambda _: np.zeros(200, np.float32), endpoint, "office") as summaries,
    ):
        wait_until("problem", lambda: room.status("controller").get("last_problem", "").startswith(differs))
        wait_until("command", lambda: room.counts.get("command", 0) > 0)
    assert summaries[0].last_problem.startswith(differs), summaries


@needs_program
def test_without_a_fallback_the_array_gets_no_command_of_a_failed_decision() -> None:
    endpoint = free_endpoint()
    scenario = heliostat.load_scenario("hall", {"control.fallback": "hold"})
    good = threading.Event()
    good.set()

    def act(_: Any) -> Any:
        if not good.is_set():
            raise ValueError("no idea")
        return np.full(200, 0.25, np.float32)

    stop, summaries = threading.Event(), []

    def work() -> None:
        summaries.append(heliostat.run(act, connect=[endpoint, _own(endpoint)], scenario=scenario, stop=stop))

    with observer(endpoint, "demo") as room, simulator(endpoint):
        thread = threading.Thread(target=work)
        thread.start()
        try:

            def roll() -> float:
                return float(room.latest.get("telemetry", {}).get("roll_commanded", [0.0])[0])

            wait_until("command", lambda: abs(roll() - 0.25 * SCENARIO.range_rad) < 1e-5)
            good.clear()
            # The array holds, and then parks by its own rules.
            wait_until("parked array", lambda: roll() == 0.0)
            good.set()
            wait_until("command again", lambda: abs(roll() - 0.25 * SCENARIO.range_rad) < 1e-5)
        finally:
            stop.set()
            thread.join(LIMIT_S)
    assert summaries[0].exceptions > 0 and summaries[0].fallbacks == 0, summaries


@needs_program
def test_a_slow_function_answers_the_newest_report_and_is_counted_as_late() -> None:
    endpoint, calls = free_endpoint(), []

    def act(observation: Any) -> Any:
        calls.append(time.monotonic())
        time.sleep(0.35)
        return np.zeros(200, np.float32)

    with observer(endpoint, "demo"), simulator(endpoint), running(act, endpoint, SCENARIO) as summaries:
        wait_until("five calls", lambda: len(calls) >= 5)
    assert summaries[0].late > 0 and summaries[0].superseded > 0, summaries


def _quarter(_: Any) -> Any:
    return np.full(200, 0.25, np.float32)


def _counter(room: Observer, name: str) -> int | None:
    """A counter in the latest status of a controller."""
    return dict(room.status("controller").get("counters", [])).get(name)


@needs_program
def test_a_run_that_took_over_no_longer_stands_by_in_its_status() -> None:
    endpoint = free_endpoint()
    with observer(endpoint, "demo") as room, simulator(endpoint), ExitStack() as leader:
        leader.enter_context(running(_quarter, endpoint))
        wait_until("command of the leader", lambda: room.counts.get("command", 0) > 0)
        with running(_quarter, endpoint) as summaries:
            wait_until("standby", lambda: _counter(room, "standby") == 1)
            leader.close()
            wait_until("lead", lambda: bool(_counter(room, "fallback:standby")) and _counter(room, "standby") == 0)
            wait_until("state", lambda: room.status("controller")["state"] == "running")
        wait_until("the last status", lambda: _counter(room, "ending") == 1)
    assert summaries[0].commands > 0 and summaries[0].standby > 0, summaries


@needs_program
def test_a_run_that_only_stood_by_warns() -> None:
    endpoint, stop = free_endpoint(), threading.Event()

    def end_in_standby(room: Observer) -> None:
        try:
            wait_until("standby", lambda: _counter(room, "standby") == 1)
        finally:
            stop.set()

    with observer(endpoint, "demo") as room, simulator(endpoint), running(_quarter, endpoint):
        wait_until("command of the leader", lambda: room.counts.get("command", 0) > 0)
        thread = threading.Thread(target=end_in_standby, args=(room,))
        thread.start()
        with pytest.warns(RuntimeWarning, match="has turned no mirror: the array followed another controller"):
            ends = [endpoint, _own(endpoint)]
            summary = heliostat.run(_quarter, connect=ends, scenario=PATIENT, stop=stop)
        thread.join(LIMIT_S)
    assert summary.commands == 0 < summary.standby and "another controller" in summary.last_problem, summary


def _message(name: str, source: int, sequence: int, **fields: Any) -> bytes:
    stamp = {"source": source, "sequence": sequence, "time_ns": UTC_NS}
    return wire.encode({"stamp": stamp, **fields}, wire.KINDS[name])


def _stop() -> bytes:
    return _message("stop", 7, 3, action=0, operator="ann", reason="test")


def test_a_stop_is_repeated_until_the_array_reports_it_and_named_until_the_array_releases_it() -> None:
    core, repeated = Commander(SCENARIO, _quarter, "angles", 5), 200_000_000
    assert core.receive("stop", 0, _stop(), UTC_NS) == [] and core.timeout(UTC_NS) == []
    ((name, array, payload),) = core.repetitions(UTC_NS)
    repetition = wire.decode(payload, wire.KINDS["stop_repetition"])
    assert (name, array, repetition["stop_source"], repetition["stop_sequence"]) == ("stop_repetition", 0, 7, 3)
    assert core.repetitions(UTC_NS + repeated // 2) == [], "at most five times a second"
    assert len(core.repetitions(UTC_NS + repeated)) == 1
    assert (core.last_problem or "").startswith('withheld by the stop of ann ("test") since ')
    latched = {"source": 7, "sequence": 3, "arrived_ns": UTC_NS, "operator": "ann", "reason": "test"}
    reported = {"device_stopped": True, "released": [], "problem": ""}
    core.receive("stops", 0, _message("stops", 9, 1, stops=[latched], **reported), UTC_NS)
    assert core.repetitions(UTC_NS + 2 * repeated) == [], "the array has reported it"
    assert "the stop of ann" in (core.last_problem or "")
    core.receive("stops", 0, _message("stops", 9, 2, stops=[], **reported), UTC_NS)
    assert core.last_problem is None


def test_a_run_repeats_a_stop_while_its_function_does_not_return_and_names_it_then() -> None:
    endpoint, end = free_endpoint(), threading.Event()
    asked, returned = threading.Event(), threading.Event()
    kind = wire.KINDS["stop_repetition"]
    repetitions: list[dict[str, Any]] = []

    def act(_: Any) -> Any:
        asked.set()
        assert returned.wait(LIMIT_S)
        return np.zeros(200, np.float32)

    settings = Settings(room="demo", connect=(endpoint, _own(endpoint)))
    with observer(endpoint, "demo") as room, Tracker(Settings(room="demo", listen=(_own(endpoint),)), end) as tracker:
        subscriber = room.session.declare_subscriber(
            room.keys["stop_repetition"], lambda sample: repetitions.append(wire.decode(bytes(sample.payload), kind))
        )
        run = _Run(act, PATIENT, "angles", settings, end)
        thread = threading.Thread(target=run.run, args=(None,))
        thread.start()

        def is_asked() -> bool:
            tracker.report([User(0, (1.0, 0.5, 0.85))])
            return asked.is_set()

        def is_named() -> bool:
            return str(room.status("controller").get("last_problem")).startswith("withheld by the stop of ann")

        try:
            wait_until("call", is_asked)
            room.publish("stop", action=0, operator="ann", reason="test")
            wait_until("repetition", lambda: bool(repetitions))
            assert not returned.is_set() and repetitions[0]["stop_source"] == 77
            returned.set()
            wait_until("problem", is_named)
        finally:
            returned.set()
            end.set()
            thread.join(LIMIT_S)
            subscriber.undeclare()
    assert run.summary().last_problem.startswith("withheld by the stop of ann")


def test_a_stop_that_arrives_behind_a_full_queue_is_obeyed() -> None:
    run = _Run(_quarter, SCENARIO, "angles", Settings(listen=(free_endpoint(),)), threading.Event())
    with run._peer:
        arrive = run._queued("channel", 0)
        for _ in range(_QUEUE_MAX + 1):
            arrive(b"")
        run._order(_stop())
        run._receive()
    assert run._dropped == 1 and "withheld by the stop of ann" in (run._core.last_problem or "")


def test_a_flood_of_orders_is_bounded_and_drops_no_first_stop() -> None:
    run = _Run(_quarter, SCENARIO, "angles", Settings(listen=(free_endpoint(),)), threading.Event())
    rearm = _message("stop", 7, 4, action=1, operator="ann", reason="test")
    with run._peer:
        for _ in range(_QUEUE_MAX + 1):
            run._order(rearm)
        assert (run._dropped, len(run._stops)) == (1, 0), "a re-arm is no stop"
        for _ in range(2 * _QUEUE_MAX):
            run._order(_stop())
        assert (run._dropped, len(run._stops)) == (1, 1), "a repeated stop counts once"
        for source in range(8, 8 + 2 * _QUEUE_MAX):
            run._order(_message("stop", source, 1, action=0, operator="bob", reason="test"))
        assert len(run._stops) == _QUEUE_MAX
        run._receive()
    assert not run._stops and "withheld by the stop of ann" in (run._core.last_problem or "")


def test_a_flood_of_tokens_is_bounded_and_hides_no_end_of_a_process() -> None:
    tokens = _Tokens()
    tokens.note("tracker", True)
    assert tokens.take() == [("tracker", True)]
    for number in range(4 * _QUEUE_MAX):
        tokens.note(f"invented-{number}", True)
        tokens.note(f"invented-{number}", False)
    tokens.note("tracker", False)
    changed = dict(tokens.take())
    assert len(changed) <= _QUEUE_MAX and changed["tracker"] is False
    tokens.note("tracker", True)
    assert tokens.take() == [("tracker", True)], "ends give their places back"


def test_a_run_that_reaches_a_controller_alone_says_what_is_missing() -> None:
    endpoint = free_endpoint()
    with observer(endpoint, "demo") as room:
        token = room.session.liveliness().declare_token("heliostat/v1/demo/alive/controller/0000000000000001")
        run = _Run(_quarter, SCENARIO, "angles", Settings(connect=(endpoint,)), threading.Event())

        def is_named() -> bool:
            run._receive()
            return run.absence().startswith("only controller of the room answers, neither a tracker nor an array")

        with run._peer:
            run._join()
            wait_until("controller", is_named)
        token.undeclare()


def test_a_run_ends_after_its_time_and_wrong_settings_are_refused() -> None:
    endpoint = free_endpoint()
    with pytest.warns(RuntimeWarning, match="has turned no mirror: no process of the room answers"):
        summary = heliostat.run(lambda _: None, connect=[endpoint], seconds=8)
    assert summary.decisions == summary.commands == 0
    assert "no process of the room answers" in summary.last_problem
    with pytest.warns(RuntimeWarning, match="no process of the room answers"):
        heliostat.run(lambda _: None, connect=endpoint, seconds=0.01)
    forced = heliostat.load_scenario("hall", {"blockage.forced_users": 2})
    with pytest.warns(RuntimeWarning), pytest.warns(UserWarning, match=r"^the cause of a blocked path does not apply: "):
        heliostat.run(lambda _: None, connect=endpoint, scenario=forced, seconds=0.01)
    with pytest.raises(PeerError, match=r"no endpoint: expected listen=\.\.\. or connect=\.\.\., for example connect='"):
        heliostat.run(lambda _: None)
    with pytest.raises(PeerError, match="expected tls='DIR', or insecure=True"):
        heliostat.run(lambda _: None, listen="tcp/0.0.0.0:7447")
    with pytest.raises(ValueError, match='"angles", "weights"'):
        heliostat.run(lambda _: None, connect=[endpoint], action="torque", seconds=0.1)  # type: ignore[arg-type]
    number: Any = 42
    with pytest.raises(TypeError, match="act: expected a function of an observation, found int"):
        heliostat.run(number, connect=[endpoint])
    with pytest.raises(TypeError, match="connect = 42: expected endpoints as texts"):
        heliostat.run(lambda _: None, connect=number)
    wrong: Any
    for wrong in (-1, 0, float("nan"), "5"):
        with pytest.raises(ValueError, match="seconds = .*: expected a number of seconds from 0.01"):
            heliostat.run(lambda _: None, connect=[endpoint], seconds=wrong)


def test_endpoints_are_a_text_or_any_iterable_of_texts() -> None:
    one = "tcp/127.0.0.1:1"
    for given in (one, [one], (one,), np.array([one]), (text for text in [one])):
        assert endpoints("listen", given) == (one,)
    wrong: Any
    for wrong in (42, [42], b"tcp", np.array(one), None):
        with pytest.raises(TypeError, match="listen = .*: expected endpoints as texts"):
            endpoints("listen", wrong)


def test_a_run_without_an_array_warns() -> None:
    endpoint, stop = free_endpoint(), threading.Event()

    def act(_: Any) -> Any:
        stop.set()
        return np.zeros(200)

    def report() -> None:
        with Tracker(Settings(room="demo", listen=(endpoint,)), stop) as tracker:
            while not stop.wait(0.05):
                tracker.report([User(0, (1.0, 0.5, 0.85))])

    thread = threading.Thread(target=report)
    thread.start()
    with pytest.warns(RuntimeWarning, match="has turned no mirror: no array answers: expected a driver or a simulator"):
        summary = heliostat.run(act, connect=[endpoint], scenario=PATIENT, stop=stop)
    thread.join(LIMIT_S)
    assert summary.decisions > 0 and summary.last_problem.startswith("no array answers")


@needs_program
def test_a_run_that_is_not_connected_names_the_fault_of_its_keys(tmp_path: Path) -> None:
    keys, foreign = tmp_path / "keys", tmp_path / "foreign"
    for folder in (keys, foreign):
        assert program("keys", "init", "--room", "lab", "--out", str(folder)).returncode == 0
    plain = free_endpoint("tcp")
    encrypted = plain.replace("tcp/", "tls/")
    command = [os.environ["HELIOSTAT_PROGRAM"], "sim-node", "--tls", str(keys), "--listen", encrypted]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            of_foreign = Settings(connect=(encrypted,), tls=foreign)
            wait_until("a listener", lambda: connection_problem(of_foreign, "controller") != "")
            assert "does not fit" in connection_problem(of_foreign, "controller")
            unencrypted = connection_problem(Settings(connect=(plain,)), "controller")
            assert "encrypted connections only: if it is a process of this room, expected tls" in unencrypted
            assert connection_problem(Settings(connect=(encrypted,), tls=keys), "controller") == ""
            nothing = Settings(connect=(free_endpoint("tcp"),))
            assert connection_problem(nothing, "controller") == ""
            with pytest.warns(RuntimeWarning, match="encrypted connections only"):
                summary = heliostat.run(lambda _: None, connect=[plain], scenario=SCENARIO, seconds=10)
            assert "encrypted connections only" in summary.last_problem
        finally:
            process.terminate()
