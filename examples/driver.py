"""A mirror driver in Python: the package eclipse-zenoh transports the messages, the codec of CONTRACT.md decodes them.

    pip install eclipse-zenoh
    python3 examples/driver.py ROOM tcp/127.0.0.1:7447[,ENDPOINT...] ROWS COLUMNS [SECONDS]

Its mirrors are lists of angles: replace `Mirrors.turn` with calls of your hardware. The rest implements section 4 of
CONTRACT.md, "Rules for a driver".
"""
import json
import pathlib
import random
import sys
import threading
import time

import zenoh

CONTRACT = (pathlib.Path(__file__).parent.parent / "CONTRACT.md").read_text(encoding="utf-8")
exec(CONTRACT.split("```python\n")[1].split("```")[0])  # decode, encode, Refused

PARKED, FOLLOWING, HOLDING, STOPPED = range(4)
LIMIT_RAD, PARK_AFTER_NS, LEAD_NS = 1.5, 300_000_000, 50_000_000
CLOCK, CALIBRATION = 32, 16


class Mirrors:
    def __init__(self, rows, columns):
        self.rows, self.columns, self.count = rows, columns, rows * columns
        self.faults, self.valid_until, self.stopped_at, self.received = 0, 0, 0, 0
        self.source = random.getrandbits(63)
        self.last = {"epoch": 0, "sequence": 0, "answers": 0}
        self.used = {"source": 0, "sequence": 0}
        self.counters = dict.fromkeys(COUNTERS, 0)
        self.park()

    def turn(self, roll, yaw):
        """Replace this with calls of your hardware. These mirrors reach every commanded angle at once."""
        self.roll, self.yaw = roll, yaw

    def park(self):
        self.state = PARKED
        self.turn([0.0] * self.count, [0.0] * self.count)

    def refusal(self, command, now):
        """The counter of a refused command, or None for a command to apply. The rules of section 4 in their order."""
        if len(command["roll"]) != self.count:
            return "rejected"
        if self.state == STOPPED:
            return "stopped"
        if command["epoch"] < self.last["epoch"]:
            return "old_epoch"
        if (command["epoch"], command["sequence"]) <= (self.last["epoch"], self.last["sequence"]):
            return "old_sequence"
        if command["time_ns"] > now + LEAD_NS:
            self.faults |= CLOCK
            return "expired"
        return "expired" if now >= command["time_ns"] + command["validity_ms"] * 1_000_000 else None

    def command(self, payload):
        now = time.time_ns()
        try:
            command = decode(payload, 4)
            refusal = self.refusal(command, now)
        except Refused:
            refusal = "rejected"
        if refusal:
            self.counters[refusal] += 1
            return
        angles = [[min(max(a, -LIMIT_RAD), LIMIT_RAD) for a in command[axis]] for axis in ("roll", "yaw")]
        self.turn(*angles)
        self.counters["accepted"] += 1
        self.counters["clipped"] += angles != [command["roll"], command["yaw"]]
        self.counters["late"] += self.received > 0 and self.state != FOLLOWING
        self.last, self.received, self.faults, self.state = command, now, self.faults & ~CLOCK, FOLLOWING
        self.valid_until = min(command["time_ns"], now) + command["validity_ms"] * 1_000_000

    def stop(self, payload):
        order = decode(payload, 9)
        if order["action"] == 0:
            self.state, self.stopped_at = STOPPED, max(self.stopped_at, order["stamp"]["time_ns"])
        elif self.state == STOPPED and order["stamp"]["time_ns"] > self.stopped_at:
            self.park()

    def calibrate(self, payload):
        """Accepts only a calibration that changes nothing, since these mirrors have no errors to correct."""
        self.faults |= CALIBRATION
        new = decode(payload, 10)
        lists = [new[axis + part] for part in ("_offset_rad", "_gain") for axis in ("roll", "yaw")]
        old = self.used["source"] == new["stamp"]["source"] and new["stamp"]["sequence"] <= self.used["sequence"]
        if lists == [[0.0] * self.count] * 2 + [[1.0] * self.count] * 2 and not old:
            self.used, self.faults = new["stamp"], self.faults & ~CALIBRATION

    def pass_time(self):
        now = time.time_ns()
        if self.state == FOLLOWING and now >= self.valid_until:
            self.state = HOLDING
        if self.state == HOLDING and now >= self.valid_until + PARK_AFTER_NS:
            self.park()

    def stamp(self, sequence):
        return {"source": self.source, "sequence": sequence, "time_ns": time.time_ns()}

    def telemetry(self, sequence):
        return encode({
            "stamp": self.stamp(sequence), "state": self.state, "epoch": self.last["epoch"],
            "applied_sequence": self.last["sequence"], "answers": self.last["answers"], "received_ns": self.received,
            "applied_ns": self.received, "calibration": self.used["sequence"], "faults": self.faults,
            "counters": self.counters, "temperature_c": None, "roll_commanded": self.roll, "yaw_commanded": self.yaw,
            "roll_measured": [], "yaw_measured": [], "unusable": []}, 5)

    def capabilities(self, sequence):
        axis = {"min_rad": -LIMIT_RAD, "max_rad": LIMIT_RAD, "slew_rad_s": 0.0, "settling_s": 0.0, "resolution_rad": 0.0}
        return encode({
            "stamp": self.stamp(sequence), "hardware": "numbers", "driver": "driver.py", "rows": self.rows,
            "columns": self.columns, "roll": axis, "yaw": axis, "feedback": 0, "validity_clock": 0,
            "command_rate_max_hz": 0.0, "park_after_ms": PARK_AFTER_NS // 1_000_000, "park_rad": [0.0, 0.0]}, 8)


def main(room, endpoints, rows, columns, seconds="1e9"):
    config = zenoh.Config()
    for key, value in {"mode": "peer", "connect/endpoints": endpoints.split(","), "listen/endpoints": [],
                       "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    mirrors, lock, base = Mirrors(int(rows), int(columns)), threading.Lock(), "heliostat/v1/%s/" % room

    def locked(handle):
        def callback(sample):
            with lock:
                try:
                    handle(bytes(sample.payload))
                except Refused as problem:
                    print("refused:", problem, file=sys.stderr)
        return callback

    with zenoh.open(config) as session:
        declared = [session.declare_subscriber(base + key, locked(handle)) for key, handle in [
            ("mirrors/command", mirrors.command), ("mirrors/stop", mirrors.stop),
            ("mirrors/calibration", mirrors.calibrate)]]
        key = base + "mirrors/capabilities"
        declared.append(session.declare_queryable(key, lambda query: query.reply(key, mirrors.capabilities(1))))
        declared.append(session.liveliness().declare_token(base + "alive/driver/%016x" % mirrors.source))
        end, turn = time.monotonic() + float(seconds), 0
        while time.monotonic() < end:
            with lock:
                mirrors.pass_time()
                telemetry = mirrors.telemetry(turn + 1)
            session.put(base + "mirrors/telemetry", telemetry)
            if turn % 20 == 0:
                session.put(key, mirrors.capabilities(turn // 20 + 1))
            turn += 1
            time.sleep(0.05)
    print("commands applied: %d" % mirrors.counters["accepted"])


if __name__ == "__main__":
    main(*sys.argv[1:])
