"""Recordings of rooms as arrays.

The files are those of `heliostat record`. Times are in ns: `arrived_ns` at the recorder, `time_ns` of the content, both
UTC where the recorded processes used UTC. All columns of times are int64, so that a difference can be negative.
"""

from __future__ import annotations

import errno
import importlib
import json
import os
import warnings
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ._checks import integer, one_of
from ._core import ARRAYS_MAX, Scenario
from ._core import Recording as _Recording
from .names import ArrayTable, Library, Table
from .tables import Beliefs, Channels, Commands, Reports, Telemetry, Truth


def _index(array: int) -> int:
    return integer("array", array, 0, ARRAYS_MAX - 1)


def _component(name: str, index: int) -> str:
    """The name of a component: of a vector with a unit by its axis, of angles by the mirror."""
    for quantity in ("position", "velocity"):
        if name.startswith(quantity):
            return name.replace(quantity, f"{quantity}_{'xyz'[index]}", 1)
    return f"{name}_{index}"


class Recording:
    """A recording up to its end, or to its last complete chunk.

    A file that was cut, one with messages that cannot be read, and one whose scenario is not that of each process of the
    room, warns with `RuntimeWarning`. A copy and a pickle hold the path, and read the file again.

    Raises `FileNotFoundError` for a path without a file, and `ValueError` for a file that is not a recording of a room.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = os.path.abspath(path)
        if not os.path.exists(path):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), os.fspath(path))
        self._inner = _Recording(os.fspath(path))
        if self._inner.account is None:
            cut = f"{os.fspath(path)}: the recording was cut: later messages are missing"
            warnings.warn(cut, RuntimeWarning, stacklevel=2)
        if self._inner.unreadable is not None:
            warnings.warn(f"{os.fspath(path)}: {self._inner.unreadable}", RuntimeWarning, stacklevel=2)
        if self._inner.other_scenario is not None:
            other = f"{self._inner.other_scenario}: record with the --scenario, --set and --seed of the room"
            warnings.warn(f"{os.fspath(path)}: {other}", RuntimeWarning, stacklevel=2)

    def __reduce__(self) -> tuple[type[Recording], tuple[str]]:
        return type(self), (self._path,)

    def __repr__(self) -> str:
        name, messages, duration_s = self._inner.room, self._inner.messages, self._inner.duration_s
        return f"<Recording of room {name!r}: {messages} messages in {duration_s:.1f} s>"

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

    def belief(self) -> Beliefs:
        """What controllers believed about the users, as they published it: one row for each user of each message.

        `arrived_ns`, `time_ns` (of the decision), `holds_ns` (for which the belief holds), `tick` (of the report that
        the decision answers), `source` (of the controller), `user`, `position_m` (n, 3), `velocity_m_s` (n, 2), the
        covariance of x and y as `xx_m2`, `xy_m2` and `yy_m2`, `heading_rad`, `heading_certainty` from 0 (unknown) to 1,
        and `blocked_probability`. A controller publishes at most 20 a second, and none with a belief other than `filter`.
        A function of `heliostat.run` publishes none: such a room has no rows.
        """
        return self._inner.belief()

    def frame(self, of: Table, array: int = 0, library: Library = "pandas") -> Any:
        """A table of the recording as a data frame of pandas, or of Polars with `library="polars"`.

        `of` is `reports`, `channels`, `truth`, `belief`, `commands`, `telemetry` or `decisions`. A column of vectors becomes one
        column for each component: `position_x_m`, `position_y_m`, `position_z_m`, or `roll_0`, `roll_1`, ... Times in ns
        stay int64: `pandas.to_datetime(frame["time_ns"])` reads them. Needs the library, which the extra `frames` installs.
        """
        if of not in get_args(Table):
            raise ValueError(f"table {of!r}: expected {', '.join(get_args(Table))}")
        one_of("library", library, Library)
        table = getattr(self, of)(array) if of in get_args(ArrayTable) else getattr(self, of)()
        columns: dict[str, NDArray[Any]] = {}
        for name, values in table.items():
            if values.ndim == 1:
                columns[name] = values
                continue
            for index in range(values.shape[1]):
                columns[_component(name, index)] = np.ascontiguousarray(values[:, index])
        try:
            frames = importlib.import_module(library)
        except ImportError as problem:
            raise ImportError(f"the package {library} is missing: pip install {library}") from problem
        return frames.DataFrame(columns)

    def decisions(self, array: int = 0) -> dict[str, NDArray[Any]]:
        """The answered position reports: one row for each.

        `tick`, `reported_ns` and `commanded_ns` (arrivals at the recorder), `answer_us` (the time between them). It is
        negative where the report took longer to the recorder than report and command on their way by the controller.
        """
        reports, commands = self.reports(), self.commands(array)
        ticks, first = np.unique(reports["tick"], return_index=True)
        answered, command = np.unique(commands["answers"], return_index=True)
        tick, of_report, of_command = np.intersect1d(ticks, answered, return_indices=True)
        reported = reports["arrived_ns"][first[of_report]]
        commanded = commands["arrived_ns"][command[of_command]]
        answer_us = (commanded - reported) * 1e-3
        return {"tick": tick, "reported_ns": reported, "commanded_ns": commanded, "answer_us": answer_us}
