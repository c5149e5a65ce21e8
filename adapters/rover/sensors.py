"""Sensors: the camera image, with one ray per column, and the laser scan. No I/O."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.rover.drive import Motion
from rosld.adapters.rover.world import WALL_HEIGHT, World

WIDTH = 160
HEIGHT = 120
FOCAL_LENGTH = 140.0
"""Focal length of both axes in pixels: a horizontal view of 60 degrees."""
CENTRE = (WIDTH / 2, HEIGHT / 2)
MOUNTED_AT = 0.3
"""Height of the camera above the floor, in metres."""
_NEAREST = 0.05
_DARK, _LIT = 0.55, 1.0
_FADING = 0.12
"""Decrease of brightness per metre."""
_CEILING = (214, 224, 232)
_FLOOR = (116, 112, 106)
_BEARINGS = np.arctan2(CENTRE[0] - 0.5 - np.arange(WIDTH), FOCAL_LENGTH)
_BELOW = np.arange(HEIGHT)[:, None] + 0.5 - CENTRE[1]
"""Distance in pixels of the centre of each row below the horizon."""


def image(world: World, motion: Motion, lights: bool) -> NDArray[np.uint8]:
    """Return an image of `HEIGHT` rows, `WIDTH` columns, and red, green and blue."""
    hits = world.cast(motion.x, motion.y, motion.heading + _BEARINGS)
    depths = np.maximum(hits.distances * np.cos(_BEARINGS), _NEAREST)
    top, bottom = FOCAL_LENGTH * (MOUNTED_AT - WALL_HEIGHT) / depths, FOCAL_LENGTH * MOUNTED_AT / depths
    is_wall = (top <= _BELOW) & (bottom >= _BELOW)
    floor = FOCAL_LENGTH * MOUNTED_AT / np.maximum(_BELOW, 1.0)
    pixels = np.where((_BELOW > 0)[:, :, None], _FLOOR * _light(floor, lights)[:, :, None], _CEILING)
    walls = hits.colours * _light(depths, lights)[:, None]
    frame: NDArray[np.uint8] = np.where(is_wall[:, :, None], walls[None, :, :], pixels).astype(np.uint8)
    return frame


def _light(distances: NDArray[np.float64], lights: bool) -> NDArray[np.float64]:
    """Return the brightness at these distances, from 0 to 1."""
    brightness: NDArray[np.float64] = (_LIT if lights else _DARK) / (1 + _FADING * distances)
    return brightness


BEAMS = 360
FIRST = -math.pi
"""Direction of the first beam: straight back."""
INCREMENT = math.tau / BEAMS
NEAREST = 0.05
FARTHEST = 8.0
_ANGLES: NDArray[np.float64] = FIRST + INCREMENT * np.arange(BEAMS, dtype=np.float64)


def scan(world: World, motion: Motion) -> NDArray[np.float32]:
    """Return the distance that each beam measures; inf if it is out of range (REP 117)."""
    distances = world.cast(motion.x, motion.y, motion.heading + _ANGLES).distances
    return np.where(distances <= FARTHEST, distances, np.inf).astype(np.float32)
