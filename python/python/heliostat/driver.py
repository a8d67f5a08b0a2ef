"""Drivers of mirrors: the rules of the contract around a device in Python. It needs the extra `zenoh`.

A driver is a subclass of `Device` and a call of `main`:

    class Mirrors(Device):
        capabilities = Capabilities("my mirrors", rows=2, columns=3, roll_rad=(-0.2, 0.2), yaw_rad=(-0.2, 0.2))

        def turn(self, roll, yaw):
            ...  # angles in rad, one per mirror

        def stop(self):
            ...

    main(Mirrors(), parser().parse_args())

The rest is the code of the Rust drivers: which commands are followed, the limits, the watchdog, the emergency stop and
its record, calibrations, telemetry, reconnection. `heliostat driver check` tests the result.
"""

from __future__ import annotations

import argparse
import math
import os
import queue
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._checks import U32_MAX, finite, integer, printable
from ._claim import Claim
from ._core import (
    ARRAYS_MAX,
    KINDS,
    MIRRORS_MAX,
    STOP_RECORD_END_WAIT_NS,
    Station,
    check_capabilities,
    decode,
    encode,
    stop_record_folder,
)
from ._stop_file import StopFile
from ._watched import LastProblem, Watched
from .peer import INTERRUPTED, SOFTWARE, Peer, PeerError, Settings, add_arguments, end_for, stop_on_signals

_LONGEST_WAIT_NS = 50_000_000
_EVENTS_MAX = 100
_EVENT_EVERY_S = 10.0


def _pair(name: str, values: Any, expected: str) -> tuple[float, float]:
    """Two finite numbers."""
    try:
        one, other = values
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {values!r}: expected {expected}") from None
    return finite(name, one, expected), finite(name, other, expected)


def _limits(name: str, values: Any, most_apart: float = math.pi) -> tuple[float, float]:
    """The smallest and the largest angle of an axis, at most half a turn apart where no other bound is given."""
    expected = "the smallest angle and the largest angle of the axis in rad"
    least, most = _pair(name, values, expected)
    if least > most:
        raise ValueError(f"{name} = {values!r}: expected {expected}, in this order")
    # A limit in single precision may round up.
    if most - least > most_apart + 1e-6:
        raise ValueError(
            f"{name} = {values!r} is more than half a turn: expected {expected}; math.radians converts degrees"
        )
    return least, most


def _travel(values: Any, *limits: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    """The range of the hardware for roll and for yaw, which holds the limits of both."""
    try:
        roll, yaw = values
    except (TypeError, ValueError):
        raise ValueError(f"travel_rad = {values!r}: expected the range of roll and that of yaw") from None
    travel = _limits("travel_rad, roll", roll, math.inf), _limits("travel_rad, yaw", yaw, math.inf)
    for axis, (least, most), inner in zip(("roll", "yaw"), travel, limits, strict=True):
        # Limits that were computed from the travel may be rounded.
        if least > inner[0] + 1e-6 or most < inner[1] - 1e-6:
            raise ValueError(f"travel_rad, {axis} = {least, most}: expected a range that holds {axis}_rad = {inner}")
    return travel


@dataclass(frozen=True)
class Capabilities:
    """What an array announces, and what the rules enforce on each command.

    `rows * columns` mirrors with `index = row * columns + column`, row 0 the lowest; smallest and largest roll and yaw
    in rad. `slew_rad_s`, `settling_s`, `resolution_rad` and `command_rate_max_hz` are 0 where unknown. Without valid
    commands the mirrors hold for `park_after_ms` and then turn to `park_rad`, roll and yaw. `measures`: the hardware
    measures its angles. `synchronised_clock`: the clock of this host follows UTC; without it the validity of a command
    counts from its arrival. `travel_rad`: range of the hardware itself for roll and for yaw, where it exceeds the
    limits to leave room for the corrections of a calibration.
    """

    hardware: str
    rows: int
    columns: int
    roll_rad: tuple[float, float]
    yaw_rad: tuple[float, float]
    slew_rad_s: float = 0.0
    settling_s: float = 0.0
    resolution_rad: float = 0.0
    command_rate_max_hz: float = 0.0
    park_after_ms: int = 1000
    park_rad: tuple[float, float] = (0.0, 0.0)
    measures: bool = False
    synchronised_clock: bool = True
    travel_rad: tuple[tuple[float, float], tuple[float, float]] | None = None
    driver: str = SOFTWARE

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "rows": integer("rows", self.rows, 1, MIRRORS_MAX),
            "columns": integer("columns", self.columns, 1, MIRRORS_MAX),
            "park_after_ms": integer("park_after_ms", self.park_after_ms, 0, U32_MAX),
            "roll_rad": _limits("roll_rad", self.roll_rad),
            "yaw_rad": _limits("yaw_rad", self.yaw_rad),
            "park_rad": _pair("park_rad", self.park_rad, "roll and yaw in rad"),
        }
        for name in ("slew_rad_s", "settling_s", "resolution_rad", "command_rate_max_hz"):
            checked[name] = finite(name, getattr(self, name), "a finite number that is not negative", least=0.0)
        for name in ("hardware", "driver"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"{name} = {getattr(self, name)!r}: expected a text")
        for name in ("measures", "synchronised_clock"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise ValueError(f"{name} = {getattr(self, name)!r}: expected True or False")
        if self.travel_rad is not None:
            checked["travel_rad"] = _travel(self.travel_rad, checked["roll_rad"], checked["yaw_rad"])
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        check_capabilities(self.message())

    def message(self) -> dict[str, Any]:
        """The message of kind 8, with an empty stamp."""

        def axis(limits: tuple[float, float]) -> dict[str, float]:
            names = ("slew_rad_s", "settling_s", "resolution_rad")
            return {"min_rad": limits[0], "max_rad": limits[1], **{name: getattr(self, name) for name in names}}

        return {
            "stamp": {"source": 0, "sequence": 0, "time_ns": 0},
            "hardware": self.hardware,
            "driver": self.driver,
            "rows": self.rows,
            "columns": self.columns,
            "roll": axis(self.roll_rad),
            "yaw": axis(self.yaw_rad),
            "feedback": int(self.measures),
            "validity_clock": int(not self.synchronised_clock),
            "command_rate_max_hz": self.command_rate_max_hz,
            "park_after_ms": self.park_after_ms,
            "park_rad": self.park_rad,
        }


@dataclass(frozen=True)
class Health:
    """The condition of the hardware: temperature in degrees Celsius where known, whether temperature and supply are
    outside their ranges, and the indices of mirrors that the hardware reports as broken."""

    temperature_c: float | None = None
    temperature_fault: bool = False
    supply_fault: bool = False
    broken: Sequence[int] = field(default=())


class Device(ABC):
    """Mirrors that can be turned. All methods are called by the thread that runs the driver.

    An exception of a method means that the device does not answer: the driver reports the fault, calls `connect` with
    growing pauses, and then `turn` with the angles that apply by then, or `stop`.
    """

    capabilities: Capabilities

    @abstractmethod
    def turn(self, roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
        """Turns all mirrors at once: mechanical angles in rad, one per mirror, within the limits, calibrated."""

    @abstractmethod
    def stop(self) -> None:
        """Stops all motion at once; an exception means that it may not have stopped.

        It is also called while the device is not connected, and again after each connection.
        """

    def connect(self) -> None:
        """Connects and initialises the device; called at the start and after each failure."""

    def measure(self) -> tuple[Sequence[float], Sequence[float]] | None:
        """Measured roll and yaw in rad, one per mirror; `None` if the hardware does not measure."""
        return None

    def health(self) -> Health:
        """The condition of the hardware."""
        return Health()


def _array(text: str) -> int:
    """An index of an array on the command line."""
    if not text.isdecimal() or int(text) >= ARRAYS_MAX:
        raise argparse.ArgumentTypeError(f'invalid array "{text}": expected an index from 0 to {ARRAYS_MAX - 1}')
    return int(text)


def parser(description: str | None = None) -> argparse.ArgumentParser:
    """A command line with the flags of `heliostat driver run`; add the flags of your hardware."""
    flags = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(flags)
    flags.add_argument("--array", metavar="N", type=_array, default=0, help="index of the array in its room, from 0")
    flags.add_argument(
        "--state",
        metavar="DIR",
        type=Path,
        help="keep the emergency stop in this folder [default: $STATE_DIRECTORY, else $XDG_STATE_HOME/heliostat or "
        "~/.local/state/heliostat]",
    )
    flags.add_argument(
        "--start-armed",
        action="store_true",
        help="start parked if there is no record of a stop: declares the first start safe",
    )
    return flags


def main(device: Device, given: argparse.Namespace) -> None:
    """Runs a driver by the flags of `parser` until Ctrl-C, SIGTERM or `--seconds`; prints what it did.

    Where a method of the device does not return, the first signal names it. A second signal ends the driver at once,
    unless the method waits in C code.

    The process exits with the reason where the driver cannot run: with status 2 for settings that cannot be used, else 1.
    """
    try:
        counters = run(
            device,
            Settings.of(given),
            array=given.array,
            state=given.state,
            start_armed=given.start_armed,
            seconds=given.seconds,
        )
    except (PeerError, ValueError) as problem:
        end_for(problem)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    print(f"commands accepted: {counters['accepted']}")


def run(
    device: Device,
    settings: Settings,
    *,
    array: int = 0,
    state: Path | None = None,
    start_armed: bool = False,
    seconds: float | None = None,
    stop: threading.Event | None = None,
) -> dict[str, int]:
    """Drives a device until `stop` is set, by Ctrl-C or SIGTERM too, or for a time in seconds.

    `array` is the index of the array in its room. `state` is the folder of the record of the emergency stop;
    `start_armed` declares a start without a record safe. Returns the counters of the telemetry. Raises `PeerError`
    where the room cannot be joined or another process has the array, and `ValueError` for capabilities that the
    contract does not allow.
    """
    if not isinstance(given := getattr(device, "capabilities", None), Capabilities):
        raise ValueError(f"{type(device).__name__}.capabilities = {given!r}: expected Capabilities, set before it runs")
    begin_ns = time.monotonic_ns()

    def now() -> tuple[int, int]:
        return time.monotonic_ns() - begin_ns, time.time_ns()

    with (
        stop_on_signals(stop or threading.Event()) as ended,
        _Log() as log,
        Peer(settings, "driver", array, ended) as peer,
        ExitStack() as ending,
    ):
        if not peer.is_open:
            return {"accepted": 0}
        claim = Claim(peer)
        latest: dict[str, bytes] = {}

        def with_problem(status: dict[str, Any], problem: str) -> bytes:
            return encode({**status, "last_problem": problem}, KINDS["status"])

        def report(problem: str) -> None:
            # The thread of the station waits for the device.
            if "status" in latest:
                status = decode(latest["status"], KINDS["status"])
                status["stamp"]["time_ns"] = time.time_ns()
                peer.put("status", with_problem(status, problem))

        watched = ending.enter_context(Watched(device, ended, log.show, report))
        station = Station(
            watched,
            device.capabilities.message(),
            device.capabilities.travel_rad,
            ending.enter_context(StopFile(state or _state_folder(), log.show)),
            room=peer.room,
            array=array,
            source=peer.source,
            software=SOFTWARE,
            start_armed=start_armed,
            authenticated=peer.authenticated,
            clock=now,
        )
        if station.advice is not None:
            log.show(station.advice)
        received = threading.Event()

        def receive(name: str) -> None:
            def handle(payload: bytes) -> None:
                station.receive(name, payload, now())
                received.set()

            peer.subscribe(name, handle)

        for name in ("command", "stop", "stop_repetition", "rearm", "calibration"):
            receive(name)
        for name in ("capabilities", "safety", "stops"):
            peer.answer(name, latest)
        claim.announce()
        peer.report_silence(log.show)
        record = _Record(station, log, received)
        shown, more, given_up_ns = _Shown(log, station.stop), False, 0
        last_problem = LastProblem()
        taken: PeerError | None = None
        while True:
            try:
                for late in claim.check(log.show):
                    station.note_other_process(late)
                station.set_other_processes(claim.count)
            except PeerError as problem:
                taken = problem
            if ended.is_set() or taken is not None or (seconds is not None and now()[0] >= 1e9 * seconds):
                station.end()
                # A stop that comes now is obeyed, and in the record before the end if the disk answers.
                given_up_ns = given_up_ns or now()[0] + STOP_RECORD_END_WAIT_NS
                if station.is_settled or now()[0] >= given_up_ns:
                    break
            if not more:
                wait_ns = min(station.next_ns - now()[0], _LONGEST_WAIT_NS)
                received.wait(max(0.0, 1e-9 * wait_ns))
                received.clear()
            more = station.handle_received(now())
            while more and not station.is_report_due(now()[0]):
                more = station.handle_received(now())
            if station.advance(now()):
                record.write()
            # A call of the device may have taken long.
            instant = now()
            for name, payload in station.reports(instant):
                # A query that follows a publication finds it.
                latest[name] = payload
                if name == "status":
                    status, slow = decode(payload, KINDS["status"]), watched.take_slow()
                    if slow:
                        shown.note_slow(slow)
                    peer.put(name, with_problem(status, last_problem.of(status, slow)))
                else:
                    peer.put(name, payload)
                if name == "safety":
                    shown.note_stop(station.stop)
                if name == "stops":
                    shown.note_stopped(decode(payload, KINDS["stops"])["device_stopped"])
                if name == "status":
                    shown.note_status(decode(payload, KINDS["status"]))
        if not station.is_settled:
            log.show(station.unsettled)
        if taken is not None:
            raise taken
        return station.counters()


class _Record:
    """Writes the record of the stop on a thread of its own: a slow disk does not delay the next stop, nor the end."""

    def __init__(self, station: Station, log: _Log, done: threading.Event) -> None:
        self._due = threading.Event()

        def work() -> None:
            shown = None
            while self._due.wait():
                self._due.clear()
                # A write that fails is repeated each second.
                if (line := station.write_record()) and line != shown:
                    log.show(shown := line)
                done.set()

        threading.Thread(target=work, name="stop record", daemon=True).start()

    def write(self) -> None:
        """Begins the write that is due."""
        self._due.set()


class _Log:
    """The log on standard error, written by a thread of its own: a reader that does not read must not delay a stop.
    Lines that such a reader leaves no room for are lost."""

    def __init__(self) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue(1000)
        self._writer = threading.Thread(target=self._write, name="log", daemon=True)

    def __enter__(self) -> _Log:
        self._writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._put(None)
        self._writer.join(timeout=1)

    def show(self, text: str) -> None:
        """Texts can come from any process of the room."""
        self._put(printable(text))

    def _put(self, line: str | None) -> None:
        with suppress(queue.Full):
            self._lines.put_nowait(line)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            print(line, file=sys.stderr, flush=True)


class _EventLimit:
    """The lines of events that other processes can cause at any rate, by the rule of `heliostat driver run`: of more than
    some in succession and one further in ten seconds, one line in ten seconds stands for the others."""

    def __init__(self, further: str) -> None:
        self._further, self._unshown = further, 0
        # Each event with a line adds the time after which one further event has one.
        self._owed_s = 0.0
        self._last = self._shown = -math.inf

    def line(self, event: str, now_s: float) -> str | None:
        """The line of an event, if one is due."""
        self._owed_s = max(0.0, self._owed_s - (now_s - self._last))
        self._last = now_s
        if self._owed_s + _EVENT_EVERY_S <= _EVENT_EVERY_S * _EVENTS_MAX:
            self._owed_s += _EVENT_EVERY_S
            return event
        self._unshown += 1
        if now_s - self._shown < _EVENT_EVERY_S:
            return None
        count, self._unshown, self._shown = self._unshown, 0, now_s
        return f"{self._further} ({count} times)" if count > 1 else self._further


class _Shown:
    """What the log has shown: each change of the stop, that the device has executed it, and once a second a new
    problem, a loss of the device and its end."""

    def __init__(self, log: _Log, stop: str) -> None:
        self._log, self._stop, self._problem = log, stop, ""
        self._is_stopped = self._is_absent = False
        self._connections = 0
        # Each kind of line has a bound of its own: a flood of stops hides no release.
        self._ordered = _EventLimit("further stops are ordered")
        self._executed = _EventLimit("the device has executed further stops")
        self._released = _EventLimit("the array is released again")
        self._slow = _EventLimit("further calls of the device are slow")

    def note_stop(self, stop: str) -> None:
        if stop != self._stop:
            line = f"stop ordered by {stop}" if stop else "the array is released"
            self._show(self._ordered if stop else self._released, line)
            self._stop, self._is_stopped = stop, False

    def note_stopped(self, is_stopped: bool) -> None:
        if is_stopped and not self._is_stopped:
            self._show(self._executed, "the array is stopped: its device has executed the stop")
        self._is_stopped = is_stopped

    def _show(self, limit: _EventLimit, event: str) -> None:
        if line := limit.line(event, time.monotonic()):
            self._log.show(line)

    def note_slow(self, call: str) -> None:
        self._show(self._slow, call)

    def note_status(self, status: dict[str, Any]) -> None:
        problem, counters = status["last_problem"], dict(status["counters"])
        was_absent, self._is_absent = self._is_absent, counters["device_absent"] > 0
        before, self._connections = self._connections, counters["connections"]
        # It may have been lost and connected again since the last status.
        is_connected_again = self._connections > before > 0
        is_lost = not was_absent and (self._is_absent or is_connected_again)
        if problem and (is_lost or problem != self._problem):
            self._log.show(problem)
        self._problem = problem
        if not self._is_absent and (was_absent or is_connected_again):
            self._log.show("the device answers")


def _state_folder() -> Path:
    """The folder of the record where no flag names one."""
    if folder := stop_record_folder(dict(os.environ)):
        return Path(folder)
    raise PeerError("no folder for the record of the emergency stop: expected --state DIR")
