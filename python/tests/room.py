"""Processes of a room for the tests: the program heliostat, and Python scripts."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from heliostat import wire

EXAMPLES = Path(__file__).parents[2] / "examples"
# Generous, for a busy machine.
LIMIT_S = 60.0
# The folder of the Unix sockets, which is removed at the end: a killed process leaves its socket behind.
SOCKETS = tempfile.TemporaryDirectory(prefix="heliostat-tests-", ignore_cleanup_errors=True)

needs_program = pytest.mark.skipif(
    "HELIOSTAT_PROGRAM" not in os.environ, reason="HELIOSTAT_PROGRAM names no heliostat"
)


def free_endpoint(protocol: str = "unixsock-stream" if hasattr(socket, "AF_UNIX") else "tcp") -> str:
    """An endpoint on this machine: a Unix socket that no other process takes, or a port that is free now."""
    if protocol == "unixsock-stream":
        return f"{protocol}/{SOCKETS.name}/{uuid.uuid4()}.sock"
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return f"{protocol}/127.0.0.1:{one.getsockname()[1]}"


def heliostat(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Runs a command of the program to its end."""
    command = [os.environ["HELIOSTAT_PROGRAM"], *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=2 * LIMIT_S, check=False)


@contextmanager
def python(*arguments: str | Path, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A running Python script; `folder` keeps its emergency stop. It is killed at the end of the block."""
    environment = {**os.environ, "STATE_DIRECTORY": str(folder)}
    command = [sys.executable, *map(str, arguments)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment) as process:
        try:
            yield process
        finally:
            process.kill()


def end_by(number: signal.Signals, process: subprocess.Popen[str]) -> tuple[str, str]:
    """Ends a process by a signal; its output and its errors. It must end in an orderly way."""
    process.send_signal(number)
    output, errors = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, errors
    return output, errors


def wait_until(what: str, check: Callable[[], bool]) -> None:
    """Waits until a check holds."""
    end = time.monotonic() + LIMIT_S
    while not check():
        assert time.monotonic() < end, f"no {what} within {LIMIT_S} s"
        time.sleep(0.05)


class Observer:
    """The latest message of each key of a room, in a session of its own, which can publish too."""

    def __init__(self, endpoint: str, room: str, array: int = 0) -> None:
        import zenoh

        config = zenoh.Config()
        config.insert_json5("listen/endpoints", json.dumps([endpoint]))
        # As in every process of a room.
        for kind in ("multicast", "gossip"):
            config.insert_json5(f"scouting/{kind}/enabled", "false")
        self.session: Any = zenoh.open(config)
        self.keys = wire.keys(room, "viewer", 1, array)
        self.sequence = 0
        self.publishers: dict[str, Any] = {}
        self.latest: dict[str, dict[str, Any]] = {}
        self.counts: dict[str, int] = {}
        self._statuses: dict[int, dict[str, Any]] = {}
        names = ("users", "telemetry", "safety", "stops", "obstacles", "channel", "orientation", "leds", "command")
        listened = {name: self.keys[name] for name in names}
        listened["status"] = f"heliostat/v1/{room}/status/*"
        self.subscribers = [self.session.declare_subscriber(key, self._note(name)) for name, key in listened.items()]

    def _note(self, name: str) -> Callable[[Any], None]:
        def note(sample: Any) -> None:
            message = wire.decode(bytes(sample.payload), wire.KINDS[name])
            self.latest[name] = message
            if name == "status":
                self._statuses[message["node"]] = message
            self.counts[name] = self.counts.get(name, 0) + 1

        return note

    def status(self, node: str) -> dict[str, Any]:
        """The latest status of a process of this kind."""
        return self._statuses.get({"controller": 0, "tracker": 3}[node], {})

    def publish(self, name: str, **fields: Any) -> None:
        """Publishes an order with a stamp, or a command without one, once a process receives such messages."""
        if name not in self.publishers:
            self.publishers[name] = self.session.declare_publisher(self.keys[name])
        wait_until(f"subscriber of {name}", lambda: bool(self.publishers[name].matching_status.matching))
        self.sequence += 1
        stamp = {"source": 77, "sequence": self.sequence, "time_ns": time.time_ns()}
        message = fields if name == "command" else {"stamp": stamp, **fields}
        self.publishers[name].put(wire.encode(message, wire.KINDS[name]))

    def alive(self, pattern: str) -> list[str]:
        """The liveliness tokens of a pattern."""
        return [str(reply.ok.key_expr) for reply in self.session.liveliness().get(pattern) if reply.ok is not None]


@contextmanager
def observer(endpoint: str, room: str, array: int = 0) -> Iterator[Observer]:
    """An observer that listens at an endpoint until the end of the block."""
    one = Observer(endpoint, room, array)
    try:
        yield one
    finally:
        one.session.close()
