"""Lowering: bodies in RDF or plain JSON to ROS messages, by tables of readers created once per schema.

A value that does not fit the type exactly is rejected with the path of the field and the expected value; nothing is
guessed, rounded (except floats to the nearest) or filled in. Every result can be encoded.

A reader takes a value from `parse_json` and its path, and returns the value for the message or raises `Misfit`. The
reader of a message collects the misfits of its fields as violations, so that all are reported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from pyoxigraph import NamedNode

from rosld.adapters.model import STRINGS, Array, Field, FieldType, Message, MessageSchema, Nested, Primitive
from rosld.ontology.body import RdfBody, Term
from rosld.ontology.coercion import describe_kind
from rosld.ontology.json_leaves import json_leaf, stated_default, unexpected_value, zero_value
from rosld.ontology.lift import LiftSettings
from rosld.ontology.literals import DTYPES
from rosld.ontology.lower_graph import GraphReaders, GraphReading
from rosld.ontology.message_readers import MessageReaders, Reader, guarded, read_message
from rosld.ontology.violations import Findings, LoweringError, Path, Violation
from rosld.ontology.vocab import ros


class JsonReading(NamedTuple):
    """State of one lowering; `defaults`: missing fields have their defaults."""

    findings: Findings
    defaults: bool


JsonReader: TypeAlias = Reader[object, JsonReading]


class _Field(NamedTuple):
    """A field, the reader of its value, and the function that returns its default."""

    field: Field
    read: JsonReader
    default: Callable[[], object]


class JsonReaders(MessageReaders[object, JsonReading]):
    """The readers of values as messages of one schema, and messages of defaults."""

    def __init__(self, schema: MessageSchema) -> None:
        super().__init__(schema)
        self._defaults = cache(self._defaults_of)

    def _message(self, name: str) -> JsonReader:
        build, kind = self._schema.codec.build, Nested(name)
        fields = {
            field.name: _Field(field, self.reader(field.type), self._default(field))
            for field in self._schema.types[name].fields
        }

        def read(value: object, path: Path, reading: JsonReading) -> object:
            if type(value) is not dict:
                raise unexpected_value(kind, value)
            values: dict[str, object] = {}
            for key, entry in fields.items():
                if key in value:
                    values[entry.field.attribute] = guarded(entry.read, value[key], (path, key), reading)
                elif reading.defaults:
                    values[entry.field.attribute] = entry.default()
                else:
                    reading.findings.add((path, key), f"missing: expected {describe_kind(entry.field.type)}")
            if not value.keys() <= fields.keys():
                for key in value.keys() - fields.keys():
                    reading.findings.add((path, key), f"{name} has no such field; it has {_list(fields)}")
            return None if reading.findings.violations else build(name, values)

        return read

    def _leaf(self, kind: Primitive | Array) -> JsonReader:
        leaf = json_leaf(kind)
        return lambda value, path, reading: leaf(value)

    def _items(self, kind: Array, value: object, reading: JsonReading) -> list[object]:
        if not isinstance(value, list):
            raise unexpected_value(kind, value)
        return value

    def _default(self, field: Field) -> Callable[[], object]:
        """Return the value of a missing field: the default in its definition, or else zero, recursively."""
        stated = stated_default(field)
        if stated is None or isinstance(field.type, Nested):  # a message has only the defaults of its fields
            return self._zero(field.type)
        leaf = json_leaf(field.type)
        return lambda: leaf(stated)

    def _zero(self, kind: FieldType) -> Callable[[], object]:
        """Return the value of a field without a default: zeros, empty strings and arrays, messages of defaults."""
        if isinstance(kind, Nested):
            return lambda: self.default(kind.name)
        if isinstance(kind, Primitive):
            return lambda: zero_value(kind)
        element, length = kind.element, kind.length or 0
        if isinstance(element, Primitive) and element.name not in STRINGS:
            return lambda: np.zeros(length, DTYPES[element.name])
        one = self._zero(element)
        return lambda: [one() for _ in range(length)]

    def default(self, name: str) -> Message:
        """Return a message of a type of this schema with every field at its default."""
        return self._schema.codec.build(name, {attribute: make() for attribute, make in self._defaults(name)})

    def _defaults_of(self, name: str) -> list[tuple[str, Callable[[], object]]]:
        return [(field.attribute, self._default(field)) for field in self._schema.types[name].fields]


def _list(fields: Mapping[str, _Field]) -> str:
    return ", ".join(fields) or "none"


class Lowerer:
    """Converter of bodies to messages of one schema."""

    def __init__(self, schema: MessageSchema, settings: LiftSettings) -> None:
        self.schema = schema
        self._type = settings.types + schema.ref.name
        self._from_json = JsonReaders(schema).message(schema.ref.name)
        self._from_graph = GraphReaders(schema, settings.types).message(schema.ref.name)

    def from_json(self, value: object, *, defaults: bool = False) -> Message:
        """Return the message in a JSON value from `parse_json`; missing fields have ROS's defaults if `defaults`.

        Raises LoweringError with the violations (at most the first twenty).
        """
        return read_message(self._from_json, value, JsonReading(Findings(), defaults))

    def from_body(self, body: RdfBody, document: str, node: str = "#message") -> Message:
        """Return the message in the body sent to `document`; the body may be empty for a type without fields.

        Raises LoweringError as `find_message` and `from_graph`.
        """
        if not self.schema.type.fields and not body.instances(NamedNode(self._type)):
            return self.from_json({})
        return self.from_graph(body, find_message(body, document, self._type, node))

    def from_graph(self, body: RdfBody, root: Term) -> Message:
        """Return the message whose node in `body` is `root`.

        Raises LoweringError with the violations (at most the first twenty).
        """
        return read_message(self._from_graph, root, GraphReading(body))


@lru_cache(maxsize=1024)
def lowerer(schema: MessageSchema, settings: LiftSettings = LiftSettings()) -> Lowerer:  # noqa: B008
    """Return the lowerer of a schema, created once per schema and settings."""
    return Lowerer(schema, settings)


def find_message(body: RdfBody, document: str, type_iri: str, node: str = "#message") -> Term:
    """Return the node of the message in the body sent to `document`.

    That is a node of the type: `document` + `node`, else the object of `<document> ros:latest`, else the only one, or
    the only one that is no part of another. Raises LoweringError if there is none, or more than one.
    """
    typed = body.instances(NamedNode(type_iri))
    named = NamedNode(document + node)
    if named in typed:
        return named
    latest = body.objects(NamedNode(document), ros.latest)
    if len(latest) == 1 and latest[0] in typed:
        return latest[0]
    if len(typed) > 1:
        roots = set(body.roots())
        typed = [subject for subject in typed if subject in roots]
    if len(typed) == 1:
        return typed[0]
    found = "none" if not typed else f"{len(typed)}"
    raise LoweringError(
        Violation(
            "", f"expected one node of type <{type_iri}>, but there is {found}: give <{document}{node}> that type"
        )
    )
