"""Scenarios: built-in ones by name, files by path, with overrides."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

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
    given = {} if overrides is None else overrides
    if not isinstance(given, Mapping):
        raise TypeError(f'overrides: expected a mapping such as {{"users.count": 3}}, found {type(given).__name__}')
    return Scenario(os.fspath(source), [f"{key}={_toml(key, value)}" for key, value in given.items()])


def _toml(key: str, value: Value) -> str:
    """A value in TOML; JSON has the same form for booleans, numbers, strings and lists."""

    def plain(other: Any) -> Any:
        if isinstance(other, (np.generic, np.ndarray)):
            return other.tolist()
        raise TypeError(f"overrides: {key} is of the type {type(other).__name__}, expected a value of TOML")

    return json.dumps(value, default=plain)
