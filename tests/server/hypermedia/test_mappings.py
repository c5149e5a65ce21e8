"""Mappings in force: atomic replacement, and lookups."""

from __future__ import annotations

import pytest

from rosld.ontology.urls import Space
from rosld.server.hypermedia.mapping_parser import InvalidMapping, MappingDocument, read_mapping
from rosld.server.hypermedia.mappings import (
    Mappings,
)

SPACE = Space("http://127.0.0.1:8080/")
PREFIXES = """
@prefix map: <https://w3id.org/rosld/mapping#> .
@prefix : <https://example.org/robot#> .
@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix sh: <http://www.w3.org/ns/shacl#> .
"""


def document(name: str, text: str) -> MappingDocument:
    return read_mapping((PREFIXES + text).encode(), "text/turtle", f"{SPACE.base}mappings/{name}")


def resource(path: str, inner: str = "") -> str:
    """Return a complex resource; its IRI is derived from its path."""
    return f'<#r{path.replace("/", "-")}> a map:ComplexResource ; map:path "{path}" {inner} .\n'


def about(place: str) -> str:
    """Return a condition in brackets about a path, or about a name."""
    seen = ":p" if place.endswith("/") else "rdf:value"
    return f'[ a sh:NodeShape ; map:about "{place}" ; sh:property [ sh:path {seen} ; sh:minInclusive 1 ] ]'


def test_a_document_that_describes_anothers_condition_is_refused() -> None:
    shape = '<http://x/c> a sh:NodeShape ; map:about "/z/" ; sh:property [ sh:path :p ; sh:minCount 1 ] .'
    mappings = Mappings()
    mappings.replace(document("a", resource("/a/", "; map:existsWhen <http://x/c>") + shape))
    with pytest.raises(InvalidMapping, match="http://x/c"):
        mappings.replace(document("b", resource("/b/", "; map:existsWhen <http://x/c>") + shape))
    mappings.replace(document("a", resource("/a/")))
    mappings.replace(document("b", resource("/b/", "; map:existsWhen <http://x/c>") + shape))
