"""The frame of a tracking system, and its transform into the frame of a room.

>>> from heliostat.track.frame import Frame
>>> Frame(axes="y-up", unit_m=0.001, origin_m=(0.5, 0.0, 0.0)).position((1000.0, 850.0, -200.0)).tolist()
[1.5, 0.2, 0.85]

A position p in the unit and the axes of the system is at t + R A s p in the room, with the unit s in m, the axes A, the
rotation R and the origin t. A quaternion is (w, x, y, z).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

UNITS_M = {"m": 1.0, "mm": 0.001, "cm": 0.01, "in": 0.0254, "ft": 0.3048}
"""Units of length by name, in m."""

AXES = {"z-up": "x,y,z", "y-up": "x,-z,y"}
"""Conventions of axes by name: the axis of the system along x, y and z of the room."""

IDENTITY = (1.0, 0.0, 0.0, 0.0)
"""The quaternion of no rotation."""

LENGTH_TOLERANCE = 0.05
"""Largest deviation of the length of a quaternion from 1, far beyond the rounding of any tracking system."""


def axes_matrix(text: str) -> NDArray[np.float64]:
    """The matrix A of a convention of `AXES`, or of three signed axes such as `y,-x,z`.

    An axis that is reversed alone gives a mirror image: the frame of the system is then left-handed. Raises
    `ValueError` for another text.
    """
    matrix = np.zeros((3, 3))
    names = [name.strip() for name in AXES.get(text, text).split(",")]
    if sorted(name.removeprefix("-") for name in names) != ["x", "y", "z"]:
        raise ValueError(f'axes "{text}": expected {", ".join(AXES)}, or three axes such as y,-x,z')
    for row, name in enumerate(names):
        matrix[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return matrix


def rotation_matrix(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """The rotation matrix of a quaternion, which is scaled to length 1.

    Raises `ValueError` for a number that is not finite, and for a length beyond `LENGTH_TOLERANCE`.
    """
    length = math.sqrt(sum(part * part for part in quaternion)) if len(quaternion) == 4 else math.nan
    if not abs(length - 1.0) <= LENGTH_TOLERANCE:
        raise ValueError(f"quaternion {tuple(quaternion)}: expected w, x, y, z of length 1")
    w, x, y, z = (part / length for part in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(matrix: ArrayLike) -> tuple[float, float, float, float]:
    """The quaternion of a rotation matrix, with w not negative.

    The largest component comes from the diagonal and the others from sums and differences, so that no division is by a
    small number. Source: Shepperd, Quaternion from rotation matrix, J. Guidance and Control 1 (1978).
    """
    m = np.asarray(matrix, np.float64)
    squares = np.array([np.trace(m), *np.diag(m)])
    most = int(np.argmax(squares))
    if most == 0:
        parts = [1 + squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    else:
        i, j, k = ((most - 1 + step) % 3 for step in range(3))
        parts = [m[k, j] - m[j, k], 0.0, 0.0, 0.0]
        parts[1 + i] = 1 + m[i, i] - m[j, j] - m[k, k]
        parts[1 + j], parts[1 + k] = m[j, i] + m[i, j], m[k, i] + m[i, k]
    quaternion = np.array(parts) / np.linalg.norm(parts) * (-1.0 if parts[0] < 0 else 1.0)
    return tuple(quaternion.tolist())


def about_z(angle_rad: float) -> tuple[float, float, float, float]:
    """The quaternion of a rotation about z."""
    return (math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2))


@dataclass(frozen=True)
class Frame:
    """The frame of a tracking system in the room.

    `axes` is a convention of `AXES`, or three signed axes. `unit_m` is the unit of positions in m. `rotation` turns the
    axes of the system, in that convention, into those of the room. `origin_m` is the origin of the system in the room.
    Raises `ValueError` for values that are no frame.
    """

    axes: str = "z-up"
    unit_m: float = 1.0
    rotation: tuple[float, float, float, float] = IDENTITY
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        axes_matrix(self.axes)
        rotation_matrix(self.rotation)
        if not (math.isfinite(self.unit_m) and self.unit_m > 0 and all(map(math.isfinite, self.origin_m))):
            raise ValueError(f"unit {self.unit_m} m, origin {self.origin_m}: expected finite numbers, and a unit above 0")

    @cached_property
    def matrix(self) -> NDArray[np.float64]:
        """R A, from the axes of the system to those of the room."""
        return rotation_matrix(self.rotation) @ axes_matrix(self.axes)

    def position(
        self,
        position: Sequence[float],
        rotation: NDArray[np.float64] | None = None,
        offset_m: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> NDArray[np.float64]:
        """A position in the room, in m.

        `offset_m` leads from the tracked point to the detector in the axes of the body, whose rotation in the frame of
        the system is `rotation`; without a rotation the body stands as the axes of the system do.
        """
        turned = np.asarray(offset_m) if rotation is None else rotation @ offset_m
        return np.asarray(self.origin_m) + self.matrix @ (self.unit_m * np.asarray(position) + turned)

    def orientation(
        self, rotation: NDArray[np.float64], upright: NDArray[np.float64] | None = None
    ) -> tuple[float, float, float, float]:
        """The quaternion of a receiver in the room: from the upright receiver to the receiver as it is held.

        `upright` is the rotation that the system reports while the receiver faces up; without it the receiver faces up
        when the axes of the body are those of the system.
        """
        turn = rotation if upright is None else rotation @ upright.T
        matrix = self.matrix
        return quaternion_of(matrix @ turn @ matrix.T)

    def others(self) -> Iterator[tuple[str, Frame]]:
        """This frame with other axes, another unit, or both, each with the flags that select it; the likely ones first."""
        axes = [(f"--axes {name}", name) for name in AXES if name != self.axes]
        units = [(f"--unit {name}", unit_m) for name, unit_m in UNITS_M.items() if unit_m != self.unit_m]
        for flag, name in axes:
            yield flag, replace(self, axes=name)
        for flag, unit_m in units:
            yield flag, replace(self, unit_m=unit_m)
        for of_unit, unit_m in units:
            for of_axes, name in axes:
                yield f"{of_unit} {of_axes}", replace(self, axes=name, unit_m=unit_m)
