"""One process for each array: two drivers that start together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest

pytest.importorskip("zenoh")
from heliostat._claim import Claim
from heliostat.peer import Peer, PeerError


def token(source: int, node: str = "driver") -> str:
    return f"heliostat/v1/lab/alive/{node}/{source:016x}"


class Room:
    """A peer with this source id, and the tokens that it receives."""

    def __init__(self, source: int) -> None:
        self.source, self.room, self.keys = source, "lab", {"alive": token(source)}
        self.now_s = 100
        self.notes: list[Callable[[str, bool], None]] = []

    def watch(self, note: Callable[[str, bool], None], name: str) -> None:
        self.notes.append(note)

    def alive(self, name: str) -> list[str]:
        return []

    def announce(self) -> None:
        self.receive(self.keys["alive"])

    def receive(self, key: str, is_alive: bool = True) -> None:
        for note in self.notes:
            note(key, is_alive)

    def claim(self) -> Claim:
        return Claim(cast(Peer, cast(Any, self)), lambda: self.now_s * 10**9)


def test_of_two_drivers_that_start_together_the_one_with_the_higher_source_id_ends() -> None:
    shown: list[str] = []
    for own, other in ((9, 7), (7, 9)):
        room = Room(own)
        claim = room.claim()
        claim.announce()
        room.receive(token(other))
        if own > other:
            with pytest.raises(PeerError, match='another driver is in room "lab"'):
                claim.check(shown.append)
        else:
            assert claim.check(shown.append) == []
    assert len(shown) == 1 and "if it has just started, it ends now" in shown[0]


def test_a_token_before_the_own_one_ends_the_driver_with_either_source_id() -> None:
    for own, other in ((9, 7), (7, 9)):
        room = Room(own)
        claim = room.claim()
        room.receive(token(other, "sim-node"))
        with pytest.raises(PeerError, match='another simulator is in room "lab"'):
            claim.announce()
        room.receive(token(other, "sim-node"), is_alive=False)
        claim.announce()


def test_a_token_that_appears_later_is_a_problem_once() -> None:
    for own, other in ((9, 7), (7, 9)):
        room = Room(own)
        claim = room.claim()
        claim.announce()
        room.now_s += 6
        room.receive(token(other))
        (problem,) = claim.check(pytest.fail)
        assert "another driver has joined the room" in problem and token(other) in problem
        assert claim.check(pytest.fail) == []


def test_a_driver_that_has_to_end_and_stays_is_a_problem_once() -> None:
    room, shown = Room(7), list[str]()
    claim = room.claim()
    claim.announce()
    room.receive(token(9))
    assert claim.check(shown.append) == [] and len(shown) == 1
    room.now_s += 5
    assert claim.check(pytest.fail) == []
    room.now_s += 1
    (problem,) = claim.check(pytest.fail)
    assert "another driver has joined the room" in problem and token(9) in problem
    assert claim.check(pytest.fail) == []
