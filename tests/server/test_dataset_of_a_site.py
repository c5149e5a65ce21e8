"""The dataset equals the responses to GET: all URLs of a site are crawled, and graphs compared with N-Triples."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import httpx
import pytest
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, RdfFormat, Triple, parse

from tests.server.robots.made_up import MadeUp, Serving

pytestmark = pytest.mark.slow

NTRIPLES, TURTLE = {"Accept": "application/n-triples"}, {"Content-Type": "text/turtle"}
UNLINKED = (
    *("status", "stop", "sparql", "graphs", "channels/", ".well-known/"),
    *("calls/", "goals/", "holds/", "activity/"),
)
"""Start of a crawl, besides the entry."""
NOT_ITSELF = frozenset({"queries/graph", "queries/mine", ".well-known/wot", "cockpit/default"})
"""Documents without an equal graph.

GET of a stored CONSTRUCT returns its results; a client's query is a text described by its `.meta`. The default cockpit
is created for its reader. A Thing Description repeats, in W3C's terms, statements in the graphs of the resources.
"""
VOLATILE = frozenset(
    f"https://w3id.org/rosld#{name}"
    for name in (
        *("rate", "briefValue", "received", "sequence", "age"),
        *("longestPause", "longestPauseEnd", "longestPauseCode", "longestWork", "longestWorkCode", "recentPause"),
    )
)
LDP = "@prefix ldp: <http://www.w3.org/ns/ldp#> . @prefix foaf: <http://xmlns.com/foaf/0.1/> . "
DIRECT = f"{LDP}<> ldp:membershipResource <../thing> ; ldp:hasMemberRelation foaf:depiction ."
INDIRECT = (
    f"{LDP}<> ldp:membershipResource <../thing> ; ldp:hasMemberRelation foaf:knows ; "
    "ldp:insertedContentRelation foaf:primaryTopic ."
)


def link(kind: str) -> dict[str, str]:
    return {"Link": f'<http://www.w3.org/ns/ldp#{kind}>; rel="type"', **TURTLE}


def kept(http: httpx.Client) -> None:
    """Store data of every kind, and documents that the server acts on."""
    thing = "<> <urn:p> '01'^^<urn:t>, 'a\\rb', [ <urn:q> ( 1 2.50 'ä'@de ) ] . <#it> a <urn:C> ."
    about_me = "<> <http://xmlns.com/foaf/0.1/primaryTopic> <#me> ."
    query = {"Content-Type": "application/sparql-query"}
    everything: Iterable[tuple[str, str, dict[str, str], bytes | str]] = (
        ("PUT", "/data/site/thing", TURTLE, thing),
        ("PUT", "/data/site/basic/", link("BasicContainer"), "<> <urn:p> 1 ."),
        ("PUT", "/data/site/direct/", link("DirectContainer"), DIRECT),
        ("PUT", "/data/site/indirect/", link("IndirectContainer"), INDIRECT),
        ("POST", "/data/site/direct/", TURTLE, "<> <urn:p> 2 ."),
        ("POST", "/data/site/indirect/", TURTLE, about_me),
        ("POST", "/data/site/basic/", {"Content-Type": "image/png", "Slug": "photo"}, b"\x89PNG"),
        ("PUT", "/cockpit/mine", TURTLE, "<> a <https://w3id.org/rosld#Cockpit> ."),
        ("PUT", "/queries/mine", query, "# Mine.\nSELECT * { ?s ?p ?o } LIMIT 1"),
    )
    for method, path, headers, body in everything:
        answer = http.request(method, path, content=body.encode() if isinstance(body, str) else body, headers=headers)
        assert answer.status_code in (200, 201, 204), (path, answer.text)


def triples(text: bytes) -> set[Triple]:
    """Return the triples that do not change by themselves, with blank nodes named by their statements."""
    quads = (quad for quad in parse(text, RdfFormat.N_TRIPLES) if quad.predicate.value not in VOLATILE)
    dataset = Dataset(Quad(*quad.triple) for quad in quads)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return {quad.triple for quad in dataset}


def named(found: set[Triple], base: str) -> Iterator[str]:
    """Yield the URLs of this site in these triples."""
    for triple in found:
        for term in triple:
            if isinstance(term, NamedNode) and term.value.startswith(base) and "?" not in term.value:
                yield term.value.partition("#")[0]


def graph(http: httpx.Client, url: str) -> set[Triple]:
    text = f"CONSTRUCT {{ ?s ?p ?o }} {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"
    answer = http.post("/sparql", content=text, headers={"Content-Type": "application/sparql-query", **NTRIPLES})
    assert answer.status_code == 200, answer.text
    return triples(answer.content)


def compared(http: httpx.Client) -> tuple[set[str], dict[str, str]]:
    """Return the crawled paths, and differences. The graph is requested before its document."""
    base = str(http.base_url)
    waiting = deque([base, *(base + path for path in UNLINKED)])
    seen, read, different = set(waiting), set(), {}
    while waiting:
        url = waiting.popleft()
        there = graph(http, url)
        answer = http.get(url, headers=NTRIPLES)
        path = url.removeprefix(base)
        if answer.status_code in (301, 303, 308):
            following = [answer.headers["location"].partition("#")[0]]
        elif answer.status_code != 200 or answer.headers["content-type"] != "application/n-triples":
            following = []
        else:
            read.add(path)
            told = triples(answer.content)
            following = list(named(told, base))
            for _ in range(3):  # a new value, or the end of a goal
                if told == there or not there:
                    break
                told, there = triples(http.get(url, headers=NTRIPLES).content), graph(http, url)
            if told != there and path not in NOT_ITSELF:
                different[path] = (
                    f"GET only: {sorted(map(str, told - there))[:3]}, graph only: {sorted(map(str, there - told))[:3]}"
                )
        for each in following:
            if each not in seen:
                seen.add(each)
                waiting.append(each)
    return read, different


def test_every_graph_of_the_aircraft_is_what_get_says(start_server: Callable[..., Any]) -> None:
    http = start_server("aircraft").http
    kept(http)
    assert http.post("/services/aircraft/start").status_code == 201
    assert http.post("/actions/aircraft/fly", json={"distance": 1.0}).status_code == 201
    holding = {"rate": 10, "lease": 5}
    assert http.post("/topics/cockpit/display", params=holding, json={"data": "x"}).status_code == 201
    read, different = compared(http)
    assert different == {}
    assert len(read) > 150
    roots = {path.partition("/")[0] for path in read}
    assert roots >= {"holds", "calls", "goals", "activity", "shapes", "queries", "stop"}
    assert {"data/site/indirect/", "types/std_srvs/srv/Trigger_Request", "parameters/aircraft/engine/limits/"} <= read


def test_every_graph_of_a_robot_without_a_mapping_is_what_get_says(robot: MadeUp, serving: Serving) -> None:
    robot.topic("/place", "geometry_msgs/msg/Vector3", {"x": 1.5, "y": 0, "z": -0.0})
    robot.topic("/arm/joints", "sensor_msgs/msg/JointState", heard=True)
    robot.topic("/arm", "std_msgs/msg/String", {"data": "a\rb\u0001"})
    robot.answer("/arm/count", "made_up/srv/GetByte", value=7)
    for name, value in {"/arm/limits/low": -1, "/arm/limits/high": [1.5, 2.5], "/arm/name": "it", "/on": True}.items():
        robot.parameter(name, value)
    client = serving()
    client.timeout = 30
    kept(client)
    read, different = compared(client)
    assert different == {}
    assert len(read) > 60
