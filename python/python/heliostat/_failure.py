"""Where a function that this package calls has failed."""

from __future__ import annotations

from pathlib import Path
from traceback import walk_tb
from types import TracebackType

_PACKAGE = Path(__file__).parent


def place_of(trace: TracebackType | None) -> str:
    """The last place in the file that the package has called, such as ` (my.py:12)`; empty where the package raised."""
    places = [(frame.f_code.co_filename, line) for frame, line in walk_tb(trace)]
    outside = [(file, line) for file, line in places if _PACKAGE not in Path(file).parents]
    if not outside:
        return ""
    called = outside[0][0]
    last = [line for file, line in outside if file == called][-1]
    return f" ({Path(called).name}:{last})"
