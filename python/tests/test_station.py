"""The rules of a driver around a device in Python, without a session: time and messages in, payloads out."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heliostat import wire
from heliostat._core import Station
from numpy.typing import NDArray

pytest.importorskip("zenoh")
from heliostat._stop_file import StopFile
from heliostat.driver import Capabilities, Device, Health

UTC_NS = 1_800_000_000_000_000_000
MS = 1_000_000
PARKED, FOLLOWING, HOLDING, STOPPED, FAULT = range(5)


class Mirrors(Device):
    """Two mirrors that record what they were told, and fail as they are told."""

    def __init__(self, **capabilities: Any) -> None:
        limits = (-0.25, 0.5)
        standard = Capabilities("two mirrors", 1, 2, limits, limits, park_after_ms=300)
        self.capabilities = replace(standard, **capabilities)
        self.turns: list[tuple[list[float], list[float]]] = []
        self.stops = 0
        self.connections = 0
        self.problem: BaseException | None = None
        self.measured: Any = None
        self.condition = Health()

    def connect(self) -> None:
        self._answer()
        self.connections += 1

    def turn(self, roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
        self._answer()
        self.turns.append((roll.tolist(), yaw.tolist()))

    def stop(self) -> None:
        self._answer()
        self.stops += 1

    def measure(self) -> tuple[Sequence[float], Sequence[float]] | None:
        measured: tuple[Sequence[float], Sequence[float]] | None = self.measured
        return measured

    def health(self) -> Health:
        return self.condition

    def _answer(self) -> None:
        if self.problem is not None:
            raise self.problem


class Driven:
    """A station with a clock that the test sets."""

    def __init__(self, folder: Path, mirrors: Mirrors, *, armed: bool = True, authenticated: bool = False) -> None:
        self.mirrors, self.local_ns, self.sequence = mirrors, 0, 0
        self.is_disk_slow = False
        self.problem: str | None = None
        self.station = Station(
            mirrors,
            mirrors.capabilities.message(),
            mirrors.capabilities.travel_rad,
            StopFile(folder, pytest.fail),
            room="lab",
            array=0,
            source=9,
            software="test",
            start_armed=armed,
            authenticated=authenticated,
            clock=lambda: self.now,
        )
        self.step(0)

    @property
    def now(self) -> tuple[int, int]:
        return self.local_ns, UTC_NS + self.local_ns

    def step(self, ms: float = 60) -> None:
        """Handles all messages, and then lets time pass."""
        while self.station.handle_received(self.now):
            pass
        self.local_ns += int(ms * MS)
        if self.station.advance(self.now) and not self.is_disk_slow:
            self.write()
        due = self.station.reports(self.now)
        self.reports = {name: wire.decode(payload, wire.KINDS[name]) for name, payload in due}

    def write(self) -> None:
        """The disk answers."""
        self.problem = self.station.write_record()
        self.station.advance(self.now)

    def telemetry(self, ms: float = 60) -> dict[str, Any]:
        self.step(ms)
        telemetry: dict[str, Any] = self.reports["telemetry"]
        return telemetry

    def command(self, **change: Any) -> None:
        self.sequence += 1
        message = {
            "epoch": UTC_NS // MS,
            "sequence": self.sequence,
            "answers": 5,
            "time_ns": self.now[1],
            "validity_ms": 200,
            "roll": [0.125, 0.0],
            "yaw": [0.0, 0.25],
        }
        self.station.receive("command", wire.encode(message | change, 4), self.now)

    def order(self, name: str, **fields: Any) -> None:
        stamp = {"source": 7, "sequence": 3, "time_ns": self.now[1]}
        texts = {"operator": "ann", "reason": "test"}
        self.station.receive(name, wire.encode({"stamp": stamp} | texts | fields, wire.KINDS[name]), self.now)


@pytest.fixture
def driven(tmp_path: Path) -> Driven:
    return Driven(tmp_path, Mirrors())


def test_a_command_turns_the_mirrors_within_their_limits_and_ends_in_the_park_position(driven: Driven) -> None:
    assert driven.reports.keys() == {"telemetry", "safety", "stops", "capabilities", "status"}
    driven.command(roll=[1.0, -1.0])
    telemetry = driven.telemetry()
    assert (telemetry["state"], telemetry["answers"], telemetry["counters"]["clipped"]) == (FOLLOWING, 5, 1)
    assert driven.mirrors.turns[-1] == ([0.5, -0.25], [0.0, 0.25])
    assert driven.telemetry(200)["state"] == HOLDING and driven.mirrors.turns[-1][0] == [0.5, -0.25]
    assert driven.telemetry(300)["state"] == PARKED and driven.mirrors.turns[-1] == ([0.0, 0.0], [0.0, 0.0])


@pytest.mark.parametrize(
    ("change", "counter"),
    [
        ({"roll": [0.0] * 3, "yaw": [0.0] * 3}, "rejected"),
        ({"time_ns": UTC_NS - 1000 * MS}, "expired"),
        ({"time_ns": UTC_NS + 1000 * MS}, "expired"),
        ({"validity_ms": 10_001}, "rejected"),
        ({"epoch": UTC_NS // MS + 61_000}, "rejected"),
        ({"epoch": 1}, "old_epoch"),
        ({"sequence": 1}, "old_sequence"),
    ],
)
def test_commands_are_refused_by_the_rules_of_the_contract(
    driven: Driven, change: dict[str, Any], counter: str
) -> None:
    driven.command()
    driven.step()
    turns = list(driven.mirrors.turns)
    driven.command(**change)
    assert driven.telemetry()["counters"][counter] == 1 and driven.mirrors.turns == turns


def test_payloads_that_are_no_messages_are_counted_and_turn_nothing(driven: Driven) -> None:
    turns = list(driven.mirrors.turns)
    not_a_number = bytes.fromhex("010407ac02e80780cffea7a4deb2c318c801020000003e000000bf02000000000000c07f")
    for payload in (b"", b"\2\4", b"\1\4\7", not_a_number):
        driven.station.receive("command", payload, driven.now)
    for name in ("stop", "stop_repetition", "rearm", "calibration"):
        driven.station.receive(name, b"\1", driven.now)
    telemetry = driven.telemetry()
    assert telemetry["counters"]["rejected"] == 4 and telemetry["state"] == PARKED and driven.mirrors.turns == turns
    driven.step(1000)
    counters = dict(driven.reports["status"]["counters"])
    assert counters["refused:stop:truncated"] == 1, counters
    with pytest.raises(ValueError, match="unknown message"):
        driven.station.receive("users", b"", driven.now)


def test_a_stop_is_recorded_and_only_a_rearm_that_names_it_releases_it(tmp_path: Path) -> None:
    driven = Driven(tmp_path, Mirrors())
    driven.command()
    driven.order("stop", action=0)
    assert driven.telemetry()["state"] == STOPPED and driven.mirrors.stops == 1
    assert driven.reports["safety"]["stop_source"] == 7 and "0000000000000007/3" in driven.station.stop
    restarted = Driven(tmp_path, Mirrors())
    assert restarted.station.state == "stopped" and "heliostat rearm --room lab" in (restarted.station.advice or "")
    restarted.command()
    restarted.order("rearm", stop_source=7, stop_sequence=4)
    assert restarted.telemetry()["counters"]["stopped"] == 1 and restarted.station.state == "stopped"
    restarted.order("rearm", stop_source=7, stop_sequence=3)
    assert restarted.telemetry()["state"] == PARKED and restarted.reports["safety"]["stopped"] is False
    assert Driven(tmp_path, Mirrors()).station.advice is None


def test_a_driver_that_ends_follows_no_command_and_obeys_a_stop(driven: Driven) -> None:
    turns = list(driven.mirrors.turns)
    driven.command()
    driven.station.end()
    assert driven.station.is_settled, "the command is no message"
    driven.command()
    assert driven.telemetry()["state"] == PARKED and driven.mirrors.turns == turns
    driven.order("stop", action=0)
    assert driven.telemetry()["state"] == STOPPED and driven.mirrors.stops == 1


def test_a_room_with_keys_refuses_a_rearm_that_names_no_stop(tmp_path: Path) -> None:
    for authenticated, state in ((False, PARKED), (True, STOPPED)):
        driven = Driven(tmp_path / str(authenticated), Mirrors(), authenticated=authenticated)
        driven.order("stop", action=0)
        driven.step()
        driven.order("stop", action=1)
        assert driven.telemetry()["state"] == state


def test_a_first_start_a_damaged_record_and_one_that_cannot_be_written_start_stopped(tmp_path: Path) -> None:
    assert "there is no" in (Driven(tmp_path / "first", Mirrors(), armed=False).station.advice or "")
    record = tmp_path / "lab.stop.toml"
    record.write_text("version = 1")
    assert str(record) in (Driven(tmp_path, Mirrors()).station.advice or "")
    record.unlink()
    record.mkdir()
    assert "expected a regular file" in (Driven(tmp_path, Mirrors()).station.advice or "")
    record.rmdir()
    record.symlink_to(tmp_path / "absent")
    assert "expected a regular file" in (Driven(tmp_path, Mirrors()).station.advice or "")
    record.unlink()
    (tmp_path / "lab.stop.new").mkdir()
    assert "cannot record the emergency stop" in (Driven(tmp_path, Mirrors()).station.advice or "")


@pytest.mark.skipif(sys.platform == "win32", reason="needs named pipes")
def test_a_pipe_in_place_of_the_record_or_of_its_new_file_makes_no_start_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "lab.stop.new")
    assert Driven(tmp_path, Mirrors()).station.advice is None, "the state is recorded"
    (tmp_path / "lab.stop.toml").unlink()
    os.mkfifo(tmp_path / "lab.stop.toml")
    (tmp_path / "lab.stop.new").mkdir()
    assert "expected a regular file" in (Driven(tmp_path, Mirrors()).station.advice or "")


def test_another_device_starts_stopped_with_the_record_of_a_released_one(tmp_path: Path) -> None:
    assert Driven(tmp_path, Mirrors()).station.advice is None
    assert Driven(tmp_path, Mirrors()).station.advice is None, "the same device"
    larger = Driven(tmp_path, Mirrors(rows=4, columns=6)).station.advice or ""
    assert "two mirrors, 1 x 2 mirrors" in larger and "two mirrors, 4 x 6 mirrors" in larger


def test_another_process_is_a_problem_of_the_status(driven: Driven) -> None:
    driven.station.note_other_process("another driver has joined the room")
    assert driven.station.last_problem == "another driver has joined the room"


def test_a_stop_that_cannot_be_recorded_is_in_force_and_is_written_again(tmp_path: Path) -> None:
    driven = Driven(tmp_path, Mirrors())
    blocked = tmp_path / "lab.stop.new"
    blocked.mkdir()
    driven.order("stop", action=0)
    driven.step()
    assert driven.station.state == "stopped" and "the next start is stopped" in (driven.problem or "")
    assert (tmp_path / "lab.stop.toml").read_text() == ""
    blocked.rmdir()
    driven.step(1000)
    assert "ann" in (tmp_path / "lab.stop.toml").read_text() and driven.station.last_problem == ""
    assert "is recorded again" in (driven.problem or ""), "a line for the log"
    driven.step(1100)
    assert driven.problem is None, "once"


def test_a_slow_disk_delays_no_stop_and_a_report_only_for_a_while(tmp_path: Path) -> None:
    driven = Driven(tmp_path, Mirrors())
    driven.is_disk_slow = True
    driven.order("stop", action=0)
    driven.step()
    assert driven.mirrors.stops == 1 and driven.reports == {}, "the stop is not recorded yet"
    driven.order("stop", action=0)
    driven.step()
    assert driven.mirrors.stops == 2, "the disk has not answered"
    driven.step(300)
    assert driven.reports["safety"]["stopped"] and "not recorded yet" in driven.station.last_problem
    driven.is_disk_slow = False
    driven.write()
    driven.step()
    assert "ann" in (tmp_path / "lab.stop.toml").read_text() and driven.station.last_problem == ""


def test_a_device_that_fails_is_a_fault_until_it_answers_again(driven: Driven) -> None:
    driven.mirrors.problem = OSError("no answer")
    driven.command()
    telemetry = driven.telemetry()
    assert (telemetry["state"], telemetry["faults"]) == (FAULT, 1)
    problem = driven.station.last_problem
    assert re.fullmatch(r"two mirrors: turn: OSError: no answer \(test_station\.py:\d+\)", problem), problem
    driven.mirrors.problem = None
    driven.command()
    telemetry = driven.telemetry(120)
    assert (telemetry["state"], telemetry["faults"], driven.mirrors.connections) == (FOLLOWING, 0, 2)
    assert driven.mirrors.turns[-1][0] == [0.125, 0.0], "the angles that apply after the reconnection"


def test_a_device_that_could_not_be_stopped_is_stopped_when_it_answers(driven: Driven) -> None:
    driven.mirrors.problem = OSError("no answer")
    driven.order("stop", action=0)
    assert driven.telemetry()["state"] == STOPPED and driven.mirrors.stops == 0
    driven.mirrors.problem = None
    driven.step(200)
    assert driven.mirrors.stops == 1


@pytest.mark.parametrize(
    ("measured", "reason"),
    [
        (([0.0], [0.0]), "roll of 1 mirrors: expected 2"),
        (([0.0, 0.0], [0.0, float("nan")]), "yaw of mirror 1 is not finite"),
        (([0.0, "x"], [0.0, 0.0]), "a pair of lists"),
        (3, "a pair of lists"),
    ],
)
def test_measured_angles_that_are_none_are_a_fault(driven: Driven, measured: Any, reason: str) -> None:
    driven.mirrors.measured = measured
    driven.step()
    driven.mirrors.measured = None
    assert reason in driven.station.last_problem and driven.reports["telemetry"]["faults"] & 1


def test_measured_angles_and_health_are_in_the_telemetry(tmp_path: Path) -> None:
    mirrors = Mirrors(measures=True)
    mirrors.measured = (np.array([0.125, -0.5]), [0.0, 0.25])
    mirrors.condition = Health(temperature_c=36.5, supply_fault=True, broken=(1,))
    telemetry = Driven(tmp_path, mirrors).telemetry()
    assert telemetry["roll_measured"] == [0.125, -0.5] and telemetry["yaw_measured"] == [0.0, 0.25]
    assert (telemetry["temperature_c"], telemetry["faults"], telemetry["unusable"]) == (36.5, 8 | 2, [1])
    for wrong in (Health(temperature_c=float("nan")), Health(broken=(2,))):
        mirrors.condition = wrong
        failed = Driven(tmp_path, mirrors)
        assert failed.telemetry()["faults"] & 1 and "health" in failed.station.last_problem


@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        (None, "health: ValueError: expected a Health, got None"),
        (36.5, "expected a Health, got 36.5"),
        (Health(temperature_c="hot"), "temperature_c: expected a number in degrees Celsius"),  # type: ignore[arg-type]
        (Health(broken=(-1,)), "broken: expected a list of indices of mirrors"),
        (Health(broken=3), "broken: expected a list of indices of mirrors"),  # type: ignore[arg-type]
    ],
)
def test_a_condition_that_is_no_health_is_named(driven: Driven, condition: Any, reason: str) -> None:
    driven.mirrors.condition = condition
    driven.step()
    assert reason in driven.station.last_problem and driven.reports["telemetry"]["faults"] & 1


def test_a_calibration_corrects_the_device_within_its_travel(tmp_path: Path) -> None:
    travel = ((-0.5, 0.75), (-0.5, 0.75))
    driven = Driven(tmp_path, Mirrors(travel_rad=travel))
    lists = {"roll_gain": [1.0, 1.0], "yaw_offset_rad": [0.0, 0.0], "yaw_gain": [1.0, 1.0]}

    def calibrate(sequence: int, offset_rad: float) -> int:
        stamp = {"source": 4, "sequence": sequence, "time_ns": 0}
        message = {"stamp": stamp, "roll_offset_rad": [offset_rad, 0.0], **lists}
        driven.station.receive("calibration", wire.encode(message, 10), driven.now)
        driven.command()
        telemetry = driven.telemetry()
        return int(telemetry["calibration"])

    assert calibrate(1, 0.125) == 1 and driven.mirrors.turns[-1][0] == [0.25, 0.0]
    assert calibrate(2, 0.3) == 1, "an offset beyond its bound"
    assert calibrate(1, 0.0) == 1 and driven.mirrors.turns[-1][0] == [0.25, 0.0], "not newer than the one in use"


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"roll_rad": (0.5, -0.5)}, "smallest angle"),
        ({"roll_rad": (float("nan"), 0.5)}, "roll_rad = .* is not finite"),
        ({"yaw_rad": (-30.0, 30.0)}, "yaw_rad = .* more than half a turn"),
        ({"yaw_rad": (0.5,)}, "yaw_rad = .*: expected the smallest angle"),
        ({"park_rad": (0.0, float("inf"))}, "park_rad = .* is not finite"),
        ({"rows": 0}, "rows = 0: expected an integer from 1"),
        ({"columns": -2}, "columns = -2: expected an integer from 1"),
        ({"settling_s": -1.0}, "settling_s = -1.0: expected a finite number that is not negative"),
        ({"slew_rad_s": -0.5}, "slew_rad_s = -0.5: expected a finite number that is not negative"),
        ({"slew_rad_s": True}, "slew_rad_s = True: expected a finite number"),
        ({"travel_rad": ((-1.0, 1.0), (-0.25, 0.25))}, "travel_rad, yaw = .*: expected a range that holds yaw_rad"),
        ({"measures": "yes"}, "measures = 'yes': expected True or False"),
        ({"synchronised_clock": 1}, "synchronised_clock = 1: expected True or False"),
        ({"driver": 5}, "driver = 5: expected a text"),
        ({"resolution_rad": "0.1"}, "resolution_rad = '0.1': expected a finite number"),
        ({"park_rad": (0.0, 0.75)}, "park_rad, yaw = 0.75: expected an angle within the limits of yaw, -0.25 to 0.5"),
        ({"rows": 200, "columns": 200}, "rows \\* columns"),
        ({"park_after_ms": -1}, "park_after_ms"),
    ],
)
def test_capabilities_that_the_contract_does_not_allow_are_refused_where_they_are_stated(
    wrong: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        Mirrors(**wrong)


def test_the_name_of_the_hardware_is_a_text() -> None:
    with pytest.raises(ValueError, match="hardware = 5: expected a text"):
        Capabilities(5, 1, 2, (-0.25, 0.5), (-0.25, 0.5))  # type: ignore[arg-type]


def test_a_boolean_is_no_number_of_mirrors() -> None:
    with pytest.raises(TypeError, match="rows = True: expected an integer from 1"):
        Mirrors(rows=True)


def test_whole_numbers_are_angles_too(tmp_path: Path) -> None:
    driven = Driven(tmp_path, Mirrors(roll_rad=(-1, 1), yaw_rad=np.array([-1, 1]), settling_s=1))
    capabilities = driven.reports["capabilities"]
    assert (capabilities["roll"]["min_rad"], capabilities["yaw"]["max_rad"]) == (-1.0, 1.0)


def test_a_stop_that_arrives_during_a_call_of_the_device_comes_before_the_next_movement(
    driven: Driven, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn = driven.mirrors.turn

    def slow(roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
        turn(roll, yaw)
        driven.local_ns += 4000 * MS
        driven.order("stop", action=0)

    driven.command()
    monkeypatch.setattr(driven.mirrors, "turn", slow)
    assert driven.station.handle_received(driven.now)
    turns = list(driven.mirrors.turns)
    assert not driven.station.is_report_due(driven.local_ns), "the stop comes before the report that is overdue"
    driven.station.advance(driven.now)
    assert driven.mirrors.turns == turns and driven.mirrors.stops == 0, "the array would park"
    assert driven.telemetry()["state"] == STOPPED
    assert driven.mirrors.turns == turns and driven.mirrors.stops == 1


def test_a_stop_that_arrives_during_a_connection_comes_before_the_movement_after_it(
    driven: Driven, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect = driven.mirrors.connect

    def slow() -> None:
        connect()
        driven.local_ns += 1500 * MS
        driven.order("stop", action=0)
        driven.local_ns += 2500 * MS

    driven.mirrors.problem = OSError("no answer")
    driven.command()
    driven.step()
    driven.mirrors.problem = None
    monkeypatch.setattr(driven.mirrors, "connect", slow)
    turns = list(driven.mirrors.turns)
    driven.step(120)
    assert driven.mirrors.connections == 2 and driven.mirrors.turns == turns and driven.mirrors.stops == 0
    assert driven.telemetry()["state"] == STOPPED
    assert driven.mirrors.turns == turns and driven.mirrors.stops == 1


def test_angles_that_expire_during_a_connection_are_not_applied_after_it(
    driven: Driven, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow() -> None:
        driven.local_ns += 4000 * MS

    driven.mirrors.problem = OSError("no answer")
    driven.command()
    driven.step()
    driven.mirrors.problem = None
    monkeypatch.setattr(driven.mirrors, "connect", slow)
    assert driven.telemetry(120)["state"] == PARKED
    assert driven.mirrors.turns[-1] == ([0.0, 0.0], [0.0, 0.0])


def test_what_the_clock_raises_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: Driven) -> tuple[int, int]:
        raise KeyboardInterrupt

    driven = Driven(tmp_path, Mirrors())
    now = driven.now
    monkeypatch.setattr(Driven, "now", property(interrupted))
    with pytest.raises(KeyboardInterrupt):
        driven.station.advance(now)


def test_an_interrupt_within_a_device_ends_the_driver(driven: Driven) -> None:
    driven.mirrors.problem = KeyboardInterrupt()
    driven.command()
    with pytest.raises(KeyboardInterrupt):
        driven.step()


def test_a_device_that_calls_the_station_gets_an_error_and_no_deadlock(
    driven: Driven, monkeypatch: pytest.MonkeyPatch
) -> None:
    def turn(roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
        assert driven.station.state

    monkeypatch.setattr(driven.mirrors, "turn", turn)
    driven.command()
    driven.step()
    assert "the station is in use" in driven.station.last_problem
