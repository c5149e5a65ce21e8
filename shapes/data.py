"""Shapes graphs written by hand: what documents of this server say, and what clients may keep (LDP 4.2.1.6)."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from pyoxigraph import RdfFormat, parse

from rosld.ontology.document import Document


def documents_shape(url: str) -> Document:
    """The shapes graph of what this server says, class by class, about the document at `url`."""
    return _document("documents.ttl", url)


def data_shape(url: str) -> Document:
    """The shapes graph of data, about the document at `url`."""
    return _document("data.ttl", url)


def query_shape(url: str) -> Document:
    """The shapes graph of stored queries, about the document at `url`."""
    return _document("query.ttl", url)


def recording_shape(url: str) -> Document:
    """The shapes graph of the orders of recordings, about the document at `url`."""
    return _document("recording.ttl", url)


@cache
def _document(name: str, url: str) -> Document:
    text = (files("rosld.shapes") / name).read_bytes()
    return Document(url, tuple(quad.triple for quad in parse(text, RdfFormat.TURTLE, base_iri=url)))
