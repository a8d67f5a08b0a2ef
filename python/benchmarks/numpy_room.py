"""Rooms in NumPy: the references for the speed of `heliostat/Paper-v0` and `heliostat/Static-v0`.

Users on random waypoints, direct paths, mirrors, cylinders that block paths, rates, the reward and the state, as
arrays over users, mirrors, points of the LED's panel and cylinders. `tests/test_benchmark.py` compares the rates with
those of the package.
"""

from __future__ import annotations

from typing import Any

import heliostat
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class PaperRoom:
    """The paper's room with its true state and mirrors that turn at once."""

    scenario = "paper"

    def __init__(self, blockers: Array, seed: int = 1) -> None:
        room = heliostat.Room(self.scenario)
        table = room.scenario.tables()
        led, receiver, mirrors, link = table["led"], table["receiver"], table["mirrors"], table["link"]
        self.mirrors = room.mirror_positions
        self.range_rad = room.scenario.range_rad
        self.length_x, self.length_y, self.height = room.scenario.room_m
        self.order = -np.log(2) / np.log(np.cos(np.radians(led["half_power_semi_angle_deg"])))
        side, points = led["side_m"], led["points_per_side"]
        offsets = ((np.arange(points) + 0.5) / points - 0.5) * side
        grid = np.stack(np.meshgrid(offsets, offsets), -1).reshape(-1, 2)
        centre = np.array(led["positions_m"][0])
        self.led = centre
        self.panel = np.concatenate([centre[:2] + grid, np.full((len(grid), 1), centre[2])], 1)
        area = receiver["area_mm2"] * 1e-6
        fov = np.radians(receiver["fov_deg"])
        gain = receiver["concentrator_index"] ** 2 / np.sin(fov) ** 2 if receiver["concentrator"] else 1.0
        self.front, self.fov_cosine = area * receiver["filter_gain"] * gain, np.cos(fov)
        noise = table["noise"]
        density = noise["background_shot_a2_per_hz"] + noise["thermal_a2_per_hz"] + noise["preamplifier_a2_per_hz"]
        self.bandwidth = link["bandwidth_mhz"] * 1e6
        self.variance = noise.get("variance_a2", density * self.bandwidth)
        power = led["power_w"] ** (2 if table["channel"]["power_law"] == "squared" else 1)
        # e / (2 pi) times the SINR of a gain of 1: paper eqs. (6) and (7).
        self.unit = np.e / (2 * np.pi) * receiver["responsivity_a_per_w"] ** 2 * power / self.variance
        self.scale = table["channel"].get("gain_scale", 1.0)
        plate = mirrors["width_m"] * mirrors["height_m"] * mirrors["reflectivity"]
        towards = self.panel[None] - self.mirrors[:, None]
        squared = (towards**2).sum(-1)
        distance = np.sqrt(squared)
        cosines = np.maximum(towards[..., 2] / distance, 0) ** self.order
        # The array is on the wall +y: the inward normal is -y.
        cosines = cosines * np.maximum(-towards[..., 1] / distance, 0) / squared
        self.lit = (self.order + 1) * plate / (2 * np.pi**2) * cosines.mean(-1)
        self.blockers = blockers
        self.led_clear = self.clear(np.broadcast_to(self.led, self.mirrors.shape), self.mirrors)
        users = table["users"]["count"]
        self.generator = np.random.default_rng(seed)
        self.receiver_height = receiver["height_m"]
        self.speeds = table["users"]["speed_min_m_s"], table["users"]["speed_max_m_s"]
        self.places = self.draw(users)
        self.targets = self.draw(users)
        self.speed = self.generator.uniform(*self.speeds, users)
        self.need = np.full(users, table["users"]["min_rate_mbps"] * 1e6)
        self.angles = np.zeros((2, len(self.mirrors)))

    def draw(self, count: int) -> Array:
        """Places on the floor."""
        flat = self.generator.uniform(-0.5, 0.5, (count, 2)) * (self.length_x, self.length_y)
        return np.concatenate([flat, np.full((count, 1), self.receiver_height)], 1)

    def clear(self, start: Array, end: Array) -> Array:
        """Whether no cylinder meets the segments between two arrays of points, (..., 3)."""
        if len(self.blockers) == 0:
            return np.ones(start.shape[:-1], bool)
        low, high = np.where(start[..., 2:] < end[..., 2:], start, end), np.where(start[..., 2:] < end[..., 2:], end, start)
        rise = high[..., 2] - low[..., 2]
        # The part of the segment below the top of each cylinder.
        top = (self.blockers[:, 3] - low[..., 2, None]) / np.where(rise == 0, 1, rise)[..., None]
        top = np.where(rise[..., None] == 0, np.where(low[..., 2, None] <= self.blockers[:, 3], 1, -1), top)
        along = (high - low)[..., None, :2]
        away = self.blockers[:, :2] - low[..., None, :2]
        length = (along**2).sum(-1)
        nearest = (away * along).sum(-1) / np.where(length == 0, 1, length)
        nearest = np.clip(nearest, 0, np.minimum(top, 1))
        offset = away - nearest[..., None] * along
        blocked = ((offset**2).sum(-1) <= self.blockers[:, 2] ** 2) & (top >= 0)
        return np.asarray(~blocked.any(-1))

    def direct(self) -> Array:
        """Direct gains, (K,)."""
        towards = self.panel[None] - self.places[:, None]
        squared = (towards**2).sum(-1)
        cosine = np.maximum(towards[..., 2] / np.sqrt(squared), 0)
        seen = np.where(cosine >= self.fov_cosine, cosine, 0)
        los = (self.order + 1) * self.front / (2 * np.pi) * (cosine**self.order * seen / squared).mean(-1)
        return np.asarray(los * self.clear(self.places, np.broadcast_to(self.led, self.places.shape)))

    def over_mirrors(self, roll: Array, yaw: Array) -> Array:
        """Gains over the mirrors, (K,)."""
        from_user = self.mirrors[None] - self.places[:, None]
        squared = (from_user**2).sum(-1)
        distance = np.sqrt(squared)
        incidence = from_user[..., 2] / distance
        incidence = np.where((incidence > 0) & (incidence >= self.fov_cosine), incidence, 0)
        tilt = from_user[..., 0] * (np.sin(yaw) * np.cos(roll)) + from_user[..., 1] * (np.cos(yaw) * np.cos(roll))
        tilt = np.maximum((tilt + from_user[..., 2] * np.sin(roll)) / distance, 0)
        starts = np.broadcast_to(self.places[:, None], from_user.shape)
        open_ = self.clear(starts, np.broadcast_to(self.mirrors[None], from_user.shape)) & self.led_clear
        return np.asarray((self.lit * self.front * incidence * tilt / squared * open_).sum(-1) * self.scale)

    def rates_bps(self, roll: Array, yaw: Array) -> Array:
        """Rates in bit/s, (K,)."""
        gain = self.direct() + self.over_mirrors(roll, yaw)
        return np.asarray(self.bandwidth / len(self.places) * np.log2(1 + self.unit * gain**2))

    def step(self, action: Array) -> tuple[Array, float]:
        """The next state, and the reward as printed."""
        self.angles = np.clip(action.reshape(2, -1), -1, 1) * self.range_rad
        rates = self.rates_bps(*self.angles)
        reward = float((rates - np.where(rates >= self.need, self.need, 0)).sum() / self.bandwidth)
        self.walk(1.0)
        los = self.direct()
        extent = (self.length_x / 2, self.length_y / 2, self.height)
        amplitude = np.log1p(np.sqrt(self.unit) * los)
        parts = [np.ones(len(self.places)), self.places / extent, amplitude, self.need * len(self.places) / self.bandwidth]
        return np.concatenate([part.ravel() for part in parts] + [self.angles.ravel() / self.range_rad]), reward

    def walk(self, duration_s: float) -> None:
        """Random waypoints without pauses."""
        left = np.full(len(self.places), duration_s)
        while (left > 0).any():
            way = self.targets - self.places
            distance = np.sqrt((way**2).sum(-1))
            needed = distance / self.speed
            share = np.minimum(left / np.maximum(needed, 1e-12), 1)
            self.places = self.places + way * share[:, None]
            left = np.maximum(left - needed, 0)
            arrived = share >= 1
            if arrived.any():
                self.targets[arrived] = self.draw(int(arrived.sum()))
                self.speed[arrived] = self.generator.uniform(*self.speeds, int(arrived.sum()))


class StaticRoom(PaperRoom):
    """The default room: specular mirrors by the image of the LED's panel, and bodies that block paths.

    The state has the steering gains for a point LED. The package also averages them over the panel and adds a summary
    of the observation, so it does more in a step.
    """

    scenario = "specular"

    def __init__(self, obstacles: Array, seed: int = 1) -> None:
        super().__init__(obstacles, seed)
        table = heliostat.Room(self.scenario).scenario.tables()
        mirrors, blockage = table["mirrors"], table["blockage"]
        self.obstacles = obstacles
        self.body = blockage["body_radius_m"], blockage["body_height_m"], blockage["body_offset_m"]
        self.half = mirrors["width_m"] / 2, mirrors["height_m"] / 2
        self.reflected = mirrors["reflectivity"] * (self.order + 1) * self.front / (2 * np.pi)
        self.to_panel = self.panel[None] - self.mirrors[:, None]
        self.to_led = self.led - self.mirrors
        self.distance_to_led = np.sqrt((self.to_led**2).sum(-1))
        self.block()

    def block(self) -> None:
        """Places the bodies behind the receivers."""
        radius, height, offset = self.body
        way = (self.targets - self.places)[:, :2]
        heading = way / np.maximum(np.sqrt((way**2).sum(-1, keepdims=True)), 1e-12)
        bodies = np.column_stack([self.places[:, :2] - offset * heading, np.full((len(way), 2), (radius, height))])
        self.blockers = np.concatenate([self.obstacles, bodies])
        self.led_clear = self.clear(np.broadcast_to(self.led, self.mirrors.shape), self.mirrors)
        starts = np.broadcast_to(self.places[:, None], (len(self.places), *self.mirrors.shape))
        self.open = self.clear(starts, np.broadcast_to(self.mirrors[None], starts.shape)) & self.led_clear

    def over_mirrors(self, roll: Array, yaw: Array) -> Array:
        """Gains over the mirrors, (K,)."""
        # The array is on the wall +y: at angles of zero the normals are -y.
        normal = np.stack([-np.sin(yaw) * np.cos(roll), -np.cos(yaw) * np.cos(roll), -np.sin(roll)], -1)
        width = np.stack([-normal[:, 1], normal[:, 0], np.zeros(len(normal))], -1)
        width /= np.sqrt((width**2).sum(-1, keepdims=True))
        up = np.cross(width, -normal)
        to_user = self.places[:, None] - self.mirrors[None]
        over_user = (to_user * normal).sum(-1)[..., None]
        over_led = (self.to_panel * normal[:, None]).sum(-1)[None]
        heights = over_user + over_led
        inside = (over_user > 0) & (over_led > 0)
        for axis, half in ((width, self.half[0]), (up, self.half[1])):
            along_user = (to_user * axis).sum(-1)[..., None]
            along_led = (self.to_panel * axis[:, None]).sum(-1)[None]
            inside &= np.abs(over_led * along_user + over_user * along_led) <= half * heights
        image = self.to_panel - 2 * (self.to_panel * normal[:, None]).sum(-1, keepdims=True) * normal[:, None]
        towards_image = image[None] - to_user[:, :, None]
        squared = (towards_image**2).sum(-1)
        towards_image = towards_image / np.sqrt(squared)[..., None]
        incidence = towards_image[..., 2]
        incidence = np.where((incidence > 0) & (incidence >= self.fov_cosine), incidence, 0)
        irradiance = incidence_of(towards_image, normal)
        each = np.where(inside, np.maximum(irradiance, 0) ** self.order / squared * incidence, 0).mean(-1)
        return np.asarray(self.reflected * (each * self.open).sum(-1))

    def steering(self) -> Array:
        """The gain of each mirror for each user if it were aimed at that user, (K, M)."""
        to_user = self.places[:, None] - self.mirrors[None]
        distance = np.sqrt((to_user**2).sum(-1))
        incidence = -to_user[..., 2] / distance
        incidence = np.where((incidence > 0) & (incidence >= self.fov_cosine), incidence, 0)
        irradiance = np.maximum(self.to_led[:, 2] / self.distance_to_led, 0) ** self.order
        return np.asarray(self.reflected * irradiance * incidence / (distance + self.distance_to_led) ** 2 * self.open)

    def step(self, action: Array) -> tuple[Array, float]:
        """The next state, and the reward with a penalty for missing minimum rates."""
        self.angles = np.clip(action.reshape(2, -1), -1, 1) * self.range_rad
        rates = self.rates_bps(*self.angles)
        reward = float((rates - np.maximum(self.need - rates, 0)).sum() / self.bandwidth)
        self.walk(1.0)
        self.block()
        los = self.direct()
        unit = np.sqrt(self.unit)
        parts = [np.ones(len(self.places)), self.places, unit * los, self.need * len(self.places) / self.bandwidth]
        parts += [unit * self.steering(), self.angles]
        return np.concatenate([part.ravel() for part in parts]), reward


def incidence_of(towards_mirror: Array, normal: Array) -> Array:
    """The height component of the direction from the mirror to the source, which the mirror has reflected."""
    along = (towards_mirror * normal[:, None]).sum(-1)
    return np.asarray(towards_mirror[..., 2] - 2 * along * normal[:, None, 2])
