#!/usr/bin/env python3
"""Reads for which system programs are built, from their headers, and checks it.

    python/program_target.py TRIPLE PROGRAM...

TRIPLE is a target of Rust, such as aarch64-unknown-linux-gnu. A program for another system or processor is refused.
The version of glibc that the programs need is printed, if they need one. A script fits each target.
"""

import re
import struct
import sys
from pathlib import Path
from typing import NamedTuple

ELF = {62: "x86_64", 183: "aarch64"}
# e_type, e_shoff, e_shentsize and e_shnum.
ELF_FIELDS = [("<H", 16), ("<Q", 40), ("<H", 58), ("<H", 60)]
MACH_O = {0x01000007: "x86_64", 0x0100000C: "aarch64"}
PE = {0x8664: "x86_64", 0xAA64: "aarch64"}


class Built(NamedTuple):
    """System and processor of a program, as the triple of its target has them, and the version of glibc that it needs."""

    system: str
    processor: str
    glibc: tuple[int, int] | None


def read(program: Path) -> Built | None:
    """What the header of a program names, or None for a script; ValueError for any other file."""
    content = program.read_bytes()
    if content.startswith(b"#!"):
        return None
    try:
        # 64 bits, little-endian, executable by itself or at any address, with its last table.
        if content.startswith(b"\x7fELF\2\1"):
            kind, table, size, entries = (struct.unpack_from(form, content, at)[0] for form, at in ELF_FIELDS)
            if kind not in (2, 3) or table + size * entries > len(content):
                raise KeyError(kind)
            return Built("linux", ELF[struct.unpack_from("<H", content, 18)[0]], glibc_of(content))
        if content.startswith(b"\xcf\xfa\xed\xfe"):
            return Built("apple-darwin", MACH_O[struct.unpack_from("<I", content, 4)[0]], None)
        if content.startswith(b"MZ"):
            header = struct.unpack_from("<I", content, 60)[0]
            return Built("windows", PE[struct.unpack_from("<H", content, header + 4)[0]], None)
    except (KeyError, struct.error):
        pass
    raise ValueError(f"{program} is no whole program of Linux, macOS or Windows for x86_64 or aarch64: build it again")


def glibc_of(content: bytes) -> tuple[int, int] | None:
    """The latest version of glibc among the versions of symbols that an ELF file asks for."""
    versions = re.findall(rb"\0GLIBC_(\d+)\.(\d+)(?=[\0.])", content)
    return max(((int(major), int(minor)) for major, minor in versions), default=None)


def check(target: str, programs: list[Path]) -> tuple[int, int] | None:
    """The version of glibc that the programs need together; ValueError for a program that does not fit the target."""
    needed = None
    for program in programs:
        built = read(program)
        if built is None:
            continue
        fits = target.startswith(f"{built.processor}-") and built.system in target
        if not fits or ("musl" in target and built.glibc):
            found = f"{built.processor} and {built.system}{' with glibc' if built.glibc else ''}"
            raise ValueError(f"{program} is built for {found}; expected {target}: name another target, or build it for this one")
        needed = max(filter(None, [needed, built.glibc]), default=None)
    return needed


def main() -> None:
    """Checks the programs of the arguments, and prints the version of glibc that they need."""
    if len(sys.argv) < 3 or sys.argv[1].startswith("-"):
        sys.exit((__doc__ or "").strip())
    try:
        needed = check(sys.argv[1], [Path(name) for name in sys.argv[2:]])
    except (OSError, ValueError) as error:
        sys.exit(str(error))
    if needed:
        print(f"glibc {needed[0]}.{needed[1]}")


if __name__ == "__main__":
    main()
