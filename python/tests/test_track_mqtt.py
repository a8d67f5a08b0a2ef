"""Tags over MQTT: layouts of makers, and a real broker where mosquitto is installed."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

paho: Any = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
pytest.importorskip("zenoh")
from heliostat.track.bridge import SourceError
from heliostat.track.mqtt import LAYOUTS, Layout, Mqtt, address_of, layout_of
from heliostat.track.users import Pose
from room import free_endpoint, wait_until
from tracked import tracked

MOSQUITTO = shutil.which("mosquitto")
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="no MQTT broker in the path: apt-get install mosquitto")


@contextmanager
def broker(folder: Path, *more: str) -> Iterator[int]:
    """A broker at a port of this machine; a connection to it shows that it listens."""
    port = int(free_endpoint("tcp").rpartition(":")[2])
    file = folder / "mosquitto.conf"
    # A broker that root starts would change to a user who cannot read the folder of a test.
    lines = [f"listener {port} 127.0.0.1", "user root", *(more or ("allow_anonymous true",))]
    file.write_text("\n".join(lines), encoding="utf-8")

    def is_open() -> bool:
        with socket.socket() as one:
            return one.connect_ex(("127.0.0.1", port)) == 0

    with subprocess.Popen([str(MOSQUITTO), "-c", str(file)], stderr=subprocess.DEVNULL) as process:
        try:
            wait_until("broker", is_open)
            yield port
        finally:
            process.terminate()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("192.168.1.5", ("192.168.1.5", None)),
        ("broker.local:1884", ("broker.local", 1884)),
        ("mqtt://broker.local:1884/", ("broker.local", 1884)),
        ("[::1]:1884", ("::1", 1884)),
        ("fe80::7", ("fe80::7", None)),
    ],
)
def test_an_address_of_a_broker_may_have_a_port(text: str, expected: tuple[str, int | None]) -> None:
    assert address_of(text) == expected
    assert f"{expected[0]}:{expected[1] or 1883}" in Mqtt(text, LAYOUTS["plain"]).name


@pytest.mark.parametrize("text", ["", "broker:", "broker:0", "broker:mqtt", "broker:70000", "https://broker", "broker/topic", "[::1"])
def test_an_address_that_is_none_is_refused_with_the_forms(text: str) -> None:
    with pytest.raises(SourceError, match="expected HOST, HOST:PORT"):
        Mqtt(text, LAYOUTS["plain"])


def test_two_ports_of_a_broker_are_refused() -> None:
    with pytest.raises(SourceError, match="the port 1885 is given too"):
        Mqtt("broker:1884", LAYOUTS["plain"], port=1885)
    assert Mqtt("broker:1884", LAYOUTS["plain"], port=1884).name.endswith("broker:1884")


class Gateway:
    """Publishes 20 times a second what `messages` makes: pairs of a topic and a payload."""

    def __init__(self, port: int, login: tuple[str, str] | None = None) -> None:
        self.messages: Callable[[], list[tuple[str, Any]]] = list
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        if login:
            self.client.username_pw_set(*login)
        self.client.connect_async("127.0.0.1", port)
        self.client.loop_start()
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self) -> None:
        while not self.ended.wait(0.05):
            for topic, payload in self.messages():
                self.client.publish(topic, payload if isinstance(payload, (bytes, str)) else json.dumps(payload))

    def close(self) -> None:
        self.ended.set()
        self.thread.join()
        self.client.disconnect()
        self.client.loop_stop()


def dwm(x: Any, y: Any, z: Any) -> dict[str, Any]:
    return {"position": {"x": x, "y": y, "z": z, "quality": 71}, "superFrameNumber": 133}


def pozyx(tag: str, x: float, y: float, z: float, success: bool = True) -> dict[str, Any]:
    data = {"coordinates": {"x": x, "y": y, "z": z}} if success else {}
    return {"version": "1", "tagId": tag, "success": success, "timestamp": time.time(), "data": data}


@needs_broker
def test_uwb_tags_become_users_whom_a_controller_answers(tmp_path: Path) -> None:
    with broker(tmp_path) as port, closing(Gateway(port)) as tags:
        flags = ("mqtt", "--broker", "127.0.0.1", "--port", str(port), "--layout", "dwm1001", "--origin=-2,-2,0")
        with tracked(tmp_path, *flags, "--user", "4F2A=0", "--user", "11CC=1", "--timeout-s", "0.4") as run:
            both = [("dwm/node/4F2A/uplink/location", dwm(3.0, 2.5, 0.85)), ("dwm/node/11CC/uplink/location", dwm(1.0, 1.0, 1.2))]
            tags.messages = lambda: [*both, ("dwm/node/4F2A/uplink/status", {"present": True})]
            run.wait_for({0: [1.0, 0.5, 0.85], 1: [-1.0, -1.0, 1.2]})
            assert "orientation" not in run.room.latest
            # A tag that the anchors lose: the gateway writes NaN as a text.
            tags.messages = lambda: [both[0], (both[1][0], dwm("NaN", "NaN", "NaN"))]
            run.wait_for({0: [1.0, 0.5, 0.85]})
            wait_until("named NaN", lambda: '"11CC" has the position (nan, nan, nan): expected numbers' in run.problem())
            output, _ = run.end()
        assert "not-finite" in output


@needs_broker
def test_the_clock_of_tags_is_used_and_lost_positions_leave(tmp_path: Path) -> None:
    with broker(tmp_path) as port, closing(Gateway(port)) as tags:
        with tracked(tmp_path, "mqtt", "--broker", "127.0.0.1", "--port", str(port), "--layout", "pozyx", "--timeout-s", "0.4") as run:
            tags.messages = lambda: [("tags", [pozyx("26895", 1000.0, -500.0, 850.0), pozyx("26896", 0.0, 0.0, 1000.0)])]
            run.wait_for({0: [1.0, -0.5, 0.85], 1: [0.0, 0.0, 1.0]})
            tags.messages = lambda: [("tags", [pozyx("26895", 1000.0, -500.0, 850.0), pozyx("26896", 0, 0, 0, success=False)])]
            run.wait_for({0: [1.0, -0.5, 0.85]})
            run.end()


@needs_broker
def test_a_broker_with_passwords_and_messages_that_cannot_be_read_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    passwords = tmp_path / "passwords"
    shutil.which("mosquitto_passwd") or pytest.skip("no mosquitto_passwd")
    subprocess.run(["mosquitto_passwd", "-b", "-c", str(passwords), "ann", "right"], check=True, capture_output=True)
    passwords.chmod(0o644)
    monkeypatch.setenv("HELIOSTAT_MQTT_PASSWORD", "wrong")
    with broker(tmp_path, "allow_anonymous false", f"password_file {passwords}") as port:
        flags = ("mqtt", "--broker", "127.0.0.1", "--port", str(port), "--login", "ann")
        with tracked(tmp_path, *flags) as run:
            wait_until("refusal", lambda: "refuses the connection: Not authorized" in run.problem())
        monkeypatch.setenv("HELIOSTAT_MQTT_PASSWORD", "right")
        with closing(Gateway(port, ("ann", "right"))) as tags, tracked(tmp_path, *flags) as run:
            wait_until("silence", lambda: "the broker answers; check the topic" in run.problem())
            for payload, problem in (("{", "cannot be read: Expecting"), ({"id": "a", "x": 1}, "y = None: expected a number")):
                tags.messages = lambda payload=payload: [("heliostat/tags/a", payload)]  # type: ignore[misc]
                wait_until(problem, lambda problem=problem: problem in run.problem())  # type: ignore[misc]
            tags.messages = lambda: [("heliostat/tags/a", {"id": "a", "x": 1.0, "y": 0.5, "z": 0.85, "quaternion": [1, 0, 0, 0]})]
            run.wait_for({0: [1.0, 0.5, 0.85]})
            wait_until("orientation", lambda: "orientation" in run.room.latest)
            run.end()


def test_a_broker_that_is_absent_is_named(tmp_path: Path) -> None:
    port = free_endpoint("tcp").rpartition(":")[2]
    with tracked(tmp_path, "mqtt", "--broker", "127.0.0.1", "--port", port) as run:
        wait_until("no broker", lambda: f"no connection to the broker 127.0.0.1:{port}" in run.problem())


@pytest.mark.parametrize(
    ("layout", "topic", "message", "pose"),
    [
        ("plain", "t", {"id": 5, "x": 1, "y": "2.5", "z": 0, "time_s": 2.5}, Pose("5", (1.0, 2.5, 0.0), None, 2_500_000_000)),
        ("plain", "t", {"id": "a", "x": 1, "y": 2, "z": 3, "quaternion": [1, 0, 0, 0]}, Pose("a", (1.0, 2.0, 3.0), [1.0, 0.0, 0.0, 0.0])),
        ("dwm1001", "dwm/node/0f07/uplink/location", dwm(1, 2, 3), Pose("0f07", (1.0, 2.0, 3.0))),
        ("pozyx", "tags", {"tagId": "7", "success": False, "data": {}}, None),
    ],
)
def test_a_layout_finds_name_position_time_and_orientation(layout: str, topic: str, message: Any, pose: Pose | None) -> None:
    assert Mqtt("127.0.0.1", LAYOUTS[layout]).pose(topic, message) == pose


def test_a_tag_that_cannot_be_read_leaves_the_others_of_its_list() -> None:
    problems: list[str] = []
    taken: list[list[str]] = []

    class Taken:
        def problem(self, kind: str, text: str) -> None:
            problems.append(f"{kind}: {text}")

        def poses(self, poses: Sequence[Pose]) -> None:
            taken.append([pose.name for pose in poses])

    source = Mqtt("127.0.0.1", LAYOUTS["pozyx"])
    good, bad = pozyx("a", 1000.0, 0.0, 850.0), {"tagId": "b", "success": True, "timestamp": 1.0, "data": {}}
    for message in ([bad, good], [bad], [], [pozyx("c", 0, 0, 0, success=False)]):
        source._receive(Taken(), "tags", json.dumps(message).encode())  # type: ignore[arg-type]
    assert taken == [["a"], [], []], "a list of which nothing can be read is no list without tags"
    assert len(problems) == 2 and all("malformed: a tag in a message of tags" in one for one in problems)


def test_an_own_layout_names_paths() -> None:
    changes = [("id", "topic:1"), ("position", ("p.0", "p.1", "p.2")), ("time_s", "at"), ("unit", "cm")]
    own = layout_of("plain", changes)
    assert Mqtt("127.0.0.1", own).pose("tags/9", {"p": [1, 2, 3], "at": 1}) == Pose("9", (1.0, 2.0, 3.0), None, 1_000_000_000)
    with pytest.raises(SourceError, match="paths of x, y and z"):
        layout_of("plain", [("position", ("x", "y"))])


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({"id": "a", "x": True, "y": 0, "z": 0}, "x = True: expected a number"),
        ({"id": "a", "x": 10**400, "y": 0, "z": 0}, "expected a number"),
        ({"id": None, "x": 0, "y": 0, "z": 0}, "expected the name of the tag"),
        ({"id": "a", "x": 0, "y": 0, "z": 0, "time_s": "NaN"}, "expected seconds since 1970"),
        ({"id": "a", "x": 0, "y": 0, "z": 0, "quaternion": [1, 0]}, "expected \\[w, x, y, z\\]"),
        ("text", "expected a number"),
        ([], "expected a number"),
    ],
)
def test_messages_that_have_no_pose_are_refused_with_the_part(message: Any, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Mqtt("127.0.0.1", LAYOUTS["plain"]).pose("heliostat/tags/a", message)


def test_certificates_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="expected a file of certificates"):
        Mqtt("127.0.0.1", Layout("t", "id", ("x", "y", "z")), authority=tmp_path / "absent.pem")
