"""The shape of cockpits: `cockpit.ttl` beside this file."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from pyoxigraph import RdfFormat, parse

from rosld.ontology.document import Document

MAX_PANELS = 60
"""Panels of one cockpit, as its shape has it."""


@cache
def cockpit_shape(url: str) -> Document:
    """The shape as the document at `url`."""
    text = files("rosld.shapes").joinpath("cockpit.ttl").read_bytes()
    return Document(url, tuple(quad.triple for quad in parse(text, format=RdfFormat.TURTLE, base_iri=url)))
