"""SPARQL Update over HTTP: each changed graph is written like its resource, all of them or none."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

pytestmark = pytest.mark.slow

UPDATE = {"Content-Type": "application/sparql-update"}
TURTLE = {"Content-Type": "text/turtle"}
STRING = "https://w3id.org/rosld/types/std_msgs/msg/String"


def update(client: httpx.Client, text: str, **query: str) -> httpx.Response:
    """Send an update."""
    return client.post("/sparql", content=text.encode(), headers=UPDATE, params=query)


def done(answer: httpx.Response) -> None:
    """Check that an update was carried out."""
    assert answer.status_code == 204, answer.text


def says(client: httpx.Client, path: str, pattern: str) -> bool:
    """Whether a pattern matches the graph of a resource in queries."""
    query = f"ASK {{ GRAPH <{path}> {{ {pattern} }} }}"
    answer = client.get("/sparql", params={"query": query}, headers={"Accept": "application/sparql-results+json"})
    return bool(answer.json()["boolean"])


# The default graph, and all graphs


def test_what_names_no_graph_goes_to_the_default_document_and_all_are_the_documents(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    for name in ("one", "two"):
        assert http.put(f"/data/{name}", content=b"<> <urn:n> 1 .", headers=TURTLE).status_code == 201
    assert http.put("/data/file", content=b"text", headers={"Content-Type": "text/plain"}).status_code == 201
    mapping = http.get("/mappings/aircraft").headers["etag"]
    done(update(http, "INSERT DATA { <urn:s> <urn:n> 1 , 2 } ; DELETE DATA { <urn:s> <urn:n> 1 }"))
    assert says(http, "/data/default", "<urn:s> <urn:n> 2")
    assert not says(http, "/data/default", "<urn:s> <urn:n> 1")
    done(update(http, "CLEAR DEFAULT"))
    assert not says(http, "/data/default", "<urn:s> ?p ?o")
    assert says(http, "/data/one", "?s <urn:n> 1")
    answer = update(http, "DROP ALL")
    done(answer)
    assert [http.get(f"/data/{name}").status_code for name in ("one", "two", "default", "file")] == [410, 410, 410, 200]
    assert http.get("/mappings/aircraft").headers["etag"] == mapping
    receipt = http.get(answer.links["http://www.w3.org/ns/prov#has_provenance"]["url"]).text
    assert "DROP ALL: 3 documents; unchanged are containers, files, policies and the robot's graphs" in receipt


# Stored documents


def test_containment_cannot_be_forged(plane: httpx.Client) -> None:
    plane.put("/data/box/", content=b"", headers=TURTLE)
    ldp = "http://www.w3.org/ns/ldp#contains"
    forged = update(plane, f"INSERT DATA {{ GRAPH </data/box/> {{ </data/box/> <{ldp}> </data/elsewhere> }} }}")
    assert forged.status_code == 409
    assert "/data/box/" in forged.json()["detail"]


# Commands of the robot


def test_changing_the_graph_of_a_parameter_sets_it_and_emptying_it_deletes_it(plane: httpx.Client) -> None:
    plane.put("/parameters/height", json=10)
    done(
        update(
            plane,
            "DELETE { GRAPH </parameters/height> { ?p ros:value ?old } } "
            "INSERT { GRAPH </parameters/height> { ?p ros:value ?new } } "
            "WHERE { GRAPH </parameters/height> { ?p ros:value ?old } BIND(?old + 5 AS ?new) }",
        )
    )
    assert plane.get("/parameters/height", headers={"Accept": "application/json"}).json() == 15
    done(update(plane, "DELETE WHERE { GRAPH </parameters/height> { ?s ?p ?o } }"))
    assert plane.get("/parameters/height").status_code == 404
    done(update(plane, "INSERT DATA { GRAPH </parameters/fresh> { </parameters/fresh> ros:value 'new' } }"))
    assert plane.get("/parameters/fresh", headers={"Accept": "application/json"}).json() == "new"


def test_changing_the_graph_of_a_command_topic_publishes_once(plane: httpx.Client) -> None:
    display = "/topics/cockpit/display"
    plane.put(display, json={"data": "before"})
    text = (
        f"DELETE {{ GRAPH <{display}> {{ ?m <{STRING}#data> ?t }} }} "
        f"INSERT {{ GRAPH <{display}> {{ ?m <{STRING}#data> 'after' }} }} "
        f"WHERE {{ GRAPH <{display}> {{ ?m <{STRING}#data> ?t }} }}"
    )
    done(update(plane, text))
    assert plane.get(display, headers={"Accept": "application/json"}).json() == {"data": "after"}
    tag = plane.get(display).headers["etag"]
    done(update(plane, text))  # it has that value already
    assert plane.get(display).headers["etag"] == tag


def test_if_one_graph_is_refused_nothing_is_stored_and_nothing_moves(plane: httpx.Client) -> None:
    plane.put("/parameters/still", json=1)
    speed = "/topics/aircraft/engine/speed"
    answer = update(
        plane,
        "INSERT DATA { GRAPH </data/never> { <urn:a> <urn:b> 1 } } ; "
        "DELETE WHERE { GRAPH </parameters/still> { ?s ros:value ?v } } ; "
        f"INSERT DATA {{ GRAPH <{speed}> {{ <{speed}#message> <urn:x> 1 }} }}",
    )
    assert answer.status_code == 403
    assert [each["graph"] for each in answer.json()["graphs"]] == [str(plane.base_url.join(speed))]
    assert plane.get("/data/never").status_code == 404
    assert plane.get("/parameters/still", headers={"Accept": "application/json"}).json() == 1


def test_a_state_that_does_not_fit_is_422_and_names_the_graph(plane: httpx.Client) -> None:
    display = "/topics/cockpit/display"
    plane.put(display, json={"data": "fits"})
    answer = update(plane, f"INSERT DATA {{ GRAPH <{display}> {{ <{display}#message> <{STRING}#data> 'two' }} }}")
    assert answer.status_code == 422
    assert display in answer.json()["detail"]
    assert plane.get(display, headers={"Accept": "application/json"}).json() == {"data": "fits"}


REFUSED = [
    ("CLEAR GRAPH </topics/cockpit/display>", 403),
    ("MOVE </parameters/x> TO </data/x>", 403),
    ("COPY </data/spelt> TO </parameters/x>", 403),
    ("INSERT DATA { GRAPH <http://example.org/elsewhere> { <urn:a> <urn:b> 1 } }", 403),
    ("INSERT DATA { GRAPH </nodes/aircraft> { <urn:a> <urn:b> 1 } }", 403),
    ("INSERT DATA { GRAPH </topics/> { <urn:a> <urn:b> 1 } }", 403),
    ("INSERT DATA { GRAPH </ontology> { <urn:a> <urn:b> 1 } }", 403),
    ("LOAD <http://127.0.0.1:9/>", 403),
]


def test_what_cannot_be_done_is_refused_with_its_reason(plane: httpx.Client) -> None:
    answers = [(text, status, update(plane, text)) for text, status in REFUSED]
    assert not [(text, answer.text) for text, status, answer in answers if answer.status_code != status]
    assert all(answer.json()["detail"] for _, _, answer in answers)


def test_with_may_name_a_graph_that_is_not_there_yet(plane: httpx.Client) -> None:
    plane.put("/data/source", content=b"<> <urn:v> 1 .", headers=TURTLE)
    done(update(plane, "WITH </data/with1> INSERT { <urn:a> <urn:b> 1 } WHERE { }"))
    assert says(plane, "/data/with1", "<urn:a> <urn:b> 1")
    done(
        update(
            plane,
            "WITH </data/with2> INSERT { ?s <urn:w> ?n } WHERE { GRAPH </data/source> { ?s <urn:v> ?v } "
            "FILTER NOT EXISTS { ?a ?b ?c } BIND(?v + 1 AS ?n) }",
        )
    )
    assert says(plane, "/data/with2", "?s <urn:w> 2")


def test_no_update_of_many_at_once_is_lost(plane: httpx.Client) -> None:
    plane.put("/parameters/count", json=0)
    plane.put("/data/count", content=b"<> <urn:count> 0 .", headers=TURTLE)
    text = (
        "DELETE { GRAPH ?g { ?s ?p ?old } } INSERT { GRAPH ?g { ?s ?p ?new } } WHERE { "
        "VALUES (?g ?p) { (</parameters/count> ros:value) (</data/count> <urn:count>) } "
        "GRAPH ?g { ?s ?p ?old } BIND(?old + 1 AS ?new) }"
    )
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: update(plane, text).status_code, range(24)))
    assert set(answers) <= {204, 409}
    number = answers.count(204)
    assert number > 0
    assert plane.get("/parameters/count", headers={"Accept": "application/json"}).json() == number
    assert says(plane, "/data/count", f"?s <urn:count> {number}")
