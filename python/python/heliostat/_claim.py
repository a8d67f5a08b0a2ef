"""One process for each array: the rule of `heliostat_driver::claim` for a driver in Python."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from .peer import Peer, PeerError

START_WINDOW_S = 5.0
"""Time from the own token in which another token is one of a process that started together with this one."""


@dataclass
class _Other:
    """Another process with the same mirrors."""

    token: str
    is_at_start: bool
    is_new: bool = True

    @property
    def kind(self) -> str:
        return "simulator" if "/sim-node/" in self.token else "driver"

    @property
    def source(self) -> int:
        return int(self.token.rpartition("/")[2], 16)


class Claim:
    """The liveliness token of a driver, and the watch over the tokens of other processes with the same mirrors.

    Raises `PeerError` in a room with such a token.
    """

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._lock = threading.Lock()
        self._present: dict[str, _Other] = {}
        self._announced_s: float | None = None
        for name in ("simulators", "drivers"):
            peer.watch(self._note, name)
        # The watch does not say when it has received the present tokens. The query does.
        for name in ("simulators", "drivers"):
            for token in peer.alive(name):
                self._note(token, True)
        with self._lock:
            self._check_free()

    def announce(self) -> None:
        """Declares the token; raises `PeerError` if another one has appeared since the begin."""
        with self._lock:
            self._check_free()
            # Before the token, so that each token that arrives from now on is compared.
            self._announced_s = time.monotonic()
        self._peer.announce()

    def check(self, show: Callable[[str], None]) -> list[str]:
        """The problems of tokens that have appeared since the last call, and too late for a start at the same time.

        Raises `PeerError` if this process has to end for one that started together with it.
        """
        with self._lock:
            new = [other for other in self._present.values() if other.is_new]
            for other in new:
                other.is_new = False
        problems = []
        for other in new:
            if not other.is_at_start:
                problems.append(f"another {other.kind} has joined the room ({other.token}): stop one of the two")
            elif self._peer.source > other.source:
                raise self._taken(other)
            else:
                show(
                    f"another {other.kind} has started at the same time ({other.token}): it has the higher source id "
                    "and ends"
                )
        return problems

    def _note(self, token: str, is_alive: bool) -> None:
        if token == self._peer.keys["alive"]:
            return
        with self._lock:
            if not is_alive:
                self._present.pop(token, None)
            elif token not in self._present:
                at_s = self._announced_s
                self._present[token] = _Other(token, at_s is None or time.monotonic() - at_s <= START_WINDOW_S)

    def _check_free(self) -> None:
        for other in self._present.values():
            raise self._taken(other)

    def _taken(self, other: _Other) -> PeerError:
        advice = "stop it, or choose another room with --room"
        return PeerError(f'another {other.kind} is in room "{self._peer.room}" ({other.token}): {advice}')
