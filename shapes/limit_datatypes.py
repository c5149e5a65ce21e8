"""Datatypes of the fields that limits are about, for those who read the limits and know no definition of a type."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from pyoxigraph import BlankNode, NamedNode, Triple

from rosld.ontology.urls import Space
from rosld.ontology.vocab import sh
from rosld.shapes.limit_parts import Place
from rosld.shapes.limits import Limits
from rosld.shapes.shapes_graph import Node, ShapesGraph


@lru_cache(maxsize=8)
def limit_datatypes(limits: Limits, places: tuple[tuple[str, Place], ...], types: str) -> tuple[Triple, ...]:
    """`sh:datatype` of each property shape of the limits that leads to one scalar and does not say it.

    `places` are what the targets are, by their IRIs. It demands nothing: as the server says a message, its fields have
    these datatypes, and a body may have others (`URL?shape`).
    """
    graph, known, space = ShapesGraph(limits.graph), dict(places), Space("http://0/", types)
    found: dict[Node, set[NamedNode]] = {}
    for node, _, target in graph.targets():
        place = known.get(target.value) if isinstance(target, NamedNode) else None
        if place is not None:
            for shape, datatype in _datatypes(graph, node, place, space):
                found.setdefault(shape, set()).add(datatype)
    return tuple(Triple(shape, sh.datatype, each) for shape, one in found.items() if len(one) == 1 for each in one)


def _datatypes(graph: ShapesGraph, node: Node, place: Place, space: Space) -> Iterator[tuple[Node, NamedNode]]:
    said = graph.statements(node)
    for path in said.get(sh.path, ()):
        found = place.follow(path, space) if isinstance(path, NamedNode) else None
        if found is None:
            return
        place = found
        if found.datatype is not None and sh.datatype not in said:
            yield node, found.datatype
    inner = [*said.get(sh.property, ()), *said.get(sh.node, ()), *said.get(sh.not_, ())]
    inner += [each for key in (sh.and_, sh.or_, sh.xone) for head in said.get(key, ()) for each in graph.members(head)]
    for each in inner:
        if isinstance(each, NamedNode | BlankNode):
            yield from _datatypes(graph, each, place, space)
