"""The world: rays against a march along them, and the map against the shapes."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from rosld.adapters.rover.grid import RESOLUTION, grid_of
from rosld.adapters.rover.world import small_world

WORLD = small_world()
XS, YS = st.floats(-4.8, 4.8), st.floats(-3.8, 3.8)
ANGLES = st.floats(-10.0, 10.0)


def marched(x: float, y: float, angle: float) -> float:
    """How far it is to a shape along a ray, by steps that are as long as the nearest shape is far."""
    distance = 0.0
    while (clearance := WORLD.clearance(x + distance * math.cos(angle), y + distance * math.sin(angle))) > 1e-7:
        distance += clearance
    return distance


@given(XS, YS, ANGLES)
def test_a_ray_ends_where_a_march_along_it_does(x: float, y: float, angle: float) -> None:
    assume(WORLD.clearance(x, y) > 0.01)
    (distance,) = WORLD.cast(x, y, np.array([angle])).distances
    beside = (angle, angle - 1e-5, angle + 1e-5)  # a ray that only touches a corner may miss it
    assert any(math.isclose(distance, marched(x, y, each), abs_tol=1e-2) for each in beside)


def test_a_ray_has_the_colour_of_what_it_meets() -> None:
    crate = next(box for box in WORLD.boxes if not box.is_mapped)
    (colour,) = WORLD.cast(3.5, 0.0, np.array([math.pi / 2])).colours
    assert tuple(colour) == crate.colour


@given(XS, YS)
def test_the_map_is_occupied_where_a_shape_is_but_for_the_crate(x: float, y: float) -> None:
    mapped = WORLD.as_mapped()
    assume(abs(mapped.clearance(x, y) - RESOLUTION / 2) > RESOLUTION)  # a cell is as good as its centre
    grid = grid_of(mapped)
    row, column = grid.cell(x, y)
    occupied = grid.occupancy().reshape(grid.rows, grid.columns)[row, column]
    assert occupied == (100 if mapped.clearance(x, y) < RESOLUTION / 2 else 0)


def test_the_crate_is_in_the_world_and_not_on_the_map() -> None:
    assert WORLD.clearance(3.5, 1.55) == 0
    assert WORLD.as_mapped().clearance(3.5, 1.55) > 0
