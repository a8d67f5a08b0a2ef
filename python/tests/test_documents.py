"""The Python blocks of the guide run, one after the other, and each public name has a docstring."""

from __future__ import annotations

import importlib
import inspect
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import heliostat
import pytest
from heliostat.envs import IDS
from room import needs_program

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize(
    ("page", "count", "printed"),
    [("python.md", 5, "Mbit/s, minimum rates met"), ("tutorials/python.md", 3, "ratio minus that of the baseline")],
)
def test_the_blocks_of_a_guide_run(page: str, count: int, printed: str, capsys: Any) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= count
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    assert printed in capsys.readouterr().out


def test_a_tutorial_that_starts_a_process_in_the_background_has_the_command_that_ends_it() -> None:
    pages = {page.name: page.read_text(encoding="utf-8") for page in (DOCS / "tutorials").glob("*.md")}
    background = {name: text for name, text in pages.items() if re.search(r" &$", text, re.MULTILINE)}
    assert {"first-run.md", "own-driver.md"} <= background.keys()
    assert [name for name, text in background.items() if "`kill %1`" not in text] == []


def test_the_guide_of_the_page_has_what_to_do_at_each_banner() -> None:
    shown = "".join((DOCS.parent / "crates/ui/page" / name).read_text("utf-8") for name in ("sentence.js", "page.js"))
    guide = (DOCS / "page.md").read_text(encoding="utf-8").split("### What to do at a banner\n")[1].split("\n### ")[0]
    named = re.findall(r"^\| `([^`]+)`[^|]* \| \w", guide, re.MULTILINE)
    assert [words for words in named if words not in shown] == []
    # Each banner is one object; that of an unconfirmed stop and that of a confirmed one have further sentences.
    assert len(named) >= shown.count("{ kind: ")


def test_the_titles_of_three_panels_of_the_study_do_not_overlap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    page = (DOCS / "tutorials" / "own-study.md").read_text(encoding="utf-8")
    (script,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    keys = ["mirrors.rows", "blockage.forced_users", "policy"]
    figures = ["outage_time_mean", "outage_time_ci95", "sum_rate_mbps_mean", "sum_rate_mbps_ci95", "episodes", "commit"]
    points = [(rows, users) for rows in (0, 5) for users in (0, 3, 5)]
    policies = ["(oracle)", "fixed-point", "flat"]
    lines = [f"{rows},{users},{name},0.2,0.1,50,5,10,0" for rows, users in points for name in policies]
    (tmp_path / "study.csv").write_text("\n".join([",".join(keys + figures), *lines]) + "\n", encoding="utf-8")
    names: dict[str, Any] = {}
    exec(compile(script, "own-study.md", "exec"), names)
    figure, axes = names["figure"], names["axes"]
    figure.draw_without_rendering()
    titles = [axis.title.get_window_extent() for axis in axes]
    assert len(titles) == 3 and all(left.x1 < right.x0 for left, right in zip(titles, titles[1:], strict=False)), titles
    (common,) = figure.texts
    assert common.get_window_extent().y0 >= max(title.y1 for title in titles)
    assert titles[0].x0 >= 0.0 and titles[-1].x1 <= figure.bbox.x1
    assert "95 % intervals" in common.get_text()
    assert common.get_window_extent().x0 >= 0.0 and common.get_window_extent().x1 <= figure.bbox.x1


@needs_program
def test_the_study_gives_a_figure_and_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    pytest.importorskip("matplotlib")
    page = (DOCS / "tutorials" / "own-study.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"```sh\n(.*?)```", page, re.DOTALL)
    (script,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    programs = Path(os.environ["HELIOSTAT_PROGRAM"]).parent
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    subprocess.run(["bash", "-c", command], check=True, capture_output=True, timeout=1200)
    exec(compile(script, "own-study.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "commit" in printed and "condition: the cause of a blocked path does not apply" in printed
    assert (tmp_path / "study.pdf").read_bytes().startswith(b"%PDF")
    assert "<svg" in (tmp_path / "study.svg").read_text(encoding="utf-8")
    table = (tmp_path / "study.tex").read_text(encoding="utf-8")
    rows = [line for line in table.splitlines() if line.endswith(r"\\") and "policy" not in line]
    assert len(rows) == 4 * 2 * 3 and any(line.startswith("0 & 3 & oracle & ") for line in rows), table
    assert "nan" not in table
    assert "% condition: the cause of a blocked path does not apply" in table


@needs_program
def test_the_function_of_the_guide_to_policies_is_compared(tmp_path: Path) -> None:
    page = (DOCS / "tutorials" / "own-policy.md").read_text(encoding="utf-8")
    section = page.partition("## As a function in Python\n")[2].partition("\n## ")[0]
    (module,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (commands,) = re.findall(r"```sh no-run\n(.*?)```", section, re.DOTALL)
    (tmp_path / "mine.py").write_text(module, encoding="utf-8")
    path = f"{Path(os.environ['HELIOSTAT_PROGRAM']).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "HELIOSTAT_PYTHON": sys.executable}
    command = ["bash", "-ec", commands]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=False, capture_output=True, text=True, timeout=1200)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("difference to mine.py:act, paired") == 2, done.stdout


def test_the_guide_has_each_part_and_each_column_of_an_observation() -> None:
    page = (DOCS / "python.md").read_text(encoding="utf-8")
    section = page.partition("## Observations and actions\n")[2].partition("\n## ")[0]
    env = heliostat.HeliostatEnv("specular", overrides={"mirrors.rows": 3})
    rows = re.findall(r"^\| (`.*?) \| (.*?) \|", section, re.MULTILINE)
    names = [name for cell, _ in rows for name in re.findall(r"`(\w+)`", cell)]
    assert names == [*env.parts, *heliostat.BELIEF_COLUMNS]
    sizes = {"U": env.slots, "M": env.scenario.mirrors}
    for (_, cell), (_, shape) in zip(rows, env.parts.values(), strict=False):
        assert eval(cell, dict(sizes)) == shape, cell


def test_the_guide_and_the_docstrings_state_that_a_function_publishes_no_belief_and_no_state() -> None:
    page = (DOCS / "python.md").read_text(encoding="utf-8")
    section = page.partition("\n## Command a room\n")[2].partition("\n## ")[0]
    assert "publishes no belief and no state" in section
    (row,) = re.findall(r"^\| `belief\(\)` \|.*$", page, re.MULTILINE)
    assert "(#command-a-room)" in row
    assert "no belief and no state" in (heliostat.run.__doc__ or "")
    assert "`heliostat.run` publishes none" in (heliostat.Recording.belief.__doc__ or "")


def test_the_tutorial_states_that_its_results_are_of_one_training() -> None:
    page = (DOCS / "tutorials" / "python.md").read_text(encoding="utf-8")
    paragraph = page.partition("](../results/python-sac.md)")[2].partition("\n\n")[0]
    assert "one training with one seed, without an interval" in paragraph


def test_the_study_names_the_time_after_the_start() -> None:
    page = (DOCS / "tutorials" / "own-study.md").read_text(encoding="utf-8")
    samples, report = (page.partition(f"\n## {title}")[2].partition("\n## ")[0] for title in ("2. ", "5. "))
    assert "--warm" in samples and "--warm" in report


def test_the_guide_has_the_length_of_each_episode_and_leads_to_actions_that_learn() -> None:
    page = (DOCS / "python.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(heliostat/\S+)` \| (\d+) \|", page, re.MULTILINE)
    assert rows == [(name, str(steps)) for name, (_, steps) in IDS.items()]
    made = re.search(r"gymnasium\.make\((.*)\)", page)
    assert made and 'action="weights"' in made[1], "the first episode"
    commands = page.partition("## Train, export, run\n")[2].partition("```sh no-run\n")[2]
    assert commands.startswith("python python/examples/ppo.py "), "the first training"


@pytest.mark.parametrize(("title", "count"), [("Symbols", 14), ("Blockage: eq. (5)", 3)])
def test_the_tables_of_the_physics_have_the_keys_and_values_of_the_default_room(title: str, count: int) -> None:
    page = (DOCS / "physics.md").read_text(encoding="utf-8")
    section = page.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    tables = heliostat.load_scenario("specular").tables()
    rows = re.findall(r"\| `(\w+)\.(\w+)` \| ([\d.]*) ?\|$", section, re.MULTILINE)
    assert len(rows) >= count
    for table, key, value in rows:
        # A key without a value in the table is absent from the room.
        found = tables[table].get(key)
        assert found == (float(value) if value else None), f"{table}.{key}: {found} in the room, {value!r} on the page"


def test_the_study_names_points_without_an_interval(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    (script,) = re.findall(r"```python\n(.*?)```", (DOCS / "tutorials" / "own-study.md").read_text("utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    # As `heliostat-lab eval --csv` writes an interval of one episode.
    lines = ["mirrors.rows,blockage.forced_users,policy,outage_time_mean,outage_time_ci95", "2,0,(oracle),0.2,"]
    (tmp_path / "study.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(SystemExit, match="points of one episode.*expected 2 episodes or more"):
        exec(compile(script, "own-study.md", "exec"), {})


def test_each_public_name_has_a_docstring() -> None:
    missing, seen = [], 0
    for found in pkgutil.walk_packages(heliostat.__path__, "heliostat.", onerror=lambda _: None):
        if found.name.rpartition(".")[2].startswith("_"):
            continue
        try:
            module = importlib.import_module(found.name)
        except ImportError:
            continue  # Its optional part is not installed.
        assert module.__doc__, found.name
        for name, value in vars(module).items():
            if name.startswith("_") or getattr(value, "__module__", None) != found.name:
                continue
            parts = {name: value}
            if inspect.isclass(value):
                parts |= {f"{name}.{part}": held for part, held in vars(value).items() if not part.startswith("_")}
            for path, part in parts.items():
                if callable(part) or isinstance(part, property):
                    seen += 1
                    missing += [] if part.__doc__ else [f"{found.name}.{path}"]
    assert seen > 40 and not missing, missing


def test_the_guide_of_drivers_names_the_flags_that_a_driver_in_python_does_not_have() -> None:
    driver = pytest.importorskip("heliostat.driver")
    guide = (DOCS / "drivers.md").read_text(encoding="utf-8")
    assert "It has neither [`--metrics-listen` nor `--log-format`]" in guide
    flags = driver.parser().format_help()
    assert "--state" in flags
    assert "--metrics-listen" not in flags and "--log-format" not in flags
