"""Types of the dictionaries that the package returns: arrays by name."""

from __future__ import annotations

from typing import TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray

_F32: TypeAlias = NDArray[np.float32]
_F64: TypeAlias = NDArray[np.float64]
_I64: TypeAlias = NDArray[np.int64]
_U64: TypeAlias = NDArray[np.uint64]
_U32: TypeAlias = NDArray[np.uint32]
_Bool: TypeAlias = NDArray[np.bool_]


class LinkResult(TypedDict):
    """The links of users under mirror angles."""

    los_gain: _F64
    irs_gain: _F64
    sinr: _F64
    rate_mbps: _F64
    ber: _F64
    blocked: _Bool


class State(TypedDict):
    """The true state of a room."""

    positions: _F64
    normals: _F64
    blockers: _F64
    headings: _F64
    min_rates_mbps: _F64
    rates_mbps: _F64
    blocked: _Bool
    roll: _F64
    yaw: _F64
    time_s: float


class Reports(TypedDict):
    """Position reports of a recording: one row for each user of each report."""

    arrived_ns: _I64
    time_ns: _I64
    tick: _U64
    user: _U32
    position_m: _F32
    velocity_m_s: _F32
    min_rate_mbps: _F64


class Channels(TypedDict):
    """Channel reports of a recording: one row for each user of each report; gains and SINR are linear."""

    arrived_ns: _I64
    time_ns: _I64
    tick: _U64
    user: _U32
    los_gain: _F32
    irs_gain: _F32
    sinr: _F32


class Commands(TypedDict):
    """Commands of a recording; angles in rad, (n, M)."""

    arrived_ns: _I64
    time_ns: _I64
    epoch: _U64
    sequence: _U64
    answers: _U64
    validity_ms: _U32
    roll: _F32
    yaw: _F32


class Telemetry(TypedDict):
    """Telemetry of a recording; angles as commanded in rad, (n, M)."""

    arrived_ns: _I64
    time_ns: _I64
    answers: _U64
    applied_ns: _I64
    faults: _U32
    roll: _F32
    yaw: _F32


class Truth(TypedDict):
    """The truth of a simulated room in a recording: one row for each user of each message."""

    arrived_ns: _I64
    time_ns: _I64
    tick: _U64
    user: _U32
    position_m: _F32
    heading_rad: _F32
    blocked: _Bool
    rate_mbps: _F64
    min_rate_mbps: _F64
    oracle_sum_rate_mbps: _F64


class Beliefs(TypedDict):
    """The belief of controllers in a recording: one row for each user of each message."""

    arrived_ns: _I64
    time_ns: _I64
    holds_ns: _I64
    tick: _U64
    source: _U64
    user: _U32
    position_m: _F32
    velocity_m_s: _F32
    xx_m2: _F32
    xy_m2: _F32
    yy_m2: _F32
    heading_rad: _F32
    heading_certainty: _F32
    blocked_probability: _F32
