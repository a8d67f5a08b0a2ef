"""A tracking system as a tracker of a room: a `Source` delivers poses, and `run` reports them.

    class Cameras(Source):
        name = "the cameras"

        def start(self, intake):
            ...  # a thread that calls intake.poses([Pose("helmet", (1.0, 0.5, 0.85))]) for each frame

        def close(self):
            ...

    run(Cameras(), Setup(), Settings(connect=("tcp/127.0.0.1:7447",)))
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass

from ..peer import Settings, stop_on_signals
from ..scenario import Scenario
from ..tracker import Tracker
from ..wire import KINDS, Refused, decode
from .users import Instant, Pose, Problems, Report, Setup, Users

_SILENT_NS = 2_000_000_000
_LONGEST_WAIT_S = 0.25


class SourceError(Exception):
    """A tracking system that cannot be used with these settings; the text has the reason."""


class Source(ABC):
    """A tracking system.

    `name` is its name in messages. `unit` is the unit of its positions, as in `heliostat.track.frame.UNITS_M`, and
    `clock` the time that its measurements have, as in `heliostat.track.users.CLOCKS`, where a user states no other.
    """

    name: str
    unit: str = "m"
    clock: str = "arrival"

    @abstractmethod
    def start(self, intake: Intake) -> None:
        """Starts to deliver poses from a thread of its own, and returns.

        A source that cannot reach its system notes a problem and tries again. Raises `SourceError` for settings with
        which no attempt can succeed.
        """

    @abstractmethod
    def close(self) -> None:
        """Ends the delivery; after it no thread of the source runs."""

    def follow(self, tracker: Tracker) -> None:
        """Called once the room is joined: a source may pass on what the room publishes."""

    def advice(self) -> str:
        """What to check while no data arrive."""
        return "check that the system is running and that its address is right"


class Intake:
    """Where a source delivers its poses, from any thread."""

    def __init__(self, users: Users) -> None:
        self.users = users
        self.arrived_ns: int | None = None
        self._named_ns = -1
        self._has_news = threading.Condition()

    def poses(self, poses: Iterable[Pose]) -> None:
        """Takes the poses of one message. No pose means that the system works, and sees no body."""
        now = _now()
        with self._has_news:
            self.arrived_ns = now.monotonic_ns
            self.users.take(poses, now)
            self._has_news.notify()

    def problem(self, kind: str, text: str) -> None:
        """Notes a problem of the source, with a short name of its kind."""
        now = _now()
        with self._has_news:
            self._named_ns = now.monotonic_ns
            self.users.problems.note(kind, text, now)

    def silence(self, text: str, since_ns: int) -> None:
        """Notes that no data have arrived since a time, unless the source has named a problem since then."""
        with self._has_news:
            if self._named_ns < since_ns:
                self.users.problems.note("no-data", text, _now())

    def report(self) -> Report | None:
        """Waits for the report that is due next, for at most 0.25 s."""
        with self._has_news:
            self._has_news.wait(min(1e-9 * self.users.wait_ns(_now()), _LONGEST_WAIT_S))
            return self.users.report(_now())


@dataclass(frozen=True)
class Summary:
    """What a run has counted: reports, poses, and problems by kind."""

    reports: int
    poses: int
    problems: dict[str, int]


def run(
    source: Source,
    setup: Setup,
    settings: Settings | None,
    *,
    room_m: tuple[float, float, float] | None = None,
    seconds: float | None = None,
    stop: threading.Event | None = None,
    show: Callable[[Report], None] | None = None,
) -> Summary:
    """Reports what a source delivers until `stop` is set, by Ctrl-C or SIGTERM too, or for a time in seconds.

    `room_m` is the size of the room; without it, it is that of the geometry that a controller or a simulator announces.
    `show` gets each report. Without settings no room is joined. Raises `PeerError` where the room cannot be joined, and
    `SourceError` where the source cannot be used.
    """
    users = Users(setup, Problems())
    users.room_m = room_m
    intake, began = Intake(users), _now()
    with ExitStack() as stack:
        ended = stack.enter_context(stop_on_signals(stop or threading.Event()))
        tracker = None if settings is None else stack.enter_context(Tracker(settings, ended))
        if tracker is not None and tracker.is_open:
            if room_m is None:
                tracker.subscribe("geometry", lambda payload: _learn_size(users, payload))
            source.follow(tracker)
        stack.callback(source.close)
        source.start(intake)
        silent = _Silence(source, intake, began)
        reports = 0
        while not ended.is_set() and (seconds is None or _now().monotonic_ns < began.monotonic_ns + 1e9 * seconds):
            report = intake.report()
            is_silent = silent.lasts()
            if tracker is not None:
                tracker.describe("no data" if is_silent else "tracking", users.problems.latest, users.problems.counts)
                try:
                    _publish(tracker, report)
                except Refused as problem:
                    users.problems.note("refused", str(problem), _now())
            if report is not None:
                reports += 1
                if show is not None:
                    show(report)
    return Summary(reports, users.poses, dict(users.problems.counts))


def _publish(tracker: Tracker, report: Report | None) -> None:
    """Publishes a report, if there is one. The orientations come first, because the users complete a tick."""
    if report is None:
        tracker.publish_status()
        return
    if report.orientations:
        tracker.publish("orientation", {"users": report.orientations}, report.time_ns)
    tracker.report(report.users, report.time_ns)


def _learn_size(users: Users, payload: bytes) -> None:
    """The size of the room of a geometry; one that cannot be read is left to the processes that check it."""
    try:
        users.room_m = Scenario.of_toml(decode(payload, KINDS["geometry"])["scenario"]).room_m
    except (Refused, ValueError):
        pass


class _Silence:
    """Names a source from which no data arrive."""

    def __init__(self, source: Source, intake: Intake, began: Instant) -> None:
        self._source, self._intake, self._since_ns = source, intake, began.monotonic_ns
        self._next_ns = 0

    def lasts(self) -> bool:
        """Whether nothing has arrived for 2 s; notes this problem each 2 s."""
        now_ns = _now().monotonic_ns
        self._since_ns = self._intake.arrived_ns or self._since_ns
        silent_ns = now_ns - self._since_ns
        if silent_ns < _SILENT_NS:
            return False
        if now_ns >= self._next_ns:
            text = f"no data from {self._source.name} for {silent_ns / 1e9:.0f} s: {self._source.advice()}"
            self._intake.silence(text, self._since_ns)
            self._next_ns = _now().monotonic_ns + _SILENT_NS
        return True


def _now() -> Instant:
    return Instant(time.monotonic_ns(), time.time_ns())
