"""How the modules of this package that are programs end."""

from __future__ import annotations

import sys

USAGE = 2
"""Exit status for a command line that cannot be used, as of the Rust programs."""


def end_program(name: str, missing: ImportError) -> None:
    """Ends the module `name` with the reason in one line and exit status 1 if it is the program; else does nothing."""
    if name == "__main__":
        sys.exit(f"error: {missing}")
