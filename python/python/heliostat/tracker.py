"""Trackers: reports of the users of a room from Python. It needs the extra `zenoh`.

A tracker is a function of the users who are present, and a call of `main`:

    def users_at(seconds):
        return [User(0, position_m=(1.0, 0.5, 0.85))]

    main(users_at, parser().parse_args(), rate_hz=20)

A tracking system that sets the pace itself uses `Tracker` and calls `report` for each measurement.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from ._checks import U32_MAX, U64_MAX, finite, integer
from ._core import Refused
from .peer import INTERRUPTED, Peer, PeerError, Settings, add_arguments, end_for, stop_on_signals

_STATUS_NS = 1_000_000_000


@dataclass(frozen=True)
class User:
    """A user who is in the room: its number, which does not change while the user is present, the position of the
    detector in m from the centre of the floor with z up, the velocity along x and y in m/s, and the required minimum
    rate in bit/s."""

    user: int
    position_m: Sequence[float]
    velocity_m_s: Sequence[float] = (0.0, 0.0)
    min_rate_bps: float = 0.0


def _entries(users: Any) -> list[dict[str, Any]]:
    """The users of a report as dictionaries; an error names the user and the field."""
    if not isinstance(users, Iterable):
        raise Refused(f"users = {users!r}: expected a list of heliostat.tracker.User")
    return [_entry(user) for user in users]


def _entry(user: Any) -> dict[str, Any]:
    if not isinstance(user, User):
        raise Refused(f"{user!r} in the list of users: expected a heliostat.tracker.User")
    try:
        number = integer("user", user.user, 0, U32_MAX)
    except (TypeError, ValueError) as problem:
        raise Refused(str(problem)) from None
    try:
        return {
            "user": number,
            "position_m": _vector("position_m", user.position_m, "x", "y", "z"),
            "velocity_m_s": _vector("velocity_m_s", user.velocity_m_s, "x", "y"),
            "min_rate_bps": finite("min_rate_bps", user.min_rate_bps, "a number that is not negative", least=0.0),
        }
    except (TypeError, ValueError) as problem:
        raise Refused(f"user {number}: {problem}") from None


def _time(time_ns: Any) -> int | None:
    """The time of a measurement, an integer in ns."""
    if time_ns is None:
        return None
    try:
        return integer("time_ns", time_ns, 0, U64_MAX)
    except TypeError:
        kind = type(time_ns).__name__
        raise Refused(f"time_ns: expected an integer in ns, got a {kind} {time_ns!r}") from None
    except ValueError as problem:
        raise Refused(str(problem)) from None


def _vector(name: str, values: Any, *axes: str) -> list[float]:
    """One finite number for each axis."""
    expected = f"{len(axes)} numbers ({', '.join(axes)})"
    try:
        numbers = list(values)
    except TypeError:
        raise ValueError(f"{name} = {values!r}: expected {expected}") from None
    if len(numbers) != len(axes):
        raise ValueError(f"{name}: expected {expected}, got {len(numbers)}")
    return [finite(f"{name}, {axis}", number, "a finite number") for axis, number in zip(axes, numbers, strict=True)]


class Tracker:
    """A tracker in a room, as a context manager.

    It announces itself, and publishes its status about once a second of reports. The first report has a line on
    standard error. Raises `PeerError` where the room cannot be joined.
    """

    def __init__(self, settings: Settings, stop: threading.Event | None = None) -> None:
        self._peer = Peer(settings, "tracker", 0, stop or threading.Event())
        self._tick, self._status_ns, self._problem = 0, 0, ""
        self._refused = 0
        self._state, self._details = "tracking", dict[str, int]()
        if self._peer.is_open:
            self._peer.announce()
            self._peer.report_silence(lambda problem: print(problem, file=sys.stderr, flush=True))

    def __enter__(self) -> Tracker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._peer.__exit__(kind, error, trace)

    @property
    def is_open(self) -> bool:
        """Whether the room was joined; false only where a stop was requested before."""
        return self._peer.is_open

    @property
    def ticks(self) -> int:
        """Number of user reports so far."""
        return self._tick

    def report(self, users: Iterable[User], time_ns: int | None = None) -> int:
        """Reports the users who are present; returns the number of the tick.

        `time_ns` is the time of the measurement, UTC in ns as of `time.time_ns()`; without it, now. Raises `Refused` for a
        number that is not finite, a time that is no integer, a wrong shape, an entry that is no `User`, or a user who is
        named twice; nothing is published then.
        """
        try:
            entries = _entries(users)
            if len({entry["user"] for entry in entries}) < len(entries):
                raise Refused("a user is named twice: expected each user at most once")
            self._peer.publish("users", {"tick": self._tick + 1, "users": entries}, _time(time_ns))
        except Refused as problem:
            self._refused, self._problem = self._refused + 1, str(problem)
            raise
        finally:
            self.publish_status()
        self._tick += 1
        if self._tick == 1:
            print(f'reports the users of room "{self._peer.room}"', file=sys.stderr, flush=True)
        return self._tick

    def publish(self, name: str, fields: Mapping[str, Any], time_ns: int | None = None) -> None:
        """Publishes `channel`, `branches`, `leds`, `obstacles` or `orientation` with the fields of CONTRACT.md but the stamp.

        A channel report has the tick of its measurement, which `report` returned. Raises `Refused` as `report` does.
        """
        if name not in ("channel", "branches", "leds", "obstacles", "orientation"):
            raise ValueError(f"message {name!r}: expected channel, branches, leds, obstacles or orientation")
        self._peer.publish(name, fields, _time(time_ns))

    def subscribe(self, name: str, handle: Callable[[bytes], None], array: int = 0) -> None:
        """Calls `handle` on a thread of Zenoh with each payload of a message of the room, as `heliostat.wire` names it."""
        self._peer.subscribe(name, handle, array)

    def describe(self, state: str, problem: str, counters: Mapping[str, int]) -> None:
        """Sets what the next status has: the activity, the latest problem, and counters of the tracking system."""
        self._state, self._problem, self._details = state, problem or self._problem, dict(counters)

    def publish_status(self) -> None:
        """Publishes the status if a second has passed since the last one; `report` calls it."""
        if time.monotonic_ns() >= self._status_ns:
            self._status_ns = time.monotonic_ns() + _STATUS_NS
            counters = {"reports": self._tick, "refused": self._refused, **self._details}
            self._peer.publish_status(self._state, counters, self._problem)


def parser(description: str | None = None) -> argparse.ArgumentParser:
    """A command line with the flags of a tracker; add the flags of your tracking system."""
    flags = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(flags)
    return flags


def main(users_at: Callable[[float], Iterable[User]], given: argparse.Namespace, rate_hz: float = 20.0) -> None:
    """Reports `users_at(seconds since the start)` at a rate in Hz until Ctrl-C, SIGTERM or `--seconds`.

    A report that is refused is left out, and its reason is printed. The process exits with the reason where the
    room cannot be joined: with status 2 for settings that cannot be used, else 1.
    """
    begin, turn, refused = time.monotonic(), 0, ""
    try:
        with stop_on_signals(threading.Event()) as stop, Tracker(Settings.of(given), stop) as tracker:
            while not stop.is_set() and (given.seconds is None or time.monotonic() < begin + given.seconds):
                try:
                    tracker.report(users_at(time.monotonic() - begin))
                except Refused as problem:
                    if refused != str(problem):
                        refused = str(problem)
                        print(f"refused: {refused}", file=sys.stderr, flush=True)
                turn += 1
                stop.wait(max(0.0, begin + turn / rate_hz - time.monotonic()))
    except PeerError as problem:
        end_for(problem)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    print(f"reports sent: {tracker.ticks}")
