"""The record of the emergency stop on disk, as `heliostat_driver::stop_record` keeps it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from ._core import STOP_RECORD_MAX
from .peer import PeerError

if sys.platform != "win32":
    import fcntl

_LOCK_TRIES = 100
"""Attempts to lock a file whose holders end meanwhile; bounded: some file systems change the numbers of files."""


class StopFile:
    """The record of the emergency stop in a folder; `heliostat driver run` uses the same file.

    It is a context manager: within the block, a lock keeps the file from other processes. `show` takes the reason where
    the folder takes no lock.
    """

    def __init__(self, folder: Path, show: Callable[[str], None]) -> None:
        self.folder = folder
        self._show = show
        self._path = folder
        self._is_locked = False
        self._lock: int | None = None

    def __enter__(self) -> StopFile:
        self._is_locked = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_locked = False
        if self._lock is not None:
            if _is_named(self._lock, _lock_path(self._path)):
                with suppress(OSError):
                    _lock_path(self._path).unlink()
            os.close(self._lock)
            self._lock = None

    def open(self, name: str) -> str:
        """Uses the file of this name from now on; returns its path for messages. The first write waits for no pipe.

        Raises `PeerError` where another process has the lock.
        """
        self._path = self.folder / name
        if self._is_locked:
            self._lock = self._take_lock()
        new = self._new_path()
        # The new file of another process, where there are no locks, stays. Of a folder the first write has the problem.
        if new.is_symlink() or (new.exists() and not new.is_file()):
            with suppress(OSError):
                new.unlink()
        return str(self._path)

    def read(self) -> str | None:
        """The record, `None` if there is none. Only a regular file is one: a start must not wait for a pipe."""
        if not self._path.is_file() or self._path.is_symlink():
            if not os.path.lexists(self._path):
                return None
            raise OSError("expected a regular file")
        if self._path.stat().st_size > STOP_RECORD_MAX:
            raise OSError(f"expected at most {STOP_RECORD_MAX} bytes")
        return self._path.read_text(encoding="utf-8")

    def replace(self, text: str) -> None:
        """Replaces the record at once, and returns when it is on the disk."""
        self.folder.mkdir(parents=True, exist_ok=True)
        new = self._new_path()
        with new.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self._path)
        if os.name == "posix":
            folder = os.open(self.folder, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def empty(self) -> None:
        """Empties the record, which means that the state is unknown."""
        # For reading too: a pipe of this name makes the start wait for no reader.
        file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        try:
            os.fsync(file)
        finally:
            os.close(file)

    def _new_path(self) -> Path:
        """The new file beside the record, which takes its place."""
        return self._path.with_suffix(".new")

    def _take_lock(self) -> int | None:
        """An open file with a lock; `None` where the folder takes no lock."""
        if sys.platform == "win32":
            return None
        path = _lock_path(self._path)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            for _ in range(_LOCK_TRIES):
                lock = _locked(path)
                if _is_named(lock, path):
                    return lock
                os.close(lock)
            return _locked(path)
        except BlockingIOError as problem:
            raise PeerError(
                f"another process uses the record of the emergency stop in {self._path}: stop that process, or choose "
                "another folder with --state DIR"
            ) from problem
        except OSError as problem:
            # The array starts stopped if the record cannot be written either.
            self._show(f"no lock keeps other processes from the record of the emergency stop: {problem}")
            return None


def _lock_path(record: Path) -> Path:
    return record.with_name(f"{record.name}.lock")


def _is_named(lock: int, path: Path) -> bool:
    """Whether the path still names the open file: a process that ended meanwhile may have removed it."""
    try:
        return os.path.samestat(os.fstat(lock), path.stat())
    except OSError:
        return False


def _locked(path: Path) -> int:
    """The open file of a lock, which ends with the process."""
    lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise
    return lock
