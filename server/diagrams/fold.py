"""Folding of a diagram that is too large to read: vertices with the same neighbours become one. Pure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from urllib.parse import quote

from rosld.server.diagrams.diagram import Diagram, Edge, Vertex, VertexKind, common_prefix

MAX_VERTICES = 70
"""What a person can look through."""
EDGES_PER_VERTEX = 2
_DEEPEST = 4


def fold(diagram: Diagram, graph_url: str, limit: int = MAX_VERTICES) -> Diagram:
    """The diagram with at most `limit` vertices, and `EDGES_PER_VERTEX` times as many edges, where folding gets there.

    First what has the same neighbours is folded, then what lies in one namespace, the deepest first, and nodes last.
    """
    found = diagram
    for grouping in _STAGES:
        if len(found.vertices) <= limit and len(found.edges) <= limit * EDGES_PER_VERTEX:
            return found
        found = _merge(found, grouping(found), graph_url)
    return found


Grouping = Callable[[Diagram], Callable[[Vertex], Hashable]]
"""Of a diagram, what tells the group of a vertex; None: it stays by itself."""


def _by_neighbours(depth: int) -> Grouping:
    """What has the same neighbours and is wrong or right alike, within namespaces of so many segments."""

    def of_diagram(diagram: Diagram) -> Callable[[Vertex], Hashable]:
        before, after = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
        for edge in diagram.edges:
            before[edge.target].add(edge.source)
            after[edge.source].add(edge.target)

        def key_of(vertex: Vertex) -> Hashable:
            if vertex.kind is VertexKind.NODE:
                return None
            ends = frozenset(before[vertex.key]), frozenset(after[vertex.key])
            return vertex.kind, bool(vertex.problem), vertex.is_unheard, _namespace(vertex)[:depth], *ends

        return key_of

    return of_diagram


def _by_namespace(depth: int, *, nodes: bool) -> Grouping:
    def key_of(vertex: Vertex) -> Hashable:
        return (vertex.kind, _namespace(vertex)[:depth]) if (vertex.kind is VertexKind.NODE) is nodes else None

    return lambda _: key_of


def _namespace(vertex: Vertex) -> tuple[str, ...]:
    """Return the segments before the last of a name; all of what is folded already, whose name ends in a slash."""
    return tuple(filter(None, vertex.name.rpartition("/")[0].split("/")))


_STAGES: Sequence[Grouping] = (
    _by_neighbours(1),
    *(_by_namespace(depth, nodes=False) for depth in range(_DEEPEST, 0, -1)),
    *(_by_namespace(depth, nodes=True) for depth in range(_DEEPEST, 0, -1)),
    _by_neighbours(0),
    _by_namespace(0, nodes=False),
    _by_namespace(0, nodes=True),
)


def _merge(diagram: Diagram, key_of: Callable[[Vertex], Hashable], graph_url: str) -> Diagram:
    groups = defaultdict[Hashable, list[Vertex]](list)
    for vertex in diagram.vertices:
        key = key_of(vertex)
        groups[vertex.key if key is None else key].append(vertex)
    vertices = tuple(group[0] if len(group) == 1 else _folded(group, graph_url) for group in groups.values())
    place = {old.key: new.key for group, new in zip(groups.values(), vertices, strict=True) for old in group}
    edges: dict[tuple[str, str], Edge] = {}
    for edge in diagram.edges:
        ends = place[edge.source], place[edge.target]
        if ends[0] == ends[1]:
            continue
        known = edges.get(ends)
        edges[ends] = (
            replace(edge, source=ends[0], target=ends[1])
            if known is None
            else replace(known, rate=known.rate + edge.rate, problem=known.problem or edge.problem)
        )
    return Diagram(vertices, tuple(edges.values()), diagram.total)


def _folded(group: Sequence[Vertex], graph_url: str) -> Vertex:
    first, count = group[0], sum(each.count for each in group)
    within = common_prefix(each.name for each in group)
    wrong = [each for each in group if each.problem]
    problem = f"{len(wrong)} of {len(group)}: {wrong[0].problem}" if 0 < len(wrong) < len(group) else ""
    if len(wrong) == len(group):
        problem = wrong[0].problem
    return Vertex(
        f"{first.key} and {count - 1} more",
        first.kind,
        f"{within.rstrip('/')}/",
        f"{graph_url}?below={quote(within, safe='/')}" if within != "/" else first.url,
        sum(each.rate for each in group),
        problem,
        count,
        all(each.is_unheard for each in group),
    )
