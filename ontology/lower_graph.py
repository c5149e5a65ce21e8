"""Lowering from RDF: tables of readers, created once per schema, that start at the message's node.

A message is read from the statements about its node: each predicate names a field or is managed by the server and
ignored; anything else is a violation. Readers behave as those of `lower.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias, cast

import numpy as np
from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import STRINGS, Array, Field, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.body import RdfBody, Term
from rosld.ontology.coercion import (
    RANGES,
    Misfit,
    Number,
    check_length,
    describe_kind,
    float_fit,
    integer_fit,
    is_octets,
    octet_array,
    string_fit,
)
from rosld.ontology.compile import TIME
from rosld.ontology.json_leaves import array_of_json, read_all
from rosld.ontology.lexical import BINARIES, NUMBERS, parse_boolean, parse_date_time
from rosld.ontology.literals import DTYPES
from rosld.ontology.message_readers import MessageReaders, Reader, guarded
from rosld.ontology.names import type_names
from rosld.ontology.violations import Findings, Path
from rosld.ontology.vocab import geo, rdf, ros, xsd

IGNORED = frozenset({ros.received, ros.sequence, ros.sentBy, ros.latched, ros.dateTime, ros.rate, geo.hasGeometry})
"""Predicates that the server adds to messages and ignores when they are sent back."""

TermLeaf: TypeAlias = Callable[[Term], object]

_FLOATS = (xsd.double, xsd.float)


class GraphReading:
    """State of one lowering: the body, the violations, the nodes above, and the remaining budget."""

    def __init__(self, body: RdfBody) -> None:
        self.body = body
        self.findings = Findings()
        self.above: list[Term] = []
        self._left = 1000 + 4 * body.size

    def spend(self) -> None:
        """Count one node or element. Raises Misfit when a few triples are read over and over."""
        self._left -= 1
        if self._left < 0:
            raise Misfit("the same nodes are used too often in this body")


GraphReader: TypeAlias = Reader[Term, GraphReading]

# Literals


def _unexpected(kind: FieldType, term: Term) -> Misfit:
    return Misfit(f"expected {describe_kind(kind)}", term)


def _number(kind: Primitive, fit: Callable[[Number], object]) -> TermLeaf:
    """Return the reader of a number; a float is no integer, because no shape could distinguish which are integers."""
    is_integer = kind.name in RANGES

    def read(term: Term) -> object:
        if not isinstance(term, Literal) or (parse := NUMBERS.get(term.datatype)) is None:
            raise _unexpected(kind, term)
        if is_integer and term.datatype in _FLOATS:
            raise Misfit(f"expected {describe_kind(kind)}, as an integer or a decimal", term)
        return fit(parse(term.value))

    return read


def _bool(term: Term) -> bool:
    if isinstance(term, Literal) and term.datatype == xsd.boolean:
        return parse_boolean(term.value)
    raise _unexpected(Primitive("bool"), term)


def _string(kind: Primitive) -> TermLeaf:
    fit = string_fit(kind)

    def read(term: Term) -> str:
        if not isinstance(term, Literal):
            raise _unexpected(kind, term)
        datatype = term.datatype
        if datatype == xsd.string:
            return fit(term.value)
        if datatype in BINARIES:
            return fit(BINARIES[datatype](term.value).decode("utf-8", "surrogateescape"))
        if datatype == rdf.langString:
            raise Misfit(f"expected {describe_kind(kind)} without a language", term)
        raise _unexpected(kind, term)

    return read


def term_leaf(kind: Primitive) -> TermLeaf:
    """Return the reader of a literal as a primitive. It raises Misfit."""
    if kind.name in STRINGS:
        return _string(kind)
    if kind.name == "bool":
        return _bool
    return _number(kind, float_fit(kind) if kind.name.startswith("float") else integer_fit(kind))


# Lists


def _elements(kind: Array, head: Term, reading: GraphReading) -> list[Term]:
    """Return the elements of an rdf:List (RDF Schema 5.2). Raises Misfit for anything else."""
    elements: list[Term] = []
    cells: set[Term] = set()
    cell = head
    while cell != rdf.nil:
        reading.spend()
        first, rest = reading.body.objects(cell, rdf.first), reading.body.objects(cell, rdf.rest)
        if cell is head and not first and not rest:
            raise _no_list(kind, head, reading)
        if len(first) != 1 or len(rest) != 1:
            raise Misfit("malformed rdf:List: each cell has one rdf:first and one rdf:rest", cell)
        if cell in cells:
            raise Misfit("malformed rdf:List: it never ends", cell)
        cells.add(cell)
        elements.append(first[0])
        cell = rest[0]
    return elements


def _no_list(kind: Array | Primitive, term: Term, reading: GraphReading) -> Misfit:
    if ros.Elided in reading.body.objects(term, rdf.type):
        return Misfit("this was elided when it was read (ros:Elided): fetch its ros:bytes and send all of it", term)
    return _unexpected(kind, term)


def _array(kind: Array, element: Primitive) -> GraphReader:
    """Return the reader of an array of primitives: an rdf:JSON literal, octets or an rdf:List of literals."""
    from_json, one = array_of_json(kind), term_leaf(element)
    binary = is_octets(kind)

    def read(term: Term, path: Path, reading: GraphReading) -> object:
        if not isinstance(term, Literal):
            return _list(kind, element, one, _elements(kind, term, reading))
        datatype = term.datatype
        if datatype == rdf.JSON:
            return from_json(term.value)
        if binary and datatype in BINARIES:
            return octet_array(kind, BINARIES[datatype](term.value))
        raise _unexpected(kind, term)

    return read


def _list(kind: Array, element: Primitive, one: TermLeaf, terms: list[Term]) -> object:
    values = read_all(one, check_length(kind, terms))
    return values if element.name in STRINGS else np.array(values, DTYPES[element.name])


# Messages


class GraphReaders(MessageReaders[Term, GraphReading]):
    """The readers of nodes as messages of one schema; `types` is the namespace of message types."""

    def __init__(self, schema: MessageSchema, types: str) -> None:
        super().__init__(schema)
        self._names = type_names(schema.types, types)

    def _message(self, name: str) -> GraphReader:
        build, kind, own = self._schema.codec.build, Nested(name), NamedNode(self._names[name].iri)
        fields = self._schema.types[name].fields
        entries = {
            NamedNode(self._names[name].property(field.name)): (field, self.reader(field.type)) for field in fields
        }
        types = (own, ros.Message)

        def read(node: Term, path: Path, reading: GraphReading) -> object:
            if isinstance(node, Literal):
                raise _unexpected(kind, node)
            if node in reading.above:
                raise Misfit(f"expected {describe_kind(kind)}, but this node contains itself", node)
            reading.spend()
            values: dict[str, object] = {}
            reading.above.append(node)
            properties = reading.body.properties(node)
            for predicate, objects in properties.items():
                entry = entries.get(predicate)
                if entry is not None:
                    field, one = entry
                    values[field.attribute] = _read(one, objects, (path, field.name), reading)
                elif predicate == rdf.type:
                    _check_type(types, objects, path, reading.findings)
                elif predicate not in IGNORED:
                    _unknown(self._names[name].iri, fields, predicate, path, reading.findings)
            reading.above.pop()
            if len(values) < len(entries):
                _complete(name, fields, values, properties, path, reading.findings)
            return None if reading.findings.violations else build(name, values)

        return read

    def _leaf(self, kind: Primitive | Array) -> GraphReader:
        return _primitive(kind) if isinstance(kind, Primitive) else _array(kind, cast(Primitive, kind.element))

    def _items(self, kind: Array, value: Term, reading: GraphReading) -> list[Term]:
        if isinstance(value, Literal):
            raise _unexpected(kind, value)
        return _elements(kind, value, reading)


def _primitive(kind: Primitive) -> GraphReader:
    leaf = term_leaf(kind)

    def read(term: Term, path: Path, reading: GraphReading) -> object:
        if not isinstance(term, Literal):
            raise _no_list(kind, term, reading)
        return leaf(term)

    return read


def _read(one: GraphReader, objects: list[Term], path: Path, reading: GraphReading) -> object:
    if len(objects) > 1 and len(set(objects)) > 1:
        reading.findings.add(path, f"expected one value, but there are {len(set(objects))}")
        return None
    return guarded(one, objects[0], path, reading)


def _check_type(types: tuple[NamedNode, ...], objects: list[Term], path: Path, findings: Findings) -> None:
    for each in objects:
        if each not in types:
            findings.add(path, f"expected a node of type {types[0]}", each)


def _unknown(iri: str, fields: tuple[Field, ...], predicate: NamedNode, path: Path, findings: Findings) -> None:
    """Add a violation for a predicate that is no field."""
    has = ", ".join(field.name for field in fields) or "none"
    step = predicate.value.removeprefix(iri + "#")
    findings.add((path, step), f"{predicate} is not a field of <{iri}>; it has {has}")


def _complete(
    name: str,
    fields: tuple[Field, ...],
    values: dict[str, object],
    properties: Mapping[NamedNode, list[Term]],
    path: Path,
    findings: Findings,
) -> None:
    """Add violations for missing fields; a stamp with only its derived ros:dateTime is completed from it."""
    if name == TIME and not values and ros.dateTime in properties:
        _read_stamp(values, properties[ros.dateTime], path, findings)
        return
    for field in fields:
        if field.attribute not in values:
            findings.add((path, field.name), f"missing: expected {describe_kind(field.type)}")


def _read_stamp(values: dict[str, object], objects: list[Term], path: Path, findings: Findings) -> None:
    term = objects[0]
    try:
        if len(set(objects)) > 1 or not isinstance(term, Literal) or term.datatype != xsd.dateTime:
            raise Misfit("expected one xsd:dateTime", term)
        seconds, nanosec = divmod(parse_date_time(term.value), 1_000_000_000)
        values["sec"] = integer_fit(Primitive("int32"))(seconds)
        values["nanosec"] = nanosec
    except Misfit as misfit:
        findings.misfit(path, misfit)
