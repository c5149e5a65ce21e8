"""What constrains the data that clients keep, as a shapes graph (LDP 4.2.1.6)."""

from __future__ import annotations

from importlib.resources import files

from pyoxigraph import RdfFormat, parse

from rosld.ontology.document import Document


def data_shape(url: str) -> Document:
    """The shapes graph, about the document at `url`."""
    text = (files("rosld.shapes") / "data.ttl").read_bytes()
    return Document(url, tuple(quad.triple for quad in parse(text, RdfFormat.TURTLE, base_iri=url)))
