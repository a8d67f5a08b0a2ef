"""Rigid bodies of Qualisys Track Manager: an emulated server to which Qualisys' own client connects."""

from __future__ import annotations

import math
import signal
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("qtm_rt", reason="qtm-rt is not installed")
pytest.importorskip("zenoh")
from heliostat.track.qtm import body_names
from room import end_by, free_endpoint, python, wait_until
from tracked import tracked

COMMAND, XML, DATA = 1, 2, 3
SIX_DEGREES = 5
SETTINGS = (
    "<QTM_Parameters_Ver_1.24><The_6D><Body><Name>helmet</Name><Points><Point><Name>helmet - 1</Name></Point></Points></Body>"
    "<Body><Name> wand </Name></Body><Euler><First>Roll</First></Euler></The_6D></QTM_Parameters_Ver_1.24>"
)
Body = tuple[tuple[float, float, float], tuple[float, ...]]
# Turned by 90 degrees about z: x goes to y. The protocol has matrices by columns.
QUARTER_TURN = (0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
LOST: Body = ((math.nan,) * 3, (math.nan,) * 9)


class Server(socketserver.ThreadingTCPServer):
    """The commands that a client of rigid bodies sends, by the documentation of the protocol, version 1.24."""

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, port: int) -> None:
        self.bodies: list[Body] = []
        self.began = time.monotonic()
        self.lines: list[socket.socket] = []
        super().__init__(("127.0.0.1", port), Client)


class Client(socketserver.BaseRequestHandler):
    """One connection."""

    def send(self, kind: int, content: bytes) -> None:
        self.request.sendall(struct.pack("<II", 8 + len(content), kind) + content)

    def receive(self, count: int) -> bytes:
        received = b""
        while len(received) < count:
            part = self.request.recv(count - len(received))
            if not part:
                raise ConnectionError
            received += part
        return received

    def handle(self) -> None:
        assert isinstance(self.server, Server)
        self.server.lines.append(self.request)
        self.send(COMMAND, b"QTM RT Interface connected\0")
        try:
            while True:
                length, kind = struct.unpack("<II", self.receive(8))
                text = self.receive(length - 8).rstrip(b"\0").decode()
                assert kind == COMMAND
                if text.startswith("version "):
                    self.send(COMMAND, f"Version set to {text.split()[1]}\0".encode())
                elif text == "getparameters 6d":
                    self.send(XML, SETTINGS.encode() + b"\0")
                elif text == "streamframes allframes 6d":
                    self.stream()
                else:
                    self.send(0, b"Command not supported.\0")
        except OSError:
            pass

    def stream(self) -> None:
        assert isinstance(self.server, Server)
        for frame in range(1, 1 << 30):
            body = struct.pack("<ihh", len(self.server.bodies), 0, 0)
            for position, matrix in self.server.bodies:
                body += struct.pack("<3f9f", *position, *matrix)
            component = struct.pack("<II", 8 + len(body), SIX_DEGREES) + body
            microseconds = round(1e6 * (time.monotonic() - self.server.began))
            self.send(DATA, struct.pack("<qII", microseconds, frame, 1) + component)
            time.sleep(0.01)


@contextmanager
def server(port: int) -> Iterator[Server]:
    with Server(port) as one:
        thread = threading.Thread(target=one.serve_forever, daemon=True)
        thread.start()
        try:
            yield one
        finally:
            one.shutdown()
            for line in one.lines:
                line.close()


def a_port() -> int:
    return int(free_endpoint("tcp").rpartition(":")[2])


def test_rigid_bodies_become_users_whom_a_controller_answers(tmp_path: Path) -> None:
    port = a_port()
    flags: tuple[str, ...] = ("qtm", "--host", "127.0.0.1", "--port", str(port), "--user", "helmet=3", "--user", "wand=5")
    flags += ("--offset", "helmet=0.1,0,0", "--timeout-s", "0.4", "--min-rate-mbps", "2")
    with server(port) as qtm, tracked(tmp_path, *flags) as run:
        qtm.bodies = [((1000.0, 500.0, 850.0), QUARTER_TURN), ((-1000.0, 0.0, 1200.0), (1, 0, 0, 0, 1, 0, 0, 0, 1))]
        run.wait_for({3: [1.0, 0.6, 0.85], 5: [-1.0, 0.0, 1.2]})
        assert run.room.latest["users"]["users"][0]["min_rate_bps"] == 2e6
        wait_until("orientation", lambda: "orientation" in run.room.latest)
        held = {one["user"]: one["quaternion"] for one in run.room.latest["orientation"]["users"]}
        assert held[3] == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)], abs=1e-6)
        assert held[5] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-6)
        qtm.bodies = [LOST, qtm.bodies[1]]
        run.wait_for({5: [-1.0, 0.0, 1.2]})
        qtm.bodies = [LOST, LOST]
        run.wait_for({})
        output, errors = run.end()
        assert "problems" not in output and 'reports the users of room "tracked"\n' in errors, (output, errors)


def test_an_absent_server_and_a_lost_connection_are_named_and_tried_again(tmp_path: Path) -> None:
    port = a_port()
    with tracked(tmp_path, "qtm", "--host", "127.0.0.1", "--port", str(port)) as run:
        wait_until("absence", lambda: "check that the computer can be reached" in run.problem())
        with server(port) as qtm:
            qtm.bodies = [((1000.0, 500.0, 850.0), QUARTER_TURN)]
            run.wait_for({0: [1.0, 0.5, 0.85]})
        wait_until("loss", lambda: "the connection is lost" in run.problem() or "no connection" in run.problem())
        with server(port) as qtm:
            qtm.bodies = [((1500.0, 500.0, 850.0), QUARTER_TURN)]
            run.wait_for({0: [1.5, 0.5, 0.85]})


def test_a_dry_run_joins_no_room_and_prints_where_the_users_are(tmp_path: Path) -> None:
    port = a_port()
    flags = ("qtm", "--host", "127.0.0.1", "--port", str(port), "--dry-run", "--axes", "y-up", "--room-size", "8,6,3")
    with server(port) as qtm, python("-m", "heliostat.track", *flags, folder=tmp_path) as process:
        qtm.bodies = [((1500.0, 850.0, -200.0), (1, 0, 0, 0, 1, 0, 0, 0, 1))]
        assert process.stdout is not None
        assert process.stdout.readline() == "user 0 at (1.500, 0.200, 0.850) m, held (1.000, 0.000, 0.000, 0.000)\n"
        output, _ = end_by(signal.SIGINT, process)
        assert "reports made: " in output


def test_the_names_of_bodies_are_in_the_order_of_the_data() -> None:
    assert body_names(SETTINGS) == ["helmet", "wand"]
    wrong: Any = "<QTM_Parameters_Ver_1.24/>"
    assert body_names(wrong) == []
