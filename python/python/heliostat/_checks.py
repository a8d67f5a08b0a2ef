"""Checks of arguments; a message has the name, the value and the expected values."""

from __future__ import annotations

import math
import operator
import sys
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

U32_MAX = 2**32 - 1
"""Largest number of 32 bits in a message."""

U64_MAX = 2**64 - 1
"""The same of 64 bits, and the largest seed of a room."""

POINTS_MAX = 4_000_000
"""Most points of a map, as for `heliostat-lab map`."""

STATES_MAX = 1_000_000
"""Most states of all seeds of a comparison."""

_CALLERS = {"heliostat", "gymnasium", "stable_baselines3"}
"""The packages that call this one on behalf of a user's code."""


def integer(name: str, value: Any, least: int, most: int) -> int:
    """An integer within bounds; raises `TypeError` for another type, booleans too, and `ValueError` outside the
    bounds."""
    expected = f"{name} = {value!r}: expected an integer from {least} to {_text(most)}"
    if isinstance(value, (bool, np.bool_)):
        raise TypeError(expected)
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(expected) from None
    if not least <= number <= most:
        raise ValueError(expected)
    return number


def seed_of(value: Any, name: str = "seed") -> int:
    """A seed of a room."""
    return integer(name, value, 0, U64_MAX)


def states_of(states: Any, seeds: Any) -> tuple[int, int]:
    """The numbers of states for each seed, and of seeds, of a comparison."""
    checked = integer("states", states, 1, STATES_MAX), integer("seeds", seeds, 1, STATES_MAX)
    if checked[0] * checked[1] > STATES_MAX:
        raise ValueError(f"{checked[0]} states of {checked[1]} seeds: expected at most {STATES_MAX} together")
    return checked


def finite(name: str, value: Any, expected: str, least: float = -math.inf) -> float:
    """A finite number from `least` as a float: an integer or a number of NumPy too, but no text and no boolean."""
    try:
        number = float("" if isinstance(value, (bool, np.bool_, str, bytes)) else value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} = {value!r}: expected {expected}") from None
    if not math.isfinite(number):
        raise ValueError(f"{name} = {value!r} is not finite: expected {expected}")
    if number < least:
        raise ValueError(f"{name} = {value!r}: expected {expected}")
    return number


def one_of(name: str, value: Any, known: Any) -> None:
    """Raises `ValueError` for a value that is none of the names of a `Literal` of `heliostat.names`."""
    if value not in get_args(known):
        expected = " or ".join(f'"{one}"' for one in get_args(known))
        raise ValueError(f"{name} = {value!r}: expected {expected}")


def function_of_observation(name: str, value: Any) -> None:
    """Raises `TypeError` for a value that cannot be called."""
    if not callable(value):
        raise TypeError(f"{name}: expected a function of an observation, found {type(value).__name__}")


def name_of(value: Any) -> str:
    """The name of a function, a class or a module in messages; that of the class for an object without one."""
    return str(getattr(value, "__name__", type(value).__name__))


def real(name: str, values: Any) -> NDArray[Any]:
    """An array of booleans, integers or real numbers; a complex number, a text or an object is refused."""
    try:
        array = np.asarray(values)
    except ValueError:
        kind = type(values).__name__
        hint = "; of several values, as `predict` of Stable-Baselines3 returns, give the first" if kind == "tuple" else ""
        raise ValueError(f"{name}: a {kind} of unequal parts, expected an array of real numbers{hint}") from None
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name}: dtype {array.dtype}, expected real numbers")
    return array


def printable(text: str) -> str:
    """A text of another process, made safe for a terminal: lines stay, other control characters become JSON escapes, as
    in the log of the Rust programs."""
    return "".join(one if one == "\n" or one.isprintable() else f"\\u{ord(one):04x}" for one in text)


def outer_level() -> int:
    """The `stacklevel` with which a warning of the calling function names the user's code."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in _CALLERS:
        level, frame = level + 1, frame.f_back
    return level


def _text(number: int) -> str:
    return "2**64 - 1" if number == U64_MAX else str(number)
