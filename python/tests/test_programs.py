"""What `python -m` says where it starts nothing, and where an extra of the package is missing."""

from __future__ import annotations

from pathlib import Path

import pytest
from heliostat.__main__ import ADVICE
from room import LIMIT_S, python


def ended(*arguments: str | Path, folder: Path) -> tuple[int, str, str]:
    """The exit status, the output and the errors of a script."""
    with python(*arguments, folder=folder) as process:
        output, errors = process.communicate(timeout=LIMIT_S)
    return process.returncode, output, errors


def test_the_package_is_no_program_and_says_in_one_line_what_to_start(tmp_path: Path) -> None:
    status, output, errors = ended("-m", "heliostat", "--help", folder=tmp_path)
    assert (status, output, errors) == (2, "", f"{ADVICE}\n")
    assert "heliostat-cli" in ADVICE and "\n" not in ADVICE


def without(hidden: str, module: str, folder: Path) -> tuple[int, str, str]:
    """The end of a module that is started as a program, where another one cannot be imported."""
    script = folder / "without.py"
    script.write_text(
        f"import runpy, sys\nsys.modules[{hidden!r}] = None\nsys.argv[1:] = ['--help']\n"
        f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)\n",
        encoding="utf-8",
    )
    return ended(script, folder=folder)


@pytest.mark.parametrize("module", ["heliostat.track", "heliostat.dynamixel"])
def test_a_module_without_its_extra_ends_with_one_line(module: str, tmp_path: Path) -> None:
    missing = 'error: the package eclipse-zenoh is missing: pip install "heliostat[zenoh]"\n'
    assert without("zenoh", module, tmp_path) == (1, "", missing)


def test_a_program_of_servos_without_their_library_ends_with_one_line(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    missing = 'error: the package dynamixel-sdk is missing: pip install "heliostat[zenoh,dynamixel]"\n'
    assert without("dynamixel_sdk", "heliostat.dynamixel", tmp_path) == (1, "", missing)
