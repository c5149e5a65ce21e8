"""A query sees every write that was answered before it was sent, whatever the query names."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served

pytestmark = pytest.mark.slow

MERGE = {"Content-Type": "application/merge-patch+json"}
TURTLE = {"Content-Type": "text/turtle"}
SPARQL = {"Content-Type": "application/sparql-update"}
ROS = "https://w3id.org/rosld#"
DISPLAY = "/topics/cockpit/display"
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String#data"
TIMES = 2
"""Number of consecutive writes, each queried immediately: within the validity of a synchronization."""
Write = Callable[[httpx.Client, str], httpx.Response]


@pytest.fixture(scope="module")
def http() -> Iterator[httpx.Client]:
    """An aircraft for these tests."""
    with served(adapter_for("aircraft", AdapterOptions()), max_publish_rate=100_000.0) as client:
        yield client


def says(http: httpx.Client, text: str) -> bool:
    """Whether any statement has the value, without naming a resource."""
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


def put_topic(http: httpx.Client, word: str) -> httpx.Response:
    return http.put(DISPLAY, json={"data": word})


def patch_topic(http: httpx.Client, word: str) -> httpx.Response:
    http.put(DISPLAY, json={"data": "before"})
    at = {"If-Match": http.get(DISPLAY).headers["etag"]}
    return http.patch(DISPLAY, json={"data": word}, headers=MERGE | at)


def update_topic(http: httpx.Client, word: str) -> httpx.Response:
    http.put(DISPLAY, json={"data": "before"})
    old = f"{{ GRAPH <{DISPLAY}> {{ ?m <{STRING}> ?old }} }}"
    return update(http, f"DELETE {old} INSERT {old.replace('?old', f'{chr(34)}{word}{chr(34)}')} WHERE {old}")


def put_topic_by_the_graph_store(http: httpx.Client, word: str) -> httpx.Response:
    url = f"{http.base_url}topics/cockpit/display"
    text = f'<{url}#message> a <{STRING.partition("#")[0]}> ; <{STRING}> "{word}" .'
    return http.put("/graphs", params={"graph": url}, content=text, headers=TURTLE)


WRITES: tuple[Write, ...] = (
    put_parameter, patch_parameter, update_parameter, put_parameter_by_the_graph_store,
    put_topic, patch_topic, update_topic, put_topic_by_the_graph_store,
    put_mapping, put_limits, put_query,
)  # fmt: skip


def test_a_query_that_names_nothing_sees_what_was_written_before_it(http: httpx.Client) -> None:
    for write in WRITES:
        for turn in range(TIMES):
            word = f"{write.__name__.replace('_', '-')}-{turn}"
            assert not says(http, word)
            answer = write(http, word)
            assert answer.is_success, answer.text
            assert says(http, word), (word, f"after {turn} writes")


def test_a_query_that_names_nothing_no_longer_sees_a_parameter_that_was_deleted(http: httpx.Client) -> None:
    url = f"{http.base_url}parameters/own/gone"
    ways: tuple[Callable[[], httpx.Response], ...] = (
        lambda: http.delete(url),
        lambda: update(http, f"DELETE WHERE {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"),
        lambda: http.delete("/graphs", params={"graph": url}),
    )
    for turn in range(TIMES):
        for number, delete in enumerate(ways):
            word = f"gone-{number}-{turn}"
            assert http.put(url, json=word).is_success
            assert says(http, word)
            answer = delete()
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


def test_a_query_sees_a_call_and_a_resource_that_was_written_before_it(http: httpx.Client) -> None:
    csv = {"Accept": "text/csv"}
    for turn in range(TIMES):
        answer = http.post("/services/aircraft/get_power", json={})
        assert answer.status_code == 201, answer.text
        found = http.get("/sparql", params={"query": "SELECT DISTINCT ?s { ?s ?p ?o }"}, headers=csv).text
        assert answer.headers["location"] in found
        value = ("on", "off")[turn % 2]
        assert http.put("/resources/aircraft/power", json=value).is_success
        query = "SELECT ?v { ?r a ros:Property ; ?p ?v FILTER(STRENDS(STR(?r), '/power') && ?p = rdf:value) }"
        found = http.get("/sparql", params={"query": query}, headers=csv).text
        assert found.split() == ["v", value]
