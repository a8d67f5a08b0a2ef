"""A tracker in Python. Its users walk in circles: put the positions of your tracking system in `users_at`.

    pip install "./python[zenoh]"
    python3 examples/tracker.py --room demo --connect tcp/127.0.0.1:7447

Connect to the controller and to each viewer, since peers do not forward messages. User 1 leaves the room and enters it
again every 10 s.
"""
import math

from heliostat.tracker import User, main, parser


def users_at(seconds):
    """The users who are in the room now. A user keeps the number; the order of the list has no meaning."""
    for user in [0, 1, 2] if seconds % 10 < 5 else [0, 2]:
        angle = 0.3 * seconds + 2 * math.pi * user / 3
        velocity = (-0.3 * math.sin(angle), 0.3 * math.cos(angle))
        yield User(user, (math.cos(angle), math.sin(angle), 0.85), velocity, min_rate_bps=1e6)


if __name__ == "__main__":
    main(users_at, parser(__doc__).parse_args(), rate_hz=20)
