"""SPARQLWrapper: it queries by GET for XML, and updates by a form."""

from __future__ import annotations

from typing import Any

import pytest

wrapper = pytest.importorskip("SPARQLWrapper", reason="SPARQLWrapper is not installed: pip install '.[interop]'")
pytestmark = pytest.mark.filterwarnings("ignore:ConjunctiveGraph is deprecated:DeprecationWarning")


@pytest.fixture
def sparql(server: Any) -> Any:
    return wrapper.SPARQLWrapper(f"{server.url}sparql")


@pytest.fixture
def kept(sparql: Any, folder: str) -> str:
    """A graph with one triple, created by an update."""
    name = f"{folder}graph"
    update(sparql, f"INSERT DATA {{ GRAPH <{name}> {{ <urn:s> <urn:p> 'o' }} }}")
    return name


def update(sparql: Any, text: str) -> None:
    sparql.setMethod(wrapper.POST)
    sparql.setQuery(text)
    sparql.query()
    sparql.setMethod(wrapper.GET)


def test_a_select_is_converted_from_its_default_format(sparql: Any, kept: str) -> None:
    sparql.setQuery(f"SELECT ?o {{ GRAPH <{kept}> {{ <urn:s> <urn:p> ?o }} }}")
    document = sparql.query().convert()
    assert [node.firstChild.data for node in document.getElementsByTagName("literal")] == ["o"]


def test_a_select_as_json_is_bindings(sparql: Any, kept: str) -> None:
    sparql.setReturnFormat(wrapper.JSON)
    sparql.setQuery(f"SELECT ?o {{ GRAPH <{kept}> {{ <urn:s> <urn:p> ?o }} }}")
    assert sparql.queryAndConvert()["results"]["bindings"] == [{"o": {"type": "literal", "value": "o"}}]


@pytest.mark.parametrize("name", ["CSV", "TSV"])
def test_a_select_as_a_table_has_a_line_a_solution(sparql: Any, kept: str, name: str) -> None:
    sparql.setReturnFormat(getattr(wrapper, name))
    sparql.setQuery(f"SELECT ?o {{ GRAPH <{kept}> {{ <urn:s> <urn:p> ?o }} }}")
    lines = sparql.queryAndConvert().decode().splitlines()
    assert lines == (["o", "o"] if name == "CSV" else ["?o", '"o"'])


@pytest.mark.parametrize("method", ["GET", "POST"])
@pytest.mark.parametrize("sent", ["URLENCODED", "POSTDIRECTLY"])
def test_an_ask_is_a_boolean_however_it_is_sent(sparql: Any, kept: str, method: str, sent: str) -> None:
    sparql.setMethod(getattr(wrapper, method))
    sparql.setRequestMethod(getattr(wrapper, sent))
    sparql.setReturnFormat(wrapper.JSON)
    sparql.setQuery(f"ASK {{ GRAPH <{kept}> {{ <urn:s> <urn:p> 'o' }} }}")
    assert sparql.queryAndConvert()["boolean"] is True


@pytest.mark.parametrize("name", [None, "TURTLE", "N3", "RDFXML", "JSONLD"])
@pytest.mark.parametrize("form", ["CONSTRUCT { ?s ?p ?o }", "CONSTRUCT"])
def test_a_construct_is_a_graph_in_each_format(sparql: Any, kept: str, form: str, name: str | None) -> None:
    if name is not None:
        sparql.setReturnFormat(getattr(wrapper, name))
    pattern = "{ ?s ?p ?o . FILTER(?s = <urn:s>) }" if form != "CONSTRUCT" else "{ ?s <urn:p> ?o }"
    sparql.addDefaultGraph(kept)
    sparql.setQuery(f"{form} WHERE {pattern}")
    found = sparql.queryAndConvert()
    if isinstance(found, bytes):
        from rdflib import Graph

        found = Graph().parse(found, format="turtle" if name == "TURTLE" else "n3")
    assert [str(o) for _, _, o in found] == ["o"]


def test_a_describe_is_a_graph(sparql: Any, server: Any) -> None:
    sparql.setQuery(f"DESCRIBE <{server.url}topics/aircraft/engine/speed>")
    assert len(sparql.queryAndConvert()) > 5


def test_the_dataset_of_a_query_is_what_its_parameters_name(sparql: Any, kept: str) -> None:
    sparql.setReturnFormat(wrapper.JSON)
    sparql.addNamedGraph(kept)
    sparql.setQuery("SELECT ?g ?o { GRAPH ?g { <urn:s> <urn:p> ?o } }")
    assert [row["g"]["value"] for row in sparql.queryAndConvert()["results"]["bindings"]] == [kept]


def test_an_update_moves_the_robot(sparql: Any, server: Any) -> None:
    property_ = f"{server.url}resources/cockpit/night"
    for value in ("true", "false"):
        update(
            sparql,
            f"PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> WITH <{property_}> "
            f"DELETE {{ ?s rdf:value ?v }} INSERT {{ ?s rdf:value {value} }} WHERE {{ ?s rdf:value ?v }}",
        )
        read = server.http.get(property_, headers={"Accept": "application/json"})
        assert read.json() is (value == "true")


@pytest.mark.parametrize("sent", ["URLENCODED", "POSTDIRECTLY"])
def test_an_update_is_carried_out_however_it_is_sent(sparql: Any, kept: str, sent: str) -> None:
    sparql.setRequestMethod(getattr(wrapper, sent))
    update(sparql, f"DELETE DATA {{ GRAPH <{kept}> {{ <urn:s> <urn:p> 'o' }} }}")
    sparql.setRequestMethod(wrapper.URLENCODED)
    sparql.setReturnFormat(wrapper.JSON)
    sparql.setQuery(f"ASK {{ GRAPH <{kept}> {{ <urn:s> <urn:p> 'o' }} }}")
    assert sparql.queryAndConvert()["boolean"] is False


def test_a_query_of_bad_syntax_is_an_error_of_its_own(sparql: Any) -> None:
    from SPARQLWrapper.SPARQLExceptions import QueryBadFormed

    sparql.setQuery("SELECT ?o {")
    with pytest.raises(QueryBadFormed):
        sparql.query()
