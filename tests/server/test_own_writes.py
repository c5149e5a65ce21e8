"""A query sees every write that was answered before it was sent, whatever the query names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from tests.adapters.ros1.system import running

MERGE = {"Content-Type": "application/merge-patch+json"}
TURTLE = {"Content-Type": "text/turtle"}
SPARQL = {"Content-Type": "application/sparql-update"}
ROS = "https://w3id.org/rosld#"
TIMES = 6
"""Writes in a row, each asked for at once: within the time that a look at everything is good enough for."""
Write = Callable[[httpx.Client, int], httpx.Response]


@pytest.fixture(scope="module")
def http_of_aircraft(start_server: Callable[..., Any]) -> Iterator[httpx.Client]:
    """An aircraft of these tests' own."""
    served = start_server("aircraft", "--max-publish-rate", "100000")
    yield served.http
    assert served.stop() == 0


@pytest.fixture(scope="module")
def http_of_ros1(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A real master, with nothing but what these tests put there."""
    with running(tmp_path_factory.mktemp("ros")) as ros:
        served = start_server(ros.source, "--max-publish-rate", "100000")
        yield served.http
        assert served.stop() == 0


@pytest.fixture(params=["aircraft", "ros1"])
def http(request: pytest.FixtureRequest) -> httpx.Client:
    """A robot with parameters that may be set."""
    found: httpx.Client = request.getfixturevalue(f"http_of_{request.param}")
    return found


def says(http: httpx.Client, text: str) -> bool:
    """Whether anything anywhere has the value, asked with nothing named."""
    answer = http.post(
        "/sparql",
        content=f'ASK {{ ?s ?p "{text}" }}',
        headers={"Content-Type": "application/sparql-query", "Accept": "application/sparql-results+json"},
    )
    assert answer.status_code == 200, answer.text
    found: bool = answer.json()["boolean"]
    return found


def update(http: httpx.Client, text: str) -> httpx.Response:
    return http.post("/sparql", content=text, headers=SPARQL)


def put_parameter(http: httpx.Client, word: str) -> httpx.Response:
    return http.put("/parameters/own/put", json=word)


def put_new_parameter(http: httpx.Client, word: str) -> httpx.Response:
    return http.put(f"/parameters/own/new_{word.replace('-', '_')}", json=word)


def patch_parameter(http: httpx.Client, word: str) -> httpx.Response:
    http.put("/parameters/own/patched", json="before")
    return http.patch("/parameters/own/patched", json=word, headers=MERGE)


def update_parameter(http: httpx.Client, word: str) -> httpx.Response:
    url = "</parameters/own/updated>"
    return update(
        http,
        f"DELETE WHERE {{ GRAPH {url} {{ {url} <{ROS}value> ?old }} }} ; "
        f'INSERT DATA {{ GRAPH {url} {{ {url} <{ROS}value> "{word}" }} }}',
    )


def put_parameter_by_the_graph_store(http: httpx.Client, word: str) -> httpx.Response:
    url = f"{http.base_url}parameters/own/put"
    return http.put("/graphs", params={"graph": url}, content=f'<{url}> <{ROS}value> "{word}" .', headers=TURTLE)


def put_document(http: httpx.Client, word: str) -> httpx.Response:
    return http.put("/data/own", content=f'<> <http://example.org/says> "{word}" .', headers=TURTLE)


def post_document(http: httpx.Client, word: str) -> httpx.Response:
    return http.post("/data/", content=f'<> <http://example.org/says> "{word}" .', headers=TURTLE)


def patch_document(http: httpx.Client, word: str) -> httpx.Response:
    http.put("/data/patched", content="<> a <http://example.org/Patched> .", headers=TURTLE)
    return http.patch(
        "/data/patched", content=f'INSERT DATA {{ <> <http://example.org/says> "{word}" }}', headers=SPARQL
    )


def update_document(http: httpx.Client, word: str) -> httpx.Response:
    return update(http, f'INSERT DATA {{ GRAPH </data/updated> {{ </data/updated> <http://e.org/says> "{word}" }} }}')


def put_mapping(http: httpx.Client, word: str) -> httpx.Response:
    text = f"""@prefix map: <https://w3id.org/rosld/mapping#> .
        <> <http://purl.org/dc/terms/title> "{word}" .
        <#own> a map:ComplexResource ; map:path "/own/" ."""
    return http.put("/mappings/own", content=text, headers=TURTLE)


def put_limits(http: httpx.Client, word: str) -> httpx.Response:
    text = f"""@prefix sh: <http://www.w3.org/ns/shacl#> .
        <#limit> a sh:NodeShape ; sh:targetNode </resources/own/limited> ; sh:message "{word}" ;
          sh:property [ sh:path <http://www.w3.org/1999/02/22-rdf-syntax-ns#value> ; sh:maxInclusive 5 ] ."""
    return http.put("/shapes/own", content=text, headers=TURTLE)


def put_query(http: httpx.Client, word: str) -> httpx.Response:
    return http.put(
        f"/queries/own-{word}", content=f"# {word}\nASK {{}}", headers={"Content-Type": "application/sparql-query"}
    )


WRITES = [
    put_parameter, put_new_parameter, patch_parameter, update_parameter, put_parameter_by_the_graph_store,
    put_document, post_document, patch_document, update_document, put_mapping, put_limits, put_query,
]  # fmt: skip


@pytest.mark.parametrize("write", WRITES)
def test_a_query_that_names_nothing_sees_what_was_written_before_it(http: httpx.Client, write: Any) -> None:
    for turn in range(TIMES):
        word = f"{write.__name__.replace('_', '-')}-{turn}"
        assert not says(http, word)
        answer = write(http, word)
        assert answer.is_success, answer.text
        assert says(http, word), f"after {turn} writes"


@pytest.mark.parametrize("how", ["DELETE", "update", "DELETE of the graph store"])
def test_a_query_that_names_nothing_no_longer_sees_a_parameter_that_was_deleted(http: httpx.Client, how: str) -> None:
    url = f"{http.base_url}parameters/own/gone"
    for turn in range(TIMES):
        word = f"gone-{how}-{turn}"
        assert http.put(url, json=word).is_success
        assert says(http, word)
        if how == "DELETE":
            answer = http.delete(url)
        elif how == "update":
            answer = update(http, f"DELETE WHERE {{ GRAPH <{url}> {{ ?s ?p ?o }} }}")
        else:
            answer = http.delete("/graphs", params={"graph": url})
        assert answer.is_success, answer.text
        assert not says(http, word)


def test_a_query_that_names_nothing_sees_parameters_that_were_set_together(http: httpx.Client) -> None:
    for turn in range(TIMES):
        words = [f"together-{turn}-{each}" for each in range(3)]
        texts = [f'</parameters/own/n{turn}_{each}> <{ROS}value> "{word}" .' for each, word in enumerate(words)]
        graphs = " ".join(f"GRAPH </parameters/own/n{turn}_{each}> {{ {text} }}" for each, text in enumerate(texts))
        answer = update(http, f"INSERT DATA {{ {graphs} }}")
        assert answer.is_success, answer.text
        assert all(says(http, word) for word in words)


DISPLAY = "/topics/cockpit/display"
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String#data"


@pytest.mark.parametrize("how", ["PUT", "PATCH", "update", "graph store"])
def test_a_query_that_names_nothing_sees_what_was_published_before_it(http_of_aircraft: httpx.Client, how: str) -> None:
    http = http_of_aircraft
    url = f"{http.base_url}topics/cockpit/display"
    assert http.put(DISPLAY, json={"data": "before"}).is_success
    for turn in range(TIMES):
        word = f"published {how} {turn}"
        assert not says(http, word)
        if how == "PUT":
            answer = http.put(DISPLAY, json={"data": word})
        elif how == "PATCH":
            answer = http.patch(
                DISPLAY, json={"data": word}, headers=MERGE | {"If-Match": http.get(DISPLAY).headers["etag"]}
            )
        elif how == "update":
            answer = update(
                http,
                f"DELETE {{ GRAPH <{url}> {{ ?m <{STRING}> ?old }} }} "
                f'INSERT {{ GRAPH <{url}> {{ ?m <{STRING}> "{word}" }} }} '
                f"WHERE {{ GRAPH <{url}> {{ ?m <{STRING}> ?old }} }}",
            )
        else:
            text = f'<{url}#message> a <{STRING.partition("#")[0]}> ; <{STRING}> "{word}" .'
            answer = http.put("/graphs", params={"graph": url}, content=text, headers=TURTLE)
        assert answer.is_success, answer.text
        assert says(http, word), f"after {turn} writes"


def test_a_query_that_names_nothing_sees_a_call_that_was_answered_before_it(http_of_aircraft: httpx.Client) -> None:
    http = http_of_aircraft
    for _ in range(TIMES):
        answer = http.post("/services/aircraft/get_power", json={})
        assert answer.status_code == 201, answer.text
        found = http.get(
            "/sparql", params={"query": "SELECT DISTINCT ?s { ?s ?p ?o }"}, headers={"Accept": "text/csv"}
        ).text
        assert answer.headers["location"] in found


def test_a_query_sees_a_resource_that_was_written_before_it(http_of_aircraft: httpx.Client) -> None:
    http = http_of_aircraft
    for turn in range(TIMES):
        value = ("on", "off")[turn % 2]
        assert http.put("/resources/aircraft/power", json=value).is_success
        query = "SELECT ?v { ?r a ros:Property ; ?p ?v FILTER(STRENDS(STR(?r), '/power') && ?p = rdf:value) }"
        found = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text
        assert found.split() == ["v", value]
