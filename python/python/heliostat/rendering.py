"""A picture of the room from above: walls, mirrors, LEDs, obstacles, users and their rates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ._core import Channel, Scenario

if TYPE_CHECKING:
    from .tables import State

Picture = NDArray[np.uint8]

_HEIGHT = 400
_MARGIN = 16
_FLOOR, _WALL, _LED, _OBSTACLE = (245, 245, 240), (90, 90, 95), (240, 190, 40), (150, 140, 130)
_MIRROR, _MET, _MISSED, _HEADING = (70, 130, 200), (60, 160, 90), (205, 75, 60), (30, 30, 30)
_USER_RADIUS_M = 0.15
_MIRRORS: dict[str, NDArray[np.float64]] = {}


def draw(scenario: Scenario, state: State) -> Picture:
    """The room from above, (400, n, 3). Users are green where their minimum rate is met, otherwise red."""
    length_x, length_y, _ = scenario.room_m
    scale = (_HEIGHT - 2 * _MARGIN) / length_y
    width = int(round(length_x * scale)) + 2 * _MARGIN
    picture: Picture = np.full((_HEIGHT, width, 3), _WALL, np.uint8)
    picture[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] = _FLOOR
    rows, columns = np.mgrid[0:_HEIGHT, 0:width]
    x = (columns - _MARGIN) / scale - length_x / 2
    y = length_y / 2 - (rows - _MARGIN) / scale

    def disc(centre: NDArray[np.float64], radius: float, colour: tuple[int, int, int]) -> None:
        picture[(x - centre[0]) ** 2 + (y - centre[1]) ** 2 <= radius**2] = colour

    for led in scenario.leds_m:
        disc(np.asarray(led), 0.12, _LED)
    for blocker in state["blockers"]:
        disc(blocker, float(blocker[2]), _OBSTACLE)
    for centre in _mirrors(scenario):
        disc(centre, 0.06, _MIRROR)
    rates, needs = state["rates_mbps"], state["min_rates_mbps"]
    for user, (place, heading) in enumerate(zip(state["positions"], state["headings"], strict=True)):
        disc(place, _USER_RADIUS_M, _MET if rates[user] >= needs[user] else _MISSED)
        nose = place[:2] + _USER_RADIUS_M * np.array([np.cos(heading), np.sin(heading)])
        disc(nose, 0.05, _HEADING)
    return picture


def _mirrors(scenario: Scenario) -> NDArray[np.float64]:
    """Centres of the mirrors, computed once for each configuration."""
    if scenario.hash not in _MIRRORS:
        _MIRRORS[scenario.hash] = Channel(scenario).mirror_positions
    return _MIRRORS[scenario.hash]


class Window:
    """A window of pygame that shows pictures."""

    def __init__(self, shape: tuple[int, ...], fps: int) -> None:
        try:
            import pygame
        except ImportError as problem:
            from gymnasium.error import DependencyNotInstalled

            raise DependencyNotInstalled('render_mode="human" needs pygame: pip install "heliostat[render]"') from problem
        self._pygame: Any = pygame
        pygame.display.init()
        self._surface = pygame.display.set_mode((shape[1], shape[0]))
        pygame.display.set_caption("heliostat")
        self._clock = pygame.time.Clock()
        self._fps = fps

    def show(self, picture: Picture) -> None:
        """Shows a picture, and waits for the rest of a frame."""
        self._pygame.event.pump()
        self._surface.blit(self._pygame.surfarray.make_surface(picture.swapaxes(0, 1)), (0, 0))
        self._pygame.display.flip()
        self._clock.tick(self._fps)

    def close(self) -> None:
        """Closes the window."""
        self._pygame.display.quit()
