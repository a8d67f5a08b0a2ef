"""Frames of tracking systems: units, axes, rotations and offsets in the frame of a room."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

pytest.importorskip("zenoh")
from heliostat.track.frame import Frame, about_z, axes_matrix, quaternion_of, rotation_matrix


def turned(axis: int, angle: float) -> NDArray[np.float64]:
    """The matrix of a rotation about an axis, from its definition."""
    i, j = ((axis + 1) % 3, (axis + 2) % 3)
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = math.cos(angle)
    matrix[j, i], matrix[i, j] = math.sin(angle), -math.sin(angle)
    return matrix


def quaternions(count: int) -> NDArray[np.float64]:
    drawn = np.random.default_rng(7).normal(size=(count, 4))
    unit: NDArray[np.float64] = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
    return unit


def test_a_quaternion_turns_about_its_axis() -> None:
    for axis in range(3):
        for angle in (-3.0, -0.5, 0.0, 1.0, math.pi):
            half = [math.cos(angle / 2), 0.0, 0.0, 0.0]
            half[1 + axis] = math.sin(angle / 2)
            assert_allclose(rotation_matrix(half), turned(axis, angle), atol=1e-12)


def test_a_matrix_gives_its_quaternion_also_at_half_turns() -> None:
    half_turns = [(0.0, *axis) for axis in np.eye(3)]
    for quaternion in [*quaternions(200), *half_turns, (1.0, 0.0, 0.0, 0.0), (1e-9, 1.0, 0.0, 0.0)]:
        back = quaternion_of(rotation_matrix(quaternion))
        assert back[0] >= 0 and math.isclose(np.linalg.norm(back), 1.0, abs_tol=1e-12)
        assert_allclose(abs(np.dot(back, quaternion)), 1.0, atol=1e-12)


def test_y_up_in_millimetres_becomes_metres_with_z_up() -> None:
    frame = Frame("y-up", 0.001, origin_m=(0.5, 0.0, 0.0))
    assert_allclose(frame.position((1000.0, 850.0, -200.0)), (1.5, 0.2, 0.85))
    assert math.isclose(np.linalg.det(frame.matrix), 1.0), "a right-handed frame stays one"


def test_a_turned_system_keeps_distances_and_moves_its_origin() -> None:
    frame = Frame(rotation=about_z(math.pi / 2), origin_m=(1.0, 2.0, 0.0))
    assert_allclose(frame.position((3.0, 0.0, 0.5)), (1.0, 5.0, 0.5), atol=1e-12)
    assert_allclose(frame.position((0.0, 1.0, 0.0)), (0.0, 2.0, 0.0), atol=1e-12)


def test_the_offset_to_the_detector_turns_with_the_body() -> None:
    frame = Frame("y-up", 0.001)
    # The body is turned by 90 degrees about the vertical, y of the system: its x axis points along -z of it, y of the room.
    place = frame.position((0.0, 1000.0, 0.0), turned(1, math.pi / 2), (0.1, -0.05, 0.0))
    assert_allclose(place, (0.0, 0.1, 0.95), atol=1e-12)
    assert_allclose(frame.position((0.0, 1000.0, 0.0), None, (0.1, -0.05, 0.0)), (0.1, 0.0, 0.95), atol=1e-12)


@pytest.mark.parametrize("axes", ["z-up", "y-up", "y,-x,z", "x,z,y"])
def test_an_orientation_is_the_rotation_of_the_contract_in_every_convention_of_axes(axes: str) -> None:
    """CONTRACT.md, kind 18: a normal with the polar angle t and the azimuth a has the quaternion
    (cos(t/2), -sin(t/2) sin(a), sin(t/2) cos(a), 0)."""
    frame = Frame(axes, rotation=about_z(0.7))
    t, a = 0.4, 1.1
    expected = (math.cos(t / 2), -math.sin(t / 2) * math.sin(a), math.sin(t / 2) * math.cos(a), 0.0)
    to_room = frame.matrix
    # The system observes the same rotation of the body in its own axes.
    observed = to_room.T @ rotation_matrix(expected) @ to_room
    assert_allclose(frame.orientation(observed), expected, atol=1e-12)
    normal = rotation_matrix(frame.orientation(observed)) @ (0.0, 0.0, 1.0)
    assert_allclose(normal, (math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)), atol=1e-12)


def test_a_receiver_that_is_mounted_askew_is_upright_in_its_stated_orientation() -> None:
    frame = Frame("y-up")
    upright, lean = turned(0, 1.2) @ turned(2, -0.3), turned(2, 0.25)
    assert_allclose(frame.orientation(upright, upright), (1.0, 0.0, 0.0, 0.0), atol=1e-12)
    assert_allclose(frame.orientation(lean @ upright, upright), frame.orientation(lean), atol=1e-12)


def test_reversed_axes_alone_are_a_left_handed_system() -> None:
    assert math.isclose(np.linalg.det(axes_matrix("x,z,y")), -1.0)
    for text in ("x,y", "x,y,y", "x,y,w", "z up", "", "--x,y,z"):
        with pytest.raises(ValueError, match="axes"):
            axes_matrix(text)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (math.nan, 0, 0, 1), (1.0, 0.0, 0.0)])
def test_what_is_no_rotation_is_refused(quaternion: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="length 1"):
        rotation_matrix(quaternion)


def test_other_frames_name_the_flags_that_select_them() -> None:
    others = dict(Frame("z-up", 1.0).others())
    assert others["--unit mm"].unit_m == 0.001 and others["--axes y-up"].axes == "y-up"
    assert others["--unit mm --axes y-up"] == Frame("y-up", 0.001)
    assert Frame("z-up", 1.0) not in others.values()
