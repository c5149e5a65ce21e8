"""Shapes graphs written by hand: documents of this server, and documents that clients may store (LDP 4.2.1.6)."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from pyoxigraph import RdfFormat, parse

from rosld.ontology.document import Document

MAX_PANELS = 60
"""Panels of one cockpit, as in `cockpit.ttl`."""


@cache
def shapes_file(name: str, url: str) -> Document:
    """Return the shapes graph in `NAME.ttl` beside this file, as the document at `url`."""
    text = (files("rosld.shapes") / f"{name}.ttl").read_bytes()
    return Document(url, tuple(quad.triple for quad in parse(text, RdfFormat.TURTLE, base_iri=url)))
