"""Thing Descriptions as RDF: the triples according to the JSON-LD context of W3C (WoT TD 1.1, 6.3). Pure.

The context is large and never fetched: this module has the part that `thing_description.py` uses.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

import orjson
from pyoxigraph import BlankNode, RdfFormat, Triple, parse

from rosld.ontology.document import Document
from rosld.ontology.vocab import hctl, htv, js, td, wotsec, xsd

_T = TypeVar("_T")

_OPERATIONS = (
    *("readProperty", "writeProperty", "observeProperty", "unobserveProperty", "readAllProperties"),
    *("invokeAction", "queryAction", "cancelAction"),
)
_TEXT = {"@language": "en"}


def _named(predicate: str, name: str, context: Mapping[str, object]) -> dict[str, object]:
    """Return the term of a member whose value maps names to objects; each gets its name as a property."""
    return {"@id": predicate, "@container": "@index", "@index": name, "@context": context}


_SCHEMA: dict[str, object] = {
    "@vocab": js.iri,
    **{name: f"js:{name.capitalize()}Schema" for name in ("object", "array", "boolean", "string", "number", "integer")},
    "type": "@type",
    "unit": {"@id": "http://schema.org/unitCode", "@type": "@vocab"},
    "properties": {"@id": "js:properties", "@container": "@index", "@index": "js:propertyName"},
}
_HYPERMEDIA = {
    **{name.lower(): f"td:{name}" for name in _OPERATIONS},
    "op": {"@id": "hctl:hasOperationType", "@type": "@vocab"},
    "href": {"@id": "hctl:hasTarget", "@type": xsd.anyURI.value},
    "contentType": "hctl:forContentType",
    "subprotocol": "hctl:forSubProtocol",
    "rel": "hctl:hasRelationType",
    "type": "hctl:hintsAtMediaType",
}
_SECURITY = {
    "@vocab": wotsec.iri,
    "scheme": "@type",
    **{name: f"wotsec:{name.capitalize()}SecurityScheme" for name in ("combo", "bearer", "basic")},
    "nosec": "wotsec:NoSecurityScheme",
}
_CONTEXT: Mapping[str, object] = {
    "@version": 1.1,
    "@vocab": td.iri,
    "td": td.iri,
    "js": js.iri,
    "hctl": hctl.iri,
    "htv": htv.iri,
    "wotsec": wotsec.iri,
    "id": "@id",
    "title": {"@id": "td:title", **_TEXT},
    "description": {"@id": "td:description", **_TEXT},
    # The outermost members of a property's value are called by td:name, all others by js:propertyName.
    "properties": _named(
        "td:hasPropertyAffordance",
        "td:name",
        {**_SCHEMA, "properties": _named("js:properties", "td:name", {"properties": _SCHEMA["properties"]})},
    ),
    "actions": _named("td:hasActionAffordance", "td:name", {}),
    "uriVariables": _named("td:hasUriTemplateSchema", "td:name", {}),
    "input": {"@id": "td:hasInputSchema", "@context": _SCHEMA},
    "output": {"@id": "td:hasOutputSchema", "@context": _SCHEMA},
    "observable": "td:isObservable",
    "safe": "td:isSafe",
    "idempotent": "td:isIdempotent",
    "synchronous": "td:isSynchronous",
    "forms": {"@id": "td:hasForm", "@context": _HYPERMEDIA},
    "links": {"@id": "td:hasLink", "@context": _HYPERMEDIA},
    "security": "td:hasSecurityConfiguration",
    "securityDefinitions": _named("td:definesSecurityScheme", "td:hasInstanceConfiguration", _SECURITY),
    "td:hasInstanceConfiguration": {"@type": "@id"},
}


def thing_document(data: bytes, url: str) -> Document:
    """Return a Thing Description, which is JSON, as the document at its URL."""
    thing = orjson.loads(data)
    thing["@context"] = [each if isinstance(each, dict) else _CONTEXT for each in thing["@context"]]
    quads = parse(orjson.dumps(thing), RdfFormat.JSON_LD, base_iri=url)
    return Document(url, tuple(dict.fromkeys(_numbered(quad.triple for quad in quads))))


def _numbered(triples: Iterable[Triple]) -> Iterable[Triple]:
    """Yield triples whose blank nodes have numbers, so that a description is written the same each time."""
    known: dict[object, BlankNode] = {}

    def rename(term: _T) -> _T | BlankNode:
        return known.setdefault(term, BlankNode(f"n{len(known) + 1}")) if isinstance(term, BlankNode) else term

    for triple in triples:
        yield Triple(rename(triple.subject), triple.predicate, rename(triple.object))
