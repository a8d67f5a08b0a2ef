"""Writes tilted.json: gains of tilted receivers from code that shares nothing with this crate.

Everything is matrices in numpy. A tilt is Rz(azimuth) Ry(polar) Rz(-azimuth); any other orientation is the matrix of a quaternion. The
gain over a mirror is the direct gain to the mirrored detector: the Householder matrix of the mirror reflects the detector's position and
normal, and the straight line from the LED to the mirrored detector must pass through the mirror's rectangle. The crate mirrors the LED
instead, and rotates by a formula of quaternions without matrices.

    python3 -m venv venv && venv/bin/pip install numpy && venv/bin/python crates/channel/tests/reference/tilted.py
"""

import json
import pathlib

import numpy as np

AREA_M2 = 20e-6
RHO = 0.95
# Rotation about z from the wall at +y to the wall of the array.
WALLS = {"+y": 0.0, "+x": -90.0, "-y": 180.0, "-x": 90.0}
ROWS, COLUMNS = 2, 3
WIDTH_M, HEIGHT_M, GAP_M = 0.25, 0.10, 0.02


def about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def about_y(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def about_x(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def of_quaternion(q):
    w, x, y, z = q
    return np.array([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])


def direct(point, n, branch, position, normal):
    """Gain from one point of an LED that faces down to a detector of this normal."""
    ray = position - point
    distance = np.linalg.norm(ray)
    down, facing = -ray[2] / distance, -(ray @ normal) / distance
    if down <= 0.0 or facing <= 0.0 or np.degrees(np.arccos(min(facing, 1.0))) > branch["fov_deg"]:
        return 0.0
    concentrator = (1.5 / np.sin(np.radians(branch["fov_deg"]))) ** 2 if branch["concentrator"] else 1.0
    return concentrator * (n + 1.0) * AREA_M2 / (2.0 * np.pi) * down**n * facing / distance**2


def over_mirror(point, n, branch, position, normal, centre, axes):
    """The same by way of a mirror, whose matrix `axes` has width, normal and height as columns."""
    facing = axes[:, 1]
    householder = np.eye(3) - 2.0 * np.outer(facing, facing)
    if (point - centre) @ facing <= 0.0 or (position - centre) @ facing <= 0.0:
        return 0.0
    image = centre + householder @ (position - centre)
    share = (centre - point) @ facing / ((image - point) @ facing)
    hit = axes.T @ (point + share * (image - point) - centre)
    if abs(hit[0]) > WIDTH_M / 2 or abs(hit[2]) > HEIGHT_M / 2:
        return 0.0
    return RHO * direct(point, n, branch, image, householder @ normal)


def panel(led, side_m, points_per_side):
    pitch = side_m / points_per_side
    steps = (np.arange(points_per_side) - (points_per_side - 1) / 2.0) * pitch
    return [led + np.array([x, y, 0.0]) for x in steps for y in steps]


def mirrors(wall):
    turn = about_z(np.radians(WALLS[wall]))
    centres = []
    for row in range(ROWS):
        for column in range(COLUMNS):
            x = (column - (COLUMNS - 1) / 2.0) * (WIDTH_M + GAP_M)
            z = 2.0 + (row - (ROWS - 1) / 2.0) * (HEIGHT_M + GAP_M)
            centres.append(turn @ np.array([x, 2.5, z]))
    return turn, centres


def aimed(turn, centre, led, position):
    """Roll and yaw of a mirror that reflects the LED's centre to a detector."""
    half = (led - centre) / np.linalg.norm(led - centre) + (position - centre) / np.linalg.norm(position - centre)
    half = turn.T @ half
    return np.arctan2(-half[2], np.hypot(half[0], half[1])), np.arctan2(-half[0], -half[1])


def axes_of(turn, roll, yaw):
    """At zero angles the width is x, the normal -y and the height z; positive roll tilts the normal down."""
    base = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]).T
    return turn @ about_z(-yaw) @ about_x(roll) @ base


def orientation(draw, index):
    if index % 3 == 2:
        q = draw.normal(size=4)
        q /= np.linalg.norm(q)
        # Not far from upright, so that light arrives.
        q = np.array([3.0, 0.0, 0.0, 0.0]) + q
        q /= np.linalg.norm(q)
        return dict(quaternion=q.tolist()), of_quaternion(q)
    polar, azimuth = draw.uniform(0.0, 1.2), draw.uniform(-np.pi, np.pi)
    return dict(polar=polar, azimuth=azimuth), about_z(azimuth) @ about_y(polar) @ about_z(-azimuth)


def receiver(draw, index):
    concentrator = index % 4 == 1
    if index % 2 == 0:
        return [dict(normal=[0.0, 0.0, 1.0], fov_deg=(90.0, 60.0)[index % 4 == 2], concentrator=concentrator)]
    branches = [dict(normal=[0.0, 0.0, 1.0], fov_deg=40.0, concentrator=concentrator)]
    for azimuth in range(0, 360, 72):
        normal = about_z(np.radians(azimuth)) @ about_y(np.radians(45.0)) @ np.array([0.0, 0.0, 1.0])
        branches.append(dict(normal=normal.tolist(), fov_deg=draw.uniform(30.0, 60.0), concentrator=concentrator))
    return branches


def case(draw, index):
    half_power_deg = (60.0, 40.0)[index % 5 == 3]
    n = -np.log(2.0) / np.log(np.cos(np.radians(half_power_deg)))
    led = np.array([draw.uniform(-0.8, 0.8), draw.uniform(-0.8, 0.8), 3.0])
    side_m, points_per_side = ((0.0, 1), (0.1, 2), (0.1, 3))[index % 3]
    points = panel(led, side_m, points_per_side)
    position = np.array([draw.uniform(-2.2, 2.2), draw.uniform(-2.2, 2.2), draw.uniform(0.3, 1.4)])
    held, matrix = orientation(draw, index)
    branches = receiver(draw, index)
    wall = list(WALLS)[index % 4]
    turn, centres = mirrors(wall)
    angles, reflected = [], []
    for centre in centres:
        roll, yaw = aimed(turn, centre, led, position)
        roll, yaw = roll + draw.normal(0.0, 0.006), yaw + draw.normal(0.0, 0.006)
        axes = axes_of(turn, roll, yaw)
        angles.append([roll, yaw])
        reflected.append([
            np.mean([over_mirror(point, n, branch, position, matrix @ branch["normal"], centre, axes) for point in points])
            for branch in branches
        ])
    straight = [np.mean([direct(point, n, branch, position, matrix @ branch["normal"]) for point in points]) for branch in branches]
    return dict(
        half_power_deg=half_power_deg, led=led.tolist(), side_m=side_m, points_per_side=points_per_side, wall=wall,
        position=position.tolist(), branches=branches, angles=angles, direct=straight, reflected=reflected, **held,
    )


def main():
    draw = np.random.default_rng(1905)
    target = pathlib.Path(__file__).with_name("tilted.json")
    cases = [json.dumps(case(draw, index)) for index in range(48)]
    target.write_text("[\n" + ",\n".join(cases) + "\n]\n")


if __name__ == "__main__":
    main()
