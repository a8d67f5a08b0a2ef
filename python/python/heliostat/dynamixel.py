"""A chain of Dynamixel X servos as a driver of mirrors. It needs the extras `zenoh` and `dynamixel`, ROBOTIS' own SDK.

    python -m heliostat.dynamixel --port /dev/ttyUSB0 --rows 1 --columns 2 --servos 1,2,3,4 --connect tcp/127.0.0.1:7447

Each axis of a mirror has a servo on its axle: `--servos` has roll and yaw of mirror 0, then of mirror 1, and so on. The
addresses and the units are those of the control table of the X series (protocol 2.0): 4096 positions in a turn, of which
2048 is the middle.

One packet sets the goals of all servos, and one reads positions, supply and temperatures. A stop switches the torque
off in one packet to all, and reads back that it is off. A servo that does not answer, or that reports a hardware error,
makes its mirror unusable; the others continue. It is asked again about once a second.

A stop waits for the exchange under way. So a measurement has one exchange, and a servo that does not answer is asked
once, and alone.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._port_lock import PortLock
from ._program import USAGE, end_program

try:
    from .driver import Capabilities, Device, Health, main, parser

    try:
        import dynamixel_sdk as sdk
        import serial
    except ImportError as problem:
        raise ImportError('the package dynamixel-sdk is missing: pip install "heliostat[zenoh,dynamixel]"') from problem
except ImportError as missing:
    end_program(__name__, missing)
    raise

STEP_RAD = 2 * math.pi / 4096
"""Angle of one position of the axle."""

MIDDLE = 2048
"""Position at the angle 0."""

ID_MAX = 252
"""Largest identifier of a servo."""

_MODE, _TORQUE, _ERROR, _VELOCITY, _GOAL, _POSITION, _VOLTAGE, _TEMPERATURE = 11, 64, 70, 112, 116, 132, 144, 146
_STATE_LENGTH = _TEMPERATURE + 1 - _POSITION
_POSITION_CONTROL = 3
_VELOCITY_STEP_RAD_S = 0.229 * 2 * math.pi / 60
_SPEED_MAX_RAD_S = 30.0
_PROTOCOL = 2.0
_RETRY_NS = 1_000_000_000
_ATTEMPTS = 3
# Hardware Error Status: 1 input voltage, 4 overheating; the others are of the motor.
_SUPPLY, _OVERHEATING = 1, 4


class ServoError(Exception):
    """A servo, or the port, that does not do what it should; the text names it."""


class Dynamixel(Device):
    """Mirrors on Dynamixel X servos.

    `servos` has the identifiers of roll and yaw of each mirror. `range_rad` is the largest angle either way, and
    `speed_rad_s` the highest speed of an axle, which the servos keep. `reversed_servos` turn in the opposite direction.
    Raises `ValueError` for values that no chain can have.
    """

    def __init__(
        self,
        port: str,
        rows: int,
        columns: int,
        servos: Sequence[int],
        *,
        baud: int = 57600,
        range_rad: float = 0.35,
        speed_rad_s: float = 2.0,
        reversed_servos: Sequence[int] = (),
    ) -> None:
        if len(servos) != 2 * rows * columns:
            raise ValueError(f"{len(servos)} servos: expected two for each of {rows} x {columns} mirrors")
        if len(set(servos)) < len(servos) or not all(0 <= one <= ID_MAX for one in servos):
            raise ValueError(f"servos {list(servos)}: expected different identifiers from 0 to {ID_MAX}")
        if not 0 < range_rad <= math.pi / 2:
            raise ValueError(f"range of {math.degrees(range_rad):g} degrees: expected more than 0 and at most 90")
        if not _VELOCITY_STEP_RAD_S <= speed_rad_s <= _SPEED_MAX_RAD_S:
            least, most = math.degrees(_VELOCITY_STEP_RAD_S), math.degrees(_SPEED_MAX_RAD_S)
            raise ValueError(f"speed of {math.degrees(speed_rad_s):g} degrees/s: expected {least:.4g} to {most:.4g}")
        self.capabilities = Capabilities(
            "Dynamixel X servos",
            rows,
            columns,
            (-range_rad, range_rad),
            (-range_rad, range_rad),
            slew_rad_s=speed_rad_s,
            resolution_rad=STEP_RAD,
            measures=True,
        )
        self._ids, self._baud = list(servos), baud
        self._signs = np.array([-1.0 if one in reversed_servos else 1.0 for one in servos])
        self._speed = max(1, int(speed_rad_s / _VELOCITY_STEP_RAD_S))
        self._port, self._packets = sdk.PortHandler(port), sdk.PacketHandler(_PROTOCOL)
        self._lock = PortLock()
        self._angles = np.zeros(len(servos))
        self._silent: dict[int, str] = {}
        self._errors: dict[int, int] = {}
        self._temperature_c: float | None = None
        self._failed = 0
        self._errors_ns = self._silent_ns = 0
        self._is_powered = False

    def connect(self) -> None:
        """Opens the port and prepares each servo; one that does not answer is left out. Raises where none answers."""
        self._is_powered = False
        self._silent.clear()
        try:
            if self._port.is_open:
                self._port.closePort()
            # Before the SDK opens the port: that discards what has arrived for another driver.
            self._lock.take(self._port.getPortName())
            if not self._port.setBaudRate(self._baud):
                raise ServoError(f"{self._baud} baud: expected a speed of Dynamixel servos, such as 57600 or 1000000")
        except (OSError, serial.SerialException) as problem:
            raise ServoError(f"{self._port.getPortName()}: {problem}") from problem
        self._write(_TORQUE, 1, 0)
        for servo in self._ids:
            self._prepare(servo)
        if len(self._silent) == len(self._ids):
            raise ServoError(f"no servo answers at {self._port.getPortName()} with {self._baud} baud: check power and cable")

    @contextmanager
    def _exchange(self) -> Iterator[None]:
        """One order to the SDK. After a failure the SDK would hold its port as in use for ever."""
        if not self._port.is_open:
            raise ServoError(f"{self._port.getPortName()}: not connected")
        try:
            yield
        except (OSError, serial.SerialException, TypeError) as problem:
            raise ServoError(f"{self._port.getPortName()}: {problem}") from problem
        finally:
            self._port.is_using = False

    def _prepare(self, servo: int, attempts: int = _ATTEMPTS) -> None:
        """Sets mode and speed of a servo whose torque is off; one that does not answer comes last among the silent."""
        self._silent.pop(servo, None)
        send, port, ask = self._packets, self._port, partial(self._ask, servo, attempts=attempts)
        try:
            ask(lambda: send.write1ByteTxRx(port, servo, _TORQUE, 0))
            if ask(lambda: send.read1ByteTxRx(port, servo, _MODE)) != _POSITION_CONTROL:
                ask(lambda: send.write1ByteTxRx(port, servo, _MODE, _POSITION_CONTROL))
            ask(lambda: send.write4ByteTxRx(port, servo, _VELOCITY, self._speed))
            if self._is_powered:
                ask(lambda: send.write1ByteTxRx(port, servo, _TORQUE, 1))
        except ServoError as problem:
            self._silent[servo] = str(problem)

    def _ask(self, servo: int, order: Callable[[], Sequence[int]], attempts: int = _ATTEMPTS) -> int:
        """Orders until the servo answers, a number of times at most; returns the value that it states."""
        for _ in range(attempts):
            with self._exchange():
                *value, result, error = order()
            if result == sdk.COMM_SUCCESS:
                break
        else:
            raise ServoError(f"servo {servo} does not answer: {self._packets.getTxRxResult(result)}")
        # The highest bit only says that the servo has a hardware error, which `health` reads.
        if error & 0x7F:
            raise ServoError(f"servo {servo} refuses an order: {self._packets.getRxPacketError(error)}")
        return int(value[0]) if value else 0

    def _write(self, address: int, length: int, values: int | Sequence[int]) -> None:
        """Writes a value to all servos in one packet, which no servo answers."""
        group = sdk.GroupSyncWrite(self._port, self._packets, address, length)
        for index, servo in enumerate(self._ids):
            value = values if isinstance(values, int) else values[index]
            group.addParam(servo, list(value.to_bytes(length, "little", signed=value < 0)))
        with self._exchange():
            result = group.txPacket()
        if result != sdk.COMM_SUCCESS:
            raise ServoError(f"{self._port.getPortName()}: {self._packets.getTxRxResult(result)}")

    def _read(self, address: int, length: int) -> dict[int, Callable[[int, int], int]] | None:
        """Reads from all servos that answer in one packet; `None` if the answer is incomplete.

        After several such answers in a row a servo that has fallen silent is left out. Raises where none is left.
        """
        answering = [servo for servo in self._ids if servo not in self._silent]
        if not answering:
            raise ServoError(f"no servo answers at {self._port.getPortName()}")
        group = sdk.GroupSyncRead(self._port, self._packets, address, length)
        for servo in answering:
            group.addParam(servo)
        with self._exchange():
            result = group.txRxPacket()
        if result == sdk.COMM_SUCCESS:
            self._failed = 0
            return {servo: partial(group.getData, servo) for servo in answering}
        self._failed += 1
        if self._failed == _ATTEMPTS:
            self._failed = 0
            self._leave_out_silent(answering, result)
        return None

    def _leave_out_silent(self, servos: Sequence[int], result: int) -> None:
        """Leaves out the first servo that does not answer: each answers after the one before it, so one that is missing
        keeps the later ones silent. Raises where all of them answer."""
        for servo in servos:
            try:
                self._ask(servo, partial(self._packets.ping, self._port, servo), attempts=1)
            except ServoError as problem:
                self._silent[servo] = str(problem)
                return
        raise ServoError(f"{self._port.getPortName()}: {self._packets.getTxRxResult(result)}")

    def turn(self, roll: NDArray[np.float64], yaw: NDArray[np.float64]) -> None:
        """Sets the goals of all servos; switches the torque on before the first after a stop."""
        angles = self._signs * np.column_stack([roll, yaw]).reshape(-1)
        if not self._is_powered:
            self._write(_TORQUE, 1, 1)
            self._is_powered = True
        self._write(_GOAL, 4, [MIDDLE + round(float(angle) / STEP_RAD) for angle in angles])

    def stop(self) -> None:
        """Switches the torque of all servos off, and reads back that it is off."""
        self._is_powered = False
        self._write(_TORQUE, 1, 0)
        while (read := self._read(_TORQUE, 1)) is None:
            pass
        powered = [servo for servo, value in read.items() if value(_TORQUE, 1) != 0]
        if powered or self._silent:
            texts = [f"servo {servo} keeps its torque" for servo in powered]
            raise ServoError("; ".join([*texts, *self._silent.values()]))

    def measure(self) -> tuple[Sequence[float], Sequence[float]] | None:
        """Measured angles; of a servo that does not answer the last one, and its mirror is unusable."""
        read = self._read(_POSITION, _STATE_LENGTH)
        if read is None:
            return None
        for index, servo in enumerate(self._ids):
            if servo in read:
                position = np.uint32(read[servo](_POSITION, 4)).astype(np.int32)
                self._angles[index] = self._signs[index] * (float(position) - MIDDLE) * STEP_RAD
        self._temperature_c = max((float(value(_TEMPERATURE, 1)) for value in read.values()), default=None)
        pairs = self._angles.reshape(-1, 2)
        return pairs[:, 0].tolist(), pairs[:, 1].tolist()

    def health(self) -> Health:
        """Temperature and errors; asks one of those servos again that did not answer."""
        now_ns = time.monotonic_ns()
        if now_ns >= self._errors_ns:
            if (read := self._read(_ERROR, 1)) is not None:
                self._errors_ns = now_ns + _RETRY_NS
                self._errors = {servo: value(_ERROR, 1) for servo, value in read.items()}
        elif self._silent and now_ns >= self._silent_ns:
            self._silent_ns = now_ns + _RETRY_NS // len(self._silent)
            self._prepare(next(iter(self._silent)), attempts=1)
        bad = {servo for servo, error in self._errors.items() if error & ~_SUPPLY} | self._silent.keys()
        return Health(
            temperature_c=self._temperature_c,
            temperature_fault=any(error & _OVERHEATING for error in self._errors.values()),
            supply_fault=any(error & _SUPPLY for error in self._errors.values()),
            broken=sorted({index // 2 for index, servo in enumerate(self._ids) if servo in bad}),
        )


def _identifiers(text: str) -> list[int]:
    if not all(part.strip().isdecimal() for part in text.split(",")):
        raise argparse.ArgumentTypeError(f'"{text}": expected identifiers with commas, such as 1,2,3,4')
    return [int(part) for part in text.split(",")]


def _command() -> argparse.ArgumentParser:
    flags = parser(__doc__)
    flags.prog = "python -m heliostat.dynamixel"
    flags.add_argument("--port", required=True, help="serial port, such as /dev/ttyUSB0")
    flags.add_argument("--baud", type=int, default=57600, help="speed of the port [57600]")
    flags.add_argument("--rows", type=int, required=True)
    flags.add_argument("--columns", type=int, required=True)
    flags.add_argument("--servos", metavar="ID,ID,...", type=_identifiers, required=True, help="roll and yaw of each mirror")
    flags.add_argument("--reversed", metavar="ID,ID,...", type=_identifiers, default=[], help="servos that turn the other way")
    flags.add_argument("--range-deg", type=float, default=20.0, help="largest angle either way [20]")
    flags.add_argument("--speed-deg-s", type=float, default=115.0, help="highest speed of an axle [115]")
    return flags


if __name__ == "__main__":
    given = _command().parse_args()
    try:
        mirrors = Dynamixel(
            given.port,
            given.rows,
            given.columns,
            given.servos,
            baud=given.baud,
            range_rad=math.radians(given.range_deg),
            speed_rad_s=math.radians(given.speed_deg_s),
            reversed_servos=given.reversed,
        )
    except ValueError as unusable:
        print(f"error: {unusable}", file=sys.stderr)
        sys.exit(USAGE)
    main(mirrors, given)
