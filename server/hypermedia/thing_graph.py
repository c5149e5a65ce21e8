"""Thing Descriptions as RDF: the triples that W3C's JSON-LD context makes of them (WoT TD 1.1, 6.3). Pure.

The context is large, and never fetched: this holds the part of it that `thing_description.py` has a use for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple, TypeAlias
from urllib.parse import urljoin

import orjson
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.document import Document
from rosld.ontology.triples import boolean, integer
from rosld.ontology.vocab import hctl, htv, js, mapping, qudt, rdf, ros, td, wotsec, xsd
from rosld.server.hypermedia.json_schema import Json

_Node: TypeAlias = NamedNode | BlankNode
_Object: TypeAlias = "dict[str, Json]"

_UNIT_CODE = NamedNode("http://schema.org/unitCode")
_PREFIXES: Mapping[str, str] = {"ros:": ros.iri, "map:": mapping.iri, "qudt:": qudt.iri, "htv:": htv.iri}


class _Scope(NamedTuple):
    """What the members of an object mean, by their names.

    `literals` have values of JSON, `texts` words in English, `urls` an xsd:anyURI, `words` are terms by their names,
    `iris` are IRIs. `nodes` hold an object, or several, `maps` one a name; with each the scope of these, with a map the
    predicate of the name as well.
    """

    literals: Mapping[str, NamedNode] = MappingProxyType({})
    texts: Mapping[str, NamedNode] = MappingProxyType({})
    urls: Mapping[str, NamedNode] = MappingProxyType({})
    words: Mapping[str, tuple[NamedNode, str]] = MappingProxyType({})
    iris: Mapping[str, NamedNode] = MappingProxyType({})
    nodes: Mapping[str, tuple[NamedNode, str]] = MappingProxyType({})
    maps: Mapping[str, tuple[NamedNode, NamedNode, str]] = MappingProxyType({})


_WORDS = {"title": td.title, "description": td.description}
_OPERATIONS: Mapping[str, NamedNode] = {
    "readproperty": td.readProperty,
    "writeproperty": td.writeProperty,
    "observeproperty": td.observeProperty,
    "unobserveproperty": td.unobserveProperty,
    "readallproperties": td.readAllProperties,
    "invokeaction": td.invokeAction,
    "queryaction": td.queryAction,
    "cancelaction": td.cancelAction,
}
_SCHEMES: Mapping[str, NamedNode] = {
    "nosec": wotsec.NoSecurityScheme,
    "combo": wotsec.ComboSecurityScheme,
    "bearer": wotsec.BearerSecurityScheme,
    "basic": wotsec.BasicSecurityScheme,
}
_OF_SCHEMES = {name: NamedNode(wotsec.iri + name) for name in ("in", "format", "oneOf")}
_SCHEMAS: Mapping[str, NamedNode] = {
    name: NamedNode(f"{js.iri}{name.capitalize()}Schema")
    for name in ("object", "array", "boolean", "string", "number", "integer", "null")
}
_TERMS: Mapping[str, Mapping[str, NamedNode]] = {
    "schema": _SCHEMAS,
    "operation": _OPERATIONS,
    "scheme": _SCHEMES,
    "thing": {"Thing": td.Thing},
}
_OF_SCHEMAS = {
    name: NamedNode(js.iri + name)
    for name in (
        *(
            "readOnly",
            "writeOnly",
            "minimum",
            "maximum",
            "exclusiveMinimum",
            "exclusiveMaximum",
            "minItems",
            "maxItems",
        ),
        *("minLength", "maxLength", "pattern", "contentEncoding", "required", "enum", "const", "default", "multipleOf"),
        "format",
    )
}


def _schema(name_of_members: NamedNode, members: str, own: str) -> _Scope:
    """A data schema: how the names of its members are said, and the scopes of these and of what else lies in it."""
    return _Scope(
        literals=_OF_SCHEMAS | {"observable": td.isObservable},
        texts=_WORDS,
        words={"type": (rdf.type, "schema")},
        iris={"unit": _UNIT_CODE},
        nodes={
            "items": (js.items, own),
            **{name: (NamedNode(js.iri + name), own) for name in ("oneOf", "allOf", "anyOf")},
            "forms": (td.hasForm, "form"),
        },
        maps={"properties": (js.properties, name_of_members, members)},
    )


_SCOPES: Mapping[str, _Scope] = {
    "thing": _Scope(
        literals={"security": td.hasSecurityConfiguration},
        texts=_WORDS,
        words={"@type": (rdf.type, "thing")},
        nodes={"forms": (td.hasForm, "form"), "links": (td.hasLink, "link")},
        maps={
            "properties": (td.hasPropertyAffordance, td.name, "property"),
            "actions": (td.hasActionAffordance, td.name, "action"),
            "securityDefinitions": (td.definesSecurityScheme, td.hasInstanceConfiguration, "security"),
        },
    ),
    # In the context, the outermost members of a property's value are called by td:name, all others by js:propertyName.
    "property": _schema(td.name, "member", "property"),
    "member": _schema(js.propertyName, "member", "member"),
    "action": _Scope(
        literals={"safe": td.isSafe, "idempotent": td.isIdempotent, "synchronous": td.isSynchronous},
        texts=_WORDS,
        nodes={
            "input": (td.hasInputSchema, "member"),
            "output": (td.hasOutputSchema, "member"),
            "forms": (td.hasForm, "form"),
        },
        maps={"uriVariables": (td.hasUriTemplateSchema, td.name, "variable")},
    ),
    # The context of WoT has no data schemas within uriVariables: their members are terms of td itself.
    "variable": _Scope(
        literals={name: NamedNode(td.iri + name) for name in ("type", "exclusiveMinimum", "maximum")}, texts=_WORDS
    ),
    "form": _Scope(
        literals={"contentType": hctl.forContentType, "subprotocol": hctl.forSubProtocol},
        urls={"href": hctl.hasTarget},
        words={"op": (hctl.hasOperationType, "operation")},
    ),
    "link": _Scope(
        literals={"rel": hctl.hasRelationType, "type": hctl.hintsAtMediaType}, urls={"href": hctl.hasTarget}
    ),
    "security": _Scope(literals=_OF_SCHEMES, words={"scheme": (rdf.type, "scheme")}),
}


def thing_document(data: bytes, url: str) -> Document:
    """Return a Thing Description, which is JSON, as the document at its URL."""
    thing: _Object = orjson.loads(data)
    return Document(url, tuple(dict.fromkeys(_Walk(url).object(NamedNode(str(thing["id"])), thing, "thing"))))


class _Walk:
    """One description being walked: its blank nodes are numbered."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._last = 0

    def object(self, subject: _Node, members: _Object, scope: str) -> Iterator[Triple]:
        """Yield the triples of an object."""
        for name, value in members.items():
            for one in value if isinstance(value, list) else [value]:
                yield from self._member(subject, name, one, scope)

    def _member(self, subject: _Node, name: str, value: Json, scope: str) -> Iterator[Triple]:
        means = _SCOPES[scope]
        if name in means.literals:
            yield Triple(subject, means.literals[name], _literal(value))
        elif name in means.texts:
            yield Triple(subject, means.texts[name], Literal(str(value), language="en"))
        elif name in means.urls:
            yield Triple(subject, means.urls[name], Literal(str(value), datatype=xsd.anyURI))
        elif name in means.words:
            predicate, terms = means.words[name]
            yield Triple(subject, predicate, _TERMS[terms][str(value)])
        elif name in means.iris:
            yield Triple(subject, means.iris[name], self._iri(str(value)))
        elif name in means.nodes:
            predicate, inner = means.nodes[name]
            yield from self._node(subject, predicate, value, inner)
        elif name in means.maps:
            predicate, key, inner = means.maps[name]
            yield from self._map(subject, predicate, key, value, inner)
        elif (prefix := name.partition(":")[0] + ":") in _PREFIXES:
            predicate = NamedNode(_PREFIXES[prefix] + name.removeprefix(prefix))
            said = NamedNode(str(value["@id"])) if isinstance(value, dict) else _literal(value)
            yield Triple(subject, predicate, said)

    def _node(self, subject: _Node, predicate: NamedNode, value: Json, scope: str) -> Iterator[Triple]:
        if isinstance(value, dict):
            self._last += 1
            node = BlankNode(f"n{self._last}")
            yield Triple(subject, predicate, node)
            yield from self.object(node, value, scope)

    def _map(self, subject: _Node, predicate: NamedNode, key: NamedNode, value: Json, scope: str) -> Iterator[Triple]:
        for name, one in value.items() if isinstance(value, dict) else ():
            triples = list(self._node(subject, predicate, one, scope))
            node = triples[0].object
            assert isinstance(node, BlankNode)
            yield from triples
            yield Triple(node, key, self._iri(name) if key == td.hasInstanceConfiguration else Literal(name))

    def _iri(self, text: str) -> NamedNode:
        return NamedNode(urljoin(self._url, text))


def _literal(value: Json) -> Literal:
    """Return the literal of a value of JSON as JSON-LD defines it (JSON-LD 1.1 API, 8.2.2)."""
    if isinstance(value, bool):
        return boolean(value)
    if isinstance(value, float) and not value.is_integer():
        digits, _, exponent = f"{value:.15E}".partition("E")
        return Literal(f"{_short(digits)}E{int(exponent)}", datatype=xsd.double)
    if isinstance(value, int | float):
        return integer(int(value)) or Literal("")
    return Literal(str(value))


def _short(digits: str) -> str:
    """Return digits without trailing zeros, except one after the point."""
    left = digits.rstrip("0")
    return left + "0" if left.endswith(".") else left
