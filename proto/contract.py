"""The codec of CONTRACT.md: decodes and encodes every message, with the standard library only.

Tests run it on the bytes in CONTRACT.md.
"""

import math
import struct

VERSION = 1
MAX_PAYLOAD = 1 << 20


class Refused(ValueError):
    """The payload is not a valid message; the text states the reason."""


# A layout is a type name, ("text", limit), ("bytes", limit), ("list", limit, layout), ("array", count, layout), ("option", layout),
# ("tuple", layout, ...), or a dict of fields in the order of their bytes.
STAMP = {"source": "u64", "sequence": "u64", "time_ns": "u64"}
ANGLES = ("list", 16384, "f32")
OBSTACLES = ("list", 1024, {"x_m": "f32", "y_m": "f32", "radius_m": "f32", "height_m": "f32"})
AXIS = {"min_rad": "f32", "max_rad": "f32", "slew_rad_s": "f32", "settling_s": "f32", "resolution_rad": "f32"}
COUNTERS = dict.fromkeys(
    ["accepted", "clipped", "late", "rejected", "old_epoch", "old_sequence", "expired", "stopped"], "u64")
LAYOUTS = {
    1: {"stamp": STAMP, "tick": "u64", "users": ("list", 64, {
        "user": "u32", "position_m": ("array", 3, "f32"), "velocity_m_s": ("array", 2, "f32"), "min_rate_bps": "f32"})},
    2: {"stamp": STAMP, "tick": "u64", "users": ("list", 64, {
        "user": "u32", "los_gain": "f32", "irs_gain": "f32", "sinr": "f32"})},
    3: {"stamp": STAMP, "obstacles": OBSTACLES},
    4: {"epoch": "u64", "sequence": "u64", "answers": "u64", "time_ns": "u64", "validity_ms": "u32",
        "roll": ANGLES, "yaw": ANGLES},
    5: {"stamp": STAMP, "state": "u32", "epoch": "u64", "applied_sequence": "u64", "answers": "u64",
        "received_ns": "u64", "applied_ns": "u64", "calibration": "u64", "faults": "u32", "counters": COUNTERS,
        "temperature_c": ("option", "f32"), "roll_commanded": ANGLES, "yaw_commanded": ANGLES,
        "roll_measured": ANGLES, "yaw_measured": ANGLES, "unusable": ("list", 16384, "u32")},
    6: {"stamp": STAMP, "node": "u32", "name": "text", "software": "text", "state": "text", "scenario": "text",
        "policy": "text", "started_ns": "u64", "counters": ("list", 256, ("tuple", "text", "u64")),
        "gauges": ("list", 256, ("tuple", "text", "f64")),
        "timings": ("list", 256, ("tuple", "text", "u64", ("array", 5, "f64"))), "last_problem": "text"},
    7: {"stamp": STAMP, "tick": "u64", "users": ("list", 64, {
        "user": "u32", "position_m": ("array", 3, "f32"), "heading_rad": "f32", "los_blocked": "bool",
        "forced": "bool", "los_gain": "f32", "irs_gain": "f32", "sinr": "f32", "rate_bps": "f32",
        "min_rate_bps": "f32"}), "obstacles": OBSTACLES, "sum_rate_bps": ("array", 4, "f64")},
    8: {"stamp": STAMP, "hardware": "text", "driver": "text", "rows": "u32", "columns": "u32", "roll": AXIS,
        "yaw": AXIS, "feedback": "u32", "validity_clock": "u32", "command_rate_max_hz": "f32",
        "park_after_ms": "u32", "park_rad": ("array", 2, "f32")},
    9: {"stamp": STAMP, "action": "u32", "operator": "text", "reason": "text"},
    10: {"stamp": STAMP, "roll_offset_rad": ANGLES, "roll_gain": ANGLES, "yaw_offset_rad": ANGLES, "yaw_gain": ANGLES},
    11: {"stamp": STAMP, "forced_users": ("option", "u32"), "power_w": ("option", "f32"),
         "speed_m_s": ("option", ("array", 2, "f32")), "faults": ("list", 256, {
             "fault": "u32", "seconds": "f32", "share": "f32", "seed": "u64", "mirrors": ("list", 16384, "u32")})},
    12: {"stamp": STAMP, "policy": "text"},
    13: {"stamp": STAMP, "stop_source": "u64", "stop_sequence": "u64", "operator": "text", "reason": "text"},
    14: {"stamp": STAMP, "stopped": "bool", "stop_source": "u64", "stop_sequence": "u64", "stopped_ns": "u64",
         "operator": "text", "reason": "text", "epoch": "u64", "validity_max_ms": "u32", "epoch_lead_max": "u64",
         "sequence_step_max": "u64"},
    15: {"stamp": STAMP, "scenario": ("text", 16384)},
    16: {"stamp": STAMP, "tick": "u64", "holds_ns": "u64", "users": ("list", 64, {
        "user": "u32", "position_m": ("array", 3, "f32"), "velocity_m_s": ("array", 2, "f32"), "xx_m2": "f32",
        "xy_m2": "f32", "yy_m2": "f32", "heading_rad": "f32", "heading_certainty": "f32",
        "blocked_probability": "f32"})},
    17: {"stamp": STAMP, "epoch": "u64", "tick": "u64", "inputs": ("list", 4096, {
        "input": "u32", "source": "u64", "sequence": "u64", "time_ns": "u64", "command": "bool"}),
        "state": ("bytes", 786432)},
    18: {"stamp": STAMP, "users": ("list", 64, {"user": "u32", "quaternion": ("array", 4, "f32")})},
    19: {"stamp": STAMP, "tick": "u64", "users": ("list", 64, {
        "user": "u32", "los_gain": ("list", 16, "f32"), "irs_gain": ("list", 16, "f32")})},
    20: {"stamp": STAMP, "device_stopped": "bool", "stops": ("list", 16, {
        "source": "u64", "sequence": "u64", "arrived_ns": "u64", "operator": "text", "reason": "text"}),
        "released": ("list", 16, {"source": "u64", "sequence": "u64"}), "problem": "text"},
    21: {"stamp": STAMP, "stop_source": "u64", "stop_sequence": "u64", "operator": "text", "reason": "text"},
    22: {"stamp": STAMP, "tick": "u64", "users": ("list", 64, {
        "user": "u32", "serving": ("option", "u32"), "measures_each": "bool"}),
        "gains": ("list", 4096, {"user": "u32", "led": "u32", "los_gain": "f32"})},
}
# Lists that go together, and how many numbers each enumeration has.
PAIRS = {4: [("roll", "yaw")], 5: [("roll_commanded", "yaw_commanded")],
         10: [("roll_offset_rad", "roll_gain"), ("roll_offset_rad", "yaw_offset_rad"), ("roll_offset_rad", "yaw_gain")]}
ENUMERATIONS = {5: {"state": 5}, 6: {"node": 5}, 8: {"feedback": 2, "validity_clock": 2}, 9: {"action": 2}}


def decode(payload, kind):
    """The message of this kind as a dict, or Refused."""
    if len(payload) > MAX_PAYLOAD:
        raise Refused("payload of %d bytes" % len(payload))
    if len(payload) < 1 or payload[0] != VERSION:
        raise Refused("expected version %d" % VERSION)
    if len(payload) < 2 or payload[1] != kind:
        raise Refused("expected kind %d" % kind)
    message, end = _read(payload, 2, LAYOUTS[kind])
    if end != len(payload):
        raise Refused("%d bytes after the last field" % (len(payload) - end))
    _check(message, kind)
    return message


def encode(message, kind):
    """The payload of a dict with the fields of this kind, or Refused."""
    _check(message, kind)
    payload = bytearray([VERSION, kind])
    _write(payload, message, LAYOUTS[kind])
    return bytes(payload)


def _check(message, kind):
    for one, other in PAIRS.get(kind, []):
        if len(message[one]) != len(message[other]):
            raise Refused("%s and %s differ in length" % (one, other))
    for field, count in ENUMERATIONS.get(kind, {}).items():
        if message[field] >= count:
            raise Refused("%s has no number %d" % (field, message[field]))
    if kind == 11 and any(fault["fault"] >= 9 for fault in message["faults"]):
        raise Refused("a fault has an unknown number")
    if kind == 17 and any(entry["input"] >= 10 for entry in message["inputs"]):
        raise Refused("an input has an unknown number")
    if kind == 18 and any(abs(math.hypot(*user["quaternion"]) - 1) > 1e-3 for user in message["users"]):
        raise Refused("a quaternion is not of length 1")
    if kind == 19:
        for user in message["users"]:
            if len(user["los_gain"]) != len(user["irs_gain"]):
                raise Refused("los_gain and irs_gain differ in length")
            if any(gain < 0 for gain in user["los_gain"] + user["irs_gain"]):
                raise Refused("a gain is negative")
    if kind == 22 and any(gain["los_gain"] < 0 for gain in message["gains"]):
        raise Refused("a gain is negative")
    if kind == 5:
        for field in ("roll_measured", "yaw_measured"):
            if len(message[field]) not in (0, len(message["roll_commanded"])):
                raise Refused("%s differs in length" % field)


def _varint(payload, at, bits):
    number = shift = 0
    while True:
        if at >= len(payload):
            raise Refused("the payload ends within a number")
        number |= (payload[at] & 0x7F) << shift
        shift += 7
        at += 1
        if payload[at - 1] < 0x80:
            break
        if shift >= bits:
            raise Refused("a number goes on for too long")
    if number >> bits:
        raise Refused("a number is too large")
    return number, at


def _take(payload, at, count):
    if at + count > len(payload):
        raise Refused("the payload ends within a field")
    return payload[at:at + count], at + count


def _text_limit(layout):
    return 1024 if layout == "text" else layout[1]


def _read(payload, at, layout):
    if isinstance(layout, dict):
        fields = {}
        for name, inner in layout.items():
            fields[name], at = _read(payload, at, inner)
        return fields, at
    if layout in ("u32", "u64"):
        return _varint(payload, at, int(layout[1:]))
    if layout in ("f32", "f64"):
        size, form = (4, "<f") if layout == "f32" else (8, "<d")
        raw, at = _take(payload, at, size)
        number = struct.unpack(form, raw)[0]
        if not math.isfinite(number):
            raise Refused("a number is not finite")
        return number, at
    if layout == "bool":
        raw, at = _take(payload, at, 1)
        if raw[0] > 1:
            raise Refused("a bool is neither 0 nor 1")
        return raw[0] == 1, at
    if layout == "text" or layout[0] == "text":
        length, at = _varint(payload, at, 64)
        if length > _text_limit(layout):
            raise Refused("a text is too long")
        raw, at = _take(payload, at, length)
        try:
            return raw.decode("utf-8"), at
        except UnicodeDecodeError:
            raise Refused("a text is not UTF-8")
    if layout[0] == "bytes":
        length, at = _varint(payload, at, 64)
        if length > layout[1]:
            raise Refused("there are too many bytes")
        return _take(payload, at, length)
    if layout[0] == "option":
        present, at = _read(payload, at, "bool")
        return _read(payload, at, layout[1]) if present else (None, at)
    if layout[0] == "tuple":
        entries = [layout[1 + i] for i in range(len(layout) - 1)]
    elif layout[0] == "array":
        entries = [layout[2]] * layout[1]
    else:
        count, at = _varint(payload, at, 64)
        if count > layout[1]:
            raise Refused("a list has %d entries, more than %d" % (count, layout[1]))
        entries = [layout[2]] * count
    values = []
    for inner in entries:
        value, at = _read(payload, at, inner)
        values.append(value)
    return values, at


def _write(out, value, layout):
    if isinstance(layout, dict):
        for name, inner in layout.items():
            _write(out, value[name], inner)
    elif layout in ("u32", "u64"):
        if not 0 <= value < 1 << int(layout[1:]):
            raise Refused("%d is no %s" % (value, layout))
        while value >= 0x80:
            out.append(value & 0x7F | 0x80)
            value >>= 7
        out.append(value)
    elif layout in ("f32", "f64"):
        if not math.isfinite(value):
            raise Refused("a number is not finite")
        out += struct.pack("<f" if layout == "f32" else "<d", value)
    elif layout == "bool":
        out.append(1 if value else 0)
    elif layout == "text" or layout[0] == "text":
        raw = value.encode("utf-8")
        if len(raw) > _text_limit(layout):
            raise Refused("a text is too long")
        _write(out, len(raw), "u64")
        out += raw
    elif layout[0] == "bytes":
        if len(value) > layout[1]:
            raise Refused("there are too many bytes")
        _write(out, len(value), "u64")
        out += value
    elif layout[0] == "option":
        _write(out, value is not None, "bool")
        if value is not None:
            _write(out, value, layout[1])
    elif layout[0] == "tuple":
        for entry, inner in zip(value, layout[1:]):
            _write(out, entry, inner)
    else:
        if layout[0] == "list":
            if len(value) > layout[1]:
                raise Refused("a list has %d entries, more than %d" % (len(value), layout[1]))
            _write(out, len(value), "u64")
        for entry in value:
            _write(out, entry, layout[2])
