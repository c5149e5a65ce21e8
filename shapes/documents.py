"""Shapes graphs of the documents of this server, and of documents that clients may store (LDP 4.2.1.6)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from pyoxigraph import RdfFormat, parse

from rosld.ontology import (
    describe_activities,
    describe_bags,
    describe_graph,
    describe_holds,
    describe_services,
    describe_topics,
    describe_types,
    describe_views,
)
from rosld.ontology.document import Document
from rosld.ontology.node_shape import NodeShape

_MODULES = (
    describe_activities,
    describe_bags,
    describe_graph,
    describe_holds,
    describe_services,
    describe_topics,
    describe_types,
    describe_views,
)

MAX_PANELS = 60
"""Maximum number of panels of a cockpit, as in `cockpit.ttl`."""


@cache
def shapes_file(name: str, url: str) -> Document:
    """Return the shapes graph in `NAME.ttl` next to this file, as the document at `url`."""
    text = (files("rosld.shapes") / f"{name}.ttl").read_text("utf-8")
    if name == "documents":
        text = "\n".join((text, *(shape.turtle() for shape in described_shapes().values())))
    return Document(url, tuple(quad.triple for quad in parse(text, RdfFormat.TURTLE, base_iri=url)))


def described_shapes() -> Mapping[str, NodeShape[Any]]:
    """Return the tables of descriptions by the names of their shapes; outlines precede them."""
    return {shape.name: shape for module in _MODULES for shape in vars(module).values() if isinstance(shape, NodeShape)}
