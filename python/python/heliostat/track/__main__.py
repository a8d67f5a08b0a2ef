"""Connects a tracking system to a room: reports its bodies as users.

    python -m heliostat.track ros2 --topic /helmet/pose --room studio --connect tcp/127.0.0.1:17711
    python -m heliostat.track mqtt --broker 192.168.1.5 --layout dwm1001 --user 4F2A=0 --connect tcp/127.0.0.1:17711
    python -m heliostat.track qtm --host 192.168.1.6 --axes y-up --origin=-1,0.5,0 --connect tcp/127.0.0.1:17711

Connect to the controller and to each viewer, since peers do not forward messages. Begin with --dry-run: it joins no room,
and prints where each user is. Positions in a room are in m, from the centre of the floor, with z up.

`@FILE` reads flags from a file, one on a line, such as --room=studio.
"""

from __future__ import annotations

import argparse
import importlib
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._program import USAGE, end_program

try:
    from ..peer import PeerError, Settings, add_arguments
    from .frame import AXES, UNITS_M, Frame, about_z
    from .users import CLOCKS, Report, Setup
except ImportError as missing:
    end_program(__name__, missing)
    raise

if TYPE_CHECKING:
    from .bridge import Source


def vector(text: str, length: int = 3) -> tuple[float, ...]:
    """Numbers with commas between them."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != length or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f'"{text}": expected {length} numbers with commas, such as 0.5,0,1.2')
    return numbers


def quaternion(text: str) -> tuple[float, ...]:
    """The parts of a quaternion."""
    return vector(text, 4)


def for_body(value: Callable[[str], Any]) -> Callable[[str], tuple[str, Any]]:
    """A value for one body, `NAME=VALUE`, or for all bodies, `VALUE`."""

    def read(text: str) -> tuple[str, Any]:
        name, _, rest = text.rpartition("=")
        return name, value(rest)

    return read


def user(text: str) -> tuple[str, int]:
    """The number of a user, `NAME=NUMBER`."""
    name, _, number = text.rpartition("=")
    if not name or not number.isdecimal():
        raise argparse.ArgumentTypeError(f'"{text}": expected NAME=NUMBER, such as helmet=0')
    return name, int(number)


def size(text: str) -> tuple[float, ...]:
    """The size of a room."""
    numbers = vector(text)
    if min(numbers) <= 0:
        raise argparse.ArgumentTypeError(f'"{text}": expected lengths above 0')
    return numbers


def _add_common(flags: argparse.ArgumentParser) -> None:
    flags.formatter_class = argparse.RawDescriptionHelpFormatter
    add_arguments(flags.add_argument_group("the room"))
    group = flags.add_argument_group("the frame of the tracking system")
    group.add_argument("--unit", choices=UNITS_M, help="unit of its positions [default: that of the system]")
    group.add_argument(
        "--axes", default="z-up", help=f"{', '.join(AXES)}, or its axes along x, y, z of the room, such as y,-x,z"
    )
    group.add_argument("--origin", metavar="X,Y,Z", type=vector, default=(0.0, 0.0, 0.0), help="its origin in the room in m")
    turn = group.add_mutually_exclusive_group()
    turn.add_argument("--turn-deg", metavar="A", type=float, default=0.0, help="its rotation about z of the room")
    turn.add_argument("--rotation", metavar="W,X,Y,Z", type=quaternion, help="its rotation as a quaternion")
    group.add_argument("--room-size", metavar="X,Y,Z", type=size, help="in m [default: as the controller announces]")
    group = flags.add_argument_group("bodies and users")
    group.add_argument(
        "--user", metavar="NAME=N", type=user, action="append", default=[], help="this body is user N (repeatable) "
        "[default: each body is a user, numbered in order of appearance]"
    )  # fmt: skip
    group.add_argument(
        "--offset", metavar="[NAME=]X,Y,Z", type=for_body(vector), action="append", default=[],
        help="from the tracked point to the detector, in m in the axes of the body (repeatable)",
    )  # fmt: skip
    group.add_argument(
        "--upright", metavar="[NAME=]W,X,Y,Z", type=for_body(quaternion), action="append", default=[],
        help="orientation that the system states while the receiver faces up (repeatable)",
    )  # fmt: skip
    group.add_argument("--no-orientation", action="store_true", help="report positions alone")
    group.add_argument("--min-rate-mbps", metavar="R", type=float, default=0.0, help="minimum rate of each user in Mbit/s")
    group.add_argument("--timeout-s", metavar="S", type=float, default=1.0, help="a body not seen for this time has left [1]")
    group = flags.add_argument_group("time")
    group.add_argument("--rate-hz", metavar="F", type=float, default=20.0, help="most reports a second; the newest count [20]")
    group.add_argument(
        "--clock", choices=CLOCKS, help="the time of a measurement: by the system in UTC, by the system with an estimated "
        "offset, or its arrival [default: what the system offers]"
    )  # fmt: skip
    group.add_argument("--clock-offset-ms", metavar="T", type=float, default=0.0, help="added to the time of each measurement")
    flags.add_argument("--dry-run", action="store_true", help="join no room; print where each user is, once a second")


def _ros2(flags: argparse.ArgumentParser) -> None:
    flags.add_argument("--topic", metavar="NAME", action="append", required=True, help="topic with poses (repeatable)")
    flags.add_argument("--ros", metavar="ENDPOINT", help="Zenoh router of ROS [default: tcp/localhost:7447]")
    flags.add_argument(
        "--domain", metavar="N", type=int, default=int(os.environ.get("ROS_DOMAIN_ID") or 0), help="[default: $ROS_DOMAIN_ID or 0]"
    )
    flags.add_argument("--frame-id", metavar="NAME", help="frame of the poses [default: that of the first pose]")
    flags.add_argument("--mirrors", metavar="NAMESPACE", default="heliostat", help="topics of the mirrors' angles [heliostat]")
    flags.add_argument("--no-mirrors", action="store_true", help="publish no angles of the mirrors")


def _open_ros2(given: argparse.Namespace) -> Source:
    module = importlib.import_module("heliostat.track.ros2")
    mirrors = None if given.no_mirrors or given.dry_run else given.mirrors
    router = given.ros or module.DEFAULT_ROUTER
    opened: Source = module.Ros2(given.topic, router, given.domain, given.frame_id, mirrors)
    return opened


def _mqtt(flags: argparse.ArgumentParser) -> None:
    flags.add_argument("--broker", metavar="HOST[:PORT]", required=True, help="address of the MQTT broker")
    flags.add_argument("--port", metavar="N", type=int, help="[default: 1883, with --broker-authority 8883]")
    flags.add_argument("--layout", choices=("plain", "dwm1001", "pozyx"), default="plain", help="layout of the messages [plain]")
    flags.add_argument("--topic", metavar="NAME", help="topic of the messages [default: that of the layout]")
    flags.add_argument("--id-at", metavar="PATH", help="where a message has the name of the tag, or topic:LEVEL")
    flags.add_argument("--position-at", metavar="PATH,PATH,PATH", help="where it has x, y and z, such as pos.0,pos.1,pos.2")
    flags.add_argument("--time-at", metavar="PATH", help="where it has the time in s since 1970")
    flags.add_argument("--quaternion-at", metavar="PATH", help="where it has the orientation [w, x, y, z]")
    flags.add_argument("--login", metavar="NAME", help="name at the broker; the password is in $HELIOSTAT_MQTT_PASSWORD")
    flags.add_argument("--broker-authority", metavar="FILE", type=Path, help="encrypt, and check the broker with these certificates")


def _open_mqtt(given: argparse.Namespace) -> Source:
    module = importlib.import_module("heliostat.track.mqtt")
    parts = {
        "topic": given.topic,
        "id": given.id_at,
        "position": None if given.position_at is None else tuple(given.position_at.split(",")),
        "time_s": given.time_at,
        "quaternion": given.quaternion_at,
        "unit": given.unit,
    }
    layout = module.layout_of(given.layout, [(name, part) for name, part in parts.items() if part is not None])
    login = None if given.login is None else (given.login, os.environ.get("HELIOSTAT_MQTT_PASSWORD", ""))
    opened: Source = module.Mqtt(given.broker, layout, port=given.port, login=login, authority=given.broker_authority)
    return opened


def _qtm(flags: argparse.ArgumentParser) -> None:
    flags.add_argument("--host", required=True, help="computer that runs Qualisys Track Manager")
    flags.add_argument("--port", metavar="N", type=int, default=22223, help="its port for little-endian numbers [22223]")


def _open_qtm(given: argparse.Namespace) -> Source:
    opened: Source = importlib.import_module("heliostat.track.qtm").Qtm(given.host, given.port)
    return opened


SOURCES: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None], Callable[[argparse.Namespace], Source]]] = {
    "ros2": ("topics of ROS 2 with poses, over Zenoh (rmw_zenoh)", _ros2, _open_ros2),
    "mqtt": ("tags that publish JSON over MQTT, such as UWB tags", _mqtt, _open_mqtt),
    "qtm": ("rigid bodies of Qualisys Track Manager", _qtm, _open_qtm),
}
"""The tracking systems by name: a description, their flags, and how they are opened."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    command = argparse.ArgumentParser(
        "python -m heliostat.track",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        fromfile_prefix_chars="@",
    )
    systems = command.add_subparsers(dest="system", metavar="SYSTEM", required=True)
    for name, (text, add, _) in SOURCES.items():
        flags = systems.add_parser(name, help=text, description=f"Reports {text}.", fromfile_prefix_chars="@")
        add(flags)
        _add_common(flags)
    return command


def setup_of(given: argparse.Namespace, source: Source) -> Setup:
    """The setup of the flags. Raises `ValueError` for values that are no setup."""
    rotation = given.rotation or about_z(math.radians(given.turn_deg))
    return Setup(
        frame=Frame(given.axes, UNITS_M[given.unit or source.unit], rotation, given.origin),
        numbers=dict(given.user),
        offsets_m=dict(given.offset),
        uprights=dict(given.upright),
        min_rate_bps=1e6 * given.min_rate_mbps,
        orientation=not given.no_orientation,
        clock=given.clock or source.clock,
        clock_offset_ns=round(1e6 * given.clock_offset_ms),
        rate_hz=given.rate_hz,
        timeout_s=given.timeout_s,
    )


class _Printed:
    """Prints the users of a report, at most once a second of reports."""

    def __init__(self) -> None:
        self._next_ns = 0

    def show(self, report: Report) -> None:
        if report.time_ns < self._next_ns:
            return
        self._next_ns = report.time_ns + 1_000_000_000
        turned = {one["user"]: one["quaternion"] for one in report.orientations}
        texts = []
        for one in report.users:
            x, y, z = one.position_m
            text = f"user {one.user} at ({x:.3f}, {y:.3f}, {z:.3f}) m"
            if one.user in turned:
                text += ", held (" + ", ".join(f"{part:.3f}" for part in turned[one.user]) + ")"
            texts.append(text)
        print("; ".join(texts) or "no user", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit status."""
    command = parser()
    given = command.parse_args(arguments)
    _, _, open_source = SOURCES[given.system]
    from .bridge import SourceError, run

    try:
        source = open_source(given)
        setup = setup_of(given, source)
        shown = _Printed().show if given.dry_run else None
        settings = None if given.dry_run else Settings.of(given)
        ended = run(source, setup, settings, room_m=given.room_size, seconds=given.seconds, show=shown)
    except (ImportError, SourceError, ValueError) as problem:
        print(f"error: {problem}", file=sys.stderr)
        return USAGE
    except PeerError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return problem.status
    found = ", ".join(f"{kind} {count}" for kind, count in sorted(ended.problems.items()))
    made = "made" if given.dry_run else "sent"
    print(f"reports {made}: {ended.reports}, poses: {ended.poses}" + (f", problems: {found}" if found else ""))
    return 0 if ended.reports else 1


if __name__ == "__main__":
    sys.exit(main())
