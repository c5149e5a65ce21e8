"""Updates that differ in their literals alone: read once, and each as if it had been read by itself."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode

from rosld.server.http.problem import Problem
from rosld.server.sparql.lexer import BOUNDS, Bounds
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.update.operations import Modify, Operation
from rosld.server.sparql.update.reading import read_update
from rosld.server.sparql.update.shaped import Reader
from tests.server.sparql.update.test_reading_judged import BASE, VALID, mutated

PREFIXES = {"e": "urn:e:", "xsd": "http://www.w3.org/2001/XMLSchema#"}
MOVE = (
    "PREFIX v: <http://v/> DELETE {{ GRAPH <g> {{ ?m v:x ?old }} }} INSERT {{ GRAPH <g> {{ ?m v:x {} ; v:name {} }} }} "
    "WHERE {{ GRAPH <g> {{ ?m v:x ?old . FILTER(?old != {}) }} }}"
)


def reader(bounds: Bounds = BOUNDS) -> Reader:
    return Reader(PREFIXES, BASE, bounds)


def by_itself(text: str, bounds: Bounds = BOUNDS) -> tuple[Operation, ...] | str:
    """The operations, or the words of the Problem."""
    try:
        return read_update(UpdateRequest(text), PREFIXES, BASE, bounds)
    except Problem as problem:
        return f"{problem.status} {problem.detail}"


def read(one: Reader, text: str) -> tuple[Operation, ...] | str:
    try:
        return one.read(UpdateRequest(text))
    except Problem as problem:
        return f"{problem.status} {problem.detail}"


def hits(one: Reader) -> int:
    """How many updates were of a shape that was known."""
    return one._kept.cache_info().hits


def has_blank_nodes(operations: Sequence[Operation]) -> bool:
    modifies = [each for each in operations if isinstance(each, Modify)]
    return any(
        isinstance(term, BlankNode) for one in modifies for quad in (*one.deletes, *one.inserts) for term in quad
    )


LITERALS = [
    ("1", "'a'", "2"), ("25", '"b c"', "17"), ("0.5", "'x'", "1"), ("-0.25", "''", "3"), ("1e3", "'é \U0001f916'", "4"),
    ("+7", "'a'@en", "'z'"), ("'5'^^xsd:int", '"it\'s"', "0.1"), (".5", "'say \"so\"'", "5"), ("1.5E-3", "'#<{'", "6"),
]  # fmt: skip


@pytest.mark.parametrize("literals", LITERALS, ids=" ".join)
def test_an_update_is_read_as_by_itself_whatever_literals_came_before(literals: tuple[str, str, str]) -> None:
    one = reader()
    for others in LITERALS:
        read(one, MOVE.format(*others))
    text = MOVE.format(*literals)
    assert not isinstance(by_itself(text), str)
    assert read(one, text) == by_itself(text)
    assert read(one, text) == by_itself(text)


def test_updates_of_one_shape_are_read_once() -> None:
    one = reader()
    for number in range(20):
        text = MOVE.format(f"{number}.5", f"'word {number}'", number)
        assert read(one, text) == by_itself(text)
    assert hits(one) == 19


def test_another_kind_of_number_is_another_shape() -> None:
    one = reader()
    texts = [MOVE.format(number, "'a'", 1) for number in ("1", "1.0", "1e0")]
    assert [read(one, text) for text in texts] == [by_itself(text) for text in texts]
    assert hits(one) == 0


@pytest.mark.parametrize(
    "text",
    [
        "INSERT DATA { GRAPH <g> { <s> <p> 'a\\'b' } }",
        "INSERT DATA { GRAPH <g> { <s> <p> '''long''' } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 'a' } } # and a remark with a ' in it",
        "INSERT DATA { GRAPH <g> { <it's> <p> 'a' } }",
        "INSERT DATA { GRAPH <g> { <s1> <p2> e:a3 , e:4 , e:a\\'5 } }",
        "INSERT DATA { GRAPH <g> { <s> e:p.5 5 . <s> e:q 5. <s> e:r .5.<s> e:s 5.0. } }",
        "DELETE { GRAPH <g> { ?1 ?2 ?x3 } } WHERE { GRAPH <g> { ?1 ?2 ?x3 FILTER(?x3<3&&?1>2) } }",
        "DELETE { GRAPH <g> { ?s e:p ?o } } WHERE { { SELECT * { ?s e:p{1,2} ?o } LIMIT 5 OFFSET 3 } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 1 , -1 , +1 , - 1 } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 'a'@en-GB , 'b'^^<http://d#5> , 'true' , true } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 'never ends } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 'a } } ; DELETE DATA { GRAPH <g> { <s> <p> a' } }",
        "INSERT DATA { GRAPH <g> { 'a' <p> 1 } }",
        "INSERT DATA { GRAPH <g> { <s> 1 1 } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 'tab\tin it' , 'del\x7f' , 'bell\x07' } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 5 } } ; CLEAR GRAPH <h>",
        "SELECT * { ?s ?p 5 }",
        "INSERT DATA { GRAPH <g> { é:s <p> 5 } }",
        "INSERT DATA { GRAPH <g> { <s> <p> 'a''b' } }",
        "INSERT DATA { GRAPH <g> { <s> <p> ''''a' } }",
    ],
)
def test_what_is_unusual_is_read_as_by_itself_too(text: str) -> None:
    one = reader()
    assert [read(one, text), read(one, text)] == [by_itself(text)] * 2


def test_every_update_has_blank_nodes_of_its_own() -> None:
    one, text = reader(), "INSERT DATA { GRAPH <g> { [] e:p 5 } }"
    nodes = set()
    for _ in range(3):
        [operation] = one.read(UpdateRequest(text))
        assert isinstance(operation, Modify)
        nodes.add(operation.inserts[0].subject)
    assert len(nodes) == 3


def test_the_dataset_of_the_request_is_part_of_what_is_read() -> None:
    one, text = reader(), "DELETE { GRAPH <g> { ?s e:p 1 } } WHERE { ?s e:p 2 }"
    for graphs in ((), ("http://a/",), ("http://b/",)):
        request = UpdateRequest(text, graphs)
        assert one.read(request) == read_update(request, PREFIXES, BASE, BOUNDS)


def test_what_is_too_long_is_refused_whatever_its_shape() -> None:
    one = reader(Bounds(size=200))
    assert not isinstance(read(one, "INSERT DATA { GRAPH <g> { <s> <p> 'a' } }"), str)
    text = f"INSERT DATA {{ GRAPH <g> {{ <s> <p> '{'a' * 300}' }} }}"
    assert read(one, text) == by_itself(text, Bounds(size=200))


SHARED = reader()
NUMBER = re.compile(r"(?<![\w?:<.])\d+(?![\w.>])")


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_any_update_is_read_as_by_itself_beside_others_of_its_shape(data: st.DataObject) -> None:
    text = data.draw(mutated())
    numbers = st.sampled_from(["1", "2", "70", "007", "12345678901234567890123"])
    for _ in range(2):
        text = NUMBER.sub(lambda _: data.draw(numbers), text)
        alone = by_itself(text)
        if isinstance(alone, str) or not has_blank_nodes(alone):
            assert read(SHARED, text) == alone


@given(st.sampled_from(VALID), st.text(max_size=12), st.floats(allow_nan=False, allow_infinity=False))
@settings(max_examples=300, deadline=None)
def test_any_words_and_numbers_are_read_as_by_themselves(text: str, words: str, number: float) -> None:
    for literal in (f"'{words}'", f'"{words}"', repr(number), f"'{words}'@en"):
        changed = re.sub(r"'[^']*'|\b1\b", lambda _: literal, text)  # noqa: B023
        alone = by_itself(changed)
        if isinstance(alone, str) or not has_blank_nodes(alone):
            assert read(SHARED, changed) == alone
