"""`python -m heliostat` starts nothing: it says which package has the programs, and which modules are programs."""

from __future__ import annotations

import sys

from ._program import USAGE

ADVICE = (
    "error: python -m heliostat starts nothing: the package heliostat-cli has the programs heliostat and heliostat-lab; "
    "this package has python -m heliostat.track and python -m heliostat.dynamixel (--help lists their flags)"
)
"""What to start instead, in one line."""


def main() -> int:
    """Prints the advice; returns the exit status."""
    print(ADVICE, file=sys.stderr)
    return USAGE


if __name__ == "__main__":
    sys.exit(main())
