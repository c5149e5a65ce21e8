"""The functions under ros: on arrays as they are lifted, and on everything else."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, QuerySolutions

from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server.dataset import MemoryStore
from rosld.server.sparql.ros_functions import functions

TOPIC = "http://robot/topics/a"
FUNCTIONS = functions(lambda url: 2.5 if url == TOPIC else None)


def ask(expression: str) -> Literal | None:
    found = MemoryStore().query(
        f"SELECT ({expression} AS ?x) {{}}", prefixes={"ros": ros.iri, "rdf": rdf.iri}, functions=FUNCTIONS
    )
    assert isinstance(found, QuerySolutions)
    [row] = found
    value = row["x"]
    assert value is None or isinstance(value, Literal)
    return value


def integer(value: int) -> Literal:
    return Literal(str(value), datatype=xsd.integer)


@pytest.mark.parametrize(
    ("call", "array", "value"),
    [
        ("length({})", "[1,2.5,3]", integer(3)),
        ("length({})", "[]", integer(0)),
        ("at({}, 1)", "[1,2.5,3]", Literal(2.5)),
        ("at({}, 2)", "[1,2,3]", integer(3)),
        ("at({}, 1)", "[true,false]", Literal(False)),
        ("at({}, 0)", '["NaN",1.5]', Literal(math.nan)),
        ("at({}, 0)", '["-INF",1.5]', Literal(-math.inf)),
        ("at({}, 0)", '["18446744073709551615"]', integer(18446744073709551615)),
        ("at({}, 1)", '["a","NaN"]', Literal("NaN")),
        ("at({}, 1)", '["1","2"]', Literal("2")),
        ("at({}, 0)", '[{"@type":"http://h/t","@value":"/w=="}]', Literal("/w==", datatype=NamedNode("http://h/t"))),
        ("min({})", "[3,1,2]", integer(1)),
        ("max({})", '[3,1.5,"INF","NaN"]', Literal(math.inf)),
        ("min({})", '[3.5,"NaN",2.5]', Literal(2.5)),
        ("mean({})", '[1,2,"NaN",6]', Literal(3.0)),
        ("mean({})", '["INF","-INF"]', Literal(math.nan)),
        ("max({})", '["NaN"]', Literal(math.nan)),
        ("mean({})", "[]", Literal(math.nan)),
    ],
)
def test_arrays_are_read(call: str, array: str, value: Literal) -> None:
    assert ask("ros:" + call.format(f"'{array}'^^rdf:JSON")) == value


@pytest.mark.parametrize(
    ("call", "array"),
    [
        ("length({})", "{}"),
        ("length({})", "[1"),
        ("at({}, 1)", "[1]"),
        ("at({}, -1)", "[1]"),
        ("at({}, 'x')", "[1]"),
        ("at({}, 0.5)", "[1]"),
        ("at({}, 0)", "[[1]]"),
        ("at({})", "[1]"),
        ("max({})", '["a"]'),
        ("mean({})", "[true]"),
        ("min({})", "[null]"),
    ],
)
def test_an_array_that_has_no_answer_is_a_type_error(call: str, array: str) -> None:
    assert ask("ros:" + call.format(f"'{array}'^^rdf:JSON")) is None


@pytest.mark.parametrize(
    "call", ["length('[1]')", "max(<http://h/>)", "age('x')", "age(<http://robot/topics/b>)", "age()"]
)
def test_what_is_no_array_or_no_topic_is_a_type_error(call: str) -> None:
    assert ask(f"ros:{call}") is None


def test_age_is_in_seconds() -> None:
    age = ask(f"ros:age(<{TOPIC}>)")
    assert age is not None
    assert age.datatype == xsd.double
    assert float(age.value) == 2.5


def test_a_topic_has_one_age_within_a_query_and_another_in_the_next() -> None:
    ticks = iter(range(10))
    query = f"SELECT (ros:age(<{TOPIC}>) AS ?a) (ros:age(<{TOPIC}>) AS ?b) {{ VALUES ?x {{ 1 2 3 }} }}"
    for tick in (0.0, 1.0):
        found = MemoryStore().query(
            query, prefixes={"ros": ros.iri}, functions=functions(lambda url: float(next(ticks)))
        )
        assert isinstance(found, QuerySolutions)
        assert {value.value for row in found for value in row} == {str(int(tick))}


@given(st.text())
def test_no_array_makes_a_function_raise(text: str) -> None:
    literal = Literal(text, datatype=rdf.JSON)
    for iri, function in FUNCTIONS.items():
        for arguments in ((literal,), (literal, integer(0)), (NamedNode("http://h/"), literal), ()):
            assert iri
            function(*arguments)
