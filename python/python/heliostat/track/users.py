"""From measurements of bodies to reports of users. It has no thread and no clock: time is an argument.

`Users.take` gets the poses of a tracking system in its own frame, and `Users.report` gives the report that is due. Of
several poses of a body the newest counts, so a fast system is reduced to the rate of the reports. A pose that cannot be
used is left out, counted and named.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import U32_MAX
from .._core import CLOCK_LEAD_MAX_NS, USERS_MAX
from ..tracker import User
from .frame import Frame, rotation_matrix

OUTSIDE_MARGIN_M = 1.0
"""How far outside the walls a position may be, in m, as for the controller: a measurement error may exceed a wall."""

AGE_MAX_NS = 1_000_000_000
"""Largest age of a measurement at its arrival. Older ones are of a clock that is not synchronised."""

_LOWEST_M = 0.2
_NAMES_MAX = 4096
_TOGETHER_NS = 10_000_000
_WINDOW_NS = 10_000_000_000
_REMINDER_NS = 10_000_000_000
CLOCKS = ("source", "aligned", "arrival")
"""Which time a measurement has: by the source in UTC, by the source with an offset to UTC that is estimated, its arrival."""


@dataclass(frozen=True)
class Instant:
    """A time on the monotonic clock of this process, and in UTC, both in ns."""

    monotonic_ns: int
    utc_ns: int


@dataclass(frozen=True)
class Pose:
    """One measurement of a body, in the frame and the unit of the tracking system.

    `rotation` is the quaternion (w, x, y, z) of the body, `None` where the system does not measure it. `time_ns` is the
    time of the measurement by the clock of the system, `None` where it states none.
    """

    name: str
    position: Sequence[float]
    rotation: Sequence[float] | None = None
    time_ns: int | None = None


@dataclass(frozen=True)
class Setup:
    """How bodies become users.

    `numbers` maps names of bodies to users; without it each body is a user, with numbers from 0 in the order of
    appearance. `offsets_m` has the vector from the tracked point to the detector in the axes of the body, and
    `uprights` the quaternion that the system reports while the receiver faces up with its x axis along that of the
    room; both by the name of the body, or "" for all others. A body without a measurement for `timeout_s` has left.
    """

    frame: Frame = Frame()
    numbers: Mapping[str, int] = field(default_factory=dict)
    offsets_m: Mapping[str, Sequence[float]] = field(default_factory=dict)
    uprights: Mapping[str, Sequence[float]] = field(default_factory=dict)
    min_rate_bps: float = 0.0
    orientation: bool = True
    clock: str = "arrival"
    clock_offset_ns: int = 0
    rate_hz: float = 20.0
    timeout_s: float = 1.0

    def __post_init__(self) -> None:
        if self.clock not in CLOCKS:
            raise ValueError(f'clock "{self.clock}": expected {", ".join(CLOCKS)}')
        for name, value in (("rate", self.rate_hz), ("timeout", self.timeout_s)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} {value}: expected a number above 0")
        if not (math.isfinite(self.min_rate_bps) and self.min_rate_bps >= 0):
            raise ValueError(f"minimum rate {self.min_rate_bps}: expected a number of at least 0")
        for upright in self.uprights.values():
            rotation_matrix(upright)
        for user in self.numbers.values():
            if not 0 <= user <= U32_MAX:
                raise ValueError(f"user {user}: expected a number from 0 to 2^32 - 1")
        if len(set(self.numbers.values())) < len(self.numbers):
            raise ValueError("two bodies have the number of one user: expected a number of its own for each")


@dataclass(frozen=True)
class Report:
    """A report that is due: the users who are present, how they hold their receivers, and the time in UTC in ns."""

    users: list[User]
    orientations: list[dict[str, Any]]
    time_ns: int


class Problems:
    """What went wrong, by kind: printed at once, and then once in 10 s with its count."""

    def __init__(self, show: Callable[[str], None] | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self.latest = ""
        self._show = show or _print_problem
        self._shown: dict[str, tuple[int, int]] = {}

    def note(self, kind: str, text: str, now: Instant) -> None:
        """Counts a problem, and shows it unless one of its kind was shown in the last 10 s."""
        self.counts[kind] += 1
        self.latest = text
        at_ns, count = self._shown.get(kind, (None, 0))
        if at_ns is None or now.monotonic_ns >= at_ns + _REMINDER_NS:
            more = self.counts[kind] - count - 1
            self._shown[kind] = now.monotonic_ns, self.counts[kind]
            self._show(text + (f" ({more} more of this kind)" if more else ""))


def _print_problem(text: str) -> None:
    # Names come from other processes.
    safe = "".join(one if one.isprintable() else f"\\x{ord(one):02x}" for one in text)
    print(f"problem: {safe}", file=sys.stderr, flush=True)


class Clock:
    """The time of a measurement in UTC.

    "aligned" estimates the offset of a clock that counts from any instant by the smallest difference between arrival
    and measurement in the last 10 to 20 s: the messages that were delayed least.
    """

    def __init__(self, mode: str, offset_ns: int) -> None:
        self._mode, self._offset_ns = mode, offset_ns
        self._least: list[int] = []
        self._until_ns = 0

    def utc_ns(self, stamp_ns: int | None, arrived: Instant) -> int:
        """The time of a measurement with this time by its source."""
        if stamp_ns is None or self._mode == "arrival":
            return arrived.utc_ns + self._offset_ns
        if self._mode == "source":
            return stamp_ns + self._offset_ns
        difference = arrived.utc_ns - stamp_ns
        # The source started again.
        is_other = bool(self._least) and abs(difference - min(self._least)) > AGE_MAX_NS
        if is_other or arrived.monotonic_ns >= self._until_ns:
            self._least = [difference] if is_other else [difference, *self._least[:1]]
            self._until_ns = arrived.monotonic_ns + _WINDOW_NS
        self._least[0] = min(difference, self._least[0])
        return stamp_ns + min(self._least) + self._offset_ns


@dataclass
class _Body:
    """The newest usable measurement of a body, in the room."""

    user: int
    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] | None
    time_ns: int
    arrived_ns: int
    is_new: bool


class Users:
    """The bodies of a tracking system as users of a room. `room_m` is the size of the room once it is known."""

    def __init__(self, setup: Setup, problems: Problems) -> None:
        self.setup, self.problems = setup, problems
        self.room_m: tuple[float, float, float] | None = None
        self.poses = 0
        self._clock = Clock(setup.clock, setup.clock_offset_ns)
        self._period_ns = round(1e9 / setup.rate_hz)
        self._timeout_ns = round(1e9 * setup.timeout_s)
        self._uprights = {name: rotation_matrix(upright) for name, upright in setup.uprights.items()}
        self._numbers = dict(setup.numbers)
        self._bodies: dict[str, _Body] = {}
        self._raw: dict[str, Sequence[float]] = {}
        self._new_ns: int | None = None
        self._is_alive = False
        self._unusable_ns: int | None = None
        self._due_ns = 0
        self._reported: set[str] = set()
        self._time_ns = 0

    def take(self, poses: Iterable[Pose], arrived: Instant) -> None:
        """Takes the poses of one message, which may be none: then the system works, and sees no body."""
        self._is_alive = True
        for pose in poses:
            self.poses += 1
            if (user := self._number(pose.name, arrived)) is None:
                continue
            body = self._placed(pose, user, arrived)
            if body is None:
                self._unusable_ns = arrived.monotonic_ns
            elif pose.name in self._bodies and body.time_ns < self._bodies[pose.name].time_ns:
                self.problems.counts["overtaken"] += 1
            else:
                self._bodies[pose.name] = body
                self._new_ns = self._new_ns or arrived.monotonic_ns

    def _placed(self, pose: Pose, user: int, arrived: Instant) -> _Body | None:
        """A pose in the room; `None`, with a note of the problem, if it cannot be used."""
        frame, note = self.setup.frame, self.problems.note
        rotation = self._rotation(pose, arrived)
        offset = self.setup.offsets_m.get(pose.name, self.setup.offsets_m.get("", (0.0, 0.0, 0.0)))
        position = frame.position(pose.position, rotation, offset)
        if not np.isfinite(position).all():
            note("not-finite", f'"{pose.name}" has the position {_text(pose.position)}: expected numbers', arrived)
            return None
        self._raw[pose.name] = pose.position
        if not self._is_inside(position):
            note("outside-room", self._outside(pose.name, position), arrived)
            return None
        time_ns = self._clock.utc_ns(pose.time_ns, arrived)
        if not self._is_timely(pose.name, time_ns, arrived):
            return None
        quaternion = None
        if rotation is not None and self.setup.orientation:
            quaternion = frame.orientation(rotation, self._uprights.get(pose.name, self._uprights.get("")))
        x, y, z = position.tolist()
        return _Body(user, (x, y, z), quaternion, time_ns, arrived.monotonic_ns, True)

    def _number(self, name: str, now: Instant) -> int | None:
        """The number of a body, which stays its own: that of a user who left is not given to another one."""
        if name not in self._numbers:
            if self.setup.numbers:
                known = ", ".join(f'"{one}"' for one in self.setup.numbers)
                self.problems.note("unknown-body", f'"{name}" is no user: expected {known}', now)
                return None
            if len(self._numbers) == _NAMES_MAX:
                self.problems.note("too-many-names", f'"{name}" is left out: {_NAMES_MAX} other names came before', now)
                return None
            self._numbers[name] = len(self._numbers)
        return self._numbers[name]

    def _rotation(self, pose: Pose, now: Instant) -> NDArray[np.float64] | None:
        if pose.rotation is None:
            return None
        try:
            return rotation_matrix(pose.rotation)
        except ValueError as problem:
            self.problems.note("orientation", f'the orientation of "{pose.name}" is left out: {problem}', now)
            return None

    def _is_inside(self, position_m: NDArray[np.float64]) -> bool:
        if self.room_m is None:
            return True
        x, y, z = position_m
        length, width, height = self.room_m
        limits = (length / 2 + OUTSIDE_MARGIN_M, width / 2 + OUTSIDE_MARGIN_M)
        return bool(abs(x) <= limits[0] and abs(y) <= limits[1] and -OUTSIDE_MARGIN_M <= z <= height)

    def _outside(self, name: str, position_m: NDArray[np.float64]) -> str:
        length, width, height = self.room_m or (0.0, 0.0, 0.0)
        text = f'"{name}" is at {_text(position_m)} m, outside the room of {length:g} m x {width:g} m x {height:g} m'
        for flags, other in self.setup.frame.others():
            # The unit and the axes are those of all bodies, and users hold or wear them.
            places = [other.position(raw) for raw in self._raw.values()]
            if all(self._is_inside(place) and place[2] >= _LOWEST_M for place in places):
                return f"{text}; with {flags} it would be at {_text(other.position(self._raw[name]))} m"
        return f"{text}; check --unit, --axes, --origin and --turn-deg"

    def _is_timely(self, name: str, time_ns: int, now: Instant) -> bool:
        lead_ns = time_ns - now.utc_ns
        if -AGE_MAX_NS <= lead_ns <= CLOCK_LEAD_MAX_NS:
            return True
        side = "ahead of" if lead_ns > 0 else "behind"
        advice = "synchronise both clocks, or use --clock aligned or --clock arrival"
        self.problems.note("clock", f'the time of "{name}" is {abs(lead_ns) / 1e9:.3f} s {side} this clock: {advice}', now)
        return False

    def wait_ns(self, now: Instant) -> int:
        """Time until a report may be due, in ns, unless poses arrive before."""
        if self._new_ns is None:
            return max(0, self._due_ns - now.monotonic_ns) if self._is_alive else self._period_ns
        return max(0, max(self._due_ns, self._new_ns + _TOGETHER_NS) - now.monotonic_ns)

    def report(self, now: Instant) -> Report | None:
        """The report that is due, if one is.

        One is due where a body has a new measurement, and where the last user has left. Bodies whose measurements
        arrive within 10 ms share a report. A pose that cannot be used is no evidence that the room is empty.
        """
        if now.monotonic_ns < self._due_ns or not self._is_alive:
            return None
        present = {
            name: body for name, body in self._bodies.items() if now.monotonic_ns - body.arrived_ns <= self._timeout_ns
        }
        new = [body for body in present.values() if body.is_new]
        if new and len(new) < len(present) and now.monotonic_ns < (self._new_ns or 0) + _TOGETHER_NS:
            return None
        is_unsure = self._unusable_ns is not None and now.monotonic_ns - self._unusable_ns <= self._timeout_ns
        if not new and (present.keys() == self._reported if present else is_unsure):
            self._is_alive = False
            return None
        if len(present) > USERS_MAX:
            text = f"{len(present)} bodies: a report has at most {USERS_MAX} users; name them with --user"
            self.problems.note("too-many", text, now)
            present = dict(list(present.items())[:USERS_MAX])
        newest_ns = max((body.time_ns for body in new), default=now.utc_ns)
        # A clock that was set back goes on from there: reports that are ahead would be refused for so long.
        self._time_ns = newest_ns if self._time_ns - newest_ns > CLOCK_LEAD_MAX_NS else max(self._time_ns, newest_ns)
        self._reported = set(present)
        self._bodies = present
        for body in present.values():
            body.is_new = False
        self._new_ns, self._is_alive = None, False
        # Rounding and waiting must not add up to a lower rate.
        self._due_ns = max(self._due_ns, now.monotonic_ns - self._period_ns) + self._period_ns
        bodies = sorted(present.values(), key=lambda body: body.user)
        users = [User(body.user, body.position_m, min_rate_bps=self.setup.min_rate_bps) for body in bodies]
        turned = [{"user": one.user, "quaternion": list(one.quaternion)} for one in bodies if one.quaternion is not None]
        return Report(users, turned, self._time_ns)


def _text(position: Iterable[float]) -> str:
    return "(" + ", ".join(f"{part:.3f}" for part in position) + ")"
