"""The wheel of programs that are built already."""

import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PACK = Path(__file__).parents[1] / "pack-programs"
NAMES = ["heliostat", "heliostat-lab"]

pytestmark = pytest.mark.skipif(not shutil.which("maturin"), reason="maturin is not on the path")


def pack(programs: Path, folder: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Runs pack-programs at a fixed date."""
    environment = os.environ | {"SOURCE_DATE_EPOCH": "1700000000"}
    command = [sys.executable, str(PACK), str(programs), str(folder), *flags]
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


def elf(machine: int, symbols: bytes = b"") -> bytes:
    """The beginning of an ELF file for a machine, and the names of its symbols' versions."""
    return b"\x7fELF\2\1" + bytes(10) + struct.pack("<HH", 3, machine) + bytes(44) + symbols


X86_64, AARCH64 = 62, 183
MACH_O_ARM64 = b"\xcf\xfa\xed\xfe" + struct.pack("<I", 0x0100000C)
PE_X86_64 = b"MZ" + bytes(58) + struct.pack("<I", 64) + b"PE\0\0" + struct.pack("<H", 0x8664)


@pytest.mark.parametrize(
    ("content", "target", "found"),
    [
        (elf(X86_64), "aarch64-unknown-linux-gnu", "x86_64 and linux"),
        (elf(AARCH64), "x86_64-unknown-linux-gnu", "aarch64 and linux"),
        (elf(AARCH64), "aarch64-apple-darwin", "aarch64 and linux"),
        (elf(X86_64, b"\0GLIBC_2.17\0"), "x86_64-unknown-linux-musl", "x86_64 and linux with glibc"),
        (MACH_O_ARM64, "x86_64-apple-darwin", "aarch64 and apple-darwin"),
        (MACH_O_ARM64, "aarch64-unknown-linux-gnu", "aarch64 and apple-darwin"),
        (PE_X86_64, "x86_64-unknown-linux-gnu", "x86_64 and windows"),
    ],
)
def test_programs_of_another_target_are_refused(content: bytes, target: str, found: str, tmp_path: Path) -> None:
    programs = write_programs(tmp_path / "programs", NAMES)
    (programs / "heliostat-lab").write_bytes(content)
    result = pack(programs, tmp_path / "wheels", "--target", target)
    assert result.returncode == 1
    assert f"heliostat-lab is built for {found}; expected {target}" in result.stderr
    assert not (tmp_path / "wheels").exists()


def test_a_file_that_is_no_whole_program_is_refused(tmp_path: Path) -> None:
    programs = write_programs(tmp_path / "programs", NAMES)
    whole = elf(X86_64)
    object_file, of_32_bits = whole[:16] + b"\1" + whole[17:], whole[:4] + b"\1" + whole[5:]
    # Its table of sections would begin behind its end.
    cut = whole[:40] + struct.pack("<Q", 4096) + whole[48:58] + struct.pack("<HH", 64, 30) + whole[62:]
    for content in [b"text", b"\x7fELF", elf(8), b"MZ", object_file, of_32_bits, cut]:
        (programs / "heliostat").write_bytes(content)
        result = pack(programs, tmp_path / "wheels")
        assert result.returncode == 1
        assert "heliostat is no whole program of Linux, macOS or Windows" in result.stderr


def test_the_tag_of_the_wheel_has_the_latest_glibc_of_both_programs(tmp_path: Path) -> None:
    programs = write_programs(tmp_path / "programs", NAMES)
    (programs / "heliostat").write_bytes(elf(X86_64, b"\0GLIBC_2.9\0GLIBC_2.28\0"))
    (programs / "heliostat-lab").write_bytes(elf(X86_64, b"\0GLIBC_2.2.5\0GLIBC_2.17\0"))
    result = pack(programs, tmp_path / "wheels", "--target", "x86_64-unknown-linux-gnu")
    assert result.returncode == 0, result.stderr
    (wheel,) = (tmp_path / "wheels").iterdir()
    assert wheel.name.endswith("-py3-none-manylinux_2_28_x86_64.whl")
    with zipfile.ZipFile(wheel) as archive:
        information = wheel.name.split("-py3")[0] + ".dist-info"
        assert "Tag: py3-none-manylinux_2_28_x86_64" in archive.read(f"{information}/WHEEL").decode()
        assert f"{information}/licenses/LICENSE-MIT" in archive.namelist()
