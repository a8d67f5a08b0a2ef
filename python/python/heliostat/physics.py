"""The physics of a room, its policies and its oracle as functions on arrays.

>>> import numpy as np
>>> room = Room("specular")
>>> users = np.array([[1.0, 0.5, 0.85], [-1.5, 1.0, 0.85]])
>>> roll, yaw = room.oracle(users)
>>> room.link(users, roll, yaw)["rate_mbps"].shape
(2,)
"""

from __future__ import annotations

import difflib
import importlib.util
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._checks import POINTS_MAX, finite, integer, outer_level, real
from ._core import Channel, Scenario, use_onnxruntime
from ._core import Policy as _Policy
from .names import Quantity
from .scenario import Value, bounds_of, load_scenario
from .tables import LinkResult

# The places of a map in parts of this size, since each place needs memory for each mirror.
_PLACES_AT_ONCE = 4096
# Users at a wall can be beyond it by rounding.
_ROUNDING_M = 1e-6
_ROUNDING_RAD = 1e-6
_UP = (0.0, 0.0, 1.0)

Angles = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Roll and yaw of each mirror in rad, each of shape (M,)."""


def _array(values: ArrayLike, name: str, dimensions: int) -> NDArray[np.float64]:
    array = np.ascontiguousarray(real(name, values), np.float64)
    if array.ndim != dimensions:
        raise ValueError(f"{name} has the shape {array.shape}, expected {dimensions} dimensions")
    return array


def _places(positions: ArrayLike, scenario: Scenario) -> NDArray[np.float64]:
    """Positions of users, (K, 3), which are in the room: on its floor, at most at its ceiling."""
    places = _array(positions, "positions", 2)
    if places.shape[1] != 3:
        return places  # The shape is refused with the other ones.
    low, high = np.array(bounds_of(scenario).position_m)
    # NaN, which is refused too, is in no comparison.
    outside = (places > high + _ROUNDING_M).any(axis=1) | (places < low - _ROUNDING_M).any(axis=1)
    if outside.any():
        user = int(outside.argmax())
        place = ", ".join(f"{part:g}" for part in places[user])
        bounds = ", ".join(f"{axis} from {low[i]:g} to {high[i]:g} m" for i, axis in enumerate("xyz"))
        raise ValueError(f"user {user} at ({place}) is outside the room: expected {bounds}")
    return places


def _angles(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Angles of the mirrors in rad, (M,): a mirror faces into the room."""
    angles = _array(values, name, 1)
    beyond = np.abs(angles) > np.pi / 2 + _ROUNDING_RAD
    if beyond.any():
        mirror = int(beyond.argmax())
        raise ValueError(f"{name} holds {angles[mirror]:g} at index {mirror}: expected radians from -pi/2 to pi/2")
    return angles


def _normals(values: ArrayLike | None, users: int, scenario: Scenario) -> NDArray[np.float64] | None:
    """Normals of the receivers, (K, 3), from one for each user or one for all; `None` where every receiver faces up."""
    if values is None:
        _warn_of_tilt(scenario)
        return None
    normals = np.ascontiguousarray(real("normals", values), np.float64)
    if normals.shape == (3,):
        return np.tile(normals, (users, 1))
    if normals.shape != (users, 3):
        raise ValueError(
            f"normals has the shape {normals.shape}, expected ({users}, 3), one vector for each user, or (3,), one for all"
        )
    return normals


def _warn_of_tilt(scenario: Scenario) -> None:
    if scenario.has_tilted_receivers:
        warnings.warn(
            "users.orientation tilts the receivers of this room, and normals is absent, so every receiver faces up: "
            'give normals, such as state()["normals"] of an environment, or [0, 0, 1] for receivers that face up',
            UserWarning,
            stacklevel=outer_level(),
        )


def _optional(values: ArrayLike | None, name: str, dimensions: int) -> NDArray[np.float64] | None:
    return None if values is None else _array(values, name, dimensions)


class Room:
    """The channel of a scenario's room.

    `positions` have the shape (K, 3) in m and are in the room; `blockers` (N, 4): x, y, radius and height of cylinders
    in m. `normals`, (K, 3) or (3,) for all users: the directions in which the receivers face, as vectors of any length; a
    receiver has the smallest rotation from upright. Receivers face up if it is absent, which warns with `UserWarning` where
    the users of the scenario hold theirs tilted.
    """

    def __init__(
        self, scenario: str | os.PathLike[str] | Scenario = "specular", overrides: Mapping[str, Value] | None = None
    ) -> None:
        self.scenario = load_scenario(scenario, overrides)
        self._channel = Channel(self.scenario)

    @property
    def mirrors(self) -> int:
        """Number of mirrors M."""
        return self._channel.mirrors

    @property
    def mirror_positions(self) -> NDArray[np.float64]:
        """Centres of the mirrors in m, (M, 3)."""
        return self._channel.mirror_positions

    def link(
        self,
        positions: ArrayLike,
        roll: ArrayLike,
        yaw: ArrayLike,
        blockers: ArrayLike | None = None,
        sharing: int | None = None,
        *,
        normals: ArrayLike | None = None,
    ) -> LinkResult:
        """Direct gain, gain over the mirrors, SINR (linear), rate, bit error rate and blockage of each user.

        `roll` and `yaw`, (M,), are in rad. `sharing`: the number of users that share the bandwidth; K if absent.
        """
        places = _places(positions, self.scenario)
        return self._channel.link(
            places,
            _angles(roll, "roll"),
            _angles(yaw, "yaw"),
            _optional(blockers, "blockers", 2),
            None if sharing is None else integer("sharing", sharing, 1, 2**31 - 1),
            _normals(normals, len(places), self.scenario),
        )

    def steering_gain(
        self, positions: ArrayLike, blockers: ArrayLike | None = None, *, normals: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """The gain of each mirror for each user if it were aimed at that user, (K, M)."""
        places = _places(positions, self.scenario)
        return self._channel.steering_gain(
            places, _optional(blockers, "blockers", 2), _normals(normals, len(places), self.scenario)
        )

    def decode(
        self,
        positions: ArrayLike,
        weights: ArrayLike,
        blockers: ArrayLike | None = None,
        *,
        normals: ArrayLike | None = None,
    ) -> Angles:
        """The angles that the decoder computes from one weight per user, (K,)."""
        places = _places(positions, self.scenario)
        return self._channel.decode(
            places,
            _array(weights, "weights", 1),
            _optional(blockers, "blockers", 2),
            _normals(normals, len(places), self.scenario),
        )

    def oracle(
        self,
        positions: ArrayLike,
        blockers: ArrayLike | None = None,
        min_rate_mbps: ArrayLike | None = None,
        *,
        normals: ArrayLike | None = None,
    ) -> Angles:
        """The angles of the oracle with minimum rates; those of the scenario if `min_rate_mbps` is absent."""
        places = _places(positions, self.scenario)
        return self._channel.oracle(
            places,
            _optional(blockers, "blockers", 2),
            _optional(min_rate_mbps, "min_rate_mbps", 1),
            _normals(normals, len(places), self.scenario),
        )


class Policy:
    """A policy of the controller by its name, or an actor from the path of its ONNX file.

    A learned policy by its name is the actor that is built in for the room, of training seed 1. A file runs on the engines
    of the controller, with equal angles: a chain of dense layers in Rust, another graph on ONNX Runtime, which
    `pip install onnxruntime` brings.
    """

    def __init__(
        self,
        name: str,
        scenario: str | os.PathLike[str] | Scenario = "specular",
        overrides: Mapping[str, Value] | None = None,
    ) -> None:
        self.name = name
        self.scenario = load_scenario(scenario, overrides)
        _find_onnxruntime()
        self._policy = _Policy(self.scenario, name)

    def act(
        self,
        positions: ArrayLike,
        blockers: ArrayLike | None = None,
        min_rate_mbps: ArrayLike | None = None,
        *,
        normals: ArrayLike | None = None,
    ) -> Angles:
        """The angles for users at these positions in the room, within the controller's range.

        `normals`: as for `Room`.
        """
        places = _places(positions, self.scenario)
        return self._policy.act(
            places,
            _optional(blockers, "blockers", 2),
            _optional(min_rate_mbps, "min_rate_mbps", 1),
            _normals(normals, len(places), self.scenario),
        )

    def answer(self, observation: ArrayLike) -> Angles:
        """The angles that a learned policy gives for a flat observation, without the controller's limits."""
        values = _array(observation, "observation", 1)
        if not np.isfinite(values).all():
            raise ValueError("observation holds NaN or infinity, expected finite numbers")
        return self._policy.answer(values.astype(np.float32))


def _find_onnxruntime() -> None:
    """Names the shared library of the package onnxruntime, which is not imported for it."""
    package = importlib.util.find_spec("onnxruntime")
    for folder in package.submodule_search_locations or [] if package else []:
        for library in sorted(Path(folder, "capi").glob("*onnxruntime.*")):
            if library.suffix == ".dll" or library.suffix == ".dylib" or ".so" in library.name:
                use_onnxruntime(str(library))


def decode(
    positions: ArrayLike,
    weights: ArrayLike,
    scenario: str | os.PathLike[str] | Scenario = "specular",
    blockers: ArrayLike | None = None,
    *,
    normals: ArrayLike | None = None,
) -> Angles:
    """The angles that the decoder computes from one weight per user; `Room.decode` for many calls."""
    return Room(scenario).decode(positions, weights, blockers, normals=normals)


def rate_map(
    room: Room,
    roll: ArrayLike,
    yaw: ArrayLike,
    *,
    step_m: float = 0.1,
    height_m: float = 0.85,
    blockers: ArrayLike | None = None,
    sharing: int = 1,
    quantity: Quantity = "rate_mbps",
    normals: ArrayLike | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[Any]]:
    """A quantity of `Room.link` over the floor: x of the columns, y of the rows, and the values (rows, columns).

    `blockers`: as for `Room.link`; nothing blocks the light if it is absent. `sharing`: the number of users that share the
    bandwidth; 1 gives the rate of a user alone in the room. `normals`: as for `Room`, for the places in the order of rows.
    """
    if not isinstance(room, Room):
        raise TypeError(f"room: expected a Room, found {type(room).__name__}")
    length_x, length_y, height = room.scenario.room_m
    expected = f"a number of metres from 0 to {height:g} in this room"
    height_m = finite("height_m", height_m, expected, 0.0)
    if height_m > height:
        raise ValueError(f"height_m = {height_m!r}: expected {expected}")
    longest = 2.0 * min(length_x, length_y)
    if not isinstance(step_m, (int, float, np.number)) or not 0.0 < step_m < longest:
        raise ValueError(f"step_m = {step_m!r}: expected a positive number of metres below {longest:g} in this room")
    points = length_x / step_m * (length_y / step_m)
    if points > POINTS_MAX:
        raise ValueError(f"step_m = {step_m}: {points:.3g} points in this room, expected at most {POINTS_MAX}")
    x = np.arange(-length_x / 2 + step_m / 2, length_x / 2, step_m)
    y = np.arange(-length_y / 2 + step_m / 2, length_y / 2, step_m)
    grid_x, grid_y = np.meshgrid(x, y)
    places = np.stack([grid_x.ravel(), grid_y.ravel(), np.full(grid_x.size, height_m)], axis=1)
    known = get_args(Quantity)
    if quantity not in known:
        similar = difflib.get_close_matches(str(quantity), known, 1)
        hint = f"; a similar name exists: {similar[0]}" if similar else ""
        raise ValueError(f"quantity = {quantity!r}: expected one of {', '.join(known)}{hint}")
    held = _normals(normals, len(places), room.scenario)
    if held is None:
        held = np.tile(_UP, (len(places), 1))
    parts = (slice(first, first + _PLACES_AT_ONCE) for first in range(0, len(places), _PLACES_AT_ONCE))
    values: list[Any] = [
        dict(room.link(places[part], roll, yaw, blockers, sharing, normals=held[part]))[quantity] for part in parts
    ]
    return x, y, np.concatenate(values).reshape(grid_x.shape)
