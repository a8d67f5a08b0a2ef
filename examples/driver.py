"""A mirror driver in Python. Its mirrors are lists of angles: put calls of your hardware in `turn` and `stop`.

    pip install "./python[zenoh]"
    python3 examples/driver.py --room demo --rows 4 --columns 6 --connect tcp/127.0.0.1:7447

docs/tutorials/own-driver.md explains it; --help lists the flags.
"""
import math

from heliostat.driver import Capabilities, Device, main, parser


class Mirrors(Device):
    """Mirrors that reach every angle at once."""

    def __init__(self, rows, columns):
        # As the default of `control.range_deg`, the largest angle that a controller commands.
        limits = (-math.pi / 2, math.pi / 2)
        self.capabilities = Capabilities("numbers", rows, columns, roll_rad=limits, yaw_rad=limits, park_after_ms=300)

    def turn(self, roll, yaw):
        self.roll, self.yaw = roll, yaw

    def stop(self):
        """They are at rest already."""


if __name__ == "__main__":
    flags = parser(__doc__)
    flags.add_argument("--rows", type=int, required=True)
    flags.add_argument("--columns", type=int, required=True)
    given = flags.parse_args()
    main(Mirrors(given.rows, given.columns), given)
