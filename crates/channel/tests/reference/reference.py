"""Writes values.json: gains and link figures from code that shares nothing with this crate.

Two sources:

* vlcSim 0.8.1 (PyPI), a public simulator of visible-light networks: direct gain with Lambertian order, field of view and
  concentrator, and the gain of a whole wall that is divided into cells. A wall of flat mirrors under eqs. (2) and (3) is that wall.
  Its private method for one wall is called so that the four walls can be compared one by one; the receiver is on the floor, as vlcSim
  lets light in from below.
* The law of reflection by energy alone, in plain Python: a Newton search finds the point of the mirror from which the reflected
  ray lands on the detector, and the irradiance there is the flux of a small piece of mirror over the area of floor that it lights (the
  Jacobian of the mapping, by central differences). There is no image source and no distance D1 + D2 in it.

Bit error rates come from Python's own math.erfc.

    python3 -m venv venv && venv/bin/pip install vlcSim==0.8.1 && venv/bin/python crates/channel/tests/reference/reference.py
"""

import json
import math
import pathlib
import random

from vlcsim.scene import Receiver, Scenario, VLed

AREA_M2 = 20e-6


def order(half_power_deg):
    return -math.log(2.0) / math.log(math.cos(math.radians(half_power_deg)))


def scene(rho, cells_per_m):
    return Scenario(width=5.0, length=5.0, height=3.0, nGrids=cells_per_m, rho=rho)


def direct_cases(draw):
    cases = []
    for index, concentrator, fov in [(1.0, False, 90.0), (1.5, True, 60.0), (1.5, True, 40.0)]:
        for half_power_deg in (60.0, 40.0, 25.0):
            for _ in range(4):
                x, y, z = draw.uniform(-2.4, 2.4), draw.uniform(-2.4, 2.4), draw.uniform(0.0, 1.8)
                room = scene(0.95, 2)
                room.addVLed(VLed(0.3, -0.2, 3.0, nLedsX=1, nLedsY=1, ledPower=1.0, theta=half_power_deg))
                receiver = Receiver(x, y, z, aDet=AREA_M2, ts=1.0, index=index, fov=fov)
                vled = room.vleds[0]
                gain = room.getPowerInPointFromVled(receiver, 0) / vled.totalPower
                cases.append(
                    dict(x=x, y=y, z=z, half_power_deg=half_power_deg, fov_deg=fov, concentrator=concentrator, gain=gain)
                )
    return cases


WALLS = {"-x": (1, 0), "-y": (0, 1), "+x": (1, 2), "+y": (0, 3)}


def wall_cases(draw):
    cases = []
    for wall, (varies, fixed) in WALLS.items():
        for half_power_deg in (60.0, 45.0):
            x, y = draw.uniform(-2.3, 2.3), draw.uniform(-2.3, 2.3)
            room = scene(0.95, 2)
            room.addVLed(VLed(0.3, -0.2, 3.0, nLedsX=1, nLedsY=1, ledPower=1.0, theta=half_power_deg))
            receiver = Receiver(x, y, 0.0, aDet=AREA_M2, ts=1.0, index=1.0, fov=90.0)
            gain = room._Scenario__channelGainWall(receiver, room.vleds[0], varies, fixed)
            cases.append(dict(wall=wall, x=x, y=y, half_power_deg=half_power_deg, gain=gain))
    return cases


def dot(a, b):
    return sum(p * q for p, q in zip(a, b))


def sub(a, b):
    return [p - q for p, q in zip(a, b)]


def length(a):
    return math.sqrt(dot(a, a))


def landing(source, centre, axes, normal, uv, height):
    """Where the ray over the mirror's point (u, v) meets the plane z = height, and its way there."""
    point = [c + uv[0] * a + uv[1] * b for c, a, b in zip(centre, *axes)]
    ray = sub(point, source)
    out = [r - 2.0 * dot(ray, normal) * n for r, n in zip(ray, normal)]
    if out[2] >= 0.0:
        return None
    t = (height - point[2]) / out[2]
    return [p + t * o for p, o in zip(point, out)][:2], point


def specular_gain(source, n, centre, angles, size, detector):
    roll, yaw = angles
    normal = [-math.sin(yaw) * math.cos(roll), -math.cos(yaw) * math.cos(roll), -math.sin(roll)]
    # Yaw turns the width about z; roll tilts about the width.
    width = [math.cos(yaw), -math.sin(yaw), 0.0]
    up = [-math.sin(yaw) * math.sin(roll), -math.cos(yaw) * math.sin(roll), math.cos(roll)]
    axes = (width, up)
    if dot(sub(source, centre), normal) <= 0.0 or dot(sub(detector, centre), normal) <= 0.0:
        return 0.0
    land = lambda u, v: landing(source, centre, axes, normal, (u, v), detector[2])
    u = v = 0.0
    step = 1e-5
    for _ in range(60):
        here = land(u, v)
        if here is None:
            return 0.0
        (x, y), _ = here
        jacobian = derivative(land, u, v, step)
        if jacobian is None:
            return 0.0
        a, b, c, d = jacobian
        det = a * d - b * c
        dx, dy = detector[0] - x, detector[1] - y
        du, dv = (d * dx - b * dy) / det, (a * dy - c * dx) / det
        scale = min(1.0, 0.2 / max(abs(du), abs(dv), 1e-12))
        u, v = u + scale * du, v + scale * dv
        if max(abs(du), abs(dv)) < 1e-13:
            break
    if abs(u) > size[0] / 2.0 or abs(v) > size[1] / 2.0:
        return 0.0
    a, b, c, d = derivative(land, u, v, step)
    _, point = land(u, v)
    ray = sub(point, source)
    far = length(ray)
    irradiance = -ray[2] / far
    incidence = -dot(ray, normal) / far
    flux_on_mirror = (n + 1.0) / (2.0 * math.pi) * irradiance**n * incidence / far**2
    return AREA_M2 * flux_on_mirror / abs(a * d - b * c)


def derivative(land, u, v, step):
    ends = [land(u + step, v), land(u - step, v), land(u, v + step), land(u, v - step)]
    if any(end is None for end in ends):
        return None
    (xa, ya), (xb, yb), (xc, yc), (xd, yd) = [end[0] for end in ends]
    return (xa - xb) / (2 * step), (xc - xd) / (2 * step), (ya - yb) / (2 * step), (yc - yd) / (2 * step)


def specular_cases(draw):
    """Angles near those that send the light to the detector, some so far off that it misses."""
    cases = []
    size = (0.25, 0.10)
    for index in range(60):
        half_power_deg = (60.0, 40.0)[index % 2]
        side = (0.0, 0.1)[index % 3 == 0]
        led = [draw.uniform(-0.5, 0.5), draw.uniform(-0.5, 0.5), 3.0]
        row, column = draw.randrange(10), draw.randrange(10)
        centre = [(column - 4.5) * 0.27, 2.5, 2.0 + (row - 4.5) * 0.12]
        detector = [draw.uniform(-2.4, 2.4), draw.uniform(-2.4, 2.2), 0.85]
        to_led, to_user = sub(led, centre), sub(detector, centre)
        half = [p / length(to_led) + q / length(to_user) for p, q in zip(to_led, to_user)]
        roll = math.atan2(-half[2], math.hypot(half[0], half[1])) + math.radians(draw.gauss(0.0, 1.2))
        yaw = math.atan2(-half[0], -half[1]) + math.radians(draw.gauss(0.0, 1.2))
        points = [led] if side == 0.0 else [[led[0] + i * side / 4, led[1] + j * side / 4, 3.0] for i in (-1, 1) for j in (-1, 1)]
        gains = [specular_gain(point, order(half_power_deg), centre, (roll, yaw), size, detector) for point in points]
        cases.append(
            dict(led=led, side_m=side, half_power_deg=half_power_deg, mirror=row * 10 + column, roll=roll, yaw=yaw,
                 detector=detector, gain=0.95 * sum(gains) / len(gains))
        )
    return cases


def error_rates():
    return [dict(sinr_db=db, ber=0.5 * math.erfc(math.sqrt(10 ** (db / 10) / 2))) for db in (-20, -3, 0, 3, 6, 8, 10, 12, 15, 18, 20)]


def main():
    draw = random.Random(20250)
    values = dict(direct=direct_cases(draw), wall=wall_cases(draw), specular=specular_cases(draw), error_rate=error_rates())
    target = pathlib.Path(__file__).with_name("values.json")
    target.write_text(json.dumps(values, indent=1) + "\n")


if __name__ == "__main__":
    main()
