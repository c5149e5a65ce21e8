"""The shape of mapping documents: `mapping.ttl` beside this file."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from pyoxigraph import RdfFormat, parse

from rosld.ontology.document import Document


@cache
def mapping_shape(url: str) -> Document:
    """The shape as the document at `url`."""
    text = files("rosld.shapes").joinpath("mapping.ttl").read_bytes()
    return Document(url, tuple(quad.triple for quad in parse(text, format=RdfFormat.TURTLE, base_iri=url)))
