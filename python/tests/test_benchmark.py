"""The rooms in NumPy, to which speeds are compared, compute what the package computes."""

from __future__ import annotations

import sys
from pathlib import Path

import heliostat
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

from numpy_room import PaperRoom, StaticRoom


def test_the_papers_room_in_numpy_has_the_rates_of_the_package() -> None:
    blockers = np.array([[0.5, 0.5, 0.2, 1.7], [-1.0, 1.0, 0.25, 1.7], [1.5, -1.0, 0.2, 2.5]])
    reference, room = PaperRoom(blockers), heliostat.Room("paper")
    generator = np.random.default_rng(1)
    blocked = 0
    for _ in range(40):
        roll, yaw = generator.uniform(-0.5, 0.5, (2, 100))
        expected = room.link(reference.places, roll, yaw, blockers)
        assert reference.rates_bps(roll, yaw) * 1e-6 == pytest.approx(expected["rate_mbps"], rel=1e-9, abs=1e-12)
        blocked += int(expected["blocked"].sum())
        reference.walk(2.0)
    assert blocked > 5
    state, reward = reference.step(np.zeros(200))
    assert state.shape == (5 * 6 + 200,) and np.isfinite(reward)


def test_the_static_room_in_numpy_has_the_rates_and_the_steering_gains_of_the_package() -> None:
    reference, room = StaticRoom(np.array([[0.5, 0.5, 0.25, 1.75]])), heliostat.Room("specular")
    point = heliostat.Room("specular", {"led.points_per_side": 1})
    generator = np.random.default_rng(1)
    blocked, lit = 0, 0
    for index in range(20):
        # Aimed angles, on which most light depends, and others near them.
        roll, yaw = room.decode(reference.places, [1.0, 2.0, 0.5, 1.0, 1.0], reference.blockers)
        roll, yaw = np.array([roll, yaw]) + 0.02 * (index % 2) * generator.standard_normal((2, 100))
        expected = room.link(reference.places, roll, yaw, reference.blockers)
        assert reference.rates_bps(roll, yaw) * 1e-6 == pytest.approx(expected["rate_mbps"], rel=1e-9, abs=1e-12)
        steering = point.steering_gain(reference.places, reference.blockers)
        assert reference.steering() == pytest.approx(steering, rel=1e-9, abs=1e-18)
        blocked, lit = blocked + int(expected["blocked"].sum()), lit + int((expected["irs_gain"] > 0.0).sum())
        reference.walk(2.0)
        reference.block()
    assert blocked > 5 and lit > 30
    state, reward = reference.step(np.zeros(200))
    assert state.shape == (5 * 6 + 500 + 200,) and np.isfinite(reward)
