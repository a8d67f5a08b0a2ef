"""A device whose calls are timed: one that does not return is named by another thread, a slow one when it returns."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

_BLOCKED_S = 1.0
_LOOK_S = 0.5
_SLOW_S = 0.5
"""The shorter interval of a status in the contract. A call that takes longer makes reports late, and stops wait for it."""
_TIMED = ("turn", "stop", "measure", "health")
_END_LOOK_S = 0.1
# A call that has taken this long when the end is requested keeps the driver from it.
_KEEPS_FROM_END_S = 0.3


class Watched:
    """Passes calls on to a device, and is a context manager: within the block, a thread calls `show` once for each call
    that does not return within some seconds, and `report` with the present text about once a second.

    From the moment at which `ended` is set, `show` is called once if a call keeps the driver from its end.
    """

    def __init__(
        self, device: Any, ended: threading.Event, show: Callable[[str], None], report: Callable[[str], None]
    ) -> None:
        self._device, self._ended, self._show, self._report = device, ended, show, report
        # The name of the call that has not returned, and its begin.
        self._present: tuple[str, float] | None = None
        # The longest slow call that was not taken yet, and its duration.
        self._slow: tuple[str, float] | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watch of the device", daemon=True)
        self._end_thread = threading.Thread(target=self._watch_end, name="watch of the end", daemon=True)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._device, name)

        def call(*arguments: Any) -> Any:
            begin = time.monotonic()
            self._present = name, begin
            try:
                return method(*arguments)
            finally:
                self._present = None
                self._note(name, time.monotonic() - begin)

        return call

    def _note(self, name: str, took: float) -> None:
        longest = self._slow[1] if self._slow else _SLOW_S
        if name in _TIMED and took >= longest:
            self._slow = name, took

    def take_slow(self) -> str:
        """The longest slow call since the last time; empty without one. For the thread that calls the device."""
        slow, self._slow = self._slow, None
        if slow is None:
            return ""
        return f"{slow[0]} took {slow[1]:.1f} s: a stop waits for it; expected less than {_SLOW_S} s, or a thread of the device"

    def __enter__(self) -> Watched:
        self._thread.start()
        self._end_thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join(timeout=1)

    def problem(self, now: float) -> str:
        """The call that has not returned at a time of the monotonic clock in s; empty without one."""
        present = self._present
        if present is None or now - present[1] < _BLOCKED_S:
            return ""
        name, begin = present
        return f"{name} has not returned for {now - begin:.0f} s: the driver waits, and obeys no stop until it returns"

    def kept_from_end(self, now: float) -> str:
        """The call that keeps the driver from its end at a time of the monotonic clock in s; empty without one."""
        present = self._present
        if present is None or now - present[1] < _KEEPS_FROM_END_S:
            return ""
        return f"the driver ends when {present[0]} returns; a second Ctrl-C or SIGTERM ends it at once"

    def _watch_end(self) -> None:
        while not self._ended.wait(_LOOK_S):
            if self._over.is_set():
                return
        while not self._over.is_set():
            if problem := self.kept_from_end(time.monotonic()):
                self._show(problem)
                return
            self._over.wait(_END_LOOK_S)

    def _watch(self) -> None:
        shown = None
        while not self._over.wait(_LOOK_S):
            present, problem = self._present, self.problem(time.monotonic())
            if problem:
                if present != shown:
                    self._show(problem)
                self._report(problem)
                shown = present


class LastProblem:
    """The last problem of a status: that of its station, or a slow call of the device after it.

    A slow call hides neither a problem that lasts nor a new one of the station, and an old one does not return after it.
    """

    def __init__(self) -> None:
        self._slow = ""
        # The problem of the station, and what it counts at each refusal.
        self._own: tuple[str, list[int]] | None = None

    def of(self, status: dict[str, Any], slow: str) -> str:
        """The problem for this status of the station, with the slow call since the last one; empty without one."""
        counters: dict[str, int] = dict(status["counters"])
        own = str(status["last_problem"]), [count for name, count in counters.items() if name.startswith("refused:")]
        is_new = own != self._own
        if is_new:
            self._own, self._slow = own, ""
        self._slow = slow or self._slow
        lasts = counters["stop_unrecorded"] > 0 or counters["device_absent"] > 0
        if lasts or (is_new and own[0]):
            return own[0]
        return self._slow or own[0]
