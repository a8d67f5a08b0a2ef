"""A mirror driver in plain Python: the eclipse-zenoh package carries the messages, the codec of CONTRACT.md reads them.

    pip install eclipse-zenoh
    python3 examples/driver.py ROOM tcp/127.0.0.1:7447 ROWS COLUMNS [SECONDS]

Its mirrors are a list of numbers: put what turns yours into `Mirrors.turn`. Everything else is section 4 of CONTRACT.md.
"""
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
        self.state, self.faults, self.sequence, self.lock = PARKED, 0, 0, threading.Lock()
        self.source = random.getrandbits(63)
        self.last = {"epoch": 0, "sequence": 0, "answers": 0}
        self.valid_until = self.stopped_at = self.received = 0
        self.used, self.used_stamp = 0, None
        self.counters = dict.fromkeys(COUNTERS, 0)
        self.turn([0.0] * self.count, [0.0] * self.count)

    def turn(self, roll, yaw):
        """Your hardware goes here. This one is where it is told to be."""
        self.roll, self.yaw = roll, yaw

    def command(self, payload):
        now = time.time_ns()
        try:
            command = decode(payload, 4)
            if len(command["roll"]) != self.count:
                raise Refused("for another number of mirrors")
        except Refused:
            return self.counted("rejected")
        age = (command["epoch"], command["sequence"])
        if self.state == STOPPED:
            return self.counted("stopped")
        if command["epoch"] < self.last["epoch"]:
            return self.counted("old_epoch")
        if age <= (self.last["epoch"], self.last["sequence"]):
            return self.counted("old_sequence")
        if command["time_ns"] > now + LEAD_NS:
            self.faults |= CLOCK
            return self.counted("expired")
        validity = command["validity_ms"] * 1_000_000
        if now >= command["time_ns"] + validity:
            return self.counted("expired")
        if self.received and self.state != FOLLOWING:
            self.counted("late")
        angles = [[min(max(a, -LIMIT_RAD), LIMIT_RAD) for a in command[axis]] for axis in ("roll", "yaw")]
        if angles != [command["roll"], command["yaw"]]:
            self.counted("clipped")
        self.turn(*angles)
        self.last, self.received, self.faults = command, now, self.faults & ~CLOCK
        self.valid_until, self.state = min(command["time_ns"], now) + validity, FOLLOWING
        self.counted("accepted")

    def counted(self, name):
        self.counters[name] += 1

    def stop(self, payload):
        order = decode(payload, 9)
        if order["action"] == 0:
            self.state, self.stopped_at = STOPPED, max(self.stopped_at, order["stamp"]["time_ns"])
        elif self.state == STOPPED and order["stamp"]["time_ns"] > self.stopped_at:
            self.park()

    def park(self):
        self.state = PARKED
        self.turn([0.0] * self.count, [0.0] * self.count)

    def calibrate(self, payload):
        """These mirrors need none: only one that changes nothing fits their hardware."""
        try:
            new = decode(payload, 10)
            plain = [0.0] * self.count, [1.0] * self.count
            old = self.used_stamp and self.used_stamp["source"] == new["stamp"]["source"]
            if (new["roll_offset_rad"], new["roll_gain"]) != plain or (new["yaw_offset_rad"], new["yaw_gain"]) != plain:
                raise Refused("beyond the hardware")
            if old and new["stamp"]["sequence"] <= self.used:
                raise Refused("an old sequence")
        except Refused:
            self.faults |= CALIBRATION
            return
        self.used, self.used_stamp, self.faults = new["stamp"]["sequence"], new["stamp"], self.faults & ~CALIBRATION

    def pass_time(self):
        now = time.time_ns()
        if self.state == FOLLOWING and now >= self.valid_until:
            self.state = HOLDING
        if self.state == HOLDING and now >= self.valid_until + PARK_AFTER_NS:
            self.park()

    def stamp(self, sequence):
        return {"source": self.source, "sequence": sequence, "time_ns": time.time_ns()}

    def telemetry(self):
        self.sequence += 1
        return encode({
            "stamp": self.stamp(self.sequence), "state": self.state, "epoch": self.last["epoch"],
            "applied_sequence": self.last["sequence"], "answers": self.last["answers"], "received_ns": self.received,
            "applied_ns": self.received, "calibration": self.used, "faults": self.faults, "counters": self.counters,
            "temperature_c": None, "roll_commanded": self.roll, "yaw_commanded": self.yaw, "roll_measured": [],
            "yaw_measured": [], "unusable": []}, 5)

    def capabilities(self, sequence):
        axis = {"min_rad": -LIMIT_RAD, "max_rad": LIMIT_RAD, "slew_rad_s": 0.0, "settling_s": 0.0, "resolution_rad": 0.0}
        return encode({
            "stamp": self.stamp(sequence), "hardware": "numbers", "driver": "driver.py", "rows": self.rows,
            "columns": self.columns, "roll": axis, "yaw": axis, "feedback": 0, "validity_clock": 0,
            "command_rate_max_hz": 0.0, "park_after_ms": PARK_AFTER_NS // 1_000_000, "park_rad": [0.0, 0.0]}, 8)


def main(room, endpoint, rows, columns, seconds="1e9"):
    config = zenoh.Config()
    for key, value in [("mode", '"peer"'), ("connect/endpoints", '["%s"]' % endpoint), ("listen/endpoints", "[]"),
                       ("scouting/multicast/enabled", "false"), ("scouting/gossip/enabled", "false")]:
        config.insert_json5(key, value)
    session = zenoh.open(config)
    mirrors, base = Mirrors(int(rows), int(columns)), "heliostat/v1/%s/" % room

    def hear(key, act):
        def heard(sample):
            with mirrors.lock:
                try:
                    act(bytes(sample.payload))
                except Refused as problem:
                    print("refused:", problem, file=sys.stderr)
        return session.declare_subscriber(base + key, heard)

    declared = [hear("mirrors/command", mirrors.command), hear("mirrors/stop", mirrors.stop),
                hear("mirrors/calibration", mirrors.calibrate)]
    key = base + "mirrors/capabilities"
    declared.append(session.declare_queryable(key, lambda query: query.reply(key, mirrors.capabilities(1))))
    declared.append(session.liveliness().declare_token(base + "alive/driver/%016x" % mirrors.source))
    end = time.monotonic() + float(seconds)
    turns = 0
    while time.monotonic() < end:
        with mirrors.lock:
            mirrors.pass_time()
            told = mirrors.telemetry()
        session.put(base + "mirrors/telemetry", told)
        if turns % 20 == 0:
            session.put(key, mirrors.capabilities(turns // 20 + 1))
        turns += 1
        time.sleep(0.05)
    print("commands applied: %d" % mirrors.counters["accepted"])
    session.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
