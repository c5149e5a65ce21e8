"""The SPARQL endpoint over HTTP: live values, every format, refusals, pages."""

from __future__ import annotations

import csv
import io
import json

import httpx
import pytest

from tests.server.sparql.processes import until_ready

TYPES = "https://w3id.org/rosld/types/"
DISPLAY = "/topics/cockpit/display"
LATEST = f"""PREFIX ros: <https://w3id.org/rosld#>
SELECT ?topic ?text WHERE {{ ?topic a ros:Topic ; ros:latest ?m . ?m <{TYPES}std_msgs/msg/String#data> ?text }}"""


def rows(answer: httpx.Response) -> list[list[str]]:
    """The rows of a CSV result, without the heading."""
    assert answer.status_code == 200, answer.text
    return list(csv.reader(io.StringIO(answer.text)))[1:]


@pytest.mark.parametrize("how", ["get", "form", "direct"])
def test_a_query_sees_what_was_published_just_before(http: httpx.Client, how: str) -> None:
    text = f"written before {how}"
    http.put(DISPLAY, json={"data": text})
    headers = {"Accept": "text/csv"}
    if how == "get":
        answer = http.get("/sparql", params={"query": LATEST}, headers=headers)
    elif how == "form":
        answer = http.post("/sparql", data={"query": LATEST}, headers=headers)
    else:
        answer = http.post("/sparql", content=LATEST, headers=headers | {"Content-Type": "application/sparql-query"})
    assert rows(answer) == [[str(http.base_url.join(DISPLAY)), text]]


def test_select_comes_in_every_result_format(http: httpx.Client) -> None:
    query = {"query": "SELECT ?name WHERE { ?t a ros:Topic ; ros:name ?name } ORDER BY ?name"}
    found = http.get("/sparql", params=query, headers={"Accept": "application/sparql-results+json"}).json()
    names = [row["name"]["value"] for row in found["results"]["bindings"]]
    assert names[:2] == ["/aircraft/engine/speed", "/cockpit/display"]
    for media_type in ("application/sparql-results+xml", "text/csv", "text/tab-separated-values"):
        answer = http.get("/sparql", params=query, headers={"Accept": media_type})
        assert answer.headers["content-type"].startswith(media_type)
        assert "/cockpit/display" in answer.text
    assert http.get("/sparql", params=query).headers["content-type"] == "application/sparql-results+json"


@pytest.mark.parametrize(
    "media_type", ["text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml", "text/n3"]
)
def test_construct_and_describe_come_in_every_rdf_syntax(http: httpx.Client, media_type: str) -> None:
    for query in (
        "CONSTRUCT { ?t ros:name ?n } WHERE { ?t a ros:Topic ; ros:name ?n }",
        f"DESCRIBE <{http.base_url.join(DISPLAY)}>",
    ):
        answer = http.get("/sparql", params={"query": query}, headers={"Accept": media_type})
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].startswith(media_type)
        assert "/cockpit/display" in answer.text


@pytest.mark.parametrize(
    ("name", "media_type"),
    [("turtle", "text/turtle"), ("json-ld", "application/ld+json"), ("rdf+xml", "application/rdf+xml")],
)
def test_formats_have_the_names_that_other_endpoints_give_them_too(
    http: httpx.Client, name: str, media_type: str
) -> None:
    query = "CONSTRUCT { ?t ros:name ?n } WHERE { ?t a ros:Topic ; ros:name ?n }"
    answer = http.get("/sparql", params={"query": query, "format": name}, headers={"Accept": "*/*"})
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith(media_type)


def test_a_graph_is_what_a_get_of_its_url_says(http: httpx.Client, triples_of: object) -> None:
    url = str(http.base_url.join("/types/std_msgs/msg/String"))
    query = f"CONSTRUCT {{ ?s ?p ?o }} WHERE {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"
    graph = http.get("/sparql", params={"query": query}, headers={"Accept": "text/turtle"})
    count = f"SELECT (COUNT(*) AS ?n) WHERE {{ GRAPH <{url}> {{ ?s ?p ?o }} }}"
    number = rows(http.get("/sparql", params={"query": count}, headers={"Accept": "text/csv"}))
    assert callable(triples_of)
    assert len(triples_of(graph)) == len(triples_of(http.get(url))) == int(number[0][0])


def test_no_topic_is_found_twice(http: httpx.Client) -> None:
    query = {"query": "SELECT ?t WHERE { ?t a ros:Topic ; ros:name ?n ; ros:hasMessageType ?y }"}
    found = [row[0] for row in rows(http.get("/sparql", params=query, headers={"Accept": "text/csv"}))]
    assert len(found) == len(set(found)) >= 2


def test_parameters_are_in_the_dataset_as_they_are_now(http: httpx.Client) -> None:
    http.put("/parameters/queried", json=41)
    http.put("/parameters/queried", json=42)
    query = {"query": f"SELECT ?v WHERE {{ <{http.base_url.join('/parameters/queried')}> ros:value ?v }}"}
    assert rows(http.get("/sparql", params=query, headers={"Accept": "text/csv"})) == [["42"]]


def test_a_query_subscribes_to_what_it_names_though_it_also_looks_at_anything(serve: object) -> None:
    assert callable(serve)
    served = serve("aircraft")
    data = f"<{TYPES}std_msgs/msg/Float64#data>"
    query = {
        "query": f"SELECT ?v WHERE {{ {{ ?m {data} ?v }} UNION {{ ?t ros:words ?v }} UNION {{ ?a ?b ?v }} }} LIMIT 1"
    }
    typed = {"query": f"SELECT ?v WHERE {{ ?m {data} ?v }}"}
    assert served.http.get("/sparql", params=query).status_code == 200
    assert rows(served.http.get("/sparql", params=typed, headers={"Accept": "text/csv"})) == [["0.0"]]


@pytest.mark.parametrize(
    ("query", "status"),
    [
        ("SELECT", 400),
        ("SELECT * WHERE { SERVICE <http://127.0.0.1:1/> { ?s ?p ?o } }", 400),
        ("SELECT * WHERE { S\\u0045RVICE <http://127.0.0.1:1/> { ?s ?p ?o } }", 400),
        ("DELETE WHERE { ?s ?p ?o }", 400),
        ("LOAD <http://127.0.0.1:1/>", 400),
        ("SELECT * WHERE " + "{" * 3000 + "}" * 3000, 400),
        ("SELECT * WHERE { ?s ?p " + "[ ?p " * 500 + "]" * 500 + "}", 400),
        ("SELECT * WHERE { FILTER(" + "(" * 3000 + "1" + ")" * 3000 + ") }", 400),
        ("SELECT * WHERE { ?s ?p ?o } # " + "x" * 400_000, 413),
        ("", 400),
        ("\x00", 400),
    ],
)
def test_what_may_not_be_asked_is_refused_with_a_reason(http: httpx.Client, query: str, status: int) -> None:
    answer = http.post("/sparql", content=query.encode(), headers={"Content-Type": "application/sparql-query"})
    assert answer.status_code == status, answer.text[:200]
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["detail"]
    assert http.get("/").status_code == 200


@pytest.mark.parametrize(
    ("content_type", "body", "status"),
    [
        ("text/plain", b"SELECT * {}", 415),
        ("application/sparql-update", b"INSERT DATA { <a:a> <b:b> <c:c> }", 422),
        ("application/sparql-query", b"\xff", 400),
        ("application/x-www-form-urlencoded", b"query=SELECT+*+%7B%7D&query=ASK+%7B%7D", 400),
        ("application/x-www-form-urlencoded", b"nothing=here", 400),
    ],
)
def test_a_wrong_use_of_the_protocol_is_a_4xx(http: httpx.Client, content_type: str, body: bytes, status: int) -> None:
    assert http.post("/sparql", content=body, headers={"Content-Type": content_type}).status_code == status


def test_a_query_that_takes_too_long_is_503_and_the_server_goes_on(serve: object) -> None:
    assert callable(serve)
    served = until_ready(serve("aircraft", "--setting", "query_time_limit", "0.5"))
    heavy = "SELECT (COUNT(*) AS ?n) WHERE { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }"
    answer = served.http.get("/sparql", params={"query": heavy})
    assert answer.status_code == 503
    assert "0.5" in answer.json()["detail"]
    assert served.http.get("/topics/aircraft/engine/speed").status_code == 200


def test_a_query_that_takes_too_much_memory_is_503_and_the_server_goes_on(serve: object) -> None:
    assert callable(serve)
    served = serve("aircraft", "--setting", "query_memory_limit", str(128 * 1024 * 1024))
    greedy = "SELECT * WHERE { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i } ORDER BY ?a ?d ?g"
    answer = served.http.get("/sparql", params={"query": greedy})
    assert answer.status_code == 503
    assert "128 MiB of memory" in answer.json()["detail"]
    assert served.http.get("/topics/aircraft/engine/speed").status_code == 200
    assert served.stop() == 0


def test_without_a_query_it_describes_itself_and_shows_people_a_page(http: httpx.Client) -> None:
    described = http.get("/sparql", headers={"Accept": "application/n-triples"})
    assert "sparql-service-description#UnionDefaultGraph" in described.text
    page = http.get("/sparql", headers={"Accept": "text/html"})
    assert "<textarea" in page.text
    shown = http.get("/sparql", params={"query": "ASK {}", "format": "html"})
    assert shown.headers["content-type"].startswith("text/html")
    wrong = http.get("/sparql", params={"query": "SELECT <"}, headers={"Accept": "text/html"})
    assert wrong.status_code == 400
    assert "<textarea" in wrong.text


def test_stored_queries_are_listed_and_run_in_every_format(http: httpx.Client) -> None:
    listed = http.get("/queries/", headers={"Accept": "application/n-triples"}).text
    names = {line.split("/queries/")[-1].split(">")[0] for line in listed.splitlines() if "ldp#contains" in line}
    assert len(names) >= 8
    for name in sorted(names):
        needed = {"node": "/nodes/aircraft", "topic": "/topics/aircraft/engine/speed"}
        answer = http.get(f"/queries/{name}", params={"format": "html"})
        if answer.status_code == 400 and "There is no past here" in answer.text:
            continue  # nothing is recorded
        assert answer.status_code == 200, (name, answer.text)
        given = {key: value for key, value in needed.items() if f'name="{key}"' in answer.text}
        for wanted in ("json", "csv", "tsv", "xml"):
            run = http.get(f"/queries/{name}", params={"format": wanted, **given})
            has_no_past = run.status_code == 400 and "There is no past here" in run.text
            assert run.status_code in (200, 406) or has_no_past, (name, wanted, run.text)
    rate = http.get("/queries/fastest-topics", headers={"Accept": "application/sparql-results+json"})
    assert json.loads(rate.text)["head"]["vars"][0] == "topic"
    unknown = http.get("/queries/fastest-topics", params={"nonsense": "1"}, headers={"Accept": "text/csv"})
    assert unknown.status_code == 400
    assert "nonsense" in unknown.json()["detail"]
    source = http.get("/queries/fastest-topics", headers={"Accept": "application/sparql-query"})
    assert "SELECT" in source.text
