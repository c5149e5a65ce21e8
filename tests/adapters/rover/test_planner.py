"""The planner: its paths are free, and it finds one wherever a flood fill of free cells reaches."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rosld.adapters.rover.drive import RADIUS
from rosld.adapters.rover.planner import MARGIN, RESOLUTION, Point, find_path, grid_of, path_length
from rosld.adapters.rover.world import Box, World, small_world

MAPPED = small_world().as_mapped()
GRID = grid_of(MAPPED)
PLACES = st.tuples(st.floats(-4.5, 4.5), st.floats(-3.5, 3.5))


def is_free(place: Point) -> bool:
    return bool(GRID.clearances[GRID.cell(*place)] >= RADIUS + MARGIN)


def flooded(start: Point) -> np.ndarray:
    """Return the cells that free steps reach from the cell of a place."""
    free = GRID.clearances >= RADIUS + MARGIN
    reached = np.zeros_like(free)
    reached[GRID.cell(*start)] = True
    while True:
        grown = reached.copy()
        for rows in (-1, 0, 1):
            for columns in (-1, 0, 1):
                grown |= np.roll(reached, (rows, columns), (0, 1)) & free
        if (grown == reached).all():
            return reached
        reached = grown


@settings(max_examples=30)
@given(PLACES, PLACES)
def test_a_way_is_free_and_no_shorter_than_the_straight_line(start: Point, goal: Point) -> None:
    assume(is_free(start) and is_free(goal))
    corners = find_path(GRID, start, goal)
    assert corners
    assert corners[-1] == goal
    assert path_length(start, corners) >= math.dist(start, goal) - 1e-9
    for (x, y), (to_x, to_y) in pairwise((start, *corners)):
        for share in np.linspace(0, 1, 50):
            clearance = MAPPED.clearance(x + share * (to_x - x), y + share * (to_y - y))
            assert clearance >= RADIUS + MARGIN - 2 * RESOLUTION


@pytest.mark.slow
@settings(max_examples=30)
@given(PLACES)
def test_there_is_a_way_wherever_a_flood_gets_to(goal: Point) -> None:
    assume(is_free(goal))
    assert bool(flooded((0.0, 0.0))[GRID.cell(*goal)]) == bool(find_path(GRID, (0.0, 0.0), goal))


def test_no_way_leads_through_a_wall() -> None:
    walled = World(
        MAPPED.left,
        MAPPED.bottom,
        MAPPED.width,
        MAPPED.height,
        (*MAPPED.boxes, Box(1.5, -0.8, 1.6, 0.8, (0, 0, 0))),
        MAPPED.discs,
    )
    assert find_path(grid_of(walled), (0.0, 0.0), (3.0, 0.0)) == ()
