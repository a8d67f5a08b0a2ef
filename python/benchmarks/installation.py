"""What the installation costs: the cold build of `pip install ./python`, and the sizes of the wheels.

`rates.py --installation` writes the section. It needs no package but the standard library, and a few minutes.
"""

from __future__ import annotations

import os
import platform
import re
import resource
import subprocess
import tempfile
import time
import zipfile
from pathlib import Path

HEADING = "## Installation"


def commit(root: Path) -> str:
    """The commit of a work tree, and whether it has changes."""
    command = ["git", "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=, with changes"]
    return subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout.strip()


def machine() -> str:
    """Processor, cores and system."""
    try:
        names = re.findall(r"^model name\s*: (.+)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        names = []
    processor = names[0] if names else platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def section(root: Path, with_program: bool) -> list[str]:
    """The lines of the section, after a cold build; `with_program` also builds the wheel of the program."""
    # The work tree may change during the build.
    source, load = commit(root), os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        # Empty, so that all crates are built.
        environment = {**os.environ, "CARGO_TARGET_DIR": str(folder / "target")}
        subprocess.run(["python3", "-m", "venv", str(folder / "venv")], check=True)
        pip = str(folder / "venv/bin/pip")
        # So that their download is no part of the time.
        required = subprocess.run([str(root / ".ci/requirements")], check=True, capture_output=True, text=True)
        subprocess.run([pip, "install", "--quiet", *required.stdout.split()], check=True)
        fetch = ["cargo", "fetch", "--quiet", "--manifest-path", "python/Cargo.toml"]
        subprocess.run(fetch, cwd=root, check=True)
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        subprocess.run([pip, "install", "--quiet", "./python"], cwd=root, env=environment, check=True)
        elapsed_s, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
        processor_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        flags = ["--cli"] if with_program else []
        path = f"{folder / 'venv/bin'}{os.pathsep}{os.environ['PATH']}"
        subprocess.run(
            [str(root / "python/build-wheels"), str(folder / "wheels"), *flags],
            env={**environment, "PATH": path},
            check=True,
            capture_output=True,
        )
        sizes = [size(one) for one in sorted((folder / "wheels").iterdir())]
    return [
        HEADING,
        "",
        f"Written by `python python/benchmarks/rates.py --installation`, at commit {source}. Machine: {machine()}. "
        f"The load average at the start was {load:.1f}.",
        "",
        f"`pip install ./python` with an empty CARGO_TARGET_DIR: {elapsed_s:.0f} s, and {processor_s:.0f} s of processor "
        "time. Crates and required packages were downloaded before.",
        "",
        "| file | MB | MB installed |",
        "| --- | --- | --- |",
        *sizes,
    ]


def size(distribution: Path) -> str:
    """The row of a wheel or a source distribution."""
    installed = "-"
    if distribution.suffix == ".whl":
        with zipfile.ZipFile(distribution) as wheel:
            installed = f"{1e-6 * sum(one.file_size for one in wheel.infolist()):.2f}"
    return f"| `{distribution.name}` | {1e-6 * distribution.stat().st_size:.2f} | {installed} |"


def kept(page: Path) -> list[str]:
    """The lines of the section of a page; none where the page has none."""
    lines = page.read_text(encoding="utf-8").splitlines() if page.exists() else []
    return lines[lines.index(HEADING) :] if HEADING in lines else []


def replaced(page: Path, lines: list[str]) -> str:
    """The text of the page with these lines as its section."""
    present = page.read_text(encoding="utf-8").splitlines()
    rest = present[: present.index(HEADING)] if HEADING in present else [*present, ""]
    return "\n".join([*rest, *lines]) + "\n"
