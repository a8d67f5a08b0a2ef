"""Rigid bodies of Qualisys Track Manager over its real-time protocol. It needs the extra `qtm`, Qualisys' own client.

The protocol has positions in mm, and rotation matrices by columns. Its times count from the start of the measurement, so
the clock "aligned" is the right one. Bodies that the cameras lose are NaN; the source leaves them out.
"""

from __future__ import annotations

import asyncio
import math
import threading
import xml.etree.ElementTree as xml
from typing import Any

import numpy as np

from .bridge import Intake, Source
from .frame import quaternion_of
from .users import Pose

try:
    import qtm_rt
except ImportError as problem:
    raise ImportError('the package qtm-rt is missing: pip install "heliostat[zenoh,qtm]"') from problem

DEFAULT_PORT = 22223
"""The port of QTM for little-endian numbers."""

_TIMEOUT_S = 5.0
_PAUSE_S = 1.0


class Qtm(Source):
    """The rigid bodies of a computer that runs Qualisys Track Manager."""

    unit = "mm"
    clock = "aligned"

    def __init__(self, host: str, port: int = DEFAULT_PORT) -> None:
        self._host, self._port = host, port
        self.name = f"Qualisys Track Manager at {host}:{port}"
        self._loss = ""
        self._loop = asyncio.new_event_loop()
        self._thread: threading.Thread | None = None
        self._ended: asyncio.Event | None = None

    def start(self, intake: Intake) -> None:
        """Connects from a thread, and again after each loss."""
        is_ready = threading.Event()

        def work() -> None:
            asyncio.set_event_loop(self._loop)
            self._loop.run_until_complete(self._work(intake, is_ready))

        self._thread = threading.Thread(target=work, daemon=True)
        self._thread.start()
        is_ready.wait()

    async def _work(self, intake: Intake, is_ready: threading.Event) -> None:
        self._ended = asyncio.Event()
        is_ready.set()
        while not self._ended.is_set():
            try:
                await self._stream(intake, self._ended)
            except (OSError, asyncio.TimeoutError, qtm_rt.QRTCommandException, xml.ParseError) as problem:
                self._loss = f"{type(problem).__name__} {problem}".rstrip() + ": "
                intake.problem("lost", f"{self.name}: {self.advice()}")
            try:
                await asyncio.wait_for(self._ended.wait(), _PAUSE_S)
            except asyncio.TimeoutError:
                pass

    async def _stream(self, intake: Intake, ended: asyncio.Event) -> None:
        """Streams until the connection is lost or the source is closed."""
        lost = asyncio.Event()
        connection = await qtm_rt.connect(
            self._host, self._port, timeout=_TIMEOUT_S, on_disconnect=lambda _: lost.set()
        )
        if connection is None:
            raise OSError("no connection")
        self._loss = ""
        try:
            names = body_names(await connection.get_parameters(parameters=["6d"]))
            if not names:
                intake.problem("no-bodies", f"{self.name} has no rigid bodies: define them in QTM")
            await connection.stream_frames(
                components=["6d"], on_packet=lambda packet: intake.poses(poses_of(packet, names))
            )
            waits = [asyncio.ensure_future(one.wait()) for one in (lost, ended)]
            await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            for wait in waits:
                wait.cancel()
            if lost.is_set() and not ended.is_set():
                raise OSError("the connection is lost")
        finally:
            if connection.has_transport():
                connection.disconnect()

    def advice(self) -> str:
        """What to check while no data arrive."""
        return f"{self._loss}check that the computer can be reached, and that QTM shows a preview or a measurement"

    def close(self) -> None:
        """Ends the thread and the connection."""
        if self._thread is not None and self._ended is not None:
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join()
        self._loop.close()


def body_names(parameters: bytes | str) -> list[str]:
    """The names of the rigid bodies in the settings of QTM, in the order of the data."""
    root = xml.fromstring(parameters)
    return [str(body.findtext("Name", "")).strip() for body in root.iter("Body")]


def poses_of(packet: Any, names: list[str]) -> list[Pose]:
    """The bodies of a packet that the cameras see."""
    component = packet.get_6d()
    if component is None:
        return []
    poses = []
    for index, (position, rotation) in enumerate(component[1]):
        if math.isnan(position.x):
            continue
        name = names[index] if index < len(names) else f"body {index + 1}"
        matrix = np.reshape(rotation.matrix, (3, 3)).T
        poses.append(Pose(name, tuple(position), quaternion_of(matrix), 1000 * packet.timestamp))
    return poses
