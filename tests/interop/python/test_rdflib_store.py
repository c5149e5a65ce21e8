"""rdflib's SPARQLStore and SPARQLUpdateStore: a remote endpoint as if it were a graph in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from pyoxigraph import Triple
from rdflib import Dataset, Graph, Literal, URIRef
from rdflib.plugins.stores.sparqlstore import SPARQLStore, SPARQLUpdateStore

S, P = URIRef("urn:s"), URIRef("urn:p")


@pytest.fixture
def store(server: Any) -> SPARQLUpdateStore:
    return SPARQLUpdateStore(f"{server.url}sparql", f"{server.url}sparql")


@pytest.fixture
def graph(store: SPARQLUpdateStore, folder: str) -> Graph:
    """An empty graph."""
    return Graph(store, identifier=URIRef(f"{folder}graph"))


def test_a_graph_is_read_as_if_it_were_here(server: Any) -> None:
    speed = URIRef(f"{server.url}topics/aircraft/engine/speed")
    graph = Graph(SPARQLStore(f"{server.url}sparql"), identifier=speed)
    name = URIRef("https://w3id.org/rosld/ros#name")
    assert graph.value(speed, name) is not None or list(graph.predicate_objects(speed))
    assert len(graph) == len(list(graph)) > 5
    assert (speed, None, None) in graph
    assert (URIRef("urn:nothing"), None, None) not in graph


def test_queries_bind_what_they_are_given(server: Any) -> None:
    graph = Graph(SPARQLStore(f"{server.url}sparql"))
    speed = URIRef(f"{server.url}topics/aircraft/engine/speed")
    rows = list(graph.query("SELECT ?p ?o { ?s ?p ?o }", initBindings={"s": speed}))
    assert len(rows) > 5
    assert graph.query("ASK { ?s ?p ?o }", initBindings={"s": speed}).askAnswer is True
    assert len(graph.query(f"CONSTRUCT {{ ?s ?p ?o }} WHERE {{ GRAPH <{speed}> {{ ?s ?p ?o }} }}").graph or ()) > 5


@pytest.mark.parametrize("method", ["GET", "POST", "POST_FORM"])
def test_queries_are_answered_however_they_are_sent(server: Any, method: str) -> None:
    store = SPARQLStore(f"{server.url}sparql", method=method)
    assert Graph(store).query("SELECT (1 AS ?x) {}").bindings


@pytest.mark.parametrize("syntax", ["xml", "json", "csv", "tsv"])
def test_solutions_are_read_in_each_format(server: Any, syntax: str) -> None:
    store = SPARQLStore(f"{server.url}sparql", returnFormat=syntax)
    (row,) = Graph(store).query("SELECT ?x { VALUES ?x { 'ü' } }")
    assert row[0] == Literal("ü")


def test_triples_are_added_and_removed(graph: Graph) -> None:
    graph.add((S, P, Literal("a")))
    graph.add((S, P, Literal(7)))
    graph += [(S, P, Literal("b", lang="de")), (S, P, Literal("c\n\"'"))]
    assert set(graph.objects(S, P)) == {Literal("a"), Literal(7), Literal("b", lang="de"), Literal("c\n\"'")}
    graph.remove((S, P, Literal("a")))
    graph.remove((S, P, Literal(7)))
    assert set(graph.objects(S, P)) == {Literal("b", lang="de"), Literal("c\n\"'")}
    graph.remove((S, None, None))
    assert list(graph.objects(S, P)) == []


def test_what_was_added_is_a_resource(
    graph: Graph, server: Any, triples_of: Callable[[httpx.Response], set[Triple]]
) -> None:
    graph.add((S, P, Literal("a")))
    answer = server.http.get(str(graph.identifier), headers={"Accept": "text/turtle"})
    assert [t.object.value for t in triples_of(answer) if t.predicate.value == str(P)] == ["a"]


def test_updates_are_of_the_graph(graph: Graph) -> None:
    graph.update("INSERT DATA { <urn:s> <urn:p> 1 }")
    graph.update("DELETE { ?s ?p ?o } INSERT { ?s ?p 2 } WHERE { ?s ?p ?o . FILTER(?o = 1) }")
    assert list(graph.objects(S, P)) == [Literal(2)]


def test_changes_wait_for_their_commit_where_asked(server: Any, folder: str) -> None:
    store = SPARQLUpdateStore(f"{server.url}sparql", f"{server.url}sparql", autocommit=False, dirty_reads=True)
    graph, other = Graph(store, identifier=URIRef(f"{folder}a")), Graph(store, identifier=URIRef(f"{folder}b"))
    graph.add((S, P, Literal("a")))
    other.add((S, P, Literal("b")))
    assert list(graph.objects(S, P)) == []
    store.commit()
    assert [list(one.objects(S, P)) for one in (graph, other)] == [[Literal("a")], [Literal("b")]]
    graph.add((S, P, Literal("never")))
    store.rollback()
    store.commit()
    assert list(graph.objects(S, P)) == [Literal("a")]


def test_a_dataset_lists_and_removes_its_graphs(store: SPARQLUpdateStore, graph: Graph) -> None:
    graph.add((S, P, Literal("a")))
    dataset = Dataset(store=store)
    assert graph.identifier in {one.identifier for one in dataset.graphs() if isinstance(one, Graph)}
    store.remove_graph(graph)
    assert list(graph.objects(S, P)) == []


def test_a_graph_that_was_removed_is_loaded_again(store: SPARQLUpdateStore, graph: Graph) -> None:
    graph.add((S, P, Literal("a")))
    store.remove_graph(graph)
    graph.add((S, P, Literal("b")))
    assert list(graph.objects(S, P)) == [Literal("b")]


@pytest.mark.parametrize("syntax", ["turtle", "xml", "json-ld", "n3", None])
def test_a_page_is_parsed_from_its_url(server: Any, syntax: str | None) -> None:
    url = f"{server.url}topics/aircraft/engine/speed"
    found = Graph().parse(url, format=syntax)
    assert (URIRef(url), None, None) in found


def test_a_page_is_parsed_into_the_default_graph(server: Any) -> None:
    url = f"{server.url}topics/aircraft/engine/speed"
    dataset = Dataset()
    dataset.parse(url, format="trig")
    assert (URIRef(url), None, None) in dataset.default_graph
