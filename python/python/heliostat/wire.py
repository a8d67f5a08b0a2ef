"""Messages of the contract as dictionaries and bytes, by the codec of the Rust programs.

>>> from heliostat import wire
>>> order = {"stamp": {"source": 7, "sequence": 1, "time_ns": 0}, "action": 0, "operator": "ann", "reason": "test"}
>>> wire.decode(wire.encode(order, wire.KINDS["stop"]), wire.KINDS["stop"]) == order
True

CONTRACT.md has the fields of each kind. An enumeration is its number; a group of fields is a dictionary. Payloads and
messages that the contract does not allow raise `Refused` with the reason.
"""

from ._core import KINDS, Refused, decode, encode, keys, kind_of

__all__ = ["KINDS", "Refused", "decode", "encode", "keys", "kind_of"]
