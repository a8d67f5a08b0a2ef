"""The room in NumPy, to which speeds are compared, computes what the package computes."""

from __future__ import annotations

import sys
from pathlib import Path

import heliostat
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

from numpy_room import NumpyRoom


def test_the_room_in_numpy_has_the_rates_of_the_package() -> None:
    blockers = np.array([[0.5, 0.5, 0.2, 1.7], [-1.0, 1.0, 0.25, 1.7], [1.5, -1.0, 0.2, 2.5]])
    reference, room = NumpyRoom(blockers), heliostat.Room("paper")
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
