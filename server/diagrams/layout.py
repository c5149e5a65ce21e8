"""Layered layout from left to right (Sugiyama, Tagawa and Toda 1981): ranks, order, coordinates. No I/O."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from msgspec import Struct, field

_GAP_X, _GAP_Y = 56.0, 12.0
_MARGIN = 12.0
_SWEEPS = 8
_BEND = 6.0
"""Height of an edge that passes a rank, including the gap."""
_PAGE = (1300.0, 900.0)
"""Width and height of a page in pixels: higher ranks are split into columns if that fills the page better."""
_MAX_COLUMNS = 6


class Size(NamedTuple):
    width: float
    height: float


class Point(NamedTuple):
    """A point; x increases to the right, y downwards."""

    x: float
    y: float


class Layout(Struct, frozen=True):
    """Upper left corner of each box, and the points of each edge from its source to its target."""

    corners: Mapping[str, Point]
    routes: Mapping[tuple[str, str], Sequence[Point]]
    size: Size


class _Layers(Struct):
    """Boxes and bends of edges (an edge and a rank) by rank, in order."""

    ranks: list[list[Hashable]]
    before: dict[Hashable, list[Hashable]] = field(default_factory=lambda: defaultdict(list))
    after: dict[Hashable, list[Hashable]] = field(default_factory=lambda: defaultdict(list))


def lay_out(sizes: Mapping[str, Size], edges: Iterable[tuple[str, str]]) -> Layout:
    """Return the layout of boxes of these sizes with edges; boxes without edges are placed below all others.

    Ranks are split into several columns if the drawing is higher than a page.
    """
    pairs = list(dict.fromkeys(pair for pair in edges if pair[0] != pair[1]))
    ends = {key for pair in pairs for key in pair}
    connected = [key for key in sizes if key in ends]
    return min(_layouts(sizes, pairs, connected), key=_pages)


def _layouts(sizes: Mapping[str, Size], pairs: Sequence[tuple[str, str]], connected: Sequence[str]) -> Iterator[Layout]:
    """Yield layouts until one fits on a page."""
    forward = _acyclic(connected, pairs)
    choices = [(forward, _rank(connected, forward))]
    if (three := _three_ranks(connected, pairs)) is not None:
        choices.append(({pair if three[pair[0]] < three[pair[1]] else pair[::-1] for pair in pairs}, three))
    for forward, ranks in choices:
        found, layers = _lay_out_ranks(sizes, pairs, connected, forward, ranks)
        yield found
        ordered = [[key for key in rank if isinstance(key, str)] for rank in layers.ranks]
        tallest = max(map(len, ordered), default=0)
        for columns in range(2, _MAX_COLUMNS + 1):
            if _pages(found) <= 1:
                return
            wrapped = _wrap(ordered, max(-(-tallest // columns), 1))
            found, _ = _lay_out_ranks(sizes, pairs, list(wrapped), forward, wrapped)
            yield found


def _pages(layout: Layout) -> float:
    """Return the ratio of the drawing's size to the page's."""
    return max(layout.size.width / _PAGE[0], layout.size.height / _PAGE[1])


def _wrap(ordered: Sequence[Sequence[str]], most: int) -> dict[str, int]:
    """Split ranks that are too high into adjacent columns."""
    ranks: dict[str, int] = {}
    first = 0
    for rank in ordered:
        columns = -(-len(rank) // most)
        ranks |= {key: first + index % columns for index, key in enumerate(rank)}
        first += columns
    return ranks


def _lay_out_ranks(
    sizes: Mapping[str, Size],
    pairs: Iterable[tuple[str, str]],
    connected: Sequence[str],
    forward: set[tuple[str, str]],
    ranks: Mapping[str, int],
) -> tuple[Layout, _Layers]:
    """Return the layout of boxes in these ranks, and their order."""
    layers, chains = _layers(connected, forward, ranks)
    _order(layers)
    centres, lefts, widths = _places(layers, sizes)
    corners = {key: Point(lefts[ranks[key]], centres[key] - sizes[key].height / 2) for key in connected}
    bottom = max((corners[key].y + sizes[key].height for key in connected), default=_MARGIN - _GAP_Y)
    right = lefts[-1] + widths[-1] if lefts else 0.0
    right, bottom = _place_apart(sizes, [key for key in sizes if key not in corners], corners, right, bottom)
    routes = {}
    for pair in pairs:
        turned = pair not in forward
        start, end = (pair[1], pair[0]) if turned else pair
        route = [Point(corners[start].x + sizes[start].width, centres[start])]
        for bend in chains.get((start, end), ()):
            rank = bend[1]
            route += [Point(lefts[rank], centres[bend]), Point(lefts[rank] + widths[rank], centres[bend])]
        route.append(Point(corners[end].x, centres[end]))
        routes[pair] = route[::-1] if turned else route
    return Layout(corners, routes, Size(right + _MARGIN, bottom + _MARGIN)), layers


def _acyclic(keys: Sequence[str], pairs: Sequence[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return the edges without cycles, by reversing some; each pair once."""
    after = defaultdict[str, list[str]](list)
    targets = {target for _, target in pairs}
    for source, target in pairs:
        after[source].append(target)
    state: dict[str, int] = {}
    forward: set[tuple[str, str]] = set()
    for root in sorted(keys, key=lambda key: key in targets):
        if root in state:
            continue
        state[root] = 1
        stack = [(root, iter(after[root]))]
        while stack:
            key, rest = stack[-1]
            for target in rest:
                forward.add((target, key) if state.get(target) == 1 else (key, target))
                if target not in state:
                    state[target] = 1
                    stack.append((target, iter(after[target])))
                    break
            else:
                state[key] = 2
                stack.pop()
    return forward


def _rank(keys: Sequence[str], forward: set[tuple[str, str]]) -> dict[str, int]:
    """Return the longest path to each box; boxes without predecessors are placed just before their successors."""
    before, after = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
    for source, target in forward:
        before[target].add(source)
        after[source].add(target)
    ranks: dict[str, int] = {}
    missing = {key: len(before[key]) for key in keys}
    ready = [key for key in keys if not missing[key]]
    for key in ready:
        ranks[key] = 1 + max((ranks[each] for each in before[key]), default=-1)
        for target in sorted(after[key]):
            missing[target] -= 1
            if not missing[target]:
                ready.append(target)
    for key in keys:
        if not before[key] and after[key]:
            ranks[key] = min(ranks[each] for each in after[key]) - 1
    return ranks


def _three_ranks(keys: Sequence[str], pairs: Iterable[tuple[str, str]]) -> dict[str, int] | None:
    """Return ranks with all nodes on either side of all else; None if an edge joins two of a kind.

    Most edges of a node decide its side. Nodes both publish and subscribe, so a robot has many cycles, and the longest
    path would be too long.
    """
    near, flow = defaultdict[str, list[str]](list), Counter[str]()
    for source, target in pairs:
        near[source].append(target)
        near[target].append(source)
        flow[source] += 1
        flow[target] -= 1
    is_middle: dict[str, bool] = {}
    for root in keys:
        if root in is_middle:
            continue
        is_middle[root], waiting = False, [root]
        while waiting:
            key = waiting.pop()
            for other in near[key]:
                if other not in is_middle:
                    is_middle[other] = not is_middle[key]
                    waiting.append(other)
                elif is_middle[other] is is_middle[key]:
                    return None
    return {key: 1 if is_middle[key] else 0 if flow[key] >= 0 else 2 for key in keys}


def _layers(
    keys: Sequence[str], forward: set[tuple[str, str]], ranks: Mapping[str, int]
) -> tuple[_Layers, dict[tuple[str, str], list[tuple[tuple[str, str], int]]]]:
    """Return the ranks with bends of passing edges, and the bends of each edge."""
    layers = _Layers([[] for _ in range(1 + max(ranks.values(), default=-1))])
    for key in keys:
        layers.ranks[ranks[key]].append(key)
    chains: dict[tuple[str, str], list[tuple[tuple[str, str], int]]] = {}
    for pair in sorted(forward):
        bends = [(pair, rank) for rank in range(ranks[pair[0]] + 1, ranks[pair[1]])]
        chains[pair] = bends
        for bend in bends:
            layers.ranks[bend[1]].append(bend)
        steps: list[Hashable] = [pair[0], *bends, pair[1]]
        for one, other in pairwise(steps):
            layers.after[one].append(other)
            layers.before[other].append(one)
    return layers, chains


def _order(layers: _Layers) -> None:
    """Sort each rank by the mean position of its neighbours, in both directions, to reduce crossings."""
    for sweep in range(_SWEEPS):
        to_right = sweep % 2 == 0
        numbers = range(1, len(layers.ranks)) if to_right else range(len(layers.ranks) - 2, -1, -1)
        near = layers.before if to_right else layers.after
        for number in numbers:
            neighbours = layers.ranks[number - 1 if to_right else number + 1]
            place = {key: index for index, key in enumerate(neighbours)}
            own = {key: index for index, key in enumerate(layers.ranks[number])}

            def mean(
                key: Hashable,
                place: Mapping[Hashable, int] = place,
                own: Mapping[Hashable, int] = own,
                near: Mapping[Hashable, Sequence[Hashable]] = near,
            ) -> float:
                found = [place[each] for each in near.get(key, ()) if each in place]
                return sum(found) / len(found) if found else own[key]

            layers.ranks[number].sort(key=mean)


def _places(layers: _Layers, sizes: Mapping[str, Size]) -> tuple[dict[Hashable, float], list[float], list[float]]:
    """Return the y of each centre, the x of each rank, and the width of each rank."""
    heights = {
        key: sizes[key].height + _GAP_Y if isinstance(key, str) else _BEND for rank in layers.ranks for key in rank
    }
    widths = [max((sizes[key].width for key in rank if isinstance(key, str)), default=0.0) for rank in layers.ranks]
    lefts, x = [], _MARGIN
    for width in widths:
        lefts.append(x)
        x += width + _GAP_X
    centres: dict[Hashable, float] = {}
    for rank in layers.ranks:
        centres |= _spread(rank, [0.0] * len(rank), heights)
    for sweep in range(_SWEEPS):
        for rank in layers.ranks if sweep % 2 == 0 else reversed(layers.ranks):
            wanted = []
            for key in rank:
                near = [*layers.before.get(key, ()), *layers.after.get(key, ())]
                wanted.append(sum(centres[each] for each in near) / len(near) if near else centres[key])
            centres |= _spread(rank, wanted, heights)
    top = min((centres[key] - heights[key] / 2 for key in centres), default=0.0)
    return {key: y - top + _MARGIN - _GAP_Y / 2 for key, y in centres.items()}, lefts, widths


def _spread(
    rank: Sequence[Hashable], wanted: Sequence[float], heights: Mapping[Hashable, float]
) -> dict[Hashable, float]:
    """Return centres as close to the wanted ones as order and heights permit (pool adjacent violators)."""
    offsets, offset = [], 0.0
    for index, key in enumerate(rank):
        if index:
            offset += (heights[rank[index - 1]] + heights[key]) / 2
        offsets.append(offset)
    pools: list[tuple[float, int]] = []
    for value, each in zip(wanted, offsets, strict=True):
        pools.append((value - each, 1))
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (one, first), (other, second) = pools[-2:]
            pools[-2:] = [((one * first + other * second) / (first + second), first + second)]
    flat = [mean for mean, count in pools for _ in range(count)]
    return {key: mean + each for key, mean, each in zip(rank, flat, offsets, strict=True)}


def _place_apart(
    sizes: Mapping[str, Size], keys: Sequence[str], corners: dict[str, Point], right: float, bottom: float
) -> tuple[float, float]:
    """Place boxes without edges in rows below all others; return the size of the drawing."""
    limit = max(right, _PAGE[0])
    x, y, row = _MARGIN, bottom + _GAP_Y, 0.0
    for key in keys:
        size = sizes[key]
        if x > _MARGIN and x + size.width > limit:
            x, y, row = _MARGIN, y + row + _GAP_Y, 0.0
        corners[key] = Point(x, y)
        row = max(row, size.height)
        right = max(right, x + size.width)
        x += size.width + _GAP_Y
    return right, y + row if keys else bottom
