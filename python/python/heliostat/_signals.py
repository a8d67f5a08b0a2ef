"""The end of a process on Ctrl-C and SIGTERM."""

from __future__ import annotations

import itertools
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_INTERRUPT_S = 0.1


@contextmanager
def stop_on_signals(stop: threading.Event) -> Iterator[threading.Event]:
    """Requests the stop on Ctrl-C and SIGTERM while the block runs; from another than the main thread it does nothing.

    A second signal raises `KeyboardInterrupt`: an orderly end may wait for a device that does not answer.

    A shell starts background processes with Ctrl-C ignored; the block listens to it all the same.
    """
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    signals, count = (signal.SIGINT, signal.SIGTERM), itertools.count()
    over: list[bool] = []

    # Runs only between two instructions of the main thread, and takes no lock, which this may hold.
    def end(*_: object) -> None:
        if next(count) > 0:
            over.append(True)
            raise KeyboardInterrupt

    # Each signal is written here at once, also while the main thread waits in a call.
    arrived, written = socket.socketpair()
    written.setblocking(False)
    main_thread = threading.get_ident()

    def pass_on() -> None:
        with arrived:
            requests = (number for number in iter(lambda: arrived.recv(1), b"") if number[0] in signals)
            if next(requests, None) is None:
                return
            stop.set()
            if next(requests, None) is None:
                return
            # A signal that came as the main thread began to wait has not interrupted the wait: a further one does.
            while hasattr(signal, "pthread_kill"):
                time.sleep(_INTERRUPT_S)
                if over:
                    return
                signal.pthread_kill(main_thread, signal.SIGINT)

    before = [signal.signal(number, end) for number in signals]
    wakeup = signal.set_wakeup_fd(written.fileno(), warn_on_full_buffer=False)
    thread = threading.Thread(target=pass_on, name="signals", daemon=True)
    thread.start()
    try:
        yield stop
    finally:
        over.append(True)
        signal.set_wakeup_fd(wakeup)
        written.close()
        try:
            thread.join()
        finally:
            for number, handler in zip(signals, before, strict=True):
                signal.signal(number, handler)
