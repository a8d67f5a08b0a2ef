"""Where a function that the package calls has failed."""

from __future__ import annotations

import json
from pathlib import Path

from heliostat._checks import finite
from heliostat._failure import place_of


def test_the_place_is_in_the_file_that_was_called_and_not_in_a_library() -> None:
    try:
        json.loads("{")
    except ValueError as problem:
        assert problem.__traceback__ is not None
        assert place_of(problem.__traceback__) == f" ({Path(__file__).name}:{problem.__traceback__.tb_lineno})"


def test_what_the_package_itself_raises_has_no_place() -> None:
    try:
        finite("seconds", "x", "a number")
    except ValueError as problem:
        assert problem.__traceback__ is not None
        assert place_of(problem.__traceback__.tb_next) == ""
    assert place_of(None) == ""
