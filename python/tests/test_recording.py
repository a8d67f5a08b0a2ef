"""Recordings as arrays, from a room that the program runs and records."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import heliostat
import numpy as np
import pytest
from heliostat.names import Library
from room import free_endpoint

OVERRIDES = ("--set", "streams.channel.rate_hz=5")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = os.environ.get("HELIOSTAT_PROGRAM")
    if program is None:
        pytest.skip("HELIOSTAT_PROGRAM names no program")
    file = tmp_path_factory.mktemp("recording") / "room.mcap"
    room, recorder = free_endpoint(), free_endpoint()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scenario = ["--scenario", "hall", *OVERRIDES]
    commands = [
        ["sim-node", "--listen", room, "--seconds", "8", *scenario],
        ["record", "--connect", room, "--listen", recorder, "--until-empty", "--out", str(file), *scenario],
        ["controller", "--connect", room, "--connect", recorder, "--policy", "fixed-point", "--seconds", "6", *scenario],
    ]
    processes = [subprocess.Popen([program, *command], **quiet) for command in commands]  # type: ignore[call-overload]
    try:
        assert [process.wait(60) for process in processes] == [0, 0, 0]
    finally:
        for process in processes:
            process.kill()
    return file


def test_a_recording_has_the_reports_commands_and_decisions_of_its_room(path: Path) -> None:
    recording = heliostat.Recording(path)
    assert re.fullmatch(r"<Recording of room 'demo': \d{3,} messages in \d+\.\d s>", repr(recording)), repr(recording)
    assert recording.account is not None and recording.scenario().name == "hall"
    assert recording.scenario().tables()["streams"]["channel"]["rate_hz"] == 5.0
    reports = recording.reports()
    ticks = np.unique(reports["tick"])
    assert len(ticks) > 30 and reports["position_m"].shape == (5 * len(ticks), 3)
    length_x, length_y, _ = recording.scenario().room_m
    assert (np.abs(reports["position_m"][:, 0]) <= length_x / 2 + 0.5).all()
    assert (np.abs(reports["position_m"][:, 1]) <= length_y / 2 + 0.5).all()
    assert set(reports["user"].tolist()) == set(recording.channels()["user"].tolist())
    commands = recording.commands()
    assert commands["roll"].shape == (len(commands["sequence"]), 100) == commands["yaw"].shape
    assert np.ptp(commands["roll"][-1]) > 0.05
    assert recording.commands(array=1)["sequence"].shape == (0,)
    # The array follows the command that it names. Two commands can answer the same report; such rows name none of them.
    telemetry = recording.telemetry()
    answered, counts = np.unique(commands["answers"], return_counts=True)
    rows = np.flatnonzero(np.isin(telemetry["answers"], answered[counts == 1]))
    assert len(rows) > 20
    row = rows[len(rows) // 2]
    (followed,) = np.flatnonzero(commands["answers"] == telemetry["answers"][row])
    assert np.array_equal(telemetry["roll"][row], commands["roll"][followed])
    decisions = recording.decisions()
    assert len(decisions["tick"]) > 20 and np.isin(decisions["tick"], commands["answers"]).all()
    report = np.flatnonzero(reports["tick"] == decisions["tick"][3])[0]
    command = np.flatnonzero(commands["answers"] == decisions["tick"][3])[0]
    apart_us = (int(commands["arrived_ns"][command]) - int(reports["arrived_ns"][report])) / 1e3
    assert decisions["answer_us"][3] == pytest.approx(apart_us)


def test_a_recording_with_another_scenario_than_the_room_warns(tmp_path: Path) -> None:
    program = os.environ.get("HELIOSTAT_PROGRAM")
    if program is None:
        pytest.skip("HELIOSTAT_PROGRAM names no program")
    file, room = tmp_path / "room.mcap", free_endpoint()
    commands = [
        ["sim-node", "--listen", room, "--seconds", "5", "--scenario", "hall"],
        ["record", "--connect", room, "--until-empty", "--out", str(file), "--scenario", "specular"],
    ]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes = [subprocess.Popen([program, *command], **quiet) for command in commands]  # type: ignore[call-overload]
    try:
        for process in processes:
            process.wait(60)
    finally:
        for process in processes:
            process.kill()
    with pytest.warns(RuntimeWarning, match=r"room.mcap: sim-node uses scenario \w+, the recording holds \w+: record with"):
        recording = heliostat.Recording(file)
    assert recording.scenario().name == "specular"


def test_the_truth_of_a_recording_agrees_with_the_physics(path: Path) -> None:
    truth = heliostat.Recording(path).truth()
    assert len(truth["user"]) > 50 and truth["position_m"].shape[1] == 3
    assert (truth["rate_mbps"] >= 0.0).all() and (truth["oracle_sum_rate_mbps"] > 0.0).any()
    open_ = ~truth["blocked"]
    assert truth["rate_mbps"][open_].mean() > truth["rate_mbps"][~open_].mean() or open_.all()


def test_the_belief_of_a_recording_is_near_the_truth_of_its_time(path: Path) -> None:
    recording = heliostat.Recording(path)
    belief, truth = recording.belief(), recording.truth()
    assert len(belief["user"]) > 50 and len(set(belief["source"].tolist())) == 1
    assert np.isin(belief["tick"], recording.reports()["tick"]).all()
    assert (belief["holds_ns"] >= belief["time_ns"]).all()
    assert (belief["xx_m2"] >= 0.0).all() and (belief["yy_m2"] >= 0.0).all()
    for share in ("heading_certainty", "blocked_probability"):
        assert ((belief[share] >= 0.0) & (belief[share] <= 1.0)).all(), share
    last = len(belief["user"]) - 1
    of_user = np.flatnonzero(truth["user"] == belief["user"][last])
    nearest = of_user[np.argmin(np.abs(truth["time_ns"][of_user] - belief["holds_ns"][last]))]
    apart = belief["position_m"][last, :2] - truth["position_m"][nearest, :2]
    assert np.hypot(*apart) < 1.5, "a user walks less than this between two messages of the truth"


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_table_of_a_recording_is_a_data_frame(path: Path, library: Library) -> None:
    pytest.importorskip(library)
    recording = heliostat.Recording(path)
    frame, truth = recording.frame("truth", library=library), recording.truth()
    assert len(frame) == len(truth["user"]) > 0
    np.testing.assert_array_equal(frame["position_y_m"].to_numpy(), truth["position_m"][:, 1])
    np.testing.assert_array_equal(frame["time_ns"].to_numpy(), truth["time_ns"])
    commands = recording.frame("commands", library=library)
    np.testing.assert_array_equal(commands["roll_7"].to_numpy(), recording.commands()["roll"][:, 7])
    for of in ("reports", "belief"):
        names = set(recording.frame(of, library=library).columns)
        assert {"position_z_m", "velocity_x_m_s", "velocity_y_m_s"} <= names, of
    assert len(recording.frame("decisions", library=library)) > 0
    with pytest.raises(ValueError, match="expected reports, channels, truth"):
        recording.frame("angles")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="pandas"):
        recording.frame("truth", library="spark")  # type: ignore[arg-type]


def test_differences_of_times_have_a_sign(path: Path) -> None:
    recording = heliostat.Recording(path)
    tables: list[Any] = [recording.reports(), recording.channels(), recording.truth(), recording.belief()]
    tables += [recording.commands(), recording.telemetry(), recording.decisions()]
    times = [values for table in tables for name, values in table.items() if name.endswith("_ns")]
    assert len(times) == 16 and {values.dtype for values in times} == {np.dtype(np.int64)}
    decisions = recording.decisions()
    apart = decisions["reported_ns"] - decisions["commanded_ns"]
    np.testing.assert_allclose(apart, decisions["answer_us"] * -1e3)
    assert (apart < 0).any()


def test_an_array_that_no_room_has_is_refused(path: Path) -> None:
    recording = heliostat.Recording(path)
    for read in (recording.commands, recording.telemetry, recording.decisions):
        for array in (-1, 16, "x"):
            with pytest.raises((TypeError, ValueError), match=r"array = .*: expected an integer from 0 to 15"):
                read(array)  # type: ignore[arg-type]


def test_a_recording_that_was_cut_warns(path: Path, tmp_path: Path) -> None:
    content = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) // 2])
    with pytest.warns(RuntimeWarning, match=r"cut.mcap: the recording was cut: later messages are missing"):
        assert heliostat.Recording(tmp_path / "cut.mcap").account is None


def test_messages_that_cannot_be_read_warn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "later.mcap"
    path.touch()
    found = "messages that cannot be read: 3, the first one: payload of contract version 2"
    stored = SimpleNamespace(account="{}", unreadable=found, other_scenario=None)
    monkeypatch.setattr("heliostat.recording._Recording", lambda path: stored)
    with pytest.warns(RuntimeWarning, match=f"later.mcap: {found}"):
        heliostat.Recording(path)


def test_files_that_are_no_recordings_are_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="none.mcap"):
        heliostat.Recording(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_bytes(b"no recording")
    with pytest.raises(ValueError, match="is not an MCAP file"):
        heliostat.Recording(tmp_path / "text.mcap")
