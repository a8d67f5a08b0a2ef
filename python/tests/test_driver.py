"""Drivers in Python as processes: they pass the conformance check, and begin and end as they should."""

from __future__ import annotations

import argparse
import json
import queue
import signal
import threading
import time
from collections.abc import Callable
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("zenoh")
from heliostat._watched import LastProblem, Watched
from heliostat.driver import _EVENTS_MAX, Capabilities, Device, _EventLimit, _Log, _Record, _Shown, run
from heliostat.peer import Peer, PeerError, Settings, duration_s, stop_on_signals
from room import EXAMPLES, LIMIT_S, end_by, free_endpoint, heliostat, needs_program, observer, python, wait_until

SIZE = ("--rows", "2", "--columns", "3")
STOPPED, PARKED = 3, 0


class Mirrors(Device):
    """Mirrors that reach every angle at once."""

    capabilities = Capabilities("two mirrors", 1, 2, (-0.25, 0.5), (-0.25, 0.5))

    def turn(self, roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
        pass

    def stop(self) -> None:
        pass


def verdicts(*arguments: str) -> dict[str, str]:
    """The verdict of `heliostat driver check` on each rule."""
    ended = heliostat("driver", "check", "--json", "--wait", str(LIMIT_S), *arguments)
    assert ended.stdout, ended.stderr
    report: dict[str, Any] = json.loads(ended.stdout)
    return {finding["rule"]: finding["verdict"] for finding in report["findings"]}


@needs_program
@pytest.mark.parametrize("array", ["0", "2"])
def test_the_example_keeps_every_rule_of_the_contract(tmp_path: Path, array: str) -> None:
    endpoint, own = free_endpoint(), ("--room", "kept", "--array", array)
    with python(EXAMPLES / "driver.py", *own, "--connect", endpoint, *SIZE, folder=tmp_path) as driver:
        found = verdicts("--listen", endpoint, *own)
        assert len(found) > 20 and set(found.values()) == {"kept"}, found
        output, _ = end_by(signal.SIGTERM, driver)
    assert "commands accepted: " in output and "commands accepted: 0" not in output


@needs_program
def test_a_driver_with_keys_keeps_every_rule_and_takes_the_room_of_its_keys(tmp_path: Path) -> None:
    keys, endpoint = tmp_path / "keys", free_endpoint("tls")
    made = heliostat("keys", "init", "--room", "locked", "--out", str(keys), "--host", "127.0.0.1")
    assert made.returncode == 0, made.stderr
    moved = keys.rename(tmp_path / "moved")
    secured = ("--tls", str(moved))
    with python(EXAMPLES / "driver.py", *secured, "--connect", endpoint, *SIZE, folder=tmp_path) as driver:
        found = verdicts("--listen", endpoint, *secured)
        assert len(found) > 15 and "broken" not in found.values(), found
        end_by(signal.SIGTERM, driver)
    with pytest.raises(PeerError, match='expected "locked"'):
        run(Mirrors(), Settings(room="lab", connect=(endpoint,), tls=moved), seconds=0)
    (moved / "driver.key").chmod(0o644)
    with pytest.raises(PeerError, match="every user of this machine can read"):
        run(Mirrors(), Settings(connect=(endpoint,), tls=moved), seconds=0)


@needs_program
def test_keys_that_are_of_no_use_end_a_driver_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = tmp_path / "keys"
    made = heliostat("keys", "init", "--room", "locked", "--out", str(keys), "--days", "5")
    assert made.returncode == 0, made.stderr

    def refusal() -> str:
        with pytest.raises(PeerError) as refused:
            run(Mirrors(), Settings(connect=("tls/127.0.0.1:1",), tls=keys), state=tmp_path, seconds=0)
        return str(refused.value)

    def shifted(days: int) -> type[datetime]:
        class Shifted(datetime):
            @classmethod
            def now(cls, tz: tzinfo | None = None) -> Any:
                return datetime.now(tz) + timedelta(days=days)

        return Shifted

    for days, expected in ((6, "the certificate expired on "), (-6, "the certificate is not valid yet")):
        with monkeypatch.context() as patched:
            patched.setattr("heliostat.peer.datetime", shifted(days))
            assert f"driver.pem: {expected}" in refusal()
    own = (keys / "driver.key").read_bytes()
    (keys / "driver.key").write_bytes((keys / "operator.key").read_bytes())
    assert "with its private key driver.key beside it" in refusal()
    (keys / "driver.key").write_bytes(own)
    (keys / "driver.pem").write_text("no certificate")
    assert "expected a certificate of heliostat keys in PEM format" in refusal()


def test_a_stop_outlives_the_driver_and_ctrl_c_ends_it(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    example = (EXAMPLES / "driver.py", "--room", "lab", "--connect", endpoint, *SIZE)
    with observer(endpoint, "lab") as operator:

        def state() -> int | None:
            return operator.latest.get("telemetry", {}).get("state")

        with python(*example, "--start-armed", folder=tmp_path) as driver:
            wait_until("parked array", lambda: state() == PARKED)
            wait_until("status", lambda: operator.latest.get("status", {}).get("state") == "array parked")
            assert len(operator.alive(operator.keys["drivers"])) == 1
            operator.publish("stop", action=0, operator="ann", reason="test")
            wait_until("stopped array", lambda: state() == STOPPED)
            wait_until("stopped device", lambda: operator.latest.get("stops", {}).get("device_stopped") is True)
            _, errors = end_by(signal.SIGINT, driver)
            ordered, _, executed = errors.partition("stop ordered by 000000000000004d/1")
            assert "the array is stopped" not in ordered
            assert "the array is stopped: its device has executed the stop" in executed
        wait_until("withdrawn token", lambda: not operator.alive(operator.keys["drivers"]))
        operator.latest.clear()
        with python(*example, "--start-armed", folder=tmp_path) as driver:
            wait_until("stopped array", lambda: state() == STOPPED)
            operator.publish("rearm", stop_source=77, stop_sequence=1, operator="ann", reason="test")
            wait_until("parked array", lambda: state() == PARKED)
            wait_until("safety report", lambda: operator.latest.get("safety", {}).get("stopped") is False)
            _, errors = end_by(signal.SIGINT, driver)
            assert "the array starts stopped by ann" in errors and "the array is released" in errors


def test_a_stop_that_arrives_during_a_movement_comes_before_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint, end = free_endpoint(), threading.Event()
    begun, stopped = threading.Event(), threading.Event()
    subscribe = Peer.subscribe

    def noted(self: Peer, name: str, handle: Callable[[bytes], None], array: int | None = None) -> None:
        def deliver(payload: bytes) -> None:
            handle(payload)
            if name == "stop":
                stopped.set()

        subscribe(self, name, deliver, array)

    class Slow(Mirrors):
        capabilities = Capabilities("two mirrors", 1, 2, (-0.25, 0.5), (-0.25, 0.5), park_after_ms=0)

        def __init__(self) -> None:
            self.calls: list[str] = []

        def turn(self, roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
            self.calls.append(f"turn {roll[0]}")
            if roll[0] and not begun.is_set():
                begun.set()
                assert stopped.wait(LIMIT_S)
                # The command expires, so that the array would park, and a report is overdue.
                time.sleep(0.3)

        def stop(self) -> None:
            self.calls.append("stop")

    monkeypatch.setattr(Peer, "subscribe", noted)
    slow = Slow()
    given = {"state": tmp_path, "start_armed": True, "stop": end}
    settings = Settings(room="slow", connect=(endpoint,))
    driver = threading.Thread(target=run, args=(slow, settings), kwargs=given, daemon=True)
    with observer(endpoint, "slow") as operator:

        def is_turning() -> bool:
            now = time.time_ns()
            numbers = {"epoch": now // 1_000_000, "sequence": 1, "answers": 1, "time_ns": now, "validity_ms": 200}
            operator.publish("command", **numbers, roll=[0.125, 0.0], yaw=[0.0, 0.0])
            return begun.is_set()

        driver.start()
        try:
            wait_until("parked array", lambda: operator.latest.get("telemetry", {}).get("state") == PARKED)
            wait_until("movement", is_turning)
            operator.publish("stop", action=0, operator="ann", reason="test")
            wait_until("stopped array", lambda: operator.latest.get("telemetry", {}).get("state") == STOPPED)
        finally:
            end.set()
            driver.join(LIMIT_S)
    assert slow.calls[slow.calls.index("turn 0.125") + 1] == "stop", slow.calls


def test_a_second_driver_of_the_same_array_is_refused(tmp_path: Path) -> None:
    endpoint, watched, stop = free_endpoint(), free_endpoint(), threading.Event()
    # Peers forward nothing, so the second driver connects to the first one.
    settings = Settings(room="taken", listen=(endpoint,), connect=(watched,))
    given = {"state": tmp_path / "first", "stop": stop}
    first = threading.Thread(target=run, args=(Mirrors(), settings), kwargs=given, daemon=True)
    with observer(watched, "taken") as operator:
        first.start()
        try:
            wait_until("telemetry", lambda: "telemetry" in operator.latest)
            second = Settings(room="taken", connect=(endpoint,))
            refusals: list[str] = []

            def is_refused() -> bool:
                # On a busy machine the first driver's answer may come after the one second for which the second waits.
                try:
                    run(Mirrors(), second, state=tmp_path / "second", seconds=0)
                except PeerError as problem:
                    refusals.extend(text for text in [str(problem)] if "another driver" in text)
                return bool(refusals)

            wait_until("refusal", is_refused)
            assert 'another driver is in room "taken"' in refusals[0]
            counters = run(Mirrors(), second, array=1, state=tmp_path / "second", seconds=0)
            assert counters["accepted"] == 0, "another array is free"
        finally:
            stop.set()
            first.join(LIMIT_S)
        assert not first.is_alive(), f"the first driver does not end within {LIMIT_S} s"


def test_a_call_that_does_not_return_is_named_and_a_second_signal_ends_the_driver(tmp_path: Path) -> None:
    endpoint, blocked = free_endpoint(), tmp_path / "blocked.py"
    blocked.write_text(
        "import threading\n"
        "from heliostat.driver import Capabilities, Device, main, parser\n"
        "class Blocked(Device):\n"
        "    capabilities = Capabilities('blocked', 1, 2, (-0.25, 0.5), (-0.25, 0.5))\n"
        "    calls = 0\n"
        "    def turn(self, roll, yaw):\n"
        "        pass\n"
        "    def health(self):\n"
        "        self.calls += 1\n"
        "        if self.calls > 50:\n"
        "            threading.Event().wait()\n"
        "        return super().health()\n"
        "    def stop(self):\n"
        "        pass\n"
        "main(Blocked(), parser().parse_args())\n",
        encoding="utf-8",
    )
    with (
        observer(endpoint, "lab") as operator,
        python(blocked, "--room", "lab", "--connect", endpoint, "--start-armed", folder=tmp_path) as driver,
    ):

        def is_named() -> bool:
            return "health has not returned for" in str(operator.latest.get("status", {}).get("last_problem"))

        wait_until("problem", is_named)
        assert operator.latest["status"]["node"] == 2
        driver.send_signal(signal.SIGTERM)
        driver.send_signal(signal.SIGINT)
        _, errors = driver.communicate(timeout=LIMIT_S)
        assert driver.returncode == 130 and errors.count("health has not returned for") == 1, errors


def test_a_call_that_takes_longer_than_the_interval_of_a_status_is_named_when_it_returns() -> None:
    class Slow(Mirrors):
        wait_s = 0.0

        def measure(self) -> None:
            time.sleep(self.wait_s)

        def connect(self) -> None:
            time.sleep(self.wait_s)

    slow = Slow()
    device = Watched(slow, threading.Event(), lambda _: None, lambda _: None)
    device.measure()
    assert device.take_slow() == "", "it returns at once"
    slow.wait_s = 0.6
    device.connect()
    assert device.take_slow() == "", "no mirror turns before a connection"
    device.measure()
    assert device.take_slow().startswith("measure took "), "once it has returned"
    assert device.take_slow() == "", "once"


def test_a_slow_call_hides_no_problem_of_the_station_and_brings_back_no_old_one() -> None:
    last = LastProblem()

    def of(own: str, refused: int, slow: str = "", unrecorded: int = 0) -> str:
        counters = [("device_absent", 0), ("stop_unrecorded", unrecorded), ("refused:command:expired", refused)]
        return last.of({"last_problem": own, "counters": counters}, slow)

    assert of("", 0) == ""
    assert of("", 0, "measure took 0.6 s") == "measure took 0.6 s"
    assert of("command: expired", 1, "measure took 0.7 s") == "command: expired", "a new one comes first"
    assert [of("command: expired", 1) for _ in range(2)] == ["measure took 0.7 s"] * 2, "the later one stays"
    assert of("command: expired", 2) == "command: expired", "it is refused again"
    assert of("command: expired", 2) == "command: expired"
    lost = "the stop is not recorded"
    assert [of(lost, 2, "measure took 0.6 s", unrecorded=1) for _ in range(3)] == [lost] * 3, "it lasts"


def test_the_status_of_a_slow_device_names_its_call(tmp_path: Path) -> None:
    class Slow(Mirrors):
        def measure(self) -> None:
            time.sleep(0.6)

    endpoint, stop = free_endpoint(), threading.Event()
    settings = Settings(room="slow", connect=(endpoint,))
    given = {"state": tmp_path / "slow", "stop": stop, "start_armed": True}
    driver = threading.Thread(target=run, args=(Slow(), settings), kwargs=given, daemon=True)
    with observer(endpoint, "slow") as operator:

        def is_named() -> bool:
            return str(operator.latest.get("status", {}).get("last_problem")).startswith("measure took ")

        driver.start()
        try:
            wait_until("problem", is_named)
        finally:
            stop.set()
            driver.join(LIMIT_S)


def test_two_signals_in_quick_succession_end_a_program_that_waits(tmp_path: Path) -> None:
    waiting = tmp_path / "waiting.py"
    waiting.write_text(
        "import sys, threading\n"
        "from heliostat.peer import stop_on_signals\n"
        "try:\n"
        "    with stop_on_signals(threading.Event()):\n"
        "        print('ready', flush=True)\n"
        "        threading.Event().wait()\n"
        "except KeyboardInterrupt:\n"
        "    sys.exit(130)\n",
        encoding="utf-8",
    )
    # The second signal comes as the first one has just interrupted the wait, in some of the attempts.
    for _ in range(10):
        with python(waiting, folder=tmp_path) as program:
            assert program.stdout is not None
            program.stdout.readline()
            program.send_signal(signal.SIGTERM)
            program.send_signal(signal.SIGINT)
            program.communicate(timeout=LIMIT_S)
            assert program.returncode == 130


def test_the_request_to_end_names_a_call_that_does_not_return_and_says_how_to_end_at_once() -> None:
    returned, ended = threading.Event(), threading.Event()
    shown: queue.SimpleQueue[str] = queue.SimpleQueue()

    class Blocked(Mirrors):
        def stop(self) -> None:
            assert returned.wait(LIMIT_S)

    with Watched(Blocked(), ended, shown.put, lambda _: None) as device:
        driver = threading.Thread(target=device.stop, daemon=True)
        driver.start()
        ended.set()
        # The watch of the device may name the call before.
        texts = iter(lambda: shown.get(timeout=LIMIT_S), "")
        expected = "the driver ends when stop returns; a second Ctrl-C or SIGTERM ends it at once"
        assert any(text == expected for text in texts)
        returned.set()
        driver.join(LIMIT_S)
        assert device.kept_from_end(time.monotonic()) == "", "no call is present"


def test_the_watch_of_a_driver_that_ends_without_a_request_ends_with_it() -> None:
    before = set(threading.enumerate())
    with Watched(Mirrors(), threading.Event(), lambda _: None, lambda _: None):
        watches = set(threading.enumerate()) - before
    for watch in watches:
        watch.join(LIMIT_S)
    assert len(watches) == 2 and not any(watch.is_alive() for watch in watches)


def test_a_signal_that_interrupts_a_holder_of_the_lock_of_the_stop_is_obeyed() -> None:
    lock = threading.Lock()

    class Locked(threading.Event):
        def set(self) -> None:
            assert lock.acquire(timeout=1.0), "the thread that holds the lock waits for itself"
            super().set()
            lock.release()

    with stop_on_signals(Locked()) as stop:
        with lock:
            signal.raise_signal(signal.SIGTERM)
            assert not stop.is_set()
        assert stop.wait(LIMIT_S)
        with lock, pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (Settings(), "no endpoint"),
        (Settings(connect=("tcp/127.0.0.1",)), "expected tcp/HOST:PORT"),
        (Settings(connect=("udp/127.0.0.1:1",)), "expected tcp/HOST:PORT"),
        (Settings(listen=("tcp/0.0.0.0:1",)), "--insecure"),
        (Settings(connect=("tls/127.0.0.1:1",)), "--tls DIR"),
        (Settings(connect=("tcp/127.0.0.1:1",), tls=Path("keys")), "with --tls"),
        (Settings(connect=("tls/127.0.0.1:1",), tls=Path("absent")), "heliostat keys"),
        (Settings(client=True, listen=("tcp/127.0.0.1:1",)), "client"),
        (Settings(listen="tcp/127.0.0.1:1"), "listen = .*: expected a tuple of endpoints"),  # type: ignore[arg-type]
        (Settings(connect=(3,)), "connect = .*: expected a tuple of endpoints"),  # type: ignore[arg-type]
        (Settings(room="l/b", connect=("tcp/127.0.0.1:1",)), "only ASCII letters"),
    ],
)
def test_settings_that_do_not_fit_are_refused_with_the_reason(settings: Settings, reason: str) -> None:
    with pytest.raises(PeerError, match=reason):
        run(Mirrors(), settings, seconds=0)


def test_a_text_from_the_room_cannot_control_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with _Log() as log:
        log.show("é\x1b[2Jcleared\r")
    assert capsys.readouterr().err == "é\\u001b[2Jcleared\\u000d\n"


def test_the_log_has_a_stop_at_its_order_and_once_when_the_device_has_executed_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with _Log() as log:
        shown = _Shown(log, "")
        for stop, executed in (("7/3", False), ("7/3", True), ("7/3", True), ("7/4", True), ("", False)):
            shown.note_stop(stop)
            shown.note_stopped(executed)
    stopped = "the array is stopped: its device has executed the stop"
    expected = ["stop ordered by 7/3", stopped, "stop ordered by 7/4", stopped, "the array is released"]
    assert capsys.readouterr().err.splitlines() == expected


def test_a_flood_of_stops_has_a_bounded_number_of_lines_and_hides_no_release(
    capsys: pytest.CaptureFixture[str],
) -> None:
    limit = _EventLimit("further stops")
    # Their times are exact as numbers of the machine.
    lines = [line for step in range(60 * 128) if (line := limit.line(f"stop {step}", step / 128))]
    assert len(lines) == _EVENTS_MAX + 5 + 6 and lines[0] == "stop 0"
    assert lines[_EVENTS_MAX:][:3] == ["further stops", "stop 1280", "further stops (1279 times)"]

    def burst(at_s: float) -> int:
        return sum(limit.line("stop", at_s) is not None for _ in range(_EVENTS_MAX))

    assert max(burst(11.0 * number) for number in range(8, 100)) <= 4, "a pause of ten seconds ends no flood"
    assert burst(3000.0) == _EVENTS_MAX, "each one after a long pause"
    with _Log() as log:
        shown = _Shown(log, "")
        for sequence in range(2 * _EVENTS_MAX):
            shown.note_stop(f"7/{sequence}")
        shown.note_stop("")
    assert capsys.readouterr().err.splitlines()[-1] == "the array is released"


def test_a_write_of_the_record_that_fails_again_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    results = ["it is full", "it is full", "it is recorded again", None, "it is full"]

    class Station:
        def write_record(self) -> str | None:
            return results.pop(0)

    done = threading.Event()
    with _Log() as log:
        record = _Record(Station(), log, done)  # type: ignore[arg-type]
        while results:
            record.write()
            assert done.wait(LIMIT_S)
            done.clear()
    assert capsys.readouterr().err.splitlines() == ["it is full", "it is recorded again", "it is full"]


def test_the_log_has_each_loss_of_the_device_and_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    with _Log() as log:
        shown = _Shown(log, "")
        for absent, connections, problem in (
            (0, 1, ""),
            (1, 1, "no answer"),
            (1, 1, "no answer"),
            (0, 2, "no answer"),
            (0, 2, "command: expired"),
            (0, 2, "no answer"),
            (0, 3, "no answer"),
        ):
            counters = [("device_absent", absent), ("connections", connections)]
            shown.note_status({"last_problem": problem, "counters": counters})
    answers = "the device answers"
    expected = ["no answer", answers, "command: expired", "no answer", "no answer", answers]
    assert capsys.readouterr().err.splitlines() == expected


def test_the_advice_about_several_stops_has_a_line_for_each(capsys: pytest.CaptureFixture[str]) -> None:
    with _Log() as log:
        log.show("the array starts stopped by ann: smoke\nthe array starts stopped by bob: fire")
    assert capsys.readouterr().err.count("\n") == 2


def test_a_wrong_command_line_ends_with_the_usage(tmp_path: Path) -> None:
    at = ("--connect", "tcp/127.0.0.1:1")
    for wrong, reason in (
        ((), "usage:"),
        (("--rows", "two", "--columns", "3"), "usage:"),
        (SIZE, "error: no endpoint"),
        ((*SIZE, *at, "--room", "a/b"), "only ASCII letters"),
        ((*SIZE, "--connect", "tcp/127.0.0.1"), "expected tcp/HOST:PORT"),
        ((*SIZE, "--connect", "tls/127.0.0.1:1", "--tls", "absent"), "made by heliostat keys init"),
    ):
        with python(EXAMPLES / "driver.py", *wrong, folder=tmp_path) as driver:
            _, errors = driver.communicate(timeout=LIMIT_S)
            assert driver.returncode == 2 and reason in errors, errors
    with python(EXAMPLES / "tracker.py", folder=tmp_path) as tracker:
        _, errors = tracker.communicate(timeout=LIMIT_S)
        assert tracker.returncode == 2 and "error: no endpoint" in errors, errors
    for array in ("-1", "16", "two", "1.5", str(2**80)):
        with python(EXAMPLES / "driver.py", *SIZE, "--array", array, folder=tmp_path) as driver:
            _, errors = driver.communicate(timeout=LIMIT_S)
            assert driver.returncode == 2 and f'invalid array "{array}": expected an index from 0 to 15' in errors, errors


def test_a_device_without_capabilities_is_named() -> None:
    class Unset(Mirrors):
        capabilities = None  # type: ignore[assignment]

    with pytest.raises(ValueError, match=r"^Unset\.capabilities = None: expected Capabilities"):
        run(Unset(), Settings(listen=("tcp/127.0.0.1:0",)), seconds=0)
    with pytest.raises(ValueError, match=r"^rows = 16385: expected an integer from 1 to 16384$"):
        Capabilities("too many", 16385, 1, (-0.25, 0.5), (-0.25, 0.5))


@pytest.mark.parametrize("array", [-1, 16, 2**80, "x", None])
def test_an_index_outside_the_arrays_of_a_room_is_refused(array: Any) -> None:
    with pytest.raises(PeerError, match=r"array = .*: expected an integer from 0 to 15"):
        run(Mirrors(), Settings(listen=("tcp/127.0.0.1:0",)), array=array, seconds=0)


@needs_program
def test_the_driver_of_the_tutorial_keeps_every_rule(tmp_path: Path) -> None:
    tutorial = (EXAMPLES.parent / "docs/tutorials/own-driver.md").read_text(encoding="utf-8")
    own = tmp_path / "own_driver.py"
    own.write_text(tutorial.split("```python\n")[1].split("```")[0], encoding="utf-8")
    endpoint = free_endpoint()
    with python(own, "--connect", endpoint, folder=tmp_path) as driver:
        found = verdicts("--listen", endpoint)
        assert len(found) > 20 and set(found.values()) == {"kept"}, found
        output, _ = end_by(signal.SIGTERM, driver)
    assert "turn [" in output and "stop" in output


def test_durations_have_the_units_of_the_other_programs() -> None:
    for text, seconds in (("2.5", 2.5), ("3s", 3.0), ("500ms", 0.5), ("2min", 120.0), ("1h", 3600.0)):
        assert duration_s(text) == pytest.approx(seconds)
    for wrong in ("", "x", "-1", "0", "nan", "inf", "1 s", "3m", "s", "5ms", "3000h"):
        with pytest.raises(argparse.ArgumentTypeError, match="invalid duration .*: expected seconds between"):
            duration_s(wrong)
