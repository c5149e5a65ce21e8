"""Literals come back from the dataset as they were written, and terms have sort keys in the order of their values."""

from __future__ import annotations

import io
from itertools import pairwise

import pyoxigraph
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, Quad, RdfFormat, parse

from rosld.server.dataset import MemoryStore
from rosld.server.dataset.encoding import (
    INTEGER,
    NAMESPACE,
    OTHER,
    Decoder,
    decode_ntriples,
    decode_term,
    encode_literal,
    encode_ntriples,
    is_changed,
)
from rosld.server.dataset.sort_keys import sort_key

XSD = "http://www.w3.org/2001/XMLSchema#"
NAMES = st.sampled_from(
    ["integer", "int", "unsignedByte", "decimal", "double", "float", "boolean", "dateTime", "date", "time", "duration"]
)
FORMS = (
    st.from_regex(r"[+-]?[0-9]{0,20}\.?[0-9]{0,20}([eE][+-]?[0-9]{1,3})?", fullmatch=True)
    | st.floats().map(repr)
    | st.tuples(st.integers(0, 2**53), st.integers(0, 60)).map(lambda parts: repr(parts[0] / 2 ** parts[1]))
    | st.datetimes().map(lambda moment: f"{moment.isoformat()}Z")
    | st.from_regex(r"2020-0[1-9]-[0-3][0-9]T[0-2][0-9]:00:00(\.[0-9]{1,3})?(Z|[+-]0[0-9]:00)?", fullmatch=True)
    | st.sampled_from(["INF", "-INF", "+INF", "NaN", "true", "false", "1", "0", "-0", "PT60S", "P1Y", "24:00:00", ""])
    | st.text(max_size=8)
)
LITERALS = st.builds(lambda value, name: Literal(value, datatype=NamedNode(XSD + name)), FORMS, NAMES)


def stored(literal: Literal) -> Literal:
    """What pyoxigraph gives back for a literal."""
    store = pyoxigraph.Store()
    store.add(Quad(NamedNode("urn:s"), NamedNode("urn:p"), literal))
    [quad] = store
    assert isinstance(quad.object, Literal)
    return quad.object


@given(LITERALS)
@settings(max_examples=3000, deadline=None)
@example(Literal("786673277317040.2", datatype=NamedNode(f"{XSD}double")))
@example(Literal("0.0", datatype=NamedNode(f"{XSD}double")))
@example(Literal("1099511627776.0312", datatype=NamedNode(f"{XSD}double")))
def test_an_encoded_literal_is_stored_as_it_is(literal: Literal) -> None:
    encoded = encode_literal(literal)
    assert stored(encoded) == encoded
    assert decode_term(encoded) == literal
    assert encoded == literal or stored(literal) != literal or not is_canonical(literal)


def is_canonical(literal: Literal) -> bool:
    """Whether its value is one that the dataset computes with."""
    [row] = pyoxigraph.Store().query(f"SELECT ({literal} = {literal} AS ?known) {{}}")  # type: ignore[misc]
    return row["known"] is not None and is_changed(literal.value, literal.datatype.value.removeprefix(XSD)) is False


@given(st.lists(LITERALS | st.text(max_size=20).map(Literal), max_size=8))
@settings(max_examples=500, deadline=None)
@example([Literal(f'x "^^<{XSD}byte> .0"^^<{XSD}double>'), Literal("07", datatype=NamedNode(f"{XSD}integer"))])
@example([Literal('a"b', datatype=NamedNode(f"{XSD}byte")), Literal("1.0", datatype=NamedNode(f"{XSD}double"))])
def test_ntriples_are_encoded_as_literals_are(literals: list[Literal]) -> None:
    text = "".join(f"<urn:s{at}> <urn:p> {literal} .\n" for at, literal in enumerate(literals))
    encoded = encode_ntriples(text)
    assert decode_ntriples(encoded.encode()).decode() == text
    found = [quad.object for quad in parse(encoded.encode(), RdfFormat.N_TRIPLES)]
    assert found == [encode_literal(literal) for literal in literals]
    store = MemoryStore()
    store.replace({"urn:g": text})
    assert sorted((store.ntriples("urn:g") or "").split("\n")) == sorted({*text.split("\n"), ""})


def test_what_no_number_is_written_in_stays_the_same_text() -> None:
    text = f'<urn:s> <urn:p> "7"^^<{XSD}integer> , "a"@en .\n'
    assert encode_ntriples(text) == text
    assert NAMESPACE not in encode_ntriples(f'<urn:s> <urn:p> "0.5"^^<{XSD}double> .\n')


@given(
    st.lists(st.sampled_from([f"{INTEGER}byte>", f"{OTHER}date>", NAMESPACE, "urn:x-", "u", "text "]), max_size=9),
    st.lists(st.integers(1, 60), min_size=1, max_size=30),
)
@settings(max_examples=500, deadline=None)
def test_output_is_decoded_wherever_it_is_cut(pieces: list[str], sizes: list[int]) -> None:
    data = "".join(pieces).encode()
    output = io.BytesIO()
    decoder, at = Decoder(output), 0
    while at < len(data):
        for size in sizes:
            decoder.write(data[at : at + size])
            at += size
    decoder.finish()
    assert output.getvalue() == decode_ntriples(data)


def typed(value: str, name: str) -> Literal:
    return Literal(value, datatype=NamedNode(XSD + name))


ORDERED = [
    BlankNode("a"), NamedNode("urn:a"), NamedNode("urn:b"),
    typed("many", "byte"), typed("-INF", "double"), typed("-9007199254740993", "integer"),
    typed("-9007199254740992", "integer"),
    typed("-1.5", "decimal"), typed("0", "integer"), typed("5e-324", "double"), typed("0.1", "decimal"),
    typed("9007199254740992", "double"), typed("9007199254740993", "long"),
    typed("1e300", "double"), typed("INF", "float"), typed("NaN", "double"),
    Literal(""), Literal("A"), Literal("a"), Literal("a", language="de"), Literal("a", language="en"),
    Literal("\U0001f600"),
    typed("-0044-03-15T12:00:00Z", "dateTime"), typed("1969-12-31T23:59:59.999", "dateTime"),
    typed("1970-01-01T01:00:00+01:00", "dateTime"), typed("1970-01-01T00:00:00.001Z", "dateTime"),
    typed("12000-01-01T00:00:00Z", "dateTime"), typed("false", "boolean"), typed("true", "boolean"),
    typed("2019", "gYear"), typed("2020-02-29", "date"), typed("2020-03-01", "date"),
    typed("-P1D", "duration"), typed("-PT1.5S", "duration"), typed("-PT1.25S", "duration"), typed("PT0S", "duration"),
    typed("P1M", "duration"), typed("P1Y", "yearMonthDuration"), typed("a", "hexBinary"), typed("b", "hexBinary"),
]  # fmt: skip


@pytest.mark.parametrize(("first", "second"), list(pairwise(ORDERED)), ids=str)
def test_sort_keys_are_in_the_order_of_the_terms(
    first: NamedNode | BlankNode | Literal, second: NamedNode | BlankNode | Literal
) -> None:
    assert sort_key(first) < sort_key(second)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (typed("7", "unsignedByte"), typed("007.0", "decimal")),
        (typed("0", "integer"), typed("-0.0", "double")),
        (typed("16777217", "float"), typed("16777216", "integer")),
        (typed("2020-01-01T00:00:00Z", "dateTime"), typed("2020-01-01T02:00:00.000+02:00", "dateTime")),
        (typed("PT60S", "duration"), typed("PT1M", "dayTimeDuration")),
        (typed("1", "boolean"), typed("true", "boolean")),
    ],
    ids=str,
)
def test_terms_of_one_value_have_one_key(one: Literal, other: Literal) -> None:
    assert sort_key(one) == sort_key(other) == sort_key(encode_literal(one))


@pytest.mark.parametrize("name", ["integer", "decimal", "double", "float", "dateTime", "duration", "boolean", "gYear"])
@pytest.mark.parametrize(
    "value", ["", "-", "9" * 10_000, f"-PT1.{'9' * 10_000}S", "1e999999999", "1_0", "nan", "\ud7ff"]
)
def test_every_literal_has_a_sort_key(value: str, name: str) -> None:
    assert sort_key(typed(value, name))
    assert sort_key(encode_literal(typed(value, name))) == sort_key(typed(value, name))
