"""Tags that publish their positions as JSON over MQTT, such as UWB tags. It needs the extra `mqtt`.

A `Layout` states where a message has what. Two are those of makers, and each part can be set:

| layout | topic | message |
| --- | --- | --- |
| `plain` | `heliostat/tags/+` | `{"id": "tag", "x": 1.0, "y": 0.5, "z": 0.85}`, in m; `time_s` and `quaternion` are optional |
| `dwm1001` | `dwm/node/+/uplink/location` | gateway of Qorvo MDEK1001: the topic has the identifier, `position` is in m |
| `pozyx` | `tags` | Pozyx Enterprise: a list of tags with `data.coordinates` in mm, and `timestamp` in s |
"""

from __future__ import annotations

import json
import math
import ssl
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from .bridge import Intake, Source, SourceError
from .users import Pose

try:
    import paho.mqtt.client as paho
    from paho.mqtt.enums import CallbackAPIVersion
except ImportError as problem:
    raise ImportError('the package paho-mqtt is missing: pip install "heliostat[zenoh,mqtt]"') from problem

DEFAULT_PORT, DEFAULT_TLS_PORT = 1883, 8883

_SIZE_MAX = 1 << 20
_LONGEST_PAUSE_S = 5
_NO_QUALITY_OF_SERVICE = 0


@dataclass(frozen=True)
class Layout:
    """Where a message has what. A path is a list of names and indices, such as `data.coordinates.x` or `position.0`;
    `topic:2` is the third level of the topic. `success` is the path of a flag that is false where the position is
    unknown. `unit` is that of the position. `time_s` is the path of the time, in s since 1970."""

    topic: str
    id: str
    position: tuple[str, str, str]
    unit: str = "m"
    time_s: str | None = None
    quaternion: str | None = None
    success: str | None = None


LAYOUTS = {
    "plain": Layout("heliostat/tags/+", "id", ("x", "y", "z"), time_s="time_s", quaternion="quaternion"),
    "dwm1001": Layout("dwm/node/+/uplink/location", "topic:2", ("position.x", "position.y", "position.z")),
    "pozyx": Layout(
        "tags",
        "tagId",
        ("data.coordinates.x", "data.coordinates.y", "data.coordinates.z"),
        unit="mm",
        time_s="timestamp",
        success="success",
    ),
}
"""The layouts by name."""


class Mqtt(Source):
    """The tags of a broker.

    `broker` is its address: HOST, HOST:PORT, or mqtt://HOST:PORT. `login` is a user name and a password. `authority` is a file of certificates with which the broker is checked; with
    it the connection is encrypted. Raises `SourceError` for an address or a file that cannot be used.
    """

    def __init__(
        self,
        broker: str,
        layout: Layout,
        *,
        port: int | None = None,
        login: tuple[str, str] | None = None,
        authority: Path | None = None,
    ) -> None:
        self.layout, self.unit = layout, layout.unit
        self.clock = "arrival" if layout.time_s is None else "source"
        self._host, in_address = address_of(broker)
        if None not in (port, in_address) and port != in_address:
            raise SourceError(f"broker {broker}: the port {port} is given too; expected one of the two")
        self._port = port or in_address or (DEFAULT_TLS_PORT if authority else DEFAULT_PORT)
        self.name = f"topic {layout.topic} of {self._host}:{self._port}"
        self._is_connected, self._refusal = False, ""
        self._client = paho.Client(CallbackAPIVersion.VERSION2)
        self._client.reconnect_delay_set(1, _LONGEST_PAUSE_S)
        if login is not None:
            self._client.username_pw_set(*login)
        if authority is not None:
            try:
                self._client.tls_set_context(ssl.create_default_context(cafile=str(authority)))
            except (OSError, ssl.SSLError) as problem:
                raise SourceError(f"{authority}: {problem}; expected a file of certificates") from problem

    def start(self, intake: Intake) -> None:
        """Connects from a thread of paho, which connects again after each loss."""
        address = f"{self._host}:{self._port}"

        def connected(client: Any, _: Any, __: Any, reason: Any, ___: Any) -> None:
            self._is_connected = not reason.is_failure
            self._refusal = f"the broker {address} refuses the connection: {reason}" if reason.is_failure else ""
            if self._refusal:
                intake.problem("refused-by-broker", self._refusal)
            else:
                client.subscribe(self.layout.topic, _NO_QUALITY_OF_SERVICE)

        def subscribed(_: Any, __: Any, ___: Any, reasons: Any, ____: Any) -> None:
            for reason in reasons:
                if reason.is_failure:
                    intake.problem("refused-by-broker", f"the broker {address} refuses the topic {self.layout.topic}: {reason}")

        def lost(_: Any, __: Any, ___: Any, reason: Any, ____: Any) -> None:
            was_connected, self._is_connected = self._is_connected, False
            if was_connected and reason.is_failure:
                intake.problem("lost", f"the connection to the broker {address} is lost: {reason}")

        self._client.on_connect, self._client.on_subscribe, self._client.on_disconnect = connected, subscribed, lost
        self._client.on_message = lambda _, __, message: self._receive(intake, message.topic, bytes(message.payload))
        try:
            self._client.connect_async(self._host, self._port)
        except ValueError as problem:
            raise SourceError(f"broker {address}: {problem}") from problem
        self._client.loop_start()

    def _receive(self, intake: Intake, topic: str, payload: bytes) -> None:
        try:
            if len(payload) > _SIZE_MAX:
                raise ValueError(f"{len(payload)} bytes, expected at most {_SIZE_MAX}")
            read = json.loads(payload)
        except (ValueError, RecursionError) as problem:
            intake.problem("malformed", f"a message of {topic} cannot be read: {problem}")
            return
        poses, is_readable = [], read == []
        for one in read if isinstance(read, list) else [read]:
            try:
                pose = self.pose(topic, one)
            except (ValueError, OverflowError) as problem:
                # The other tags of the list count.
                intake.problem("malformed", f"a tag in a message of {topic} cannot be read: {problem}")
                continue
            is_readable = True
            if pose is not None:
                poses.append(pose)
        # A message of which nothing can be read does not say that no tag is there.
        if is_readable:
            intake.poses(poses)

    def pose(self, topic: str, message: Any) -> Pose | None:
        """The pose of one tag; `None` if it states that its position is unknown. Raises `ValueError`."""
        layout = self.layout
        if layout.success is not None and _found(topic, message, layout.success) is False:
            return None
        values = [_found(topic, message, path) for path in layout.position]
        x, y, z = (_number(path, value) for path, value in zip(layout.position, values, strict=True))
        seconds = None if layout.time_s is None else _found(topic, message, layout.time_s)
        rotation = None if layout.quaternion is None else _found(topic, message, layout.quaternion)
        if rotation is not None and not (isinstance(rotation, list) and len(rotation) == 4):
            raise ValueError(f"{layout.quaternion} = {rotation!r}: expected [w, x, y, z]")
        name = _found(topic, message, layout.id)
        if not isinstance(name, (str, int)):
            raise ValueError(f"{layout.id} = {name!r}: expected the name of the tag")
        at_ns = None
        if seconds is not None:
            number = _number(layout.time_s or "", seconds)
            if not math.isfinite(number):
                raise ValueError(f"{layout.time_s} = {seconds!r}: expected seconds since 1970")
            at_ns = round(1e9 * number)
        quaternion = None if rotation is None else [_number("quaternion", part) for part in rotation]
        return Pose(str(name), (x, y, z), quaternion, at_ns)

    def advice(self) -> str:
        """What to check while no data arrive."""
        if not self._is_connected:
            return self._refusal or f"no connection to the broker {self._host}:{self._port}"
        return "the broker answers; check the topic and that the tags are on"

    def close(self) -> None:
        """Ends the thread and the connection."""
        self._client.disconnect()
        self._client.loop_stop()


def _found(topic: str, message: Any, path: str) -> Any:
    """The value at a path, `None` if there is none."""
    if path.startswith("topic:"):
        levels, level = topic.split("/"), path.removeprefix("topic:")
        return levels[int(level)] if level.isdecimal() and int(level) < len(levels) else None
    value = message
    for step in path.split("."):
        if isinstance(value, dict):
            value = value.get(step)
        elif isinstance(value, list) and step.isdecimal() and int(step) < len(value):
            value = value[int(step)]
        else:
            return None
    return value


def _number(path: str, value: Any) -> float:
    """A number, or a text of one: some gateways write NaN as a text."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{path} = {value!r}: expected a number") from None


def address_of(broker: str) -> tuple[str, int | None]:
    """Host and port of a broker; `None` where the address has no port. Raises `SourceError`."""
    place = broker.removeprefix("mqtt://").removesuffix("/")
    # An IPv6 address without brackets has colons, and no port.
    if place.count(":") > 1 and not place.startswith("["):
        place = f"[{place}]"
    try:
        parts = urlsplit(f"//{place}")
        host, port, is_place = parts.hostname, parts.port, parts.netloc == place
    except ValueError:
        host, port, is_place = None, None, False
    if not host or port == 0 or not is_place or "@" in place or place.endswith(":"):
        raise SourceError(f'broker "{broker}": expected HOST, HOST:PORT with a port from 1 to 65535, or mqtt://HOST:PORT')
    return host, port


def layout_of(name: str, changes: Sequence[tuple[str, Any]]) -> Layout:
    """A layout with other parts. Raises `SourceError` for parts that are no layout."""
    fields = {**vars(LAYOUTS[name]), **dict(changes)}
    if len(fields["position"]) != 3:
        raise SourceError(f"{fields['position']}: expected the paths of x, y and z")
    return Layout(**fields)
