"""The planner: a way through the free cells of a map, by A*, straightened where the view is free. Pure."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TypeAlias

from rosld.adapters.rover.drive import RADIUS
from rosld.adapters.rover.grid import RESOLUTION, Cell, Grid

MARGIN = 0.1
"""Metres that a planned way keeps from obstacles beside the rover's rim."""
_NEAR = 4
"""Cells within which one is looked for that is free, where the rover stands or shall stand close to something."""

Point: TypeAlias = "tuple[float, float]"
_STEPS = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]


def way(grid: Grid, start: Point, goal: Point) -> tuple[Point, ...]:
    """The corners of a way from a point to another, the goal last; empty where no way leads there."""
    first, last = _nearest_free(grid, grid.cell(*start)), _nearest_free(grid, grid.cell(*goal))
    if first is None or last is None:
        return ()
    cells = _cells(grid, first, last)
    return (*(grid.centre(cell) for cell in _straighten(grid, cells)[1:-1]), goal) if cells else ()


def length(start: Point, corners: Sequence[Point]) -> float:
    """How long the way from a point over these is."""
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
        beside = (cell[0] + row, cell[1] + column)
        if _is_free(grid, beside):
            yield beside, math.hypot(row, column)


def _cells(grid: Grid, first: Cell, last: Cell) -> Sequence[Cell]:
    """The cells of the shortest way, both ends included; none where there is no way."""
    came: dict[Cell, Cell] = {}
    costs = {first: 0.0}
    waiting = [(math.dist(first, last), first)]
    done: set[Cell] = set()
    while waiting:
        _, cell = heapq.heappop(waiting)
        if cell == last:
            return _back(came, last)
        if cell in done:
            continue
        done.add(cell)
        for beside, step in _neighbours(grid, cell):
            cost = costs[cell] + step
            if cost < costs.get(beside, math.inf):
                costs[beside], came[beside] = cost, cell
                heapq.heappush(waiting, (cost + math.dist(beside, last), beside))
    return ()


def _back(came: Mapping[Cell, Cell], last: Cell) -> Sequence[Cell]:
    cells = [last]
    while cells[-1] in came:
        cells.append(came[cells[-1]])
    return cells[::-1]


def _straighten(grid: Grid, cells: Sequence[Cell]) -> Sequence[Cell]:
    """Of these cells the first, the last, and those in between at which the way must bend."""
    kept = [cells[0]]
    for previous, cell in pairwise(cells):
        if not _is_view_free(grid, kept[-1], cell):
            kept.append(previous)
    return [*kept, cells[-1]]


def _is_view_free(grid: Grid, one: Cell, other: Cell) -> bool:
    (x, y), (to_x, to_y) = grid.centre(one), grid.centre(other)
    steps = max(1, math.ceil(2 * math.dist((x, y), (to_x, to_y)) / RESOLUTION))
    shares = (step / steps for step in range(steps + 1))
    return all(_is_free(grid, grid.cell(x + share * (to_x - x), y + share * (to_y - y))) for share in shares)
