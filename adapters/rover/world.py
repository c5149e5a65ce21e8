"""World: walls and obstacles on a plane, in metres, and distances to them. No I/O.

The origin is the rover's initial position; x points east, y north. Every shape is `WALL_HEIGHT` high.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

WALL_HEIGHT = 0.8
_PARALLEL = 1e-12

Colour = tuple[int, int, int]
_WALL: Colour = (196, 188, 172)
_INNER_WALL: Colour = (150, 172, 190)
_SHELF: Colour = (139, 94, 60)
_TABLE: Colour = (70, 120, 80)
_PILLAR: Colour = (120, 120, 130)
_CRATE: Colour = (205, 92, 40)


class Box(NamedTuple):
    """A rectangle with sides parallel to the axes; `is_mapped`: it is on the rover's map."""

    left: float
    bottom: float
    right: float
    top: float
    colour: Colour
    is_mapped: bool = True

    def distance(self, x: float, y: float) -> float:
        """Return the distance of a point from the box, 0 inside."""
        return math.hypot(max(self.left - x, 0.0, x - self.right), max(self.bottom - y, 0.0, y - self.top))


class Disc(NamedTuple):
    """A round pillar."""

    x: float
    y: float
    radius: float
    colour: Colour

    def distance(self, x: float, y: float) -> float:
        """Return the distance of a point from the disc, 0 inside."""
        return max(math.hypot(x - self.x, y - self.y) - self.radius, 0.0)


class Hits(NamedTuple):
    """Hits of rays: the distance (inf for none) and colour of each."""

    distances: NDArray[np.float64]
    colours: NDArray[np.uint8]


@dataclass(frozen=True)
class World:
    """Shapes within a rectangle of `width` by `height` metres whose lower left corner is at `left`, `bottom`."""

    left: float
    bottom: float
    width: float
    height: float
    boxes: tuple[Box, ...]
    discs: tuple[Disc, ...]

    def as_mapped(self) -> World:
        """Return the world on the rover's map."""
        boxes = tuple(box for box in self.boxes if box.is_mapped)
        return World(self.left, self.bottom, self.width, self.height, boxes, self.discs)

    def contains(self, x: float, y: float) -> bool:
        """Whether a point lies within the rectangle."""
        return self.left <= x <= self.left + self.width and self.bottom <= y <= self.bottom + self.height

    def clearance(self, x: float, y: float) -> float:
        """Return the distance of a point from the nearest shape, 0 inside one."""
        return min(min(box.distance(x, y) for box in self.boxes), min(disc.distance(x, y) for disc in self.discs))

    def cast(self, x: float, y: float, angles: NDArray[np.float64]) -> Hits:
        """Return the hits of rays from a point in these directions (radians, counterclockwise from x)."""
        dx, dy = np.cos(angles), np.sin(angles)
        distances = np.concatenate([_to_boxes(self.boxes, x, y, dx, dy), _to_discs(self.discs, x, y, dx, dy)])
        nearest = np.argmin(distances, axis=0)
        colours = np.array([box.colour for box in self.boxes] + [disc.colour for disc in self.discs], dtype=np.uint8)
        return Hits(distances[nearest, np.arange(len(angles))], colours[nearest])


def _to_boxes(
    boxes: tuple[Box, ...], x: float, y: float, dx: NDArray[np.float64], dy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance to each box (rows) along each ray (columns), by its slabs; inf where the ray misses it."""
    left, bottom, right, top = np.array([box[:4] for box in boxes]).T[:, :, None]
    dx = np.where(np.abs(dx) < _PARALLEL, _PARALLEL, dx)
    dy = np.where(np.abs(dy) < _PARALLEL, _PARALLEL, dy)
    across, along = ((left - x) / dx, (right - x) / dx), ((bottom - y) / dy, (top - y) / dy)
    enters = np.maximum(np.minimum(*across), np.minimum(*along))
    leaves = np.minimum(np.maximum(*across), np.maximum(*along))
    distances: NDArray[np.float64] = np.where(leaves >= np.maximum(enters, 0.0), np.maximum(enters, 0.0), np.inf)
    return distances


def _to_discs(
    discs: tuple[Disc, ...], x: float, y: float, dx: NDArray[np.float64], dy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance to each disc (rows) along each ray (columns); inf where the ray misses it."""
    centre_x, centre_y, radius = np.array([disc[:3] for disc in discs]).T[:, :, None]
    towards = (centre_x - x) * dx + (centre_y - y) * dy
    within = radius**2 - ((centre_x - x) ** 2 + (centre_y - y) ** 2 - towards**2)
    distance = towards - np.sqrt(np.maximum(within, 0.0))
    distances: NDArray[np.float64] = np.where((within >= 0.0) & (distance >= 0.0), distance, np.inf)
    return distances


@cache
def small_world() -> World:
    """Return two rooms with a door between them, and a store room with its door blocked by a crate not on the map."""
    outer = (
        Box(-5.0, -4.0, 5.0, -3.9, _WALL),
        Box(-5.0, 3.9, 5.0, 4.0, _WALL),
        Box(-5.0, -4.0, -4.9, 4.0, _WALL),
        Box(4.9, -4.0, 5.0, 4.0, _WALL),
    )
    inner = (
        Box(1.5, -4.0, 1.6, -0.8, _INNER_WALL),
        Box(1.5, 0.8, 1.6, 4.0, _INNER_WALL),
        Box(1.6, 1.5, 3.0, 1.6, _INNER_WALL),
        Box(4.0, 1.5, 5.0, 1.6, _INNER_WALL),
    )
    furniture = (
        Box(-4.9, -1.0, -4.4, 1.6, _SHELF),
        Box(-0.6, 2.2, 0.6, 3.0, _TABLE),
        Box(3.2, -3.0, 4.2, -2.2, _TABLE),
        Box(3.2, 1.4, 3.8, 1.8, _CRATE, is_mapped=False),
    )
    pillars = (Disc(-2.5, 1.5, 0.3, _PILLAR), Disc(-2.5, -1.8, 0.25, _PILLAR))
    return World(-5.0, -4.0, 10.0, 8.0, (*outer, *inner, *furniture), pillars)
