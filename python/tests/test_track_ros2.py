"""Poses of ROS 2 over Zenoh: an emulated node with the keys of rmw_zenoh, and payloads by an independent CDR library."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed")
pycdr2 = pytest.importorskip("pycdr2", reason="pycdr2 is not installed")
zenoh: Any = pytest.importorskip("zenoh")
from heliostat.track import ros2
from heliostat.track.bridge import SourceError
from room import free_endpoint, wait_until
from ros_messages import Header, JointState, OnePose, Point, PoseArray, PoseStamped, Quaternion, Time
from tracked import tracked


POSE_STAMPED = "geometry_msgs::msg::dds_::PoseStamped_/RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"


COUNTERS = ("accepted", "clipped", "late", "rejected", "old_epoch", "old_sequence", "expired", "stopped")
TELEMETRY = {
    **{name: 0 for name in ("state", "epoch", "applied_sequence", "answers", "received_ns", "applied_ns")},
    **{"calibration": 0, "faults": 0, "counters": dict.fromkeys(COUNTERS, 0), "temperature_c": None, "unusable": []},
    **{"roll_commanded": [0.125, -0.25], "yaw_commanded": [0.5, 0.0], "roll_measured": [0.0625, -0.125], "yaw_measured": []},
}


def header(frame_id: str = "map") -> Header:
    now = time.time_ns()
    return Header(Time(now // 10**9, now % 10**9), frame_id)


def pose(x: float, y: float, z: float, tilt: float = 0.0) -> OnePose:
    return OnePose(Point(x, y, z), Quaternion(0.0, math.sin(tilt / 2), 0.0, math.cos(tilt / 2)))


@contextmanager
def session(mode: str, **endpoints: str) -> Iterator[Any]:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for kind, endpoint in endpoints.items():
        config.insert_json5(f"{kind}/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as opened:
        yield opened


class Node:
    """A node of ROS 2 with one publisher, which publishes what `message` makes 50 times a second."""

    def __init__(self, opened: Any, key: str, topic: str) -> None:
        self.session, self.key = opened, key
        self.message: Any = None
        dds = "/".join(key.split("/")[-2:])
        zid = opened.info.zid()
        self.token = opened.liveliness().declare_token(f"@ros2_lv/0/{zid}/0/10/MP/%/%/camera/%{topic}/{dds}/::,7:,:,:,,")
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self) -> None:
        sequence_number = 0
        while not self.ended.wait(0.02):
            if self.message is not None:
                sequence_number += 1
                stamps = zenoh.ext.z_serialize((zenoh.ext.Int64(sequence_number), zenoh.ext.Int64(time.time_ns()), bytes(16)))
                self.session.put(self.key, self.message(), attachment=stamps)


@contextmanager
def node(endpoint: str, key: str, topic: str = "helmet") -> Iterator[Node]:
    """A router of ROS 2 at an endpoint, and a node that is a peer of it, as with the default files of rmw_zenoh."""
    with session("router", listen=endpoint), session("peer", connect=endpoint) as opened:
        one = Node(opened, key, topic)
        try:
            yield one
        finally:
            one.ended.set()
            one.thread.join()


def test_the_hashes_of_definitions_are_those_of_ros() -> None:
    """The hash of String is in the design document of rmw_zenoh, and that of PoseStamped is of ROS 2 Jazzy."""
    hash_of = ros2._STORE.hash_rihs01
    assert hash_of("std_msgs/msg/String") == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    dds, pose_hash = POSE_STAMPED.split("/")
    assert ros2.dds_name("geometry_msgs/msg/PoseStamped") == dds and hash_of("geometry_msgs/msg/PoseStamped") == pose_hash
    assert ros2.ros_name(dds) == "geometry_msgs/msg/PoseStamped" and ros2.ros_name("other") == "other"
    assert ros2.topic_key(2, "/robot1/chatter", "a", "b") == "2/robot1/chatter/a/b"


def test_poses_of_a_node_become_users_whom_a_controller_answers(tmp_path: Path) -> None:
    router = free_endpoint("tcp")
    flags = ("ros2", "--topic", "/helmet", "--ros", router, "--turn-deg", "90", "--origin", "0.5,0,0", "--offset=0,0,0.1")
    with node(router, f"0/helmet/{POSE_STAMPED}") as camera, tracked(tmp_path, *flags) as run:
        camera.message = lambda: PoseStamped(header(), pose(1.0, 0.5, 0.75, tilt=math.pi / 2)).serialize()
        # The body lies on its side: the offset along its z axis is along x of the system, y of the room.
        run.wait_for({0: [0.0, 1.1, 0.75]})
        age_ns = time.time_ns() - run.room.latest["users"]["stamp"]["time_ns"]
        assert 0 <= age_ns < 60 * 10**9, "the time is that of the header"
        wait_until("orientation", lambda: "orientation" in run.room.latest)
        (held,) = run.room.latest["orientation"]["users"]
        # A rotation by 90 degrees about y of the system, which is -x of the room.
        assert held["quaternion"] == pytest.approx([math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0], abs=1e-6)
        output, errors = run.end()
        assert output.startswith("reports sent: ") and "problems" not in output, (output, errors)


def test_an_array_of_poses_is_one_user_for_each_place(tmp_path: Path) -> None:
    router = free_endpoint("tcp")
    key = f"0/bodies/{ros2.dds_name('geometry_msgs/msg/PoseArray')}/{ros2._STORE.hash_rihs01('geometry_msgs/msg/PoseArray')}"
    flags = ("ros2", "--topic", "/bodies", "--ros", router, "--user", "/bodies[0]=4", "--user", "/bodies[1]=2", "--timeout-s", "0.3")
    with node(router, key, "bodies") as camera, tracked(tmp_path, *flags) as run:
        camera.message = lambda: PoseArray(header(), [pose(1.0, 0.0, 1.0), pose(-1.0, 0.5, 1.2)]).serialize()
        run.wait_for({4: [1.0, 0.0, 1.0], 2: [-1.0, 0.5, 1.2]})
        camera.message = lambda: PoseArray(header(), [pose(1.5, 0.0, 1.0)]).serialize()
        run.wait_for({4: [1.5, 0.0, 1.0]})
        camera.message = lambda: PoseArray(header(), []).serialize()
        run.wait_for({})
        run.end()


def test_what_is_wrong_with_a_topic_is_named(tmp_path: Path) -> None:
    router = free_endpoint("tcp")
    odometry = "nav_msgs::msg::dds_::Odometry_/RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    with tracked(tmp_path, "ros2", "--topic", "/helmet", "--ros", router) as run:
        wait_until("no router", lambda: "no Zenoh router answers" in run.problem())
        with node(router, f"0/odometry/{odometry}", "odometry"), session("peer", connect=router) as other:
            Node(other, f"0/cap/{POSE_STAMPED}", "cap")
            wait_until("the topics there", lambda: "topics with poses there: /cap (domain 0)" in run.problem())
            for wrong in (
                (f"0/helmet/{odometry}", b"", "/helmet has messages of nav_msgs/msg/Odometry: expected geometry_msgs"),
                (f"0/helmet/{POSE_STAMPED[:-4]}ffff", b"", "is not that of ROS 2 Jazzy"),
                (f"0/helmet/{POSE_STAMPED}", b"\x00\x01\x00\x00\x01", "a payload that is no geometry_msgs/msg/PoseStamped"),
                (f"0/helmet/{POSE_STAMPED}", PoseStamped(header(), pose(1500.0, 500.0, 850.0)).serialize(), "with --unit mm"),
                (f"0/helmet/{POSE_STAMPED}", PoseStamped(header(), pose(math.nan, 0.0, 1.0)).serialize(), "expected numbers"),
                (f"0/helmet/{POSE_STAMPED}", PoseStamped(header("odom"), pose(1.0, 0.0, 1.0)).serialize(), 'expected "map" alone'),
            ):
                key, payload, problem = wrong

                def is_named(key: str = key, payload: bytes = payload, problem: str = problem) -> bool:
                    other.put(key, payload)
                    return problem in run.problem()

                wait_until(problem, is_named)
            assert "users" not in run.room.latest
        run.process.terminate()
        output, _ = run.process.communicate()
        assert run.process.returncode == 1 and output.startswith("reports sent: 0, poses: "), output


def test_the_mirrors_come_back_as_joint_states(tmp_path: Path) -> None:
    router = free_endpoint("tcp")
    with node(router, f"0/helmet/{POSE_STAMPED}") as camera, tracked(tmp_path, "ros2", "--topic", "/helmet", "--ros", router) as run:
        camera.message = lambda: PoseStamped(header(), pose(1.0, 0.5, 0.85)).serialize()
        wait_until("report", lambda: bool(run.positions()))
        seen: dict[str, Any] = {}

        def note(sample: Any) -> None:
            stamps = zenoh.ext.z_deserialize(tuple[zenoh.ext.Int64, zenoh.ext.Int64, bytes], sample.attachment)
            seen[str(sample.key_expr)] = (JointState.deserialize(bytes(sample.payload)), stamps)

        dds = f"sensor_msgs::msg::dds_::JointState_/{ros2._STORE.hash_rihs01('sensor_msgs/msg/JointState')}"
        subscriber = camera.session.declare_subscriber(f"0/heliostat/**/{dds}", note)

        def are_there() -> bool:
            run.room.publish("telemetry", **TELEMETRY)
            return len(seen) == 2

        wait_until("joint states", are_there)
        commanded, (sequence_number, _, gid) = seen[f"0/heliostat/array_0/commanded/{dds}"]
        assert commanded.name == ["mirror_0_roll", "mirror_1_roll", "mirror_0_yaw", "mirror_1_yaw"]
        assert list(commanded.position) == [0.125, -0.25, 0.5, 0.0] and not commanded.velocity
        assert sequence_number >= 1 and len(gid) == 16
        measured, _ = seen[f"0/heliostat/array_0/measured/{dds}"]
        assert measured.name == ["mirror_0_roll", "mirror_1_roll"] and list(measured.position) == [0.0625, -0.125]
        tokens = [str(one.ok.key_expr) for one in camera.session.liveliness().get("@ros2_lv/0/**") if one.ok is not None]
        assert any("/MP/%/%/heliostat/%heliostat%array_0%commanded/sensor_msgs" in token for token in tokens), tokens
        subscriber.undeclare()


@pytest.mark.parametrize("topics", [[], ["/"], ["/bodies/*"], ["/a?b"]])
def test_names_that_are_no_topics_are_refused(topics: list[str]) -> None:
    with pytest.raises(SourceError, match="expected names such as"):
        ros2.Ros2(topics)
