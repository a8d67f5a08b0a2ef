"""Dynamixel X servos on a pseudo-terminal: protocol 2.0 and the control table, by the e-Manual of ROBOTIS.

It answers ping, read, write, sync read and sync write. In a sync read a servo answers after the one before it, so one that
is missing keeps the later ones silent.
"""

from __future__ import annotations

import os
import pty
import select
import struct
import threading
import time
import tty

PING, READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x55, 0x82, 0x83
HEADER = b"\xff\xff\xfd\x00"
MODEL, MODE, TORQUE, ERROR, VELOCITY, GOAL, POSITION, VOLTAGE, TEMPERATURE = 0, 11, 64, 70, 112, 116, 132, 144, 146
RANGE_ERROR, ACCESS_ERROR, ALERT = 4, 7, 0x80
VELOCITY_STEP = 0.229 * 4096 / 60  # positions a second


def crc(data: bytes) -> int:
    """CRC-16 with the polynomial 0x8005, bit by bit, initial value 0, not reflected."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x8005 if value & 0x8000 else 0)
            value &= 0xFFFF
    return value


class Servo:
    """One servo: its control table, and an axle that turns to its goal while the torque is on."""

    def __init__(self) -> None:
        self.table = bytearray(160)
        self.position = 2048.0
        self.at = time.monotonic()
        for address, length, value in ((MODEL, 2, 1060), (MODE, 1, 4), (POSITION, 4, 2048), (VOLTAGE, 2, 120), (TEMPERATURE, 1, 31)):
            self.set(address, length, value)
        self.is_connected = True

    def get(self, address: int, length: int) -> int:
        return int.from_bytes(self.table[address : address + length], "little")

    def set(self, address: int, length: int, value: int) -> None:
        self.table[address : address + length] = value.to_bytes(length, "little")

    def move(self) -> None:
        now = time.monotonic()
        step = VELOCITY_STEP * self.get(VELOCITY, 4) * (now - self.at)
        self.at = now
        if self.get(TORQUE, 1):
            away = self.get(GOAL, 4) - self.position
            self.position += max(-step, min(step, away))
        self.set(POSITION, 4, round(self.position))

    def write(self, address: int, data: bytes) -> int:
        if address < 64 and self.get(TORQUE, 1):
            return ACCESS_ERROR
        if address == TORQUE and data[0] and not self.get(TORQUE, 1):
            self.set(GOAL, 4, round(self.position))
        if address == GOAL and not 0 <= int.from_bytes(data, "little") <= 4095:
            return RANGE_ERROR
        self.table[address : address + len(data)] = data
        return 0


class Chain:
    """Servos by identifier, behind a pseudo-terminal whose name is `port`."""

    def __init__(self, *identifiers: int) -> None:
        self.servos = {one: Servo() for one in identifiers}
        self.lock = threading.Lock()
        self.host, self.device = pty.openpty()
        tty.setraw(self.device)
        self.port = os.ttyname(self.device)
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self) -> None:
        received = b""
        while not self.ended.is_set():
            if not select.select([self.host], [], [], 0.05)[0]:
                continue
            try:
                received += os.read(self.host, 4096)
            except OSError:
                return
            while (begin := received.find(HEADER)) >= 0 and len(received) >= begin + 7:
                end = begin + 7 + struct.unpack_from("<H", received, begin + 5)[0]
                if len(received) < end:
                    break
                packet, received = received[begin:end], received[end:]
                assert crc(packet[:-2]) == struct.unpack("<H", packet[-2:])[0]
                with self.lock:
                    for servo in self.servos.values():
                        servo.move()
                    self.handle(packet[4], packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"))

    def answer(self, identifier: int, error: int, parameters: bytes = b"") -> None:
        error |= ALERT if self.servos[identifier].get(ERROR, 1) else 0
        body = (bytes([STATUS, error]) + parameters).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = HEADER + struct.pack("<BH", identifier, len(body) + 2) + body
        os.write(self.host, packet + struct.pack("<H", crc(packet)))

    def handle(self, identifier: int, instruction: int, parameters: bytes) -> None:
        if instruction == SYNC_WRITE:
            address, length = struct.unpack_from("<HH", parameters)
            for first in range(4, len(parameters), 1 + length):
                servo = self.servos.get(parameters[first])
                if servo is not None and servo.is_connected:
                    servo.write(address, parameters[first + 1 : first + 1 + length])
            return
        if instruction == SYNC_READ:
            address, length = struct.unpack_from("<HH", parameters)
            for one in parameters[4:]:
                if one not in self.servos or not self.servos[one].is_connected:
                    return
                self.answer(one, 0, bytes(self.servos[one].table[address : address + length]))
            return
        servo = self.servos.get(identifier)
        if servo is None or not servo.is_connected:
            return
        if instruction == PING:
            self.answer(identifier, 0, bytes(servo.table[:2]) + b"\x2d")
        elif instruction == READ:
            address, length = struct.unpack("<HH", parameters)
            self.answer(identifier, 0, bytes(servo.table[address : address + length]))
        elif instruction == WRITE:
            self.answer(identifier, servo.write(struct.unpack_from("<H", parameters)[0], parameters[2:]))

    def close(self) -> None:
        self.ended.set()
        self.thread.join()
        for end in (self.host, self.device):
            os.close(end)
