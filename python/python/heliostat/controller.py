"""A function in Python that commands the mirrors of a room. It needs the extra `zenoh`.

    import heliostat

    def act(observation):
        ...
        return action

    summary = heliostat.run(act, connect=["tcp/127.0.0.1:7447"], scenario="hall", seconds=60)

The function sees what an environment shows with `observation="flat"`, and returns an action as for an environment. The
decision core of the controller does the rest: it accepts or refuses reports, predicts the users, limits the angles,
chooses the epoch, withholds commands from stopped arrays, and repeats a stop to an array that has not reported it. This
process does not promise 0.5 ms for a decision; `late` counts those that took longer than the interval of the reports.
"""

from __future__ import annotations

import os
import queue
import re
import sys
import threading
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._checks import finite, function_of_observation, name_of, outer_level, printable, real
from ._core import Commander, closed_loop_conditions
from .names import ActionForm
from .scenario import Scenario, load_scenario

_STATUS_S = 0.5
_TICK_S = 0.05
_ANNOUNCED_S = 0.3
_QUEUE_MAX = 1024
_SILENT_S = 2.0
_LOOK_AGAIN_S = 5.0
_END_S = 1.0
_ARRAY = ("capabilities", "safety", "stops", "telemetry")
_STATES = {
    "standby": "the array follows another controller: this run stands by, and takes over when that one ends",
    "running": "standby has ended",
}
_ROOM = ("room_geometry", "obstacles", "orientation", "leds", "channel", "users")


@dataclass(frozen=True)
class RunSummary:
    """What a run has counted."""

    decisions: int
    """Decisions on position reports."""
    commands: int
    """Commands to arrays."""
    late: int
    """Decisions in which the function took longer than `control.deadline_ms`, or the interval of the reports."""
    superseded: int
    """Position reports that were older than another one when their turn came; the newest was answered."""
    exceptions: int
    """Decisions in which the function raised, or answered with a wrong shape or a value that is not finite."""
    fallbacks: int
    """Those of them in which the fallback of `control.fallback` decided; without one the mirrors hold."""
    withheld: int
    """Commands that were withheld, because the array is stopped or does not fit the scenario."""
    standby: int
    """Commands that were withheld, because the array follows another controller."""
    stale: int
    """Position reports that were too old."""
    dropped: int
    """Messages that were dropped, because the function took too long."""
    last_problem: str
    """Why the last failed decision failed, why an array or the whole room gets no command, or in what the room differs
    from the scenario; empty without a problem."""


def run(
    act: Callable[[NDArray[np.float32]], Any],
    *,
    connect: str | Iterable[str] = (),
    listen: str | Iterable[str] = (),
    scenario: str | os.PathLike[str] | Scenario = "hall",
    action: ActionForm | None = None,
    room: str | None = None,
    client: bool = False,
    tls: str | os.PathLike[str] | None = None,
    insecure: bool = False,
    seconds: float | None = None,
    stop: threading.Event | None = None,
) -> RunSummary:
    """Commands the mirrors of a room by `act` until `seconds` have passed, Ctrl-C, SIGTERM or `stop`.

    Args:
        act: from an observation, the flat vector of an environment, to an action.
        connect: endpoints of other processes, such as `["tcp/127.0.0.1:7447"]`; a text is one endpoint.
        listen: endpoints at which to listen; a text is one endpoint.
        scenario: what the controller assumes of the room: a built-in name, the path of a TOML file, or a `Scenario`.
        action: "angles" or "weights", as for `HeliostatEnv`; absent: the attribute `action` of the function, or "angles".
        room, client, tls, insecure: as in `heliostat.peer.Settings`.
        seconds: how long it runs, from 0.01; absent: until it is stopped.
        stop: ends the run when it is set.

    Where `act` raises an `Exception`, or answers with a wrong shape or a value that is not finite, the decision counts in
    `exceptions`, and the fallback that the scenario names in `control.fallback` decides. With `control.fallback = "hold"`
    no command is sent: the array holds its angles and then parks, by its own rules. The same happens while `act` does not
    return, and after this process ends. Other exceptions, such as `KeyboardInterrupt`, end the run.

    The run publishes commands, stops and its status, but no belief and no state of the decision core: a recording has
    none of them.

    Raises `heliostat.peer.PeerError` where the room cannot be joined. Warns of the conditions of the scenario, as
    `heliostat-lab eval --closed-loop` states them. Warns with `RuntimeWarning` where no mirror has turned: no tracker or no
    array was in the room, or every command was withheld, as by a run that only stood by. The same where the fallback
    decided after each call of the function.
    """
    from .peer import SHORTEST_S, Settings, endpoints, stop_on_signals

    function_of_observation("act", act)
    if seconds is not None:
        seconds = finite("seconds", seconds, f"a number of seconds from {SHORTEST_S}, or None", SHORTEST_S)
    form = action if action is not None else getattr(act, "action", "angles")
    ends = endpoints("listen", listen), endpoints("connect", connect)
    settings = Settings(room, *ends, client, None if tls is None else Path(tls), insecure)
    with stop_on_signals(stop or threading.Event()) as ended, _keywords_for_flags():
        assumed = load_scenario(scenario)
        for condition in closed_loop_conditions(assumed):
            warnings.warn(condition, stacklevel=outer_level())
        one = _Run(act, assumed, form, settings, ended)
        summary = one.run(seconds)
    if reason := one.unmoved():
        warnings.warn(f"heliostat.run has turned no mirror: {printable(reason)}", RuntimeWarning, stacklevel=2)
    elif _has_only_failed(one.calls, summary):
        reason = printable(summary.last_problem)
        text = f"heliostat.run has turned no mirror by the function, control.fallback decided each time: {reason}"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return summary


def _has_only_failed(calls: int, summary: RunSummary) -> bool:
    """Whether each call of the function failed, and the fallback decided. A decision that stands by calls no function."""
    return summary.fallbacks > 0 and summary.exceptions >= calls


def _keyword(flag: re.Match[str]) -> str:
    name, value = flag.groups()
    if name in ("client", "insecure"):
        return f"{name}=True"
    return f"{name}={value!r}" if value else f"{name}=..."


@contextmanager
def _keywords_for_flags() -> Iterator[None]:
    """Errors within name the keywords of `run` in place of the flags of a driver or a tracker."""
    from .peer import PeerError

    try:
        yield
    except PeerError as problem:
        flags = r"--(listen|connect|client|tls|insecure|room)\b(?: (DIR|(?:tcp|tls)/[\w.:]+))?"
        raise type(problem)(re.sub(flags, _keyword, str(problem))) from problem.__cause__


class _Tokens:
    """The last state of each token since it was taken: of at most `_QUEUE_MAX` processes, and each loses its place when
    its end is taken. Thus a process that invents tokens hides no end of another one."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: set[str] = set()
        self._changed: dict[str, bool] = {}

    def note(self, token: str, is_alive: bool) -> None:
        """A token has appeared or ended; called by the thread of the session."""
        with self._lock:
            if token in self._known or (is_alive and len(self._known) < _QUEUE_MAX):
                self._known.add(token)
                self._changed[token] = is_alive

    def take(self) -> list[tuple[str, bool]]:
        """The tokens that have changed since the last call."""
        with self._lock:
            changed, self._changed = self._changed, {}
            self._known.difference_update(token for token, is_alive in changed.items() if not is_alive)
        return list(changed.items())


class _Run:
    """One run: the session, the core, and the messages between their threads."""

    def __init__(
        self, act: Callable[[Any], Any], scenario: Scenario, form: str, settings: Any, stop: threading.Event
    ) -> None:
        from .peer import Peer

        self._act, self._stop, self._settings = act, stop, settings
        # The tokens of the other processes; why none answers, and when to look again.
        self._others: set[str] = set()
        self._unreachable, self._look_again = "", 0.0
        self.calls = self._late = self._dropped = 0
        self._began, self._heard, self._has_array = time.monotonic(), False, False
        self._arrived: queue.Queue[tuple[str, int, bytes]] = queue.Queue(_QUEUE_MAX)
        # The stops that wait, each once, apart from the messages that may be dropped.
        self._stops: OrderedDict[bytes, None] = OrderedDict()
        self._tokens = _Tokens()
        self._peer = Peer(settings, "controller", 0, stop)
        self._core = Commander(scenario, self._call, form, self._peer.source, name_of(act))
        self._scenario = scenario

    def _call(self, observation: NDArray[np.float32]) -> Any:
        begin = time.monotonic()
        self.calls += 1
        try:
            action = np.ascontiguousarray(real("action", self._act(observation)), np.float32)
            if action.ndim != 1:
                raise ValueError(f"an action of shape {action.shape}, expected one dimension")
            return action
        finally:
            self._late += time.monotonic() - begin > self._core.deadline_s

    def run(self, seconds: float | None) -> RunSummary:
        """Joins the room and decides until the end."""
        with self._peer:
            if self._peer.is_open:
                self._join()
                with self._repeating_stops():
                    self._serve(None if seconds is None else time.monotonic() + seconds)
        return self.summary()

    @contextmanager
    def _repeating_stops(self) -> Iterator[None]:
        """Repeats stops by a thread of its own while the block runs: the function may not return."""
        over = threading.Event()

        def work() -> None:
            while not over.wait(_TICK_S):
                self._send(self._core.repetitions(time.time_ns()))

        thread = threading.Thread(target=work, name="stop repetitions", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join(timeout=_END_S)

    def _join(self) -> None:
        arrays = range(self._core.arrays)
        self._peer.subscribe("stop", self._order)
        # The first epoch must be above the one that an array follows, and a stop must be known.
        for array in arrays:
            for name in ("capabilities", "safety", "stops"):
                for payload in self._peer.fetch(name, _ANNOUNCED_S, array):
                    self._heard = self._has_array = True
                    self._core.receive(name, array, payload, time.time_ns())
                self._peer.subscribe(name, self._queued(name, array), array)
            self._peer.subscribe("telemetry", self._queued("telemetry", array), array)
        # Positions come last, so that the other reports are there when the first decision is due.
        for name in _ROOM:
            self._peer.subscribe(name, self._queued(name, 0))
        self._peer.watch(self._tokens.note)
        self._peer.announce()

    def _queued(self, name: str, array: int) -> Callable[[bytes], None]:
        def arrive(payload: bytes) -> None:
            try:
                self._arrived.put_nowait((name, array, payload))
            except queue.Full:
                self._dropped += 1

        return arrive

    def _order(self, payload: bytes) -> None:
        if not self._core.note_order(payload, time.time_ns()):
            self._queued("stop", 0)(payload)
        elif len(self._stops) < _QUEUE_MAX:
            self._stops[payload] = None
        else:
            # The core holds fewer stops than wait, and each of them withholds every command.
            self._dropped += 1

    def _serve(self, end: float | None) -> None:
        reported, problem, state = -_STATUS_S, "", "running"
        while not self._stop.is_set() and (end is None or time.monotonic() < end):
            self._receive()
            # The function is called here, for the newest report.
            self._send(self._core.decide(time.time_ns()))
            self._send(self._core.timeout(time.time_ns()))
            if time.monotonic() - reported >= _STATUS_S:
                reported = time.monotonic()
                found = self._problem()
                if found and found != problem:
                    print(f"heliostat.run: {found}", file=sys.stderr, flush=True)
                problem = found
                before, state = state, "standby" if self._core.status()["standby"] else "running"
                if state != before:
                    print(f"heliostat.run: {_STATES[state]}", file=sys.stderr, flush=True)
                self._publish_status(state, found)
        # Of a controller that ends in order: it is no missing standby.
        self._publish_status(state, problem, ending=1)

    def _publish_status(self, state: str, problem: str, **more: int) -> None:
        counters = {**self._core.status(), "late": self._late, "dropped": self._dropped, **more}
        self._peer.publish_status(state, counters, problem, policy="python", scenario=self._scenario.hash)

    def _problem(self, is_over: bool = False) -> str:
        """Why there is no command, or why commands suit another room; empty without a problem."""
        found = filter(None, (self._core.geometry_problem(time.time_ns()), self._core.last_problem))
        if problem := printable("; ".join(found)):
            return problem
        if is_over:
            return self.unmoved()
        return "" if time.monotonic() - self._began < _SILENT_S else self.absence()

    def unmoved(self) -> str:
        """Why no mirror has turned; empty where an array received commands."""
        status = self._core.status()
        if (absence := self.absence()) or status["commands"]:
            return absence
        if status["standby"]:
            return "the array followed another controller, and this run only stood by"
        return self._core.last_problem or "no command was sent: the array was stopped, or no decision gave angles"

    def absence(self) -> str:
        """Which process has not been in the room, and what is expected; empty where reports and an array were there."""
        has_positions = self._core.counters()["decisions"] > 0
        if has_positions and self._has_array:
            return ""
        if has_positions:
            return "no array answers: expected a driver or a simulator at the endpoints, since peers forward no messages"
        if self._heard:
            return "the room has not reported positions: expected a tracker or a simulator"
        if self._others:
            nodes = ", ".join(sorted({token.split("/")[-2] for token in self._others}))
            return (
                f"only {nodes} of the room answers, neither a tracker nor an array: expected in `connect` their endpoints "
                "too, or that of the simulator or a router, since peers forward no messages"
            )
        if time.monotonic() >= self._look_again:
            from .peer import connection_problem

            self._look_again = time.monotonic() + _LOOK_AGAIN_S
            self._unreachable = connection_problem(self._settings, "controller")
        reason = self._unreachable or "expected one at the endpoints of `connect`, with the same room and keys"
        return f"no process of the room answers: {reason}"

    def _receive(self) -> None:
        """Gives all waiting messages to the core; waits a moment for the first one."""
        for token, is_alive in self._tokens.take():
            self._core.presence(token, is_alive, time.time_ns())
            if token != self._peer.keys["alive"]:
                (self._others.add if is_alive else self._others.discard)(token)
        wait = True
        while True:
            try:
                name, array, payload = self._arrived.get(block=wait, timeout=_TICK_S if wait else None)
            except queue.Empty:
                self._receive_stops()
                return
            wait, self._heard = False, True
            self._receive_stops()
            self._has_array = self._has_array or name in _ARRAY
            self._send(self._core.receive(name, array, payload, time.time_ns()))

    def _receive_stops(self) -> None:
        """Gives stops to the core before any report that waits: they withhold its command."""
        with suppress(KeyError):
            while True:
                payload, _ = self._stops.popitem(last=False)
                self._heard = True
                self._send(self._core.receive("stop", 0, payload, time.time_ns()))

    def _send(self, messages: Sequence[tuple[str, int, bytes]]) -> None:
        for name, array, payload in messages:
            self._peer.put(name, payload, array)

    def summary(self) -> RunSummary:
        """The counts so far."""
        counters = self._core.counters()
        return RunSummary(
            decisions=counters["decisions"],
            commands=counters["commands"],
            late=self._late,
            superseded=counters["superseded"],
            exceptions=counters["exceptions"],
            fallbacks=counters["fallbacks"],
            withheld=counters["withheld"],
            standby=counters["standby"],
            stale=counters["stale"],
            dropped=self._dropped,
            last_problem=self._problem(is_over=True),
        )
