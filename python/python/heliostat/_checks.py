"""Checks of arguments, with the expected values in the message."""

from __future__ import annotations

import operator
from typing import Any

SEED_MAX = 2**64 - 1
"""Largest seed of a room."""

POINTS_MAX = 4_000_000
"""Most points of a map, as for `heliostat map`."""

STATES_MAX = 1_000_000
"""Most states of all seeds of a comparison."""


def integer(value: Any, name: str, first: int, last: int) -> int:
    """An integer of Python or NumPy from `first` to `last`; raises `ValueError` for any other value."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or not first <= number <= last:
        raise ValueError(f"{name} = {value!r}: expected an integer from {first} to {_text(last)}")
    return number


def seed_of(value: Any, name: str = "seed") -> int:
    """A seed of a room."""
    return integer(value, name, 0, SEED_MAX)


def states_of(states: Any, seeds: Any) -> tuple[int, int]:
    """The numbers of states for each seed, and of seeds, of a comparison."""
    checked = integer(states, "states", 1, STATES_MAX), integer(seeds, "seeds", 1, STATES_MAX)
    if checked[0] * checked[1] > STATES_MAX:
        raise ValueError(f"{checked[0]} states of {checked[1]} seeds: expected at most {STATES_MAX} together")
    return checked


def _text(number: int) -> str:
    return "2**64 - 1" if number == SEED_MAX else str(number)
