"""The lock of a serial port, as `heliostat driver run` takes it: the bytes of two drivers on one port would mix."""

from __future__ import annotations

import os
import sys

if sys.platform != "win32":
    import fcntl


class PortLock:
    """Keeps other drivers from one port. Windows opens a port once only, and needs no lock."""

    def __init__(self) -> None:
        self._descriptor: int | None = None

    def take(self, path: str) -> None:
        """Locks a port, in place of the one before. Raises `OSError` where it is absent, or where another process has it."""
        self.release()
        if sys.platform == "win32":
            return
        # Neither waits for a carrier nor takes the port as the terminal of this process.
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as problem:
            os.close(descriptor)
            advice = "end the process that uses it, for example another driver, or name another port"
            raise BlockingIOError(problem.errno, f"another process has this port; {advice}") from problem
        except OSError:
            # Some systems lock no device: the port works there too.
            pass
        self._descriptor = descriptor

    def release(self) -> None:
        """Lets other drivers use the port."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
