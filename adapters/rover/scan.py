"""The laser scanner: the distances all around, from the middle of the rover. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.rover.drive import Motion
from rosld.adapters.rover.world import World

BEAMS = 360
FIRST = -math.pi
"""The direction of the first beam: straight behind."""
INCREMENT = math.tau / BEAMS
NEAREST = 0.05
FARTHEST = 8.0
_ANGLES: NDArray[np.float64] = FIRST + INCREMENT * np.arange(BEAMS, dtype=np.float64)


def scan(world: World, motion: Motion) -> NDArray[np.float32]:
    """The distance that each beam measures; inf for what is too far (REP 117)."""
    distances = world.cast(motion.x, motion.y, motion.heading + _ANGLES).distances
    return np.where(distances <= FARTHEST, distances, np.inf).astype(np.float32)
