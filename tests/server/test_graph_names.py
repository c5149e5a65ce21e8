"""How requests name graphs: one at a time, by an absolute IRI or one that is resolved."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.problem import Problem
from rosld.server.resources.graph_store import GraphSelection, parse_graph_selection

STORE = "http://robot:8080/under/graphs"


@pytest.mark.parametrize(
    ("query", "graph"),
    [
        (b"graph=http://robot:8080/under/data/a", "http://robot:8080/under/data/a"),
        (b"graph=http%3A%2F%2Frobot%3A8080%2Funder%2Fdata%2Fa", "http://robot:8080/under/data/a"),
        (b"graph=data/a", "http://robot:8080/under/data/a"),
        (b"graph=/data/a", "http://robot:8080/data/a"),
        (b"graph=urn:x:y", "urn:x:y"),
        (b"graph=data/%C3%BC", "http://robot:8080/under/data/%C3%BC"),
        (b"graph=data/%25C3%25BC", "http://robot:8080/under/data/%C3%BC"),
        (b"graph=types/x?hash=1%26a=2", "http://robot:8080/under/types/x?hash=1&a=2"),
    ],
)
def test_a_graph_is_named_by_an_iri(query: bytes, graph: str) -> None:
    assert parse_graph_selection(query, STORE) == GraphSelection(graph, False, False, "")


def test_all_other_parameters_are_kept() -> None:
    assert parse_graph_selection(b"a=1%20%26&graph=urn:x:y&b", STORE) == GraphSelection(
        "urn:x:y", False, False, "a=1+%26&b="
    )
    the_default_graph = GraphSelection(None, True, False, "format=nt")
    assert (
        parse_graph_selection(b"format=nt&default", STORE)
        == parse_graph_selection(b"default=&format=nt", STORE)
        == the_default_graph
    )
    assert parse_graph_selection(b"", STORE) == GraphSelection(None, False, False, "")


@pytest.mark.parametrize(
    "query",
    [
        *(b"graph=a&graph=a", b"graph=a&default", b"default&default", b"graph=a%20b", b"graph=http://[", b"graph=%FF"),
        *(b"\xff", b"&".join([b"a=b"] * 300)),
    ],
)
def test_what_names_no_graph_is_refused(query: bytes) -> None:
    with pytest.raises(Problem) as caught:
        parse_graph_selection(query, STORE)
    assert caught.value.status == 400


@given(st.text(), st.binary())
def test_nothing_that_arrives_makes_it_raise_anything_else(text: str, raw: bytes) -> None:
    for query in (raw, b"graph=" + raw, b"graph=" + text.encode("utf-8", "surrogatepass")):
        with suppress(Problem):
            parse_graph_selection(query, STORE)
