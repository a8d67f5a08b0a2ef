"""Checks of arguments; a message has the name, the value and the expected values."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray


def integer(name: str, value: Any, least: int, most: int) -> int:
    """An integer within bounds; raises `TypeError` for another type and `ValueError` outside the bounds."""
    expected = f"{name} = {value!r}: expected an integer from {least} to {most}"
    try:
        number = operator.index(value)
    except TypeError:
        raise TypeError(expected) from None
    if not least <= number <= most:
        raise ValueError(expected)
    return number


def real(name: str, values: Any) -> NDArray[Any]:
    """An array of booleans, integers or real numbers; a complex number, a text or an object is refused."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name}: dtype {array.dtype}, expected real numbers")
    return array
