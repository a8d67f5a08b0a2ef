"""Scenarios: built-in ones by name, files by path, with overrides."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ._core import Scenario

Value: TypeAlias = bool | int | float | str | os.PathLike[str] | Sequence[Any] | Mapping[str, Any]
"""A value of a scenario's key; a mapping is a table, and a path its text."""

__all__ = ["Bounds", "Scenario", "Value", "bounds_of", "load_scenario"]


def load_scenario(
    source: str | os.PathLike[str] | Scenario = "specular", overrides: Mapping[str, Value] | None = None
) -> Scenario:
    """The checked scenario of a built-in name or of a TOML file.

    `overrides` maps keys as "users.count" to values; a dictionary is a table of TOML, as in
    `{"users.mixture": [{"mobility": "seated", "count": 2}]}`. Raises `ValueError` for an unknown name or key, and for a
    value outside its domain; the message states key, value and the expected values.
    """
    if isinstance(source, Scenario):
        if overrides:
            raise ValueError("overrides apply to a name or a file, not to a Scenario that is already checked")
        return source
    return Scenario(os.fspath(source), override_texts({} if overrides is None else overrides))


@dataclass(frozen=True)
class Bounds:
    """The smallest and the largest values of a room."""

    roll_rad: tuple[float, float]
    """Roll of each mirror, to which the controller limits it."""
    yaw_rad: tuple[float, float]
    """Yaw of each mirror, to which the controller limits it."""
    position_m: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Position of a user: x, y and z."""


def bounds_of(
    scenario: str | os.PathLike[str] | Scenario = "specular", overrides: Mapping[str, Value] | None = None
) -> Bounds:
    """The bounds of mirrors and users in a scenario's room.

    >>> bounds_of("specular").position_m
    ((-2.5, -2.5, 0.0), (2.5, 2.5, 3.0))
    """
    checked = load_scenario(scenario, overrides)
    axis = (-checked.range_rad, checked.range_rad)
    x, y, height = checked.room_m
    return Bounds(axis, axis, ((-x / 2, -y / 2, 0.0), (x / 2, y / 2, height)))


def override_texts(overrides: Mapping[str, Value]) -> list[str]:
    """Overrides in the form `table.key=value` of the Rust programs."""
    if not isinstance(overrides, Mapping):
        raise TypeError(f'overrides: expected a mapping such as {{"users.count": 3}}, found {type(overrides).__name__}')
    return [f"{key}={_toml(key, value)}" for key, value in overrides.items()]


def _toml(key: str, value: Any) -> str:
    """A value in TOML: a dictionary is an inline table, and JSON has the same form for the others but `Infinity`."""
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, Mapping):
        entries = (f"{_text(key, name)} = {_toml(f'{key}.{name}', entry)}" for name, entry in value.items())
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml(key, entry) for entry in value)}]"
    if isinstance(value, (str, os.PathLike)):
        return _text(key, os.fspath(value))
    if isinstance(value, (bool, int, float)):
        return json.dumps(value).replace("Infinity", "inf").replace("NaN", "nan")
    raise TypeError(f"overrides: {key} is of the type {type(value).__name__}, expected a value of TOML")


def _text(key: str, text: Any) -> str:
    """A text in quotes."""
    if not isinstance(text, str):
        raise TypeError(f"overrides: {key} has a name of the type {type(text).__name__}, expected a text")
    # TOML has no surrogates, so JSON must not write characters as pairs of them.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
