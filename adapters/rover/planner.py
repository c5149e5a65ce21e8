"""Occupancy grid of a world, and paths in it with a margin to all obstacles. No I/O."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rosld.adapters.rover.drive import RADIUS
from rosld.adapters.rover.world import World

RESOLUTION = 0.1
"""Side of a cell in metres."""

Cell: TypeAlias = "tuple[int, int]"


@dataclass(frozen=True, eq=False)
class Grid:
    """Clearance of the centre of each cell, by row (south to north) and column (west to east)."""

    left: float
    bottom: float
    clearances: NDArray[np.float64]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.clearances.shape[0])

    @property
    def columns(self) -> int:
        """Number of columns."""
        return int(self.clearances.shape[1])

    def cell(self, x: float, y: float) -> Cell:
        """Return the row and column of a point, or those of the nearest cell of the grid."""
        row, column = int((y - self.bottom) / RESOLUTION), int((x - self.left) / RESOLUTION)
        return min(max(row, 0), self.rows - 1), min(max(column, 0), self.columns - 1)

    def centre(self, cell: Cell) -> tuple[float, float]:
        """Return the centre of a cell."""
        return self.left + (cell[1] + 0.5) * RESOLUTION, self.bottom + (cell[0] + 0.5) * RESOLUTION

    def occupancy(self) -> NDArray[np.int8]:
        """Return the data of a nav_msgs/OccupancyGrid: 100 if a shape touches the cell, 0 if it is free."""
        occupied = self.clearances < RESOLUTION / 2
        return np.where(occupied, 100, 0).astype(np.int8).ravel()


@cache
def grid_of(world: World) -> Grid:
    """Return the grid of a world."""
    rows, columns = round(world.height / RESOLUTION), round(world.width / RESOLUTION)
    xs = [world.left + (column + 0.5) * RESOLUTION for column in range(columns)]
    ys = [world.bottom + (row + 0.5) * RESOLUTION for row in range(rows)]
    return Grid(world.left, world.bottom, np.array([[world.clearance(x, y) for x in xs] for y in ys]))


MARGIN = 0.1
"""Metres between obstacles and the rover's rim on a planned path."""
_NEAR = 4
"""Maximum distance in cells to a free cell, if the start or the goal is close to an obstacle."""

Point: TypeAlias = "tuple[float, float]"
_STEPS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]


def find_path(grid: Grid, start: Point, goal: Point) -> tuple[Point, ...]:
    """Return the corners of a path between two points, including the goal; empty if there is no path."""
    first, last = _nearest_free(grid, grid.cell(*start)), _nearest_free(grid, grid.cell(*goal))
    if first is None or last is None:
        return ()
    cells = _cells(grid, first, last)
    return (*(grid.centre(cell) for cell in _straighten(grid, cells)[1:-1]), goal) if cells else ()


def path_length(start: Point, corners: Sequence[Point]) -> float:
    """Return the length of the path from a point along these corners."""
    return math.fsum(math.dist(one, other) for one, other in pairwise((start, *corners)))


def _is_free(grid: Grid, cell: Cell) -> bool:
    inside = 0 <= cell[0] < grid.rows and 0 <= cell[1] < grid.columns
    return inside and bool(grid.clearances[cell] >= RADIUS + MARGIN)


def _nearest_free(grid: Grid, cell: Cell) -> Cell | None:
    reach = range(-_NEAR, _NEAR + 1)
    near = [(cell[0] + row, cell[1] + column) for row in reach for column in reach]
    return min((each for each in near if _is_free(grid, each)), key=lambda each: math.dist(each, cell), default=None)


def _neighbours(grid: Grid, cell: Cell) -> Iterator[tuple[Cell, float]]:
    for row, column in _STEPS:
        neighbour = (cell[0] + row, cell[1] + column)
        if _is_free(grid, neighbour):
            yield neighbour, math.hypot(row, column)


def _cells(grid: Grid, first: Cell, last: Cell) -> Sequence[Cell]:
    """Return the cells of the shortest path, including both ends; empty if there is no path."""
    predecessors: dict[Cell, Cell] = {}
    costs = {first: 0.0}
    queue = [(math.dist(first, last), first)]
    done: set[Cell] = set()
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == last:
            return _path_to(predecessors, last)
        if cell in done:
            continue
        done.add(cell)
        for neighbour, step in _neighbours(grid, cell):
            cost = costs[cell] + step
            if cost < costs.get(neighbour, math.inf):
                costs[neighbour], predecessors[neighbour] = cost, cell
                heapq.heappush(queue, (cost + math.dist(neighbour, last), neighbour))
    return ()


def _path_to(predecessors: Mapping[Cell, Cell], last: Cell) -> Sequence[Cell]:
    cells = [last]
    while cells[-1] in predecessors:
        cells.append(predecessors[cells[-1]])
    return cells[::-1]


def _straighten(grid: Grid, cells: Sequence[Cell]) -> Sequence[Cell]:
    """Return the first and last of these cells, and those where the path bends."""
    bends = [cells[0]]
    for previous, cell in pairwise(cells):
        if not _is_view_free(grid, bends[-1], cell):
            bends.append(previous)
    return [*bends, cells[-1]]


def _is_view_free(grid: Grid, one: Cell, other: Cell) -> bool:
    (x, y), (to_x, to_y) = grid.centre(one), grid.centre(other)
    steps = max(1, math.ceil(2 * math.dist((x, y), (to_x, to_y)) / RESOLUTION))
    shares = (step / steps for step in range(steps + 1))
    return all(_is_free(grid, grid.cell(x + share * (to_x - x), y + share * (to_y - y))) for share in shares)
