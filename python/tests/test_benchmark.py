"""The rooms in NumPy, to which speeds are compared, compute what the package computes."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import heliostat
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

import bounds
import installation
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


def test_each_part_of_the_results_page_stays_when_the_other_is_written(tmp_path: Path) -> None:
    page = tmp_path / "python.md"
    assert installation.kept(page) == []
    page.write_text("# Results\n\nrates\n", encoding="utf-8")
    for size in ("1.00", "2.00"):
        page.write_text(installation.replaced(page, [installation.HEADING, "", size]), encoding="utf-8")
        assert page.read_text(encoding="utf-8") == f"# Results\n\nrates\n\n## Installation\n\n{size}\n"
    assert installation.kept(page) == ["## Installation", "", "2.00"]


def test_each_bound_has_a_verdict() -> None:
    head, _, *rows = bounds.table({"Static": (1.023, 100.84), "Hall": (0.867, None), "Paper": (0.9, 11.0)})
    assert head == "| environment | bound | found | verdict |"
    assert [row.strip("| ").split(" | ")[2:] for row in rows] == [
        ["1.02", "met"],
        ["100.8", "met"],
        ["0.87", "not met"],
        ["0.90", "met"],
        ["11.0", "not met"],
    ]


def test_the_results_page_has_the_verdicts_of_its_figures() -> None:
    page = Path(__file__).parents[2] / "docs/results/python.md"
    if not page.exists():
        pytest.skip("the page is in the repository only")
    lines = page.read_text(encoding="utf-8").splitlines()
    tables = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    speeds = [cells for cells in tables if len(cells) == 11 and cells[0] in ("Static", "Hall", "Office", "Paper")]
    # Column 6 is the batch over one room in Rust, and the last one over NumPy.
    found = {cells[0]: (float(cells[6]), float(cells[10]) if cells[10] else None) for cells in speeds}
    # A figure is rounded, and its verdict is not that of the rounded one.
    stated = {tuple(cells[:3]) for cells in tables if cells[-1] in ("met", "not met")}
    assert len(found) == 4 and stated == {tuple(row.strip("| ").split(" | ")[:3]) for row in bounds.table(found)[2:]}


def test_the_row_of_a_wheel_has_its_size_and_that_of_its_files(tmp_path: Path) -> None:
    wheel = tmp_path / "own-1.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("own/part.py", b"0" * 2_500_000)
    assert installation.size(wheel) == "| `own-1.whl` | 0.00 | 2.50 |"
