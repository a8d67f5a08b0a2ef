"""The wheel of programs that are built already."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACK = Path(__file__).parents[1] / "pack-programs"
NAMES = ["heliostat", "heliostat-lab"]

pytestmark = pytest.mark.skipif(not shutil.which("maturin"), reason="maturin is not on the path")


def pack(programs: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs pack-programs at a fixed date."""
    environment = os.environ | {"SOURCE_DATE_EPOCH": "1700000000"}
    command = [sys.executable, str(PACK), str(programs), str(folder)]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def write_programs(folder: Path, names: list[str]) -> Path:
    """Programs that print their names."""
    folder.mkdir()
    for name in names:
        (folder / name).write_text(f"#!/bin/sh\necho this is {name}\n")
    return folder


def test_pip_installs_both_programs_of_a_folder_from_the_wheel(tmp_path: Path) -> None:
    result = pack(write_programs(tmp_path / "programs", NAMES), tmp_path / "wheels")
    assert result.returncode == 0, result.stderr
    (wheel,) = (tmp_path / "wheels").iterdir()
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "venv")], check=True)
    pip = [str(tmp_path / "venv/bin/pip"), "install", "--quiet", "--no-index", "--no-deps", str(wheel)]
    subprocess.run(pip, check=True)
    for name in NAMES:
        output = subprocess.run([str(tmp_path / "venv/bin" / name)], capture_output=True, text=True, check=True)
        assert output.stdout == f"this is {name}\n"


def test_two_wheels_of_the_same_programs_are_equal(tmp_path: Path) -> None:
    programs = write_programs(tmp_path / "programs", NAMES)
    for folder in ["first", "second"]:
        assert pack(programs, tmp_path / folder).returncode == 0
    first, second = (next((tmp_path / folder).iterdir()).read_bytes() for folder in ["first", "second"])
    assert first == second


def test_a_folder_without_one_of_the_programs_is_refused_by_its_name(tmp_path: Path) -> None:
    result = pack(write_programs(tmp_path / "programs", NAMES[:1]), tmp_path / "wheels")
    assert result.returncode == 1
    assert "has no heliostat-lab; expected heliostat and heliostat-lab" in result.stderr
    assert not (tmp_path / "wheels").exists()
