"""Recordings of rooms as arrays.

The files are those of `heliostat record`. Times are in ns: `arrived_ns` at the recorder, `time_ns` of the content, both
UTC where the recorded processes used UTC.
"""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._checks import integer
from ._core import ARRAYS_MAX, Scenario
from ._core import Recording as _Recording
from .tables import Channels, Commands, Reports, Telemetry, Truth


def _index(array: int) -> int:
    return integer("array", array, 0, ARRAYS_MAX - 1)


class Recording:
    """A recording up to its end, or to its last complete chunk.

    Raises `ValueError` for a file that is not a recording of a room.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._inner = _Recording(os.fspath(path))

    @property
    def room(self) -> str:
        """The name of the room."""
        return self._inner.room

    @property
    def scenario_toml(self) -> str:
        """The effective scenario of the recorder as TOML."""
        return self._inner.scenario

    @property
    def account(self) -> dict[str, Any] | None:
        """The recorder's counts of received and missing messages; `None` in a file that was cut."""
        text = self._inner.account
        return None if text is None else dict(json.loads(text))

    def scenario(self) -> Scenario:
        """The recorded scenario, checked."""
        return Scenario.of_toml(self._inner.scenario)

    def reports(self) -> Reports:
        """Position reports: one row for each user of each report.

        `arrived_ns`, `time_ns`, `tick`, `user`, `position_m` (n, 3), `velocity_m_s` (n, 2), `min_rate_mbps`.
        """
        return self._inner.reports()

    def channels(self) -> Channels:
        """Channel reports: one row for each user of each report.

        `arrived_ns`, `time_ns`, `tick`, `user`, `los_gain`, `irs_gain`, `sinr` (linear).
        """
        return self._inner.channels()

    def commands(self, array: int = 0) -> Commands:
        """Commands to an array: one row for each.

        `arrived_ns`, `time_ns`, `epoch`, `sequence`, `answers` (the tick of the report that it answers),
        `validity_ms`, `roll` and `yaw` (n, M) in rad.
        """
        return self._inner.commands(_index(array))

    def telemetry(self, array: int = 0) -> Telemetry:
        """Telemetry of an array: one row for each message.

        `arrived_ns`, `time_ns`, `answers`, `applied_ns`, `faults`, `roll` and `yaw` (n, M) as commanded, in rad.
        """
        return self._inner.telemetry(_index(array))

    def truth(self) -> Truth:
        """The truth of a simulated room: one row for each user of each message.

        `arrived_ns`, `time_ns`, `tick`, `user`, `position_m` (n, 3), `heading_rad`, `blocked`, `rate_mbps`,
        `min_rate_mbps`, `oracle_sum_rate_mbps`.
        """
        return self._inner.truth()

    def decisions(self, array: int = 0) -> dict[str, NDArray[Any]]:
        """The answered position reports: one row for each.

        `tick`, `reported_ns` and `commanded_ns` (arrivals at the recorder), `answer_us` (the time between them).
        """
        reports, commands = self.reports(), self.commands(array)
        ticks, first = np.unique(reports["tick"], return_index=True)
        answered, command = np.unique(commands["answers"], return_index=True)
        tick, of_report, of_command = np.intersect1d(ticks, answered, return_indices=True)
        reported = reports["arrived_ns"][first[of_report]]
        commanded = commands["arrived_ns"][command[of_command]]
        apart = commanded.astype(np.int64) - reported.astype(np.int64)
        return {"tick": tick, "reported_ns": reported, "commanded_ns": commanded, "answer_us": apart * 1e-3}
