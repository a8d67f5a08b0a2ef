"""One process for each array: the session around the rules of `heliostat_array::others`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ._core import Others, RoomTaken
from .peer import Peer, PeerError


class Claim:
    """The liveliness token of a driver, and the watch over the tokens of other processes with the same mirrors.

    `now_ns` is the monotonic time in ns. Raises `PeerError` in a room with such a token.
    """

    def __init__(self, peer: Peer, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._peer, self._now_ns = peer, now_ns
        self._others = Others(peer.room, peer.source)
        for name in ("simulators", "drivers"):
            peer.watch(self._note, name)
        # The watch does not say when it has received the present tokens. The query does.
        for name in ("simulators", "drivers"):
            for token in peer.alive(name):
                self._note(token, True)
        with _refusals():
            self._others.check_free()

    def announce(self) -> None:
        """Declares the token; raises `PeerError` if another one has appeared since the begin."""
        # Before the token, so that each token that arrives from now on is compared.
        with _refusals():
            self._others.announce(self._now_ns())
        self._peer.announce()

    def check(self, show: Callable[[str], None]) -> list[str]:
        """The problems since the last call: processes that go on beside this one. `show` takes lines for the log.

        Raises `PeerError` if this process has to end for one that started together with it.
        """
        with _refusals():
            notes, problems = self._others.check(self._now_ns())
        for note in notes:
            show(note)
        return problems

    @property
    def count(self) -> int:
        """Number of other processes that are in the room."""
        return self._others.count

    def _note(self, token: str, is_alive: bool) -> None:
        self._others.note(token, is_alive, self._now_ns())


@contextmanager
def _refusals() -> Iterator[None]:
    """Raises the refusals of the rules as those of a peer."""
    try:
        yield
    except RoomTaken as taken:
        raise PeerError(str(taken)) from taken
