"""Two robots, each behind its own server, and one store that both fill."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

if TYPE_CHECKING:
    from tests.server.conftest import Served
    from tests.server.dataset.conftest import Oxigraph

TURTLE = {"Content-Type": "text/turtle"}
SPEEDS = """
PREFIX ros: <https://w3id.org/rosld#>
PREFIX float64: <https://w3id.org/rosld/types/std_msgs/msg/Float64#>
SELECT ?topic ?received WHERE {
  ?topic ros:name "/aircraft/engine/speed" ; ros:latest ?m . ?m float64:data ?speed ; ros:received ?received }
"""


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to hold"
        time.sleep(0.05)


def mirror(served: Served) -> dict[str, Any]:
    found: dict[str, Any] = served.http.get("mirror", headers={"Accept": "application/json"}).json()
    return found


def test_one_query_spans_two_robots_and_neither_drops_the_others_graphs(
    serve: Callable[..., Served], new_oxigraph: Callable[..., Oxigraph], tmp_path: Path
) -> None:
    oxigraph = new_oxigraph()
    options = ("--store", oxigraph.url, "--store-rate", "10", "--subscribe", "*")
    one = serve("aircraft", *options)
    two = serve("aircraft", *options, "--data", str(tmp_path), process=True)
    kept = two.http.put("data/note", content='<> <http://h/p> "kept" .', headers=TURTLE)
    assert kept.status_code == 201

    def topics() -> dict[str, str]:
        return {row["topic"]: row["received"] for row in oxigraph.select(SPEEDS)}

    both = {one.topic("/aircraft/engine/speed"), two.topic("/aircraft/engine/speed")}
    until(lambda: topics().keys() == both)
    before = topics()
    until(lambda: all(moment > before[topic] for topic, moment in topics().items()))
    until(lambda: f"{two.url}data/note" in oxigraph.graphs())

    two.process.kill()  # an unclean end: what it told stays, for the time being
    two.process.wait(60)
    assert topics().keys() == both

    two_url = two.url
    port = two_url.rstrip("/").rpartition(":")[2]
    oxigraph.update(f"INSERT DATA {{ GRAPH <{two_url}topics/gone> {{ <{two_url}topics/gone> a <http://h/Topic> }} }}")
    again = serve("aircraft", *options, "--data", str(tmp_path), "--base-url", two_url)
    until(lambda: f"{two_url}topics/gone" not in oxigraph.graphs())
    until(lambda: topics().get(two.topic("/aircraft/engine/speed"), "") > before[two.topic("/aircraft/engine/speed")])
    assert topics().keys() == both
    assert port in two_url

    ones = {graph for graph in oxigraph.graphs() if graph.startswith(one.url)}
    assert again.stop() == 0
    left = oxigraph.graphs()
    assert {graph for graph in left if graph.startswith(one.url)} == ones
    assert f"{two_url}data/note" in left
    assert not any(graph.startswith(f"{two_url}topics") for graph in left)


def test_what_the_store_holds_is_what_the_dataset_holds(
    serve: Callable[..., Served], new_oxigraph: Callable[..., Oxigraph]
) -> None:
    oxigraph = new_oxigraph()
    served = serve("aircraft", "--store", oxigraph.url, "--store-rate", "20")
    listing = {"query": "SELECT DISTINCT ?g { GRAPH ?g { ?s ?p ?o } }"}

    def here() -> set[str]:
        rows = served.http.get("sparql", params=listing, headers={"Accept": "application/sparql-results+json"}).json()
        return {row["g"]["value"] for row in rows["results"]["bindings"]}

    until(lambda: oxigraph.graphs() == here() | {f"{served.url}mirror"})
    assert all(graph.startswith(served.url) for graph in here())


def test_a_store_that_is_away_holds_no_request_up_and_is_caught_up_with(
    serve: Callable[..., Served], new_oxigraph: Callable[..., Oxigraph]
) -> None:
    oxigraph = new_oxigraph()
    served = serve("aircraft", "--store", oxigraph.url, "--store-rate", "20", "--subscribe", "*")
    until(lambda: f"{served.url}mirror" in oxigraph.graphs() and mirror(served)["failure"] is None)
    oxigraph.stop()
    until(lambda: mirror(served)["failure"] is not None)
    for number in range(20):
        put = served.http.put(f"data/{number}", content=f"<> <http://h/p> {number} .", headers=TURTLE, timeout=20)
        assert put.status_code == 201
        assert served.http.get("topics/aircraft/engine/speed", timeout=20).status_code == 200
    asked = served.http.get("sparql", params={"query": "ASK { ?s <http://h/p> 19 }"}, timeout=20)
    assert asked.json()["boolean"] is True
    until(lambda: mirror(served)["lag"] > 0.2)
    described = served.http.get("mirror", headers={"Accept": "text/turtle"})
    assert "ros:Stale" in described.text
    assert "ros:reason" in described.text
    oxigraph.start()
    until(lambda: f"{served.url}data/19" in oxigraph.graphs())
    until(lambda: mirror(served)["failure"] is None and mirror(served)["lag"] < 0.5)
    assert len(oxigraph.select("SELECT ?s { ?s <http://h/p> ?o }")) == 20


def test_without_a_store_there_is_no_mirror(http: httpx.Client) -> None:
    assert http.get("mirror").status_code == 404


def test_the_service_description_says_where_the_mirror_is(
    serve: Callable[..., Served], new_oxigraph: Callable[..., Oxigraph]
) -> None:
    served = serve("aircraft", "--store", new_oxigraph().url)
    described = served.http.get("sparql", headers={"Accept": "text/turtle"})
    assert f"<{served.url}mirror>" in described.text
