"""A process of a room: its flags, its session and what it publishes. It needs the extra `zenoh`.

`heliostat.driver`, `heliostat.tracker` and `heliostat.controller` use it. The flags are those of the Rust programs.
"""

from __future__ import annotations

import argparse
import ipaddress
import json
import os
import random
import re
import socket
import ssl
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from ._checks import integer
from ._core import ARRAYS_MAX, KINDS, __version__, encode, keys
from ._program import USAGE
from ._signals import stop_on_signals as stop_on_signals

try:
    import zenoh
except ImportError as problem:
    raise ImportError('the package eclipse-zenoh is missing: pip install "heliostat[zenoh]"') from problem

SOFTWARE = f"heliostat for Python {__version__}"
DEFAULT_ROOM = "demo"
INTERRUPTED = 130
"""The exit code of a second signal, as of the Rust programs."""
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.25, 5.0
_ALIVE_LIMIT_S = 1.0
SHORTEST_S, _LONGEST_S = 0.01, 1e7
_UNITS_S = {"ms": 1e-3, "min": 60.0, "h": 3600.0, "s": 1.0}
_PROBE_LIMIT_S = 0.5
_SILENT_S = 3.0
_ENCRYPTED = ("tls", "quic")
_SESSION = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "connect/retry": {"period_init_ms": 50, "period_max_ms": 1000, "period_increase_factor": 2},
}
_NODES = {"controller": 0, "driver": 2, "tracker": 3}
# Quality of service by CONTRACT.md: priority, and whether a message is sent at once.
_QUALITY = {
    "telemetry": (zenoh.Priority.DATA_HIGH, True),
    "capabilities": (zenoh.Priority.DATA_HIGH, True),
    "safety": (zenoh.Priority.DATA_HIGH, True),
    "command": (zenoh.Priority.REAL_TIME, True),
    "stops": (zenoh.Priority.DATA_HIGH, True),
    "status": (zenoh.Priority.DATA_LOW, False),
}
_REPORTS = (zenoh.Priority.REAL_TIME, True)
# Messages that wait where the network is congested; others are dropped.
_BLOCKING = ("stop", "stop_repetition", "rearm", "calibration")


class PeerError(Exception):
    """A setting that is refused, or a room that the process cannot join; the text has the reason."""

    status = 1
    """The exit status of a program that ends for it, as of the Rust programs."""


class SettingsError(PeerError):
    """A setting that is refused: room, endpoints or keys."""

    status = USAGE


def end_for(problem: PeerError | ValueError) -> NoReturn:
    """Ends a program with the reason in one line."""
    print(f"error: {problem}", file=sys.stderr)
    sys.exit(problem.status if isinstance(problem, PeerError) else USAGE)


@dataclass(frozen=True)
class Settings:
    """How a process joins a room.

    Endpoints are `tcp/HOST:PORT`, or `tls/HOST:PORT` with `tls`, the folder of `heliostat keys`. Without a room it
    is that of the keys, else `demo`. A client exchanges messages through the router in `connect` only. Without keys,
    `insecure` allows to listen where other machines reach the process.
    """

    room: str | None = None
    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()
    client: bool = False
    tls: Path | None = None
    insecure: bool = False

    @staticmethod
    def of(given: argparse.Namespace) -> Settings:
        """The settings of the flags of `add_arguments`."""
        return Settings(
            given.room, tuple(given.listen), tuple(given.connect), given.client, given.tls, given.insecure
        )


def endpoints(name: str, given: str | Iterable[str]) -> tuple[str, ...]:
    """Endpoints; a text is one endpoint. Raises `TypeError` for another type."""
    wrong = f'{name} = {given!r}: expected endpoints as texts, for example ["tcp/127.0.0.1:7447"]'
    try:
        found = (given,) if isinstance(given, str) else tuple(given)
    except TypeError as problem:
        raise TypeError(wrong) from problem
    if not all(isinstance(one, str) for one in found):
        raise TypeError(wrong)
    return tuple(str(one) for one in found)


def add_arguments(parser: argparse._ActionsContainer) -> None:
    """Adds the flags of the room, the endpoints, the keys and the end."""
    parser.add_argument("--room", metavar="NAME", help="name of the room [default: the room of --tls, or demo]")
    parser.add_argument(
        "--listen", metavar="ENDPOINT", action="append", default=[], help="endpoint at which to listen (repeatable)"
    )
    parser.add_argument(
        "--connect", metavar="ENDPOINT", action="append", default=[], help="endpoint of another process (repeatable)"
    )
    parser.add_argument("--client", action="store_true", help="exchange messages through the router of --connect only")
    parser.add_argument("--tls", metavar="DIR", type=Path, help="encrypt with the keys in this folder (heliostat keys)")
    parser.add_argument("--insecure", action="store_true", help="listen without --tls where other machines reach it")
    parser.add_argument("--seconds", metavar="S", type=duration_s, help="end after this time")


def duration_s(text: str) -> float:
    """The seconds of a text such as 2.5, 3s, 500ms, 2min or 1h, by the rule of the Rust programs; a `type` of argparse."""
    parts = re.fullmatch(r"([0-9.]+(?:[eE][+-]?[0-9]+)?)(ms|min|h|s)?", text)
    try:
        seconds = float(parts[1]) * _UNITS_S[parts[2] or "s"] if parts else 0.0
    except ValueError:
        seconds = 0.0
    if not SHORTEST_S <= seconds <= _LONGEST_S:
        raise argparse.ArgumentTypeError(
            f'invalid duration "{text}": expected seconds between 0.01 and 10000000, for example 2.5, 2.5s, 500ms or 10min'
        )
    return seconds


class Peer:
    """A session in a room, as a context manager: it is closed at the end of the block in every case."""

    def __init__(self, settings: Settings, node: str, array: int, stop: threading.Event) -> None:
        config, room = _configuration(settings, node)
        self.room, self.node, self.array = room, node, array
        self._settings = settings
        self.authenticated = settings.tls is not None
        self.source = random.SystemRandom().getrandbits(64)
        try:
            self.keys = keys(room, node, self.source, integer("array", array, 0, ARRAYS_MAX - 1))
        except (TypeError, ValueError) as problem:
            raise SettingsError(str(problem)) from problem
        self._started_ns = time.time_ns()
        self._process = os.getpid()
        self._sequences: dict[str, int] = {}
        self._publishers: dict[str, Any] = {}
        self._declared: list[Any] = []
        self._stack = ExitStack()
        self.session: Any = open_session(config, stop)
        if self.session is not None:
            self._stack.enter_context(self.session)

    def __enter__(self) -> Peer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if os.getpid() == self._process:
            self._stack.close()

    @property
    def is_open(self) -> bool:
        """Whether the room was joined; false only where a stop was requested before."""
        return self.session is not None

    def alive(self, name: str) -> list[str]:
        """The liveliness tokens of these processes that are there now."""
        replies = self.session.liveliness().get(self.keys[name], timeout=_ALIVE_LIMIT_S)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def announce(self) -> None:
        """Declares the liveliness token of the process."""
        self._declared.append(self.session.liveliness().declare_token(self.keys["alive"]))

    def report_silence(self, show: Callable[[str], None]) -> None:
        """Shows once, after some seconds, why the messages of this process reach no controller, if they do not."""

        def look() -> None:
            # The session may end meanwhile.
            with suppress(zenoh.ZError):
                if problem := self.silence():
                    show(problem)

        timer = threading.Timer(_SILENT_S, look)
        timer.daemon = True
        timer.start()
        self._stack.callback(timer.cancel)

    def silence(self) -> str:
        """Why the messages of this process reach no controller now; empty if they do."""
        info = self.session.info
        if not [*info.peers_zid(), *info.routers_zid()]:
            if problem := connection_problem(self._settings, self.node):
                return f"not connected, retrying: {problem}"
            if self._settings.connect:
                return f"no process of the room answers at {', '.join(self._settings.connect)}: retrying"
            return f"no process has connected to {', '.join(self._settings.listen)} yet: waiting"
        if any("/controller/" in token for token in self.alive("processes")):
            return ""
        return f'no controller of room "{self.room}" is connected: start one, or join its room with --room'

    def _key(self, name: str, array: int | None) -> str:
        """The key of a message; of another array than that of the process, if one is given."""
        if array is None or array == self.array:
            return self.keys[name]
        return keys(self.room, self.node, self.source, array)[name]

    def subscribe(self, name: str, handle: Callable[[bytes], None], array: int | None = None) -> None:
        """Calls `handle` on a thread of Zenoh with each payload of this message."""

        def deliver(sample: Any) -> None:
            handle(bytes(sample.payload))

        self._declared.append(self.session.declare_subscriber(self._key(name, array), deliver))

    def fetch(self, name: str, within_s: float, array: int | None = None) -> list[bytes]:
        """The latest payloads of this message that processes of the room answer with within this time."""
        replies = self.session.get(self._key(name, array), timeout=within_s)
        return [bytes(reply.ok.payload) for reply in replies if reply.ok is not None]

    def watch(self, handle: Callable[[str, bool], None], name: str = "processes") -> None:
        """Calls `handle` with the key of each process of the room, or of those of a name, that is there, appears or
        leaves."""

        def deliver(sample: Any) -> None:
            handle(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        subscriber = self.session.liveliness().declare_subscriber(self.keys[name], deliver, history=True)
        self._declared.append(subscriber)

    def answer(self, name: str, latest: Mapping[str, bytes]) -> None:
        """Answers queries of this message with the latest payload, if there is one."""
        key = self.keys[name]

        def reply(query: Any) -> None:
            if name in latest:
                query.reply(key, latest[name])

        self._declared.append(self.session.declare_queryable(key, reply))

    def put(self, name: str, payload: bytes, array: int | None = None) -> None:
        """Publishes a payload with the quality of service of this message."""
        if os.getpid() != self._process:
            raise PeerError(
                "the session belongs to the process before the fork: join the room in the new process, or start workers "
                'with the method "spawn"'
            )
        key = self._key(name, array)
        if key not in self._publishers:
            priority, express = _QUALITY.get(name, _REPORTS)
            control = zenoh.CongestionControl.BLOCK if name in _BLOCKING else zenoh.CongestionControl.DROP
            self._publishers[key] = self.session.declare_publisher(
                key, priority=priority, express=express, congestion_control=control
            )
        self._publishers[key].put(payload)

    def publish(self, name: str, fields: Mapping[str, Any], time_ns: int | None = None) -> None:
        """Publishes a message with the next stamp of its key; `time_ns` is when its content was sampled."""
        sequence = self._sequences.get(name, 0) + 1
        stamp = {"source": self.source, "sequence": sequence, "time_ns": time.time_ns() if time_ns is None else time_ns}
        payload = encode({"stamp": stamp, **fields}, KINDS[name])
        self._sequences[name] = sequence
        self.put(name, payload)

    def publish_status(
        self,
        state: str,
        counters: Mapping[str, int],
        last_problem: str = "",
        policy: str = "",
        scenario: str = "",
    ) -> None:
        """Publishes the status of the process, which operators see."""
        self.publish(
            "status",
            {
                "node": _NODES[self.node],
                "name": f"{self.source:016x}",
                "software": SOFTWARE,
                "state": state,
                "scenario": scenario,
                "policy": policy,
                "started_ns": self._started_ns,
                "counters": list(counters.items()),
                "gauges": [],
                "timings": [],
                "last_problem": last_problem,
            },
        )


def connection_problem(settings: Settings, role: str) -> str:
    """Why no connection to a process comes about that answers at an endpoint; empty where no reason is known.

    It makes the handshake of TLS with the keys of the role, and exchanges no data.
    """
    return next((found for endpoint in settings.connect if (found := _endpoint_problem(endpoint, settings, role))), "")


def _endpoint_problem(endpoint: str, settings: Settings, role: str) -> str:
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    host = host.strip("[]")
    keys_of = "give both processes keys of one `heliostat keys init`, or renew them with `heliostat keys renew`"
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if protocol == "tls" and settings.tls is not None:
        context.load_verify_locations(settings.tls / "ca.pem")
        context.load_cert_chain(settings.tls / f"{role}.pem", settings.tls / f"{role}.key")
    elif protocol == "tcp":
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    else:
        return ""
    try:
        with socket.create_connection((host, int(port)), timeout=_PROBE_LIMIT_S) as plain:
            with context.wrap_socket(plain, server_hostname=host) as secured:
                if protocol == "tls":
                    # The other side reads the certificate of this one after the handshake.
                    secured.recv(1)
    except ssl.SSLCertVerificationError as problem:
        return f"{endpoint}: the certificate of {host} does not fit ({problem.verify_message}): {keys_of}"
    except ssl.SSLError as problem:
        is_alert = "ALERT" in (problem.reason or "")
        if protocol == "tls" and is_alert:
            return f"{endpoint}: {host} refuses the certificate of this process ({problem.reason}): {keys_of}"
        if not is_alert:
            return ""
    except (OSError, ValueError):
        # No process answers, or one without TLS.
        return ""
    if protocol == "tls":
        return ""
    return (
        f"{endpoint}: the process there accepts encrypted connections only: if it is a process of this room, expected "
        f"tls, the folder of the keys of its room, and the endpoint tls/{address}"
    )


def open_session(config: zenoh.Config, stop: threading.Event) -> Any:
    """Opens a session, and retries while a router cannot be reached; `None` where a stop is requested before."""
    pause_s, began, is_shown = _FIRST_PAUSE_S, time.monotonic(), False
    while not stop.is_set():
        try:
            return zenoh.open(config)
        except zenoh.ZError as problem:
            if json.loads(config.get_json("mode")) != "client":
                raise PeerError(f"the Zenoh session cannot be opened: {problem}") from problem
        if not is_shown and time.monotonic() - began >= _SILENT_S:
            is_shown = True
            routers = ", ".join(json.loads(config.get_json("connect/endpoints")))
            print(f"no router answers at {routers}: retrying", file=sys.stderr, flush=True)
        stop.wait(pause_s)
        pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
    return None


def _configuration(settings: Settings, role: str) -> tuple[zenoh.Config, str]:
    """The configuration of Zenoh, and the room."""
    _check(settings)
    config, room = zenoh.Config(), settings.room or DEFAULT_ROOM
    if settings.tls is not None:
        config, of_keys = _secured(settings.tls, role)
        if settings.room not in (None, of_keys):
            raise SettingsError(f'room "{settings.room}": expected "{of_keys}", the room of the keys in {settings.tls}')
        room = of_keys
    own = {
        "mode": "client" if settings.client else "peer",
        "listen/endpoints": list(settings.listen),
        "connect/endpoints": list(settings.connect),
        "connect/timeout_ms": 5000 if settings.client else -1,
        "connect/exit_on_failure": settings.client,
    }
    for key, value in {**_SESSION, **own}.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as problem:
            raise SettingsError(f"setting {key} = {value}: {problem}") from problem
    return config, room


def _secured(folder: Path, role: str) -> tuple[zenoh.Config, str]:
    """The configuration of a role in a folder of `heliostat keys`, and the room of its rights."""
    private_key = folder / f"{role}.key"
    try:
        if private_key.stat().st_mode & stat.S_IRWXO:
            raise SettingsError(
                f"{private_key}: every user of this machine can read or change this private key; expected chmod 600 or 640"
            )
        config = zenoh.Config.from_file(folder / f"zenoh-{role}.json5")
    except (OSError, zenoh.ZError) as problem:
        raise SettingsError(
            f'{folder}: {problem}; expected the keys of role "{role}", made by heliostat keys init or keys issue'
        ) from problem
    certificate = f"{role}.pem"
    _check_certificate(folder / certificate, private_key)
    # The file has the paths of the folder in which it was made.
    for setting, name in (
        ("root_ca_certificate", "ca.pem"),
        ("listen_certificate", certificate),
        ("listen_private_key", private_key.name),
        ("connect_certificate", certificate),
        ("connect_private_key", private_key.name),
    ):
        config.insert_json5(f"transport/link/tls/{setting}", json.dumps(str(folder.resolve() / name)))
    rights = json.loads(config.get_json("access_control"))
    return config, rights["rules"][0]["key_exprs"][0].split("/")[2]


def _check_certificate(path: Path, private_key: Path) -> None:
    """Refuses a certificate that is no use at this time: Zenoh would retry its connections without a reason."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(path, private_key, password="")
        begin, end = _validity(ssl.PEM_cert_to_DER_cert(path.read_text()))
    except (OSError, ValueError, IndexError) as problem:
        raise SettingsError(
            f"{path}: {problem}; expected a certificate of heliostat keys in PEM format, with its private key "
            f"{private_key.name} beside it: copy both from the same folder, or issue them again with heliostat keys issue"
        ) from problem
    now = datetime.now(timezone.utc)
    if now > end:
        raise SettingsError(f"{path}: the certificate expired on {end:%Y-%m-%d}; renew it with heliostat keys renew")
    if now < begin:
        raise SettingsError(f"{path}: the certificate is not valid yet; set the clock of this machine, or issue it again")


def _validity(certificate: bytes) -> tuple[datetime, datetime]:
    """Begin and end of the validity of a certificate in DER (RFC 5280, section 4.1)."""

    def element(at: int) -> tuple[int, int, int]:
        """Tag, begin and end of the content of the element at a place."""
        length, begin = certificate[at + 1], at + 2
        if length & 0x80:
            digits = length & 0x7F
            length, begin = int.from_bytes(certificate[begin : begin + digits], "big"), begin + digits
        return certificate[at], begin, begin + length

    _, at, _ = element(element(0)[1])
    # An explicit version comes before serial number, algorithm, issuer and validity.
    for _ in range(4 if certificate[at] == 0xA0 else 3):
        at = element(at)[2]
    at, times = element(at)[1], list[datetime]()
    for _ in range(2):
        tag, begin, at = element(at)
        form = "%y%m%d%H%M%SZ" if tag == 0x17 else "%Y%m%d%H%M%SZ"
        times.append(datetime.strptime(certificate[begin:at].decode(), form).replace(tzinfo=timezone.utc))
    return times[0], times[1]


def _check(settings: Settings) -> None:
    """Refuses endpoints that do not suit each other or the keys."""
    if settings.client and (settings.listen or not settings.connect):
        raise SettingsError("wrong endpoints for a client: expected no --listen, and the router in --connect")
    if not (settings.listen or settings.connect):
        raise SettingsError("no endpoint: expected --listen or --connect, for example --connect tcp/127.0.0.1:7447")
    for name, endpoints in (("listen", settings.listen), ("connect", settings.connect)):
        if not isinstance(endpoints, (tuple, list)) or not all(isinstance(one, str) for one in endpoints):
            raise SettingsError(f"{name} = {endpoints!r}: expected a tuple of endpoints tcp/HOST:PORT or tls/HOST:PORT")
    for endpoint in (*settings.listen, *settings.connect):
        protocol, _, address = endpoint.partition("/")
        port = address.rpartition(":")[2].partition("#")[0].partition("?")[0]
        if protocol == "unixsock-stream":
            continue
        if protocol not in ("tcp", *_ENCRYPTED) or not address.rpartition(":")[0] or not port.isdecimal():
            raise SettingsError(f'endpoint "{endpoint}": expected tcp/HOST:PORT or tls/HOST:PORT')
        if (protocol in _ENCRYPTED) != (settings.tls is not None):
            expected = "tls/HOST:PORT with --tls" if settings.tls else "--tls DIR with an endpoint tls/HOST:PORT"
            raise SettingsError(f'endpoint "{endpoint}": expected {expected}')
        if endpoint in settings.listen and not (settings.tls or settings.insecure or _is_local(address)):
            raise SettingsError(f'other machines reach "{endpoint}": expected --tls DIR, or --insecure')


def _is_local(address: str) -> bool:
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
