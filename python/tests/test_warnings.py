"""Warnings fail the tests of this package, but not those that an upstream package causes in its own code."""

from __future__ import annotations

import warnings

import pytest

UNRAISABLE = pytest.PytestUnraisableExceptionWarning


@pytest.mark.parametrize("category", [DeprecationWarning, ResourceWarning])
def test_a_warning_of_another_package_passes_and_one_of_this_package_fails(category: type[Warning]) -> None:
    for module in ("zenoh.session", "gymnasium.envs.registration", "socket"):
        warnings.warn_explicit("old", category, f"{module}.py", 1, module)
    for module in ("heliostat", "heliostat.envs", "test_envs", "room"):
        with pytest.raises(category, match="old"):
            warnings.warn_explicit("old", category, f"{module}.py", 1, module)


def test_an_exception_in_a_destructor_fails_where_this_package_is_in_its_trace() -> None:
    upstream = 'Exception ignored in: <socket>\n\nTraceback:\n  File "/venv/site-packages/zenoh/session.py", line 1'
    warnings.warn(UNRAISABLE(upstream), stacklevel=1)
    for file in ("/repo/python/python/heliostat/envs.py", "/venv/site-packages/heliostat/envs.py", "/repo/python/tests/room.py"):
        with pytest.raises(UNRAISABLE):
            warnings.warn(UNRAISABLE(upstream.replace("/venv/site-packages/zenoh/session.py", file)), stacklevel=1)


def test_other_warnings_fail() -> None:
    with pytest.raises(UserWarning, match="any"):
        warnings.warn_explicit("any", UserWarning, "session.py", 1, "zenoh.session")
