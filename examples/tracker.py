"""A tracker in Python: it reports users who walk in circles. User 1 leaves the room and enters it again every 10 s.

    pip install eclipse-zenoh
    python3 examples/tracker.py ROOM tcp/127.0.0.1:7447[,ENDPOINT...] [SECONDS]

The endpoints are those of the controller and of each viewer, since peers do not forward messages. Replace
`users_at` with the positions of your tracking system. The bytes are those of CONTRACT.md, kind 1.
"""
import json
import math
import pathlib
import random
import signal
import sys
import time

import zenoh

CONTRACT = (pathlib.Path(__file__).parent.parent / "CONTRACT.md").read_text(encoding="utf-8")
exec(CONTRACT.split("```python\n")[1].split("```")[0])  # decode, encode, Refused
RATE_HZ = 20
USAGE = "usage: python3 examples/tracker.py ROOM ENDPOINT[,ENDPOINT...] [SECONDS]"


def users_at(seconds):
    """The users who are in the room now. A user keeps the number; its place in the list has no meaning."""
    present = [0, 1, 2] if seconds % 10 < 5 else [0, 2]
    angles = {user: 0.3 * seconds + 2 * math.pi * user / 3 for user in present}
    return [{"user": user, "position_m": [math.cos(angle), math.sin(angle), 0.85],
             "velocity_m_s": [-0.3 * math.sin(angle), 0.3 * math.cos(angle)], "min_rate_bps": 1e6}
            for user, angle in angles.items()]


def arguments(room, endpoints, seconds="1e9"):
    """The typed arguments of the command line; TypeError or ValueError for others."""
    return room, endpoints, float(seconds)


def main(room, endpoints, seconds):
    config = zenoh.Config()
    for key, value in {"mode": "peer", "connect/endpoints": endpoints.split(","), "listen/endpoints": [],
                       "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    source, base, tick, begin = random.getrandbits(63), "heliostat/v1/%s/" % room, 0, time.monotonic()
    # A shell starts background processes with Ctrl-C ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # `with` closes the session. A session that is not closed keeps the process alive after an error.
    with zenoh.open(config) as session:
        token = session.liveliness().declare_token(base + "alive/tracker/%016x" % source)
        reports = session.declare_publisher(base + "users", express=True, priority=zenoh.Priority.REAL_TIME,
                                            congestion_control=zenoh.CongestionControl.DROP)
        try:
            while time.monotonic() < begin + seconds:
                tick += 1
                stamp = {"source": source, "sequence": tick, "time_ns": time.time_ns()}
                users = users_at(time.monotonic() - begin)
                reports.put(encode({"stamp": stamp, "tick": tick, "users": users}, 1))
                time.sleep(max(0.0, begin + tick / RATE_HZ - time.monotonic()))
        except KeyboardInterrupt:
            pass
    print("reports sent: %d" % tick)


if __name__ == "__main__":
    try:
        given = arguments(*sys.argv[1:])
    except (TypeError, ValueError):
        print(USAGE, file=sys.stderr)
        sys.exit(2)
    main(*given)
