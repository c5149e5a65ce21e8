"""W3C's tests of the SPARQL 1.1 Protocol for queries, by name, and its other requirements for endpoints."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from tests.conformance.sparql.conftest import boolean
from tests.server.robots.asking import SYNTAXES

if TYPE_CHECKING:
    from tests.conformance.sparql.conftest import Endpoint, Store

FORM = "application/x-www-form-urlencoded"
QUERY = "application/sparql-query"
ONE = "<http://example.org/data1> a ?one"
TWO = "<http://example.org/data2> a ?two"
THREE = "<http://example.org/data3> a ?three"
SD = "http://www.w3.org/ns/sparql-service-description#"


def answered(endpoint: Endpoint, method: str, text: str, **graphs: list[str]) -> bool:
    """Return the answer to an ASK with a dataset; an underscore in a name stands for a hyphen."""
    named = {name.replace("_", "-"): value for name, value in graphs.items()}
    if method == "get":
        return endpoint.ask(text, **named)
    url = f"{endpoint.url}sparql"
    return boolean(endpoint.http.post(url, params=named, content=text, headers={"Content-Type": QUERY}))


def test_query_post_form(endpoint: Endpoint, three: tuple[str, str, str]) -> None:
    text = f"ASK {{ {ONE} }}"
    assert boolean(endpoint.form(f"?default-graph-uri={quote(three[0])}", query=text))
    assert not boolean(endpoint.form(f"?default-graph-uri={quote(three[1])}", query=text))


@pytest.mark.parametrize("method", ["get", "post"])
def test_query_dataset_default_graphs(endpoint: Endpoint, three: tuple[str, str, str], method: str) -> None:
    text = f"ASK {{ {ONE} . {TWO} }}"
    assert answered(endpoint, method, text, default_graph_uri=[three[0], three[1]])
    assert not answered(endpoint, method, text, default_graph_uri=[three[0]])


@pytest.mark.parametrize("method", ["get", "post"])
def test_query_dataset_named_graphs(endpoint: Endpoint, three: tuple[str, str, str], method: str) -> None:
    text = f"ASK {{ GRAPH ?g1 {{ {ONE} }} GRAPH ?g2 {{ {TWO} }} }}"
    assert answered(endpoint, method, text, named_graph_uri=[three[0], three[1]])
    assert not answered(endpoint, method, text, named_graph_uri=[three[0], three[2]])
    assert not answered(endpoint, method, f"ASK {{ {ONE} }}", named_graph_uri=[three[0]]), "no default graph is named"


@pytest.mark.parametrize("method", ["get", "post"])
def test_query_dataset_full(endpoint: Endpoint, three: tuple[str, str, str], method: str) -> None:
    """By direct POST and by GET, as in the other tests of datasets (`query_post_direct`, `query_get`)."""
    text = f"ASK {{ {THREE} GRAPH ?g1 {{ {ONE} }} GRAPH ?g2 {{ {TWO} }} }}"
    one, two, default = three
    assert answered(endpoint, method, text, default_graph_uri=[default], named_graph_uri=[one, two])
    assert not answered(endpoint, method, text, default_graph_uri=[one], named_graph_uri=[default, two])


@pytest.mark.parametrize("method", ["get", "post"])
def test_query_multiple_dataset(endpoint: Endpoint, three: tuple[str, str, str], method: str) -> None:
    text = f"ASK FROM <{three[2]}> {{ {ONE} . {TWO} }}"
    assert answered(endpoint, method, text, default_graph_uri=[three[0], three[1]])
    own = f"ASK FROM <{three[0]}> {{ {ONE} }}"
    assert answered(endpoint, method, own)
    assert not answered(endpoint, method, own, default_graph_uri=[three[1]]), "what is beside the query goes first"


def test_query_content_type_select(endpoint: Endpoint, store: Store) -> None:
    store.put("a", "<http://example.org/s> <http://example.org/p> 'a, \"b\"'@en .")
    text = "SELECT ?s ?o { ?s <http://example.org/p> ?o }"
    graph = {"default-graph-uri": store.at("a")}
    for media_type, found in (
        ("application/sparql-results+json", '"xml:lang":"en"'),
        ("application/sparql-results+xml", "<uri>http://example.org/s</uri>"),
        ("text/csv", 'http://example.org/s,"a, ""b"""'),
        ("text/tab-separated-values", "<http://example.org/s>\t"),
    ):
        url, sent = f"{endpoint.url}sparql", {"Accept": media_type}
        answer = endpoint.http.get(url, params={"query": text, **graph}, headers=sent)
        assert answer.status_code == 200
        assert answer.headers["content-type"].partition(";")[0] == media_type
        assert found in answer.text
        assert "Accept" in answer.headers["vary"]
    rows = list(csv.reader(io.StringIO(endpoint.post(text, QUERY, Accept="text/csv").text)))
    assert rows[0] == ["s", "o"]


def test_query_content_type_ask(endpoint: Endpoint) -> None:
    for media_type, found in (
        ("application/sparql-results+json", "true"),
        ("application/sparql-results+xml", "<boolean>true</boolean>"),
    ):
        answer = endpoint.post("ASK {}", QUERY, Accept=media_type)
        assert answer.headers["content-type"] == media_type
        assert found in answer.text


@pytest.mark.parametrize("media_type", SYNTAXES)
def test_query_content_type_construct(endpoint: Endpoint, three: tuple[str, str, str], media_type: str) -> None:
    """And of DESCRIBE (`query_content_type_describe`)."""
    construct = "CONSTRUCT { ?s a ?o } FROM <%s> { ?s a ?o FILTER(STRSTARTS(STR(?o), 'http://example.org/')) }"
    for text in (construct, "DESCRIBE <http://example.org/data1> FROM <%s>"):
        answer = endpoint.post(text % three[0], QUERY, Accept=media_type)
        assert answer.headers["content-type"].partition(";")[0] == media_type
        (quad,) = parse(answer.content, RdfFormat.from_media_type(media_type))
        assert (quad.subject.value, quad.object.value) == ("http://example.org/data1", "http://example.org/Kind1")


def test_bad_query_method(endpoint: Endpoint) -> None:
    answer = endpoint.http.put(f"{endpoint.url}sparql?query=ASK%20%7B%7D")
    assert answer.status_code == 405
    assert {"GET", "HEAD", "POST", "OPTIONS"} <= set(answer.headers["allow"].split(", "))


def test_bad_multiple_queries(endpoint: Endpoint) -> None:
    assert endpoint.http.get(f"{endpoint.url}sparql?query=ASK%20%7B%7D&query=SELECT%20%2A%20%7B%7D").status_code == 400
    assert endpoint.form(query=["ASK {}", "SELECT * {}"]).status_code == 400
    assert endpoint.post("ASK {}", QUERY, "?query=ASK%20%7B%7D").status_code == 400


def test_bad_query_wrong_media_type(endpoint: Endpoint) -> None:
    """And none (`bad_query_missing_form_type`, `bad_query_missing_direct_type`)."""
    answer = endpoint.post("ASK {}", "text/plain")
    assert answer.status_code == 415
    assert {QUERY, FORM} <= set(answer.headers["accept-post"].split(", "))
    for body in ("query=ASK%20%7B%7D", "ASK {}"):
        assert endpoint.post(body, None).status_code == 415


def test_bad_query_non_utf8(endpoint: Endpoint) -> None:
    text = "SELECT * { ?s ?p 'ü' }"
    assert endpoint.post(text.encode("utf-16"), f"{QUERY}; charset=UTF-16").status_code == 415
    answer = endpoint.post(text.encode("utf-16"), QUERY)
    assert answer.status_code == 400
    assert "UTF-8" in answer.json()["detail"]
    assert endpoint.post(b"query=" + quote(text, encoding="utf-16").encode(), FORM).status_code == 400


def test_bad_query_syntax(endpoint: Endpoint) -> None:
    answer = endpoint.query("ASK {")
    assert answer.status_code == 400
    assert answer.headers["content-type"] == "application/problem+json"


# Beyond the tests of W3C


def test_other_parameters_beside_a_query_are_refused(endpoint: Endpoint) -> None:
    assert endpoint.query("ASK {}", **{"using-graph-uri": "http://example.org/"}).status_code == 400
    answer = endpoint.query("ASK {}", **{"default-graph-uri": "no iri"})
    assert answer.status_code == 400
    assert "no iri" in answer.json()["detail"]
    assert endpoint.http.get(f"{endpoint.url}sparql?default-graph-uri=http://example.org/").status_code == 400


def test_results_that_no_format_of_theirs_is_accepted_for_are_406(endpoint: Endpoint) -> None:
    answer = endpoint.post("ASK {}", QUERY, Accept="video/mp4")
    assert answer.status_code == 406
    assert "application/sparql-results+json" in answer.json()["detail"]


def test_head_is_get_without_a_body(endpoint: Endpoint) -> None:
    get = endpoint.query("ASK {}")
    head = endpoint.http.head(f"{endpoint.url}sparql", params={"query": "ASK {}"})
    assert head.status_code == get.status_code == 200
    assert head.content == b""
    assert head.headers["content-type"] == get.headers["content-type"]


def test_a_bare_get_describes_the_service(endpoint: Endpoint) -> None:
    answer = endpoint.http.get(f"{endpoint.url}sparql", headers={"Accept": "text/turtle"})
    said = [quad.triple for quad in parse(answer.content, RdfFormat.TURTLE)]
    service = NamedNode(f"{endpoint.url}sparql")

    def objects(name: str, subject: object = service) -> set[str]:
        found = (each for each in said if each.subject == subject and each.predicate.value == SD + name)
        return {each.object.value for each in found}

    assert objects("endpoint") == {service.value}
    assert objects("supportedLanguage") == {f"{SD}SPARQL11Query", f"{SD}SPARQL11Update"}
    assert objects("feature") == {f"{SD}UnionDefaultGraph"}
    (dataset,) = objects("defaultDataset")
    assert objects("defaultGraph", NamedNode(dataset))
    formats = {iri.removeprefix("http://www.w3.org/ns/formats/") for iri in objects("resultFormat")}
    assert formats == {
        *("SPARQL_Results_JSON", "SPARQL_Results_XML", "SPARQL_Results_CSV", "SPARQL_Results_TSV", "Turtle"),
        *("JSON-LD", "N-Triples", "RDF_XML", "N3", "N-Quads", "TriG"),
    }
    assert "http://www.w3.org/ns/formats/Turtle" in objects("inputFormat")
    assert {"age", "at"} <= {iri.partition("#")[2] for iri in objects("extensionFunction")}
    links = {each.object.value for each in said if each.subject == service and each.predicate.value.endswith("seeAlso")}
    assert links == {f"{endpoint.url}graphs"}
