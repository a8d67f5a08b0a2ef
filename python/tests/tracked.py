"""A tracking system that is emulated, its tracker as a process, and the controller of the room that it reports to."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from room import Observer, end_by, free_endpoint, observer, python, wait_until


@dataclass
class Tracked:
    """An observer of the room, the process of the tracker, and whether a controller answers."""

    room: Observer
    process: subprocess.Popen[str]
    is_controlled: bool

    def positions(self) -> dict[int, list[float]]:
        """The latest reported position of each user, to 1 mm."""
        users = self.room.latest.get("users", {}).get("users", [])
        return {one["user"]: [round(part, 3) for part in one["position_m"]] for one in users}

    def wait_for(self, expected: dict[int, list[float]]) -> None:
        """Waits for a report of these users, and for the controller's answers to ten more reports."""
        wait_until(f"report of {expected}", lambda: self.positions() == expected)
        if self.is_controlled:
            tick = self.room.latest["users"]["tick"]
            answered = set()

            def is_answered() -> bool:
                answered.add(self.room.latest.get("command", {}).get("answers", 0))
                return len([one for one in answered if one >= tick]) >= 10

            wait_until("answers to ten reports", is_answered)

    def problem(self) -> str:
        """The latest problem in the status of the tracker."""
        return str(self.room.status("tracker").get("last_problem", ""))

    def end(self) -> tuple[str, str]:
        """Ends the tracker by SIGTERM, and checks that the controller has refused nothing."""
        if self.is_controlled:
            controller = self.room.status("controller")
            counters = dict(map(tuple, controller["counters"]))
            bad = {name: count for name, count in counters.items() if count and ("refused" in name or "left-out" in name)}
            assert not bad, (bad, controller["last_problem"])
        return end_by(signal.SIGTERM, self.process)


@contextmanager
def tracked(folder: Path, *arguments: str, scenario: str = "hall") -> Iterator[Tracked]:
    """`python -m heliostat.track` in a room that a controller runs, where the program is there."""
    endpoint, of_controller = free_endpoint(), free_endpoint()
    program: Any = os.environ.get("HELIOSTAT_PROGRAM")
    with observer(endpoint, "tracked") as room:
        command = ("-m", "heliostat.track", *arguments, "--room", "tracked", "--connect", endpoint)
        if program is None:
            with python(*command, "--room-size", "8,8,3", folder=folder) as process:
                yield Tracked(room, process, False)
            return
        flags = ["--room", "tracked", "--listen", of_controller, "--connect", endpoint, "--scenario", scenario]
        # A pause of a busy machine makes no report stale.
        flags += ["--policy", "fixed-point", "--set", "control.report_age_max_ms=60000"]
        with subprocess.Popen([program, "controller", *flags], stdout=subprocess.DEVNULL) as controller:
            try:
                with python(*command, "--connect", of_controller, folder=folder) as process:
                    yield Tracked(room, process, True)
            finally:
                controller.kill()
