"""The file of the emergency stop: one process holds it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("zenoh")
from heliostat import _stop_file
from heliostat._stop_file import StopFile
from heliostat.peer import PeerError


def test_a_record_is_of_one_process_until_it_ends(tmp_path: Path) -> None:
    record = str(tmp_path / "lab.stop.toml")
    with StopFile(tmp_path, pytest.fail) as first:
        assert first.open("lab.stop.toml") == record
        with StopFile(tmp_path, pytest.fail) as second, pytest.raises(PeerError, match="uses the record"):
            second.open("lab.stop.toml")
        with StopFile(tmp_path, pytest.fail) as other:
            other.open("lab.mirrors-1.stop.toml")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "lab.stop.toml.lock").touch()
    with StopFile(tmp_path, pytest.fail) as after_a_kill:
        assert after_a_kill.open("lab.stop.toml") == record


def test_a_lock_whose_file_changes_its_number_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[int] = []

    def is_named(lock: int, path: Path) -> bool:
        tries.append(lock)
        assert len(tries) < 1000
        return False

    monkeypatch.setattr(_stop_file, "_is_named", is_named)
    with StopFile(tmp_path, pytest.fail) as first:
        first.open("lab.stop.toml")
        with StopFile(tmp_path, pytest.fail) as second, pytest.raises(PeerError, match="another process uses"):
            second.open("lab.stop.toml")


def test_a_folder_without_locks_is_shown(tmp_path: Path) -> None:
    (tmp_path / "lab.stop.toml.lock").mkdir()
    shown: list[str] = []
    with StopFile(tmp_path, shown.append) as without_lock:
        without_lock.open("lab.stop.toml")
    assert len(shown) == 1 and "no lock keeps other processes from the record of the emergency stop" in shown[0]
    assert "lab.stop.toml.lock" in shown[0]
