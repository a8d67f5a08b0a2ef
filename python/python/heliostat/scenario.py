"""Scenarios: built-in ones by name, files by path, with overrides."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import TypeAlias

from ._core import Scenario

Value: TypeAlias = "bool | int | float | str | list[bool | int | float | str | list[float]]"
"""A value of a scenario's key."""

__all__ = ["Scenario", "Value", "load_scenario"]


def load_scenario(
    source: str | os.PathLike[str] | Scenario = "specular", overrides: Mapping[str, Value] | None = None
) -> Scenario:
    """The checked scenario of a built-in name or of a TOML file.

    `overrides` maps keys as "users.count" to values. Raises `ValueError` for an unknown name or key, and for a
    value outside its domain; the message states key, value and the expected values.
    """
    if isinstance(source, Scenario):
        if overrides:
            raise ValueError("overrides apply to a name or a file, not to a Scenario that is already checked")
        return source
    if overrides is not None and not isinstance(overrides, Mapping):
        raise TypeError(f"overrides = {overrides!r}: expected a dictionary from keys to values")
    return Scenario(os.fspath(source), [f"{key}={_toml(value)}" for key, value in (overrides or {}).items()])


def _toml(value: Value) -> str:
    """A value in TOML; JSON has the same form for booleans, numbers, strings and lists."""
    return json.dumps(value)
