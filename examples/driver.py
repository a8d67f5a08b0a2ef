"""A mirror driver in Python: the package eclipse-zenoh transports the messages, the codec of CONTRACT.md decodes them.

    pip install eclipse-zenoh
    python3 examples/driver.py ROOM tcp/127.0.0.1:7447[,ENDPOINT...] ROWS COLUMNS [SECONDS]

With TLS, open the session with `zenoh.Config.from_file("DIR/zenoh-driver.json5")`, a file of `heliostat keys`.
Its mirrors are lists of angles: replace `Mirrors.turn` with calls of your hardware. The rest implements section 4 of
CONTRACT.md, "Rules for a driver". The emergency stop is kept in $STATE_DIRECTORY, or in the present folder. The first
start is stopped: re-arm it with `heliostat rearm`.
"""
import json
import os
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
VALIDITY_MAX_MS, EPOCH_LEAD_MAX, SEQUENCE_STEP_MAX = 10_000, 60_000, 1 << 32
USAGE = "usage: python3 examples/driver.py ROOM ENDPOINT[,ENDPOINT...] ROWS COLUMNS [SECONDS], ROWS and COLUMNS from 1"
NO_STOP = {"stop_source": 0, "stop_sequence": 0, "stopped_ns": 0, "operator": "", "reason": ""}


class StopFile:
    """The emergency stop on disk. An unknown state is a stop."""

    def __init__(self, room):
        self.path = pathlib.Path(os.environ.get("STATE_DIRECTORY", "."), "driver-%s.stop.json" % room)

    def read(self):
        try:
            stop = json.loads(self.path.read_text(encoding="utf-8"))
            return stop if stop is None else {**NO_STOP, **{name: stop[name] for name in NO_STOP}}
        except (OSError, ValueError, KeyError, TypeError) as problem:
            return {**NO_STOP, "stopped_ns": time.time_ns(), "reason": "the last state is unknown: %s" % problem}

    def write(self, stop):
        """A new file replaces the old one at once; an empty file is an unknown state. False if it is not written."""
        try:
            new = self.path.with_suffix(".new")
            with open(new, "w", encoding="utf-8") as file:
                json.dump(stop, file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(new, self.path)
            return True
        except OSError as problem:
            print("cannot record the emergency stop: %s; the next start must be stopped" % problem, file=sys.stderr)
        try:
            self.path.write_text("", encoding="utf-8")
        except OSError as problem:
            print("cannot empty the old record, stop again after the next start:", problem, file=sys.stderr)
        return False


# In a room with keys every process may publish mirrors/stop: there only mirrors/rearm releases a stop.
HAS_KEYS = False


class Mirrors:
    def __init__(self, rows, columns, stop_file):
        self.rows, self.columns, self.count, self.stop_file = rows, columns, rows * columns, stop_file
        self.faults, self.valid_until, self.stopped_at, self.received = 0, 0, 0, 0
        self.source = random.getrandbits(63)
        self.last = {"epoch": 0, "sequence": 0, "answers": 0}
        self.used = {"source": 0, "sequence": 0}
        self.counters = dict.fromkeys(COUNTERS, 0)
        self.park()
        self.latch = stop_file.read()
        if not stop_file.write(self.latch) and self.latch is None:
            self.latch = {**NO_STOP, "stopped_ns": time.time_ns(), "reason": "the stop cannot be recorded"}
        if self.latch is not None:
            self.state, self.stopped_at = STOPPED, min(self.latch["stopped_ns"], time.time_ns())
            print("starts stopped:", self.latch["reason"], file=sys.stderr)

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
        if now >= command["time_ns"] + command["validity_ms"] * 1_000_000:
            return "expired"
        first = self.last["sequence"] if command["epoch"] == self.last["epoch"] else 0
        beyond = (command["epoch"] > max(now // 1_000_000, self.last["epoch"]) + EPOCH_LEAD_MAX
                  or command["sequence"] > first + SEQUENCE_STEP_MAX or command["validity_ms"] > VALIDITY_MAX_MS)
        return "rejected" if beyond else None

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
        order, now = decode(payload, 9), time.time_ns()
        stamp = order["stamp"]
        if order["action"] == 0:
            self.state, self.stopped_at = STOPPED, max(self.stopped_at, min(stamp["time_ns"], now))
            self.set_latch({"stop_source": stamp["source"], "stop_sequence": stamp["sequence"], "stopped_ns": now,
                            "operator": order["operator"], "reason": order["reason"]})
        elif not HAS_KEYS and self.state == STOPPED and stamp["time_ns"] > self.stopped_at:
            self.release()

    def rearm(self, payload):
        """Releases the stop that the message names; times do not matter."""
        order = decode(payload, 13)
        if self.state == STOPPED and all(order[name] == self.latch[name] for name in ("stop_source", "stop_sequence")):
            self.release()

    def release(self):
        self.stopped_at = 0
        self.park()
        self.set_latch(None)

    def set_latch(self, stop):
        """Called before telemetry reports the state, and after the mirrors have stopped."""
        self.latch = stop
        self.stop_file.write(stop)

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

    def status(self, sequence, started_ns):
        states = ("parked", "following", "holding", "stopped")
        return encode({
            "stamp": self.stamp(sequence), "node": 2, "name": "%016x" % self.source, "software": "driver.py",
            "state": "array " + states[self.state], "scenario": "", "policy": "", "started_ns": started_ns,
            "counters": [("commands", self.counters["accepted"])], "gauges": [], "timings": [], "last_problem": ""}, 6)

    def safety(self, sequence):
        return encode({
            "stamp": self.stamp(sequence), "stopped": self.latch is not None, **(self.latch or NO_STOP),
            "epoch": self.last["epoch"], "validity_max_ms": VALIDITY_MAX_MS, "epoch_lead_max": EPOCH_LEAD_MAX,
            "sequence_step_max": SEQUENCE_STEP_MAX}, 14)


def arguments(room, endpoints, rows, columns, seconds="1e9"):
    """The typed arguments of the command line; TypeError or ValueError for others."""
    given = room, endpoints, int(rows), int(columns), float(seconds)
    if min(given[2:4]) < 1:
        raise ValueError("an array without mirrors")
    return given


def main(room, endpoints, rows, columns, seconds):
    config = zenoh.Config()
    for key, value in {"mode": "peer", "connect/endpoints": endpoints.split(","), "listen/endpoints": [],
                       "scouting/multicast/enabled": False, "scouting/gossip/enabled": False}.items():
        config.insert_json5(key, json.dumps(value))
    mirrors, lock = Mirrors(rows, columns, StopFile(room)), threading.Lock()
    base = "heliostat/v1/%s/" % room

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
            ("mirrors/command", mirrors.command), ("mirrors/stop", mirrors.stop), ("mirrors/rearm", mirrors.rearm),
            ("mirrors/calibration", mirrors.calibrate)]]
        key, safety_key = base + "mirrors/capabilities", base + "mirrors/safety"
        declared.append(session.declare_queryable(key, lambda query: query.reply(key, mirrors.capabilities(1))))
        declared.append(session.declare_queryable(safety_key, lambda query: query.reply(safety_key, mirrors.safety(1))))
        declared.append(session.liveliness().declare_token(base + "alive/driver/%016x" % mirrors.source))
        end, turn, reported, reports = time.monotonic() + seconds, 0, None, 0
        started_ns = time.time_ns()
        while time.monotonic() < end:
            with lock:
                mirrors.pass_time()
                telemetry = mirrors.telemetry(turn + 1)
                latch, safety = mirrors.latch, mirrors.safety(reports + 1)
            session.put(base + "mirrors/telemetry", telemetry)
            if turn % 20 == 0 or latch != reported:
                session.put(safety_key, safety)
                reported, reports = latch, reports + 1
            if turn % 20 == 0:
                session.put(key, mirrors.capabilities(turn // 20 + 1))
                session.put(base + "status/driver", mirrors.status(turn // 20 + 1, started_ns))
            turn += 1
            time.sleep(0.05)
    print("commands applied: %d" % mirrors.counters["accepted"])


if __name__ == "__main__":
    try:
        given = arguments(*sys.argv[1:])
    except (TypeError, ValueError):
        print(USAGE, file=sys.stderr)
        sys.exit(2)
    main(*given)
