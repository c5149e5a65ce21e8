"""The graph store as a dataset: `?all` returns all named graphs, `?graph=` one graph without a name."""

from __future__ import annotations

import httpx
import pytest
from pyoxigraph import CanonicalizationAlgorithm, Dataset, DefaultGraph, NamedNode, Quad, RdfFormat, parse

pytestmark = pytest.mark.slow

TURTLE = {"Content-Type": "text/turtle"}
SYNTAXES = {
    "application/n-quads": RdfFormat.N_QUADS,
    "application/trig": RdfFormat.TRIG,
    "application/ld+json": RdfFormat.JSON_LD,
}


def quads(answer: httpx.Response) -> set[Quad]:
    assert answer.status_code == 200, answer.text
    media_type = answer.headers["content-type"].partition(";")[0]
    return {*parse(answer.content, SYNTAXES[media_type], base_iri=str(answer.url))}


def test_all_graphs_are_told_with_their_names_and_one_graph_without(http: httpx.Client) -> None:
    url = f"{http.base_url}data/all/one"
    assert http.put(url, content="<> <urn:p> '01'^^<urn:t>, 007, 'a'@en .", headers=TURTLE).is_success
    told = {quad.triple for quad in parse(http.get(url, headers=NTRIPLES).content, RdfFormat.N_TRIPLES)}
    for media_type in SYNTAXES:
        answer = http.get("/graphs?all", headers={"Accept": media_type})
        assert answer.headers["content-type"].partition(";")[0] == media_type
        found = quads(answer)
        assert {quad.graph_name for quad in found} >= {NamedNode(url), NamedNode(f"{http.base_url}nodes/aircraft")}
        assert DefaultGraph() not in {quad.graph_name for quad in found}
        assert {quad.triple for quad in found if quad.graph_name == NamedNode(url)} == told
    for media_type in ("application/trig", "application/n-quads"):
        for path in ("data/all/one", "topics/aircraft/engine/speed", "types/std_msgs/msg/Float64"):
            url = f"{http.base_url}{path}"
            for answer in (
                http.get("/graphs", params={"graph": url}, headers={"Accept": media_type}),
                http.get(url, headers={"Accept": media_type}),
            ):
                assert {quad.graph_name for quad in quads(answer)} == {DefaultGraph()}


NTRIPLES = {"Accept": "application/n-triples"}


def test_the_dataset_is_had_as_nquads_unless_something_else_is_asked_for(http: httpx.Client) -> None:
    assert http.get("/graphs?all").headers["content-type"] == "application/n-quads"
    assert http.head("/graphs?all").headers["content-type"] == "application/n-quads"
    assert http.get("/graphs?all&format=trig").headers["content-type"] == "application/trig"
    refused = http.get("/graphs?all", headers={"Accept": "text/turtle"})
    assert refused.status_code == 406
    assert "application/n-quads, application/trig" in refused.text
    assert http.get("/graphs?all&default").status_code == 400


def test_a_name_that_is_spelt_otherwise_is_no_graph(http: httpx.Client) -> None:
    """Equal URLs are one resource (RFC 3986, 6.2.2.2), and graph names are compared by characters."""
    assert http.put("/graphs?graph=/data/spelt/1", content="<> <urn:p> 1 .", headers=TURTLE).is_success
    assert http.put("/graphs?graph=/data/spelt/%2531", content="<> <urn:p> 2 .", headers=TURTLE).status_code == 403
    refused = http.delete("/graphs?graph=/data/spelt/%2531")
    assert refused.status_code == 403
    assert f"<{http.base_url}data/spelt/1>" in refused.text
    moved = http.get("/graphs?graph=/data/spelt/%2531", follow_redirects=False)
    assert (moved.status_code, moved.headers["location"]) == (308, f"{http.base_url}data/spelt/1")
    assert '"1"' in http.get("/data/spelt/1", headers=NTRIPLES).text


def test_what_cannot_be_read_is_refused_and_the_endpoint_of_queries_names_the_graph_store(http: httpx.Client) -> None:
    for query in ("graph=%FF", "graph=a&" + "&".join(["a=b"] * 300)):
        assert http.get(f"/graphs?{query}").status_code == 400, query
    for query in ("graph=http://127.0.0.1/data/x", "default", "all"):
        answer = http.get(f"/sparql?{query}")
        assert answer.status_code == 400
        assert f"{http.base_url}graphs?graph=URL" in answer.json()["detail"]


KEPT = {
    "thing": "<> <urn:p> '01'^^<urn:t>, 007, 'a\\rb'@en, [ <urn:q> ( 1 2 ) ] . <#it> a <urn:C> .",
    "box/": "@prefix ldp: <http://www.w3.org/ns/ldp#> . <> a ldp:BasicContainer ; <urn:p> 'box' .",
    "box/member": "<> <urn:p> 1 .",
}
DIRECT = (
    "@prefix ldp: <http://www.w3.org/ns/ldp#> . "
    "<> a ldp:DirectContainer ; ldp:membershipResource <thing> ; ldp:hasMemberRelation <urn:has> ."
)


def keep(http: httpx.Client, room: str) -> None:
    for path, text in {**KEPT, "direct/": DIRECT, "direct/member": "<> <urn:p> 2 ."}.items():
        kind = {"box/": "BasicContainer", "direct/": "DirectContainer"}.get(path)
        link = {"Link": f'<http://www.w3.org/ns/ldp#{kind}>; rel="type"'} if kind else {}
        answer = http.put(
            f"{room}{path}",
            content=text.replace("<thing>", f"<{http.base_url}{room[1:]}thing>"),
            headers={**TURTLE, **link},
        )
        assert answer.status_code == 201, answer.text


def said(http: httpx.Client, room: str) -> set[Quad]:
    """Return the graphs below a container without times, with blank nodes named by their statements."""
    url = f"{http.base_url}{room[1:]}"
    found = Dataset(
        quad
        for quad in quads(http.get("/graphs?all"))
        if quad.graph_name.value.startswith(url) and not quad.predicate.value.startswith("http://purl.org/dc/terms/")
    )
    found.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return {*found}


def test_a_dump_of_all_graphs_can_be_put_back(http: httpx.Client) -> None:
    room, trig = "/data/round/", "application/trig"
    keep(http, room)
    before, dump = said(http, room), http.get("/graphs?all", headers={"Accept": trig}).content
    assert len(before) > 20
    assert http.put("/graphs?all", content=dump, headers={"Content-Type": trig}).status_code == 204
    assert said(http, room) == before
    assert http.put(f"{room}thing", content="<> <urn:p> 'changed' .", headers=TURTLE).status_code == 204
    assert http.delete(f"{room}box/member").status_code == 204
    assert said(http, room) != before
    assert http.put("/graphs?all", content=dump, headers={"Content-Type": trig}).status_code == 204
    assert said(http, room) == before


def test_what_was_deleted_comes_back_with_what_it_said(http: httpx.Client) -> None:
    room = "/data/deleted/"
    keep(http, room)
    for path in ("direct/member", "direct/"):  # it would return as a basic one
        assert http.delete(f"{room}{path}").status_code == 204
    before, dump = said(http, room), http.get("/graphs?all").content
    for path in ("box/member", "box/", "thing", ""):
        assert http.delete(f"{room}{path}").status_code == 204
    answer = http.put("/graphs?all", content=dump, headers={"Content-Type": "application/n-quads"})
    assert answer.status_code == 204, answer.text
    assert said(http, room) == before


def test_what_is_posted_is_merged(http: httpx.Client) -> None:
    graph = NamedNode(f"{http.base_url}data/merged")
    http.put("/data/merged", content="<> <urn:p> 1 .", headers=TURTLE)
    kind = {"Content-Type": "application/trig"}
    assert http.post("/graphs?all", content=f"{graph} {{ {graph} <urn:p> 2, 3 }}", headers=kind).status_code == 204
    found = (quad for quad in quads(http.get("/graphs?all")) if quad.graph_name == graph)
    assert {quad.object.value for quad in found if quad.predicate == NamedNode("urn:p")} == {"1", "2", "3"}


def test_what_cannot_be_taken_back_is_refused_whole(http: httpx.Client) -> None:
    kept = f"<{http.base_url}data/never> {{ <urn:s> <urn:p> 1 }}\n"
    for body, status, words in (
        ("<urn:s> <urn:p> 1 .", 400, "is not in a graph"),
        ("<urn:g> { <urn:s> <urn:p> 1 }", 403, "The graph <urn:g> cannot be created"),
        ("<urn:g> { <urn:s> <urn:p> ", 400, ""),
    ):
        answer = http.put("/graphs?all", content=kept + body, headers={"Content-Type": "application/trig"})
        assert answer.status_code == status
        assert words in answer.text
    assert http.get("/data/never").status_code == 404


def test_graphs_of_the_robot_are_passed_over_and_a_dry_run_tells_what_would_be_written(http: httpx.Client) -> None:
    base = http.base_url
    body = f"<{base}nodes/aircraft> <urn:p> 1 <{base}nodes/aircraft> .\n<urn:s> <urn:p> 1 <{base}data/dry> .\n"
    kind = {"Content-Type": "application/n-quads"}
    planned = http.post("/graphs?all&dry-run=true", content=body.replace(" 1 ", ' "1" '), headers=kind)
    assert [each["url"] for each in planned.json()["steps"]] == [f"{base}data/dry"]
    assert http.get("/data/dry").status_code == 404
    assert http.put("/graphs?all", content=body, headers=TURTLE).status_code == 415
