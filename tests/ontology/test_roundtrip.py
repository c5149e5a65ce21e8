"""Round trips: lifted messages, in any syntax that can represent them, lower back to equal messages."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable

import numpy as np
import pyoxigraph as ox
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from rosld.adapters.model import STRINGS, Array, Encoding, FieldType, Message, MessageSchema, Nested, Primitive, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.body import parse_body, parse_json
from rosld.ontology.document import Envelope
from rosld.ontology.lift import TYPES, Lifter, lifter
from rosld.ontology.literals import DTYPES
from rosld.ontology.lower import find_message, lowerer
from rosld.ontology.syntax import Syntax
from tests.ontology.test_serialize import canonical, rdflib_read, read

pytestmark = pytest.mark.slow

LIBRARIES = {version: TypeLibrary(ros_version=version) for version in (1, 2)}  # type: ignore[arg-type]
IN_ROS_1, IN_ROS_2 = (get_typestore(store).fielddefs for store in (Stores.ROS1_NOETIC, Stores.ROS2_JAZZY))
STORED = [*((1, name) for name in sorted(IN_ROS_1)), *((2, name) for name in sorted(IN_ROS_2))]
"""Every message type that rosbags ships, with the version of ROS."""
EMPTY = "structure_needs_at_least_one_member"

INTEGERS = {
    name: st.integers(int(np.iinfo(dtype).min), int(np.iinfo(dtype).max))
    | st.sampled_from([int(np.iinfo(dtype).min), int(np.iinfo(dtype).max), 0])
    for name, dtype in DTYPES.items()
    if dtype.kind in "iu"
}
FLOATS = {name: st.floats(width=width) for name, width in (("float32", 32), ("float64", 64))}
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8) | st.sampled_from(
    ['"', "a\nb\r\tc", "\x00", "\\", "\x7f\x85", "𝄞 ü", "#<>{}", "'''\"\"\"", "�￾"]
)
BYTES = st.binary(max_size=5).map(lambda octets: octets.decode("utf-8", "surrogateescape"))


class Filler:
    """Strategies for the messages of one schema."""

    def __init__(self, schema: MessageSchema, texts: st.SearchStrategy[str]) -> None:
        self.schema = schema
        self.texts = texts
        self.known: dict[str, st.SearchStrategy[Message]] = {}

    def message(self, name: str) -> st.SearchStrategy[Message]:
        if name not in self.known:
            fields = {field.attribute: self.field(field.type) for field in self.schema.types[name].fields}
            self.known[name] = st.fixed_dictionaries(fields).map(lambda v: self.schema.codec.build(name, v))
        return self.known[name]

    def field(self, kind: FieldType) -> st.SearchStrategy[object]:
        if isinstance(kind, Nested):
            return self.message(kind.name)
        if isinstance(kind, Array):
            return self.array(kind)
        return self.primitive(kind)

    def primitive(self, kind: Primitive) -> st.SearchStrategy[object]:
        if kind.name in STRINGS:
            bound = kind.bound
            return self.texts if bound is None else self.texts.filter(lambda text: len(text.encode()) <= bound)
        if kind.name == "bool":
            return st.booleans()
        return FLOATS[kind.name] if kind.name in FLOATS else INTEGERS[kind.name]

    def array(self, kind: Array) -> st.SearchStrategy[object]:
        least, limit = (0, min(3, kind.bound or 3)) if kind.length is None else (kind.length, kind.length)
        element = kind.element
        if isinstance(element, Nested):
            return st.lists(self.message(element.name), min_size=least, max_size=min(limit, max(least, 2)))
        values = st.lists(self.primitive(element), min_size=least, max_size=limit)
        if element.name in STRINGS:
            return values
        dtype = DTYPES[element.name]
        return values.map(lambda numbers: np.array(numbers, dtype))


def schema_of(version: int, name: str) -> MessageSchema:
    schema = LIBRARIES[version].find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def same(one: object, other: object) -> bool:
    """Whether values are equal in all relevant bits: NaN is NaN, -0.0 is not 0.0, an int is no float, dtypes agree."""
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and same(one.tolist(), other.tolist())
    if type(one) is not type(other):
        return False
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return (one != one and other != other) or (one == other and math.copysign(1, one) == math.copysign(1, other))
    if hasattr(one, "__msgtype__"):
        return all(same(value, getattr(other, name)) for name, value in vars(one).items() if name != EMPTY)
    return one == other


DOCUMENT = "http://127.0.0.1:8080/topics/some/thing"
ENVELOPE = Envelope(1_700_000_000_123_000_000, 18446744073709551616, "http://127.0.0.1:8080/nodes/n")
NOT_XML = re.compile("[\x00-\x08\x0b\x0c\r\x0e-\x1f\ufffe\uffff]")
FEW = settings(
    max_examples=8,  # of each of some twenty types, in nine syntaxes
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def turtle(lift: Lifter, message: Message) -> bytes:
    prefixes = "".join([f"@prefix {prefix}: <{iri}> .\n" for prefix, iri in lift.prefixes.items()])
    return f"@base <{DOCUMENT}> .\n{prefixes}{lift.turtle(message, DOCUMENT, '#message', envelope=ENVELOPE)}".encode()


def jsonld(lift: Lifter, message: Message) -> bytes:
    node = lift.jsonld(message, DOCUMENT, "#message", envelope=ENVELOPE)
    return f'{{"@context":{json.dumps(dict(lift.context))},{node[1:]}'.encode()


def based_jsonld(lift: Lifter, message: Message) -> bytes:
    return jsonld(lift, message).replace(b'{"@context":{', f'{{"@context":{{"@base":"{DOCUMENT}",'.encode(), 1)


def nquads(lift: Lifter, message: Message) -> bytes:
    end = f" <{DOCUMENT}> .\n"
    return lift.ntriples(message, DOCUMENT, "#message", end=end, envelope=ENVELOPE).encode()


def ntriples(lift: Lifter, message: Message) -> bytes:
    return lift.ntriples(message, DOCUMENT, "#message", envelope=ENVELOPE).encode()


def rdfxml(lift: Lifter, message: Message) -> bytes | None:
    """Return RDF/XML by pyoxigraph; None if the message has characters that XML 1.0 cannot represent."""
    triples = lift.triples(message, DOCUMENT, "#message", envelope=ENVELOPE)
    if any(NOT_XML.search(triple.object.value) for triple in triples if isinstance(triple.object, ox.Literal)):
        return None
    return ox.serialize(triples, format=ox.RdfFormat.RDF_XML)


SYNTAXES: dict[str, Callable[[Lifter, Message], bytes | None]] = {
    "text/turtle": turtle,
    "text/n3": turtle,
    "application/trig": turtle,
    "application/ld+json": jsonld,
    "application/n-triples": ntriples,
    "application/n-quads": nquads,
    "application/rdf+xml": rdfxml,
}


def kind_of(kind: FieldType) -> str:
    """Return the properties of a field that lifting and lowering distinguish."""
    if isinstance(kind, Array):
        size = "=" if kind.length is not None else "<=" if kind.bound is not None else ""
        return f"{kind_of(kind.element)}[{size}]"
    return "nested" if isinstance(kind, Nested) else f"{kind.name}{'<=' if kind.bound is not None else ''}"


def covering() -> list[tuple[int, str]]:
    """Return a few stored types that together have every kind of field, in both versions of ROS."""
    kinds = {
        each: {(each[0], kind_of(field.type)) for field in schema_of(*each).type.fields} or {(each[0], "empty")}
        for each in STORED
    }
    chosen, left = [], set().union(*kinds.values())
    while left:
        best = max(STORED, key=lambda each: len(kinds[each] & left))
        chosen.append(best)
        left -= kinds[best]
    return chosen


def test_a_message_says_the_same_in_every_syntax_and_lowers_to_its_equal() -> None:
    for version, name in covering():
        try_messages(schema_of(version, name), version)


def try_messages(schema: MessageSchema, version: int) -> None:
    @FEW
    @given(Filler(schema, TEXTS | BYTES if version == 1 else TEXTS).message(schema.ref.name))  # in ROS 1 any bytes
    def attempt(message: Message) -> None:
        says_the_same(schema, message)
        comes_back(schema, version, message)

    attempt()


def says_the_same(schema: MessageSchema, message: Message) -> None:
    """Assert that third-party readers find the same triples in every syntax."""
    lift = lifter(schema)
    said = canonical(lift.triples(message, DOCUMENT, "#message", envelope=ENVELOPE))
    assert canonical(read(ntriples(lift, message), Syntax.N_TRIPLES)) == said
    for syntax, write in ((Syntax.TURTLE, turtle), (Syntax.JSON_LD, based_jsonld)):
        text = write(lift, message)
        assert canonical(read(text, syntax)) == canonical(rdflib_read(text, syntax)) == said


def test_a_message_of_every_stored_type_comes_back() -> None:
    for version, name in STORED:
        if version == 1 and IN_ROS_1[name] == IN_ROS_2.get(name):
            continue
        schema = schema_of(version, name)
        comes_back(schema, version, lowerer(schema).from_json({}, defaults=True), ("text/turtle",))


def comes_back(schema: MessageSchema, version: int, message: Message, media_types: Iterable[str] = SYNTAXES) -> None:
    """Assert that a message is lowered from these syntaxes and from JSON to its equal."""
    lift, lower, name = lifter(schema), lowerer(schema), schema.ref.name
    for media_type in media_types:
        text = SYNTAXES[media_type](lift, message)
        if text is not None:
            body = parse_body(text, media_type, DOCUMENT)
            root = find_message(body, DOCUMENT, TYPES + name)
            assert same(message, lower.from_graph(body, root)), (name, media_type)
    lowered = lower.from_json(parse_json(lift.json(message, DOCUMENT)))
    assert same(message, lowered), name
    encoding = Encoding.ROS1 if version == 1 else Encoding.CDR
    assert schema.codec.encode(lowered, encoding) == schema.codec.encode(message, encoding) or has_nan(lift, message)


def has_nan(lift: Lifter, message: Message) -> bool:
    """Whether bytes may differ: there are many NaNs, and RDF has one."""
    return b'"NaN"' in lift.json(message, DOCUMENT)
