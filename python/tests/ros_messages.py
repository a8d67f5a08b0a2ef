"""Messages of ROS 2 for pycdr2, the CDR library of Cyclone DDS: an independent encoder of what the package decodes.

The fields are those of the interface definitions. pycdr2 resolves the annotations itself, so they must not be texts.
"""

from dataclasses import dataclass

from pycdr2 import IdlStruct
from pycdr2.types import float64, int32, sequence, uint32


@dataclass
class Time(IdlStruct):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class OnePose(IdlStruct):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct):
    header: Header
    pose: OnePose


@dataclass
class PoseArray(IdlStruct):
    header: Header
    poses: sequence[OnePose]


@dataclass
class JointState(IdlStruct):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]
