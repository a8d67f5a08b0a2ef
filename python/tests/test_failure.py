"""Where a function that the package calls has failed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from heliostat._checks import finite
from heliostat._failure import place_of


def test_the_place_is_in_the_file_that_was_called_and_not_in_a_library() -> None:
    with pytest.raises(ValueError) as raised:
        json.loads("{")
    assert place_of(raised.tb) == f" ({Path(__file__).name}:{raised.tb.tb_lineno})"


def test_what_the_package_itself_raises_has_no_place() -> None:
    with pytest.raises(ValueError, match="seconds") as raised:
        finite("seconds", "x", "a number")
    assert place_of(raised.tb.tb_next) == "" == place_of(None)
