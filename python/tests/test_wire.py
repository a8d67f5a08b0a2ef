"""The codec agrees with CONTRACT.md: with its bytes, and with the codec in plain Python that it links to."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heliostat import wire

CONTRACT = (Path(__file__).parents[2] / "CONTRACT.md").read_text(encoding="utf-8")
CODEC = (Path(__file__).parents[2] / "proto" / "contract.py").read_text(encoding="utf-8")
SAMPLES = {
    payload[1]: payload
    for payload in (bytes.fromhex(text) for text in re.findall(r"```text\n(01[0-9a-f\n]+)```", CONTRACT))
}
NAMED_INSTEAD_OF_LISTED = (6, 7)  # quantiles and sum rates

COMMAND: dict[str, Any] = wire.decode(SAMPLES[4], 4)


def test_every_kind_has_a_sample() -> None:
    assert sorted(SAMPLES) == sorted(wire.KINDS.values()) == list(range(1, len(SAMPLES) + 1))


@pytest.mark.parametrize("kind", SAMPLES)
def test_samples_are_decoded_encoded_and_refused_when_damaged(kind: int) -> None:
    payload = SAMPLES[kind]
    message = wire.decode(payload, kind)
    assert wire.encode(message, kind) == payload and wire.kind_of(payload) == kind
    damaged = [payload[:length] for length in range(len(payload))]
    damaged += [payload + b"\0", b"\2" + payload[1:], bytes(1 << 20 | 1)]
    for one in damaged:
        with pytest.raises(wire.Refused):
            wire.decode(one, kind)
    with pytest.raises(wire.Refused, match="expected"):
        wire.decode(payload, kind % len(SAMPLES) + 1)


@pytest.mark.parametrize("kind", [kind for kind in SAMPLES if kind not in NAMED_INSTEAD_OF_LISTED])
def test_messages_equal_those_of_the_codec_in_plain_python(kind: int) -> None:
    names: dict[str, Any] = {}
    exec(CODEC, names)
    listed = names["decode"](SAMPLES[kind], kind)
    assert wire.decode(SAMPLES[kind], kind) == listed
    assert wire.encode(listed, kind) == SAMPLES[kind]


def test_angles_may_be_arrays() -> None:
    message = COMMAND | {"roll": np.array([0.125, -0.5]), "yaw": np.array([0.0, 0.25], np.float32)}
    assert wire.encode(message, 4) == SAMPLES[4]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"roll": [math.nan, 0.0]}, r"roll\[0\]: NaN is not finite"),
        ({"roll": [0.0]}, "yaw"),
        ({"roll": ["north", 0.0]}, "north"),
        ({"roll": object()}, "object"),
        ({"epoch": 1 << 64}, "2\\^64"),
        ({"epoch": -1}, "2\\^64"),
        ({"epoch": None}, "null"),
        ({"speed": 1.0}, "speed"),
        ({"roll": [0.0] * 16385, "yaw": [0.0] * 16385}, "16384"),
    ],
)
def test_messages_that_the_contract_does_not_allow_are_refused(change: dict[str, Any], reason: str) -> None:
    with pytest.raises(wire.Refused, match=reason):
        wire.encode(COMMAND | change, 4)


def test_a_missing_field_an_unknown_number_and_an_unknown_kind_are_refused() -> None:
    with pytest.raises(wire.Refused, match="missing field `epoch`"):
        wire.encode({name: value for name, value in COMMAND.items() if name != "epoch"}, 4)
    stop = wire.decode(SAMPLES[9], 9)
    with pytest.raises(wire.Refused, match="no value has the number 2"):
        wire.encode(stop | {"action": 2}, 9)
    with pytest.raises(wire.Refused):
        wire.encode(COMMAND, 99)


def test_keys_are_those_of_the_room_and_the_array() -> None:
    first, second = (wire.keys("lab", "driver", 255, array) for array in (0, 1))
    assert first["command"] == "heliostat/v1/lab/mirrors/command"
    assert second["telemetry"] == "heliostat/v1/lab/mirrors-1/telemetry"
    assert second["stop"] == first["stop"] == "heliostat/v1/lab/mirrors/stop"
    assert second["alive"] == "heliostat/v1/lab/alive/driver-1/00000000000000ff"
    assert second["status"] == "heliostat/v1/lab/status/driver-1"
    for room, node, array in [("l/b", "driver", 0), ("lab", "lamp", 0), ("lab", "driver", 16)]:
        with pytest.raises(ValueError, match="expected|unknown"):
            wire.keys(room, node, 1, array)


def test_numbers_outside_their_bounds_are_refused() -> None:
    for kind in (-1, 0, 99, 999, 2**40):
        with pytest.raises(wire.Refused, match=f"kind {kind}"):
            wire.encode({}, kind)
    for array in (-1, 16, 2**40):
        with pytest.raises(ValueError, match=f"array = {array}: expected 0 to 15"):
            wire.keys("demo", "driver", 1, array)
