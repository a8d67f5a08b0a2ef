"""Trackers in Python: what they publish, and how they end."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heliostat import wire

pytest.importorskip("zenoh")
from heliostat.peer import PeerError, Settings
from heliostat.tracker import Tracker, User
from room import EXAMPLES, LIMIT_S, end_by, free_endpoint, observer, python, wait_until


def test_the_example_reports_users_who_enter_and_leave_until_ctrl_c(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with observer(endpoint, "tracked") as room:
        example = (EXAMPLES / "tracker.py", "--room", "tracked", "--connect", endpoint)
        with python(*example, folder=tmp_path) as tracker:

            def present() -> list[int]:
                return [one["user"] for one in room.latest.get("users", {}).get("users", [])]

            wait_until("report of three users", lambda: present() == [0, 1, 2])
            wait_until("report of two users", lambda: present() == [0, 2])
            assert len(room.alive("heliostat/v1/tracked/alive/tracker/*")) == 1
            assert room.latest["status"]["node"] == 3 and room.latest["status"]["state"] == "tracking"
            output, errors = end_by(signal.SIGINT, tracker)
        assert errors.startswith('reports the users of room "tracked"\n')
        assert int(output.removeprefix("reports sent: ")) >= room.latest["users"]["tick"] > 20


def test_the_example_ends_after_its_time_without_a_controller(tmp_path: Path) -> None:
    example = (EXAMPLES / "tracker.py", "--connect", free_endpoint(), "--seconds", "0.5")
    with python(*example, folder=tmp_path) as tracker:
        output, errors = tracker.communicate(timeout=LIMIT_S)
        assert tracker.returncode == 0 and "reports sent:" in output, errors


def test_reports_have_a_tick_a_stamp_and_the_time_of_the_measurement() -> None:
    endpoint = free_endpoint()
    with observer(endpoint, "stamped") as room, Tracker(Settings("stamped", connect=(endpoint,))) as tracker:

        def report() -> bool:
            tracker.report([User(3, (1.5, -0.25, 0.85), min_rate_bps=1e6)], time_ns=1000)
            return "users" in room.latest

        wait_until("report", report)
        message = room.latest["users"]
        assert message["tick"] == message["stamp"]["sequence"] and message["stamp"]["time_ns"] == 1000
        assert message["users"][0]["position_m"][:2] == [1.5, -0.25]
        gains = {"user": 3, "los_gain": 0.0, "irs_gain": 1e-6, "sinr": 42.5}
        leds = {"user": 3, "serving": 0, "measures_each": False}
        others: dict[str, dict[str, Any]] = {
            "obstacles": {"obstacles": [{"x_m": -1.0, "y_m": 0.5, "radius_m": 0.25, "height_m": 1.75}]},
            "channel": {"tick": tracker.ticks, "users": [gains]},
            "orientation": {"users": [{"user": 3, "quaternion": [0.5, -0.5, 0.5, 0.5]}]},
            "leds": {"tick": 1, "users": [leds], "gains": []},
        }

        def other_reports() -> bool:
            for name, fields in others.items():
                tracker.publish(name, fields)
            return others.keys() <= room.latest.keys()

        wait_until("other reports", other_reports)
        with pytest.raises(ValueError, match="expected channel"):
            tracker.publish("command", {})


@pytest.mark.parametrize(
    ("users", "reason"),
    [
        ([User(0, (float("nan"), 0.0, 0.85))], "not finite"),
        ([User(0, (0.0, 0.85))], r"user 0: position_m: expected 3 numbers \(x, y, z\), got 2"),
        ([User(0, (0.0, 0.0, 0.85), (1.0, 2.0, 3.0))], r"velocity_m_s: expected 2 numbers \(x, y\), got 3"),
        ([User(0, 0.85)], "position_m = 0.85: expected 3 numbers"),  # type: ignore[arg-type]
        ([User(0, (0.0, "1", 0.85))], "position_m, y = '1': expected a finite number"),  # type: ignore[arg-type]
        (None, "users = None: expected a list"),
        ([(0, (0.0, 0.0, 0.85))], "in the list of users: expected a heliostat.tracker.User"),
        ([User(2**32, (0.0, 0.0, 0.85))], "user = 4294967296: expected an integer from 0 to 4294967295"),
        ([User("a", (0.0, 0.0, 0.85))], "user = 'a': expected an integer"),  # type: ignore[arg-type]
        ([User(0, (0.0, 0.0, 0.85)), User(0, (1.0, 0.0, 0.85))], "named twice"),
        ([User(-1, (0.0, 0.0, 0.85))], "user = -1: expected an integer from 0"),
        ([User(0, (0.0, 0.0, 0.85), min_rate_bps=-1.0)], "not negative"),
        ([User(number, (0.0, 0.0, 0.85)) for number in range(65)], "64"),
    ],
)
def test_users_that_the_contract_does_not_allow_are_refused_and_reporting_goes_on(
    users: Any, reason: str
) -> None:
    with Tracker(Settings(connect=(free_endpoint(),))) as tracker:
        with pytest.raises(wire.Refused, match=reason):
            tracker.report(users)
        assert tracker.report([]) == 1


def test_a_time_in_seconds_is_refused_with_its_type() -> None:
    wrong: Any = 1.7e9
    with Tracker(Settings(connect=(free_endpoint(),))) as tracker:
        with pytest.raises(wire.Refused, match=r"time_ns: expected an integer in ns, got a float 1700000000\.0"):
            tracker.report([], wrong)
        with pytest.raises(wire.Refused, match="got a float"):
            tracker.publish("obstacles", {"obstacles": []}, wrong)
        assert tracker.report([], np.int64(1000)) == 1  # type: ignore[arg-type]


def test_numbers_of_numpy_are_numbers_of_a_user() -> None:
    with Tracker(Settings(connect=(free_endpoint(),))) as tracker:
        user = User(np.int64(0), np.array([0.0, 0.0, 0.85]), (np.float32(1.0), 0), np.float64(1e6))  # type: ignore[arg-type]
        assert tracker.report([user]) == 1


def test_a_tracker_without_an_endpoint_is_refused_and_a_stop_ends_the_wait_for_a_router() -> None:
    with pytest.raises(PeerError, match="no endpoint"):
        Tracker(Settings())
    stop = threading.Event()
    threading.Timer(1.0, stop.set).start()
    with Tracker(Settings(connect=(free_endpoint(),), client=True), stop) as tracker:
        assert not tracker.is_open


def test_a_dead_endpoint_and_a_room_without_a_controller_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    with Tracker(Settings("wrong", connect=(endpoint,))) as tracker:
        peer = tracker._peer
        assert peer.silence() == f"no process of the room answers at {endpoint}: retrying"
        shown: list[str] = []

        def is_shown() -> bool:
            shown.append(capsys.readouterr().err)
            return endpoint in "".join(shown)

        wait_until("line on standard error", is_shown)
        with observer(endpoint, "right") as room:
            wait_until("connection", lambda: 'no controller of room "wrong"' in peer.silence())
            token = room.session.liveliness().declare_token("heliostat/v1/wrong/alive/controller/0000000000000001")
            wait_until("controller", lambda: peer.silence() == "")
            token.undeclare()


def test_a_client_names_the_router_that_does_not_answer(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliostat.peer._SILENT_S", 0.0)
    endpoint, stop, shown = free_endpoint(), threading.Event(), list[str]()
    joining = threading.Thread(target=lambda: Tracker(Settings(connect=(endpoint,), client=True), stop))
    joining.start()

    def is_shown() -> bool:
        shown.append(capsys.readouterr().err)
        return f"no router answers at {endpoint}: retrying" in "".join(shown)

    try:
        wait_until("line on standard error", is_shown)
    finally:
        stop.set()
        joining.join(LIMIT_S)
    assert "".join(shown).count(endpoint) == 1
