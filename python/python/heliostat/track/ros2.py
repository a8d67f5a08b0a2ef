"""Poses of ROS 2, without ROS: topics that `rmw_zenoh` publishes over Zenoh. It needs the extra `ros2`.

A message of a topic has the key `DOMAIN/TOPIC/TYPE/HASH`, with the type as declared in DDS and the RIHS01 hash of its
definition. The payload is CDR, and the attachment has sequence, time and publisher. Source: docs/design.md and
`attachment_helpers.cpp` of ros2/rmw_zenoh. Nodes with another middleware need the bridge zenoh-bridge-ros2dds.

The mirrors come back as `sensor_msgs/msg/JointState`, with joints `mirror_N_roll` and `mirror_N_yaw` in rad: commanded
angles, and measured ones where the hardware measures.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np
import zenoh
import zenoh.ext

from .._core import ARRAYS_MAX
from ..peer import open_session
from ..tracker import Tracker
from ..wire import KINDS, Refused, decode
from .bridge import Intake, Source, SourceError
from .users import Pose

try:
    from rosbags.typesys import Stores, get_typestore
except ImportError as problem:
    raise ImportError('the package rosbags is missing: pip install "heliostat[zenoh,ros2]"') from problem

DEFAULT_ROUTER = "tcp/localhost:7447"
"""The endpoint at which the router of `rmw_zenoh` listens."""

NO_HASH = "TypeHashNotSupported"
"""The hash in keys of ROS 2 Humble, which computes none."""

_JOINTS = "sensor_msgs/msg/JointState"
_GET_S = 0.5
_STORE = get_typestore(Stores.ROS2_JAZZY)


def _position(point: Any) -> tuple[float, float, float]:
    return (point.x, point.y, point.z)


def _rotation(quaternion: Any) -> tuple[float, float, float, float]:
    return (quaternion.w, quaternion.x, quaternion.y, quaternion.z)


def _of_pose(name: str, pose: Any, time_ns: int | None) -> Pose:
    return Pose(name, _position(pose.position), _rotation(pose.orientation), time_ns)


_READERS: dict[str, Callable[[str, Any, int | None], list[Pose]]] = {
    "geometry_msgs/msg/PoseStamped": lambda topic, message, at: [_of_pose(topic, message.pose, at)],
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda topic, message, at: [_of_pose(topic, message.pose.pose, at)],
    "geometry_msgs/msg/PointStamped": lambda topic, message, at: [Pose(topic, _position(message.point), None, at)],
    "geometry_msgs/msg/PoseArray": lambda topic, message, at: [
        _of_pose(f"{topic}[{index}]", pose, at) for index, pose in enumerate(message.poses)
    ],
}

TYPES = tuple(_READERS)
"""Types of messages with poses. A `PoseArray` is one body for each place in it, named `TOPIC[PLACE]`."""


def dds_name(type_name: str) -> str:
    """The name of a type as declared in DDS: `a/msg/B` is `a::msg::dds_::B_`."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def ros_name(dds: str) -> str:
    """The name of a type in ROS; a name that is not of ROS stays as it is."""
    parts = dds.split("::")
    return "/".join([*parts[:2], parts[3].removesuffix("_")]) if len(parts) == 4 and parts[2] == "dds_" else dds


def topic_key(domain: int, topic: str, type_name: str, type_hash: str) -> str:
    """The key of a topic; both parts of the type may be `*`."""
    return f"{domain}/{topic.strip('/')}/{type_name}/{type_hash}"


class Ros2(Source):
    """Topics of ROS 2 with poses.

    `router` is the endpoint of the Zenoh router of ROS. `frame_id` is the frame of the poses; without it the first one
    that arrives, since one transform fits one frame. `mirrors` is the namespace of the mirrors' joint states, `None`
    for none.
    """

    clock = "source"

    def __init__(
        self,
        topics: Sequence[str],
        router: str = DEFAULT_ROUTER,
        domain: int = 0,
        frame_id: str | None = None,
        mirrors: str | None = "heliostat",
    ) -> None:
        if not topics or any(not topic.strip("/") or set(topic) & set("*$?#") for topic in topics):
            raise SourceError(f"topics {list(topics)}: expected names such as /helmet/pose")
        self.name = f"{', '.join(topics)} at {router}"
        self._topics, self._router, self._domain = list(topics), router, domain
        self._frame_id, self._mirrors = frame_id, mirrors
        self._stop, self._is_open = threading.Event(), threading.Event()
        self._session: Any = None
        self._stack = ExitStack()
        self._thread: threading.Thread | None = None
        self._publishers: dict[str, _Publisher] = {}
        self._lock = threading.Lock()

    def start(self, intake: Intake) -> None:
        """Connects from a thread, and again and again until the router answers."""
        config = zenoh.Config()
        settings = {"mode": "client", "connect/endpoints": [self._router], "scouting/multicast/enabled": False}
        for key, value in {**settings, "connect/timeout_ms": 1000, "connect/exit_on_failure": True}.items():
            try:
                config.insert_json5(key, json.dumps(value))
            except zenoh.ZError as problem:
                raise SourceError(f'router "{self._router}": expected an endpoint such as {DEFAULT_ROUTER}') from problem
        self._thread = threading.Thread(target=self._connect, args=(config, intake), daemon=True)
        self._thread.start()

    def _connect(self, config: zenoh.Config, intake: Intake) -> None:
        session = open_session(config, self._stop)
        if session is None:
            return
        self._stack.enter_context(session)
        for topic in self._topics:
            key = topic_key(self._domain, topic, "*", "*")
            self._stack.enter_context(session.declare_subscriber(key, self._receive(topic, intake)))
        node = _token(session, self._domain, "NN", [])
        self._stack.enter_context(session.liveliness().declare_token(node))
        with self._lock:
            self._session = session
        self._is_open.set()

    def _receive(self, topic: str, intake: Intake) -> Callable[[Any], None]:
        name = "/" + topic.strip("/")

        def receive(sample: Any) -> None:
            dds, given_hash = str(sample.key_expr).rsplit("/", 2)[1:]
            type_name = ros_name(dds)
            if type_name not in _READERS:
                intake.problem("wrong-type", f"{name} has messages of {type_name}: expected {', '.join(TYPES)}")
                return
            if given_hash not in (NO_HASH, _STORE.hash_rihs01(type_name)):
                text = f"{name}: this {type_name} is not that of ROS 2 Jazzy ({given_hash}): expected the same definition"
                intake.problem("wrong-type", text)
                return
            try:
                message: Any = _STORE.deserialize_cdr(bytes(sample.payload), type_name)
                header = message.header
            except Exception as problem:  # rosbags states no exceptions; a payload comes from any process.
                intake.problem("malformed", f"{name}: a payload that is no {type_name}: {type(problem).__name__} {problem}")
                return
            if self._is_other_frame(header.frame_id):
                text = f'{name} has poses in the frame "{header.frame_id}": expected "{self._frame_id}" alone'
                intake.problem("other-frame", text)
                return
            stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
            intake.poses(_READERS[type_name](name, message, stamp_ns or None))

        return receive

    def _is_other_frame(self, frame_id: str) -> bool:
        with self._lock:
            if self._frame_id is None:
                self._frame_id = frame_id
            return self._frame_id != frame_id

    def advice(self) -> str:
        """The topics with poses that the router knows."""
        if not self._is_open.is_set():
            return f"no Zenoh router answers at {self._router}; ros2 run rmw_zenoh_cpp rmw_zenohd starts one"
        publishers = f"@ros2_lv/{self._domain}/*/*/*/MP/*/*/*/*/*/*/*"
        found = set()
        for reply in self._session.liveliness().get(publishers, timeout=_GET_S):
            if reply.ok is not None:
                topic, dds = str(reply.ok.key_expr).split("/")[9:11]
                if ros_name(dds) in _READERS:
                    found.add(topic.replace("%", "/"))
        known = f"topics with poses there: {', '.join(sorted(found))}" if found else "no topic there has poses"
        return f"{known} (domain {self._domain})"

    def follow(self, tracker: Tracker) -> None:
        """Publishes the angles of the mirrors as joint states."""
        if self._mirrors is None:
            return
        for array in range(ARRAYS_MAX):
            tracker.subscribe("telemetry", self._pass_on(array), array)

    def _pass_on(self, array: int) -> Callable[[bytes], None]:
        def pass_on(payload: bytes) -> None:
            if not self._is_open.is_set():
                return
            try:
                telemetry = decode(payload, KINDS["telemetry"])
            except Refused:
                return
            for kind in ("commanded", "measured"):
                angles = {axis: telemetry[f"{axis}_{kind}"] for axis in ("roll", "yaw")}
                if any(angles.values()):
                    self._publish_joints(f"{self._mirrors}/array_{array}/{kind}", angles, telemetry["stamp"]["time_ns"])

        return pass_on

    def _publish_joints(self, topic: str, angles: dict[str, list[float]], time_ns: int) -> None:
        with self._lock:
            if not self._is_open.is_set():
                return
            if topic not in self._publishers:
                self._publishers[topic] = _Publisher(self._session, self._domain, topic, _JOINTS, self._stack)
            self._publishers[topic].publish(joint_state(angles, time_ns))

    def close(self) -> None:
        """Closes the session."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        with self._lock:
            self._is_open.clear()
        # Without the lock: the session waits for callbacks, which take it.
        self._stack.close()


def joint_state(angles: dict[str, list[float]], time_ns: int) -> bytes:
    """The CDR payload of a `JointState` with the angles of each axis in rad, one for each mirror."""
    types = _STORE.types
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 1_000_000_000, nanosec=time_ns % 1_000_000_000)
    none = np.empty(0, np.float64)
    message = types[_JOINTS](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        name=[f"mirror_{index}_{axis}" for axis, values in angles.items() for index in range(len(values))],
        position=np.array([angle for values in angles.values() for angle in values], np.float64),
        velocity=none,
        effort=none,
    )
    return bytes(_STORE.serialize_cdr(message, _JOINTS))


_LIVELINESS = "@ros2_lv/{domain}/{zid}/0/{entity}/{kind}/%/%/{node}{rest}"
_DEFAULT_QUALITY = "::,10:,:,:,,"


def _token(session: Any, domain: int, kind: str, rest: Iterable[str], entity: int = 0) -> str:
    """The liveliness token by which the graph of ROS knows a node, or a publisher of it."""
    parts = "".join(f"/{part}" for part in rest)
    zid = str(session.info.zid())
    return _LIVELINESS.format(domain=domain, zid=zid, kind=kind, node="heliostat", rest=parts, entity=entity)


class _Publisher:
    """A publisher of ROS 2: its key, its token in the graph, and the attachment that subscribers expect."""

    def __init__(self, session: Any, domain: int, topic: str, type_name: str, stack: ExitStack) -> None:
        dds, type_hash = dds_name(type_name), _STORE.hash_rihs01(type_name)
        rest = ["%" + topic.replace("/", "%"), dds, type_hash, _DEFAULT_QUALITY]
        token = _token(session, domain, "MP", rest, entity=secrets.randbelow(2**31) + 1)
        stack.enter_context(session.liveliness().declare_token(token))
        self._publisher = stack.enter_context(session.declare_publisher(topic_key(domain, topic, dds, type_hash)))
        self._sequence, self._gid = 0, secrets.token_bytes(16)

    def publish(self, payload: bytes) -> None:
        self._sequence += 1
        self._publisher.put(payload, attachment=attachment(self._sequence, time.time_ns(), self._gid))


def attachment(sequence: int, time_ns: int, gid: bytes) -> Any:
    """The attachment of a message: sequence, time of the publication in ns, and identifier of the publisher."""
    return zenoh.ext.z_serialize((zenoh.ext.Int64(sequence), zenoh.ext.Int64(time_ns), gid))
