"""The occupancy grid of a world: which cells a shape touches, and which are far enough from all for the rover. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.rover.world import World

RESOLUTION = 0.1
"""Metres of a cell's side."""

Cell: TypeAlias = "tuple[int, int]"


@dataclass(frozen=True, eq=False)
class Grid:
    """The clearance of the centre of each cell, by row (south to north) and column (west to east)."""

    left: float
    bottom: float
    clearances: NDArray[np.float64]

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return int(self.clearances.shape[0])

    @property
    def columns(self) -> int:
        """How many columns there are."""
        return int(self.clearances.shape[1])

    def cell(self, x: float, y: float) -> Cell:
        """The row and the column of a point of the world, of which the grid holds the nearest."""
        row, column = int((y - self.bottom) / RESOLUTION), int((x - self.left) / RESOLUTION)
        return min(max(row, 0), self.rows - 1), min(max(column, 0), self.columns - 1)

    def centre(self, cell: Cell) -> tuple[float, float]:
        """The point in the middle of a cell."""
        return self.left + (cell[1] + 0.5) * RESOLUTION, self.bottom + (cell[0] + 0.5) * RESOLUTION

    def occupancy(self) -> NDArray[np.int8]:
        """nav_msgs/OccupancyGrid's data: 100 where a shape touches the cell, 0 where it is free."""
        occupied = self.clearances < RESOLUTION / 2
        return np.where(occupied, 100, 0).astype(np.int8).ravel()


@cache
def grid_of(world: World) -> Grid:
    """The grid of a world."""
    rows, columns = round(world.height / RESOLUTION), round(world.width / RESOLUTION)
    xs = [world.left + (column + 0.5) * RESOLUTION for column in range(columns)]
    ys = [world.bottom + (row + 0.5) * RESOLUTION for row in range(rows)]
    return Grid(world.left, world.bottom, np.array([[world.clearance(x, y) for x in xs] for y in ys]))
