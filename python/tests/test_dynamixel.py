"""A chain of Dynamixel X servos as a driver: ROBOTIS' own SDK talks to emulated servos over a pseudo-terminal."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

if os.name != "posix":
    pytest.skip("pseudo-terminals are of POSIX", allow_module_level=True)
pytest.importorskip("dynamixel_sdk", reason="dynamixel-sdk is not installed")
pytest.importorskip("zenoh")
from dynamixel_chain import ERROR, GOAL, MODE, TEMPERATURE, TORQUE, VELOCITY, Chain, crc
from heliostat._port_lock import PortLock
from heliostat.dynamixel import MIDDLE, STEP_RAD, Dynamixel, ServoError
from room import end_by, free_endpoint, needs_program, python, wait_until
from test_driver import verdicts


def angles(*values: float) -> NDArray[np.float64]:
    return np.array(values)


def are_measured(device: Dynamixel, expected: list[list[float]]) -> bool:
    measured = device.measure()
    return measured is not None and np.allclose(measured, expected, atol=STEP_RAD)


def test_the_checksum_of_the_emulated_servos_is_that_of_the_manual() -> None:
    """The example of a ping of servo 1 in the e-Manual: FF FF FD 00 01 03 00 01 19 4E."""
    assert crc(bytes.fromhex("fffffd000103 0001")) == 0x4E19


@needs_program
def test_a_chain_keeps_every_rule_of_the_contract(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with closing(Chain(1, 2, 3, 4)) as servos:
        flags = ("--port", servos.port, "--rows", "1", "--columns", "2", "--servos", "1,2,3,4", "--speed-deg-s", "600")
        with python("-m", "heliostat.dynamixel", *flags, "--connect", endpoint, folder=tmp_path) as driver:
            found = verdicts("--listen", endpoint)
            assert len(found) > 20 and set(found.values()) == {"kept"}, found
            output, _ = end_by(signal.SIGTERM, driver)
        assert "commands accepted: " in output and "commands accepted: 0" not in output


def test_angles_reach_the_servos_of_their_axes_and_come_back_as_measured() -> None:
    with closing(Chain(1, 2, 7, 8)) as servos:
        device = Dynamixel(servos.port, 1, 2, [1, 2, 7, 8], range_rad=0.5, speed_rad_s=20.0, reversed_servos=[8])
        device.connect()
        assert all(servo.get(MODE, 1) == 3 and not servo.get(TORQUE, 1) for servo in servos.servos.values())
        assert servos.servos[1].get(VELOCITY, 4) == int(20.0 / (0.229 * math.tau / 60))
        device.turn(angles(0.1, -0.2), angles(0.3, 0.4))
        device.measure()
        goals = {one: servo.get(GOAL, 4) - MIDDLE for one, servo in servos.servos.items()}
        assert goals == {one: round(angle / STEP_RAD) for one, angle in ((1, 0.1), (2, 0.3), (7, -0.2), (8, -0.4))}
        wait_until("angles", lambda: are_measured(device, [[0.1, -0.2], [0.3, 0.4]]))
        servos.servos[7].set(TEMPERATURE, 1, 70)
        device.measure()
        assert device.health().temperature_c == 70.0


def test_a_stop_switches_the_torque_off_and_reads_it_back() -> None:
    with closing(Chain(1, 2)) as servos:
        device = Dynamixel(servos.port, 1, 1, [1, 2])
        device.connect()
        device.turn(angles(0.2), angles(0.2))
        device.measure()
        assert all(servo.get(TORQUE, 1) for servo in servos.servos.values())
        device.stop()
        assert not any(servo.get(TORQUE, 1) for servo in servos.servos.values())
        # A servo that does not execute the stop.
        device.turn(angles(0.2), angles(0.2))
        device.measure()
        servos.servos[2].write = lambda address, data: 0  # type: ignore[method-assign]
        with pytest.raises(ServoError, match="servo 2 keeps its torque"):
            device.stop()
        servos.servos[2].is_connected = False
        with pytest.raises(ServoError, match="servo 2 does not answer"):
            device.stop()
        assert not servos.servos[1].get(TORQUE, 1)


def test_a_servo_that_falls_silent_makes_its_mirror_unusable_and_keeps_no_other_from_turning() -> None:
    with closing(Chain(1, 2, 3, 4)) as servos:
        device = Dynamixel(servos.port, 1, 2, [1, 2, 3, 4], speed_rad_s=20.0)
        device.connect()
        servos.servos[2].is_connected = False
        device.turn(angles(0.1, 0.1), angles(0.1, 0.1))
        wait_until("others", lambda: are_measured(device, [[0.1, 0.1], [0.0, 0.1]]))
        assert list(device.health().broken) == [0]
        servos.servos[2].is_connected = True
        wait_until("return", lambda: not device.health().broken)
        device.turn(angles(0.1, 0.1), angles(0.1, 0.1))
        wait_until("all", lambda: are_measured(device, [[0.1, 0.1], [0.1, 0.1]]))
        servos.servos[3].set(ERROR, 1, 4)
        wait_until("overheating", lambda: device.health().temperature_fault)
        assert list(device.health().broken) == [1]


def test_servos_that_do_not_answer_are_asked_one_at_a_time_so_that_a_stop_does_not_wait() -> None:
    identifiers = range(1, 13)
    with closing(Chain(*identifiers)) as servos:
        device = Dynamixel(servos.port, 2, 3, list(identifiers))
        device.connect()
        device.turn(np.zeros(6), np.zeros(6))
        for one in list(identifiers)[:-2]:
            servos.servos[one].is_connected = False
        orders: list[int] = []
        exchange = device._exchange

        @contextmanager
        def counted() -> Iterator[None]:
            orders[-1] += 1
            with exchange():
                yield

        device._exchange = counted  # type: ignore[method-assign]

        def is_known() -> bool:
            orders.append(0)
            device.measure()
            orders.append(0)
            return list(device.health().broken) == [0, 1, 2, 3, 4]

        wait_until("mirrors without an answer", is_known)
        # A reading, and the pings up to the first silent servo, which is the only one that lets time pass.
        assert max(orders) <= 2, orders
        orders.append(0)
        # Errors are not due, and a silent servo is.
        device._errors_ns, device._silent_ns = time.monotonic_ns() + 10**12, 0
        device.health()
        assert orders[-1] == 1, "one silent servo, one attempt"


def test_a_chain_without_servos_and_a_port_that_is_absent_are_named() -> None:
    with closing(Chain(9)) as servos, pytest.raises(ServoError, match="no servo answers at .* check power and cable"):
        Dynamixel(servos.port, 1, 1, [1, 2]).connect()
    with pytest.raises(ServoError, match="/dev/absent"):
        Dynamixel("/dev/absent", 1, 1, [1, 2]).connect()
    with closing(Chain(1, 2)) as servos:
        device = Dynamixel(servos.port, 1, 1, [1, 2])
        with pytest.raises(ServoError, match="not connected"):
            device.stop()
        device.connect()
        device.stop()


def test_a_port_that_another_driver_has_is_named_until_it_is_released() -> None:
    with closing(Chain(1, 2)) as servos:
        lock, device = PortLock(), Dynamixel(servos.port, 1, 1, [1, 2])
        lock.take(servos.port)
        with pytest.raises(ServoError, match=f"{servos.port}: .*another process has this port; end the process"):
            device.connect()
        lock.release()
        device.connect()
        with pytest.raises(OSError, match="another process has this port"):
            lock.take(servos.port)


@pytest.mark.parametrize(
    ("servos", "settings", "reason"),
    [
        ([1], {}, "expected two for each"),
        ([1, 1], {}, "different identifiers"),
        ([1, 253], {}, "from 0 to 252"),
        ([1, 2], {"range_rad": math.radians(400)}, "^range of 400 degrees: expected more than 0 and at most 90$"),
        ([1, 2], {"speed_rad_s": 0.0}, r"^speed of 0 degrees/s: expected 1\.374 to 1719$"),
    ],
)
def test_values_that_no_chain_can_have_are_refused(servos: list[int], settings: dict[str, float], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Dynamixel("/dev/null", 1, 1, servos, **settings)  # type: ignore[arg-type]
