"""LDP 4.2: resources."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import pytest
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import ldp, rdf, ros
from tests.conformance.ldp.conftest import links, models

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
READS = ("GET", "HEAD", "OPTIONS")
ROBOTS_OWN = (
    *("topics/aircraft/engine/speed", "nodes/aircraft", "services/aircraft/get_power", "parameters/aircraft/seats"),
    *("resources/aircraft/power", "types/std_msgs/msg/String", "shapes/std_msgs/msg/String", "mappings/aircraft"),
    *("queries/graph", "ontology"),
)
"""Resources of the robot that are not containers."""


@pytest.fixture
def everything(place: Place, kinds: dict[str, str], robots: list[Place], served: Served) -> list[str]:
    """URLs of resources of all kinds: under `/data/`, and the robot's."""
    own = [*kinds.values(), place.url, place.at("file.txt.meta")]
    return [*own, *(robot.url for robot in robots), *(served.url + path for path in ROBOTS_OWN)]


def test_4_2_1_1_a_connection_serves_several_requests_and_a_request_needs_a_host(served: Served) -> None:
    parts = urlsplit(served.url)
    request = f"GET /ontology HTTP/1.1\r\nHost: {parts.netloc}\r\nAccept: text/turtle\r\n\r\n".encode()
    assert parts.hostname is not None
    with (
        socket.create_connection((parts.hostname, parts.port or 80), 10) as connection,
        connection.makefile("rb") as to,
    ):
        for _ in range(2):
            connection.sendall(request)
            assert to.readline().startswith(b"HTTP/1.1 200 ")
            headers = dict(line.lower().rstrip().split(b": ", 1) for line in iter(to.readline, b"\r\n"))
            assert len(to.read(int(headers[b"content-length"]))) == int(headers[b"content-length"])
        connection.sendall(b"GET /ontology HTTP/1.1\r\n\r\n")
        assert to.readline().startswith(b"HTTP/1.1 4")


def test_4_2_1_1_a_body_may_come_in_chunks(place: Place) -> None:
    def chunks() -> object:
        yield b"<> <http://ex.org/p> "
        yield b'"in pieces" .'

    answer = place.http.put(place.at("a"), content=chunks(), headers={"Content-Type": "text/turtle"})
    assert answer.status_code == 201
    assert place.objects("a", P) == {Literal("in pieces")}


def test_4_2_1_2_rdf_and_other_files_lie_side_by_side(place: Place, kinds: dict[str, str]) -> None:
    assert place.contained() == set(kinds.values())
    assert place.get("file.txt").text == "some words"


def test_4_2_1_3_every_representation_has_an_etag(everything: list[str], place: Place) -> None:
    for url in everything:
        for method in ("GET", "HEAD"):
            answer = place.send(method, url)
            assert answer.status_code == 200, answer.text
            assert answer.headers["etag"].startswith('"'), url


def test_4_2_1_3_a_change_changes_the_etag(place: Place) -> None:
    """A change of members changes the ETag of the container."""

    def etags() -> tuple[str, str]:
        return place.get().headers["etag"], place.get("a").headers["etag"]

    place.put("a", "<> <http://ex.org/p> 1 .")
    seen = [etags()]
    assert etags() == seen[0]
    place.put("a", "<> <http://ex.org/p> 2 .")
    made = place.post()
    seen.append(etags())
    assert place.send("DELETE", made).status_code == 204
    place.put("a", "<> <http://ex.org/p> 1 .")
    seen.append(etags())
    assert [len(set(each)) for each in zip(*seen, strict=True)] == [3, 3]


def test_4_2_1_4_every_answer_links_to_the_type(everything: list[str], place: Place) -> None:
    for url in everything:
        for method in READS:
            assert "Resource" in models(place.send(method, url)), (method, url)
        assert "Resource" in models(place.get(url, Accept="video/mp4")), url
    url = place.at("rdf")
    assert "Resource" in models(place.put(url, "<> <http://ex.org/p> 2 ."))
    update = "INSERT DATA { <> <http://ex.org/p> 3 }"
    assert "Resource" in models(place.send("PATCH", url, update, "application/sparql-update"))
    assert "Resource" in models(place.send("POST", "basic/", "<> <http://ex.org/p> 1 .", "text/turtle"))
    etag = place.get(url).headers["etag"]
    assert "Resource" in models(place.get(url, If_None_Match=etag))


def test_4_2_1_4_refusals_link_to_the_type_too(place: Place, kinds: dict[str, str]) -> None:
    url = kinds["RDFSource"]
    refused = (
        place.send("PUT", url, "this is no Turtle", "text/turtle"),
        place.send("PUT", url, "<> <http://ex.org/p> 2 .", "text/turtle", If_Match='"another"'),
        place.send("POST", kinds["NonRDFSource"], "<> <http://ex.org/p> 2 .", "text/turtle"),
        place.send("PATCH", url, "x", "text/x-diff"),
        place.get(url, Accept="video/mp4"),
    )
    assert [answer.status_code for answer in refused] == [400, 412, 405, 415, 406]
    for answer in refused:
        assert "Resource" in models(answer), answer.status_code


def test_4_2_1_5_relative_iris_are_resolved_against_the_resource(place: Place) -> None:
    expected = {place.at("deep/x"), place.at("deep/a#y"), place.at("z")}
    for _ in ("made", "replaced"):
        place.put("deep/a", "<> <http://ex.org/p> <x> , <#y> , <../z> .")
        assert place.objects("deep/a", P) == expected
    made = place.post("<> <http://ex.org/p> <#y> .")
    assert place.objects(made, P) == {f"{made}#y"}


def test_4_2_1_6_a_refused_body_links_to_what_constrains_it(place: Place, served: Served) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    resource, turtle = "<#x> a <https://w3id.org/rosld/mapping#ComplexResource> .", "text/turtle"
    refused = (
        place.send("PUT", "a", "this is no Turtle", turtle),
        place.send("PUT", "", f"<> <{ldp.iri}contains> <elsewhere> .", turtle),
        place.send("POST", "", "this is no Turtle", turtle),
        place.send("PATCH", "a", "this is no update", "application/sparql-update"),
        place.send("PATCH", "a", "x", "text/x-diff"),
        place.send("PUT", "c/", "", turtle, model="IndirectContainer"),
        served.at("mappings/").send("PUT", "x", resource, turtle),
        served.at("mappings/").send("PUT", "x", "this is no Turtle", turtle),
        served.at("parameters/").send("PUT", "aircraft/seats", f"<> {ros.value} <http://ex.org/x> .", turtle),
        served.at("resources/").send("PUT", "aircraft/power", f"<> {rdf.value} 4.5 .", turtle),
    )
    for answer in refused:
        assert 400 <= answer.status_code < 500
        (target,) = {each.target for each in links(answer) if each.rel == f"{ldp.iri}constrainedBy"}
        assert place.get(target).status_code == 200


def test_4_2_2_2_get_has_the_headers_of_options(containers: list[Place]) -> None:
    for container in containers:
        read, asked = container.get(), container.send("OPTIONS")
        for name in ("allow", "accept-post", "accept-put", "accept-patch"):
            assert read.headers.get(name) == asked.headers.get(name), container.url


def test_4_2_4_1_put_replaces_everything(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 1 ; <http://ex.org/q> 2 . <http://ex.org/s> <http://ex.org/p> 3 .")
    place.put("a", "<> <http://ex.org/q> 4 .")
    said = {each for each in place.graph("a") if each.predicate.value.startswith("http://ex.org/")}
    assert [each.object.value for each in said] == ["4"]


def test_4_2_4_2_what_was_got_is_put_back_with_a_change(place: Place) -> None:
    """Server-managed triples are included, and do not prevent it."""
    place.put("a", "<> <http://ex.org/p> 1 .")
    place.put("basic/", "", model="BasicContainer")
    place.put("basic/m", "<> <http://ex.org/p> 1 .")
    for name in ("a", "basic/"):
        got = place.get(name, Accept="text/turtle")
        changed = got.text + "\n<> <http://ex.org/p> 2 ."
        place.put(name, changed, If_Match=got.headers["etag"])
        assert "2" in {each.value for each in place.objects(name, P) if isinstance(each, Literal)}
    assert place.contained("basic/") == {place.at("basic/m")}


def test_4_2_4_4_what_cannot_be_kept_is_refused(place: Place, served: Served) -> None:
    """Under `/data/` these are graphs with other names, as a resource is one graph."""
    body = "<http://ex.org/g> { <> <http://ex.org/p> 1 }"
    answer = place.send("PUT", "a", body, "application/trig")
    assert 400 <= answer.status_code < 500
    assert "http://ex.org/g" in answer.text
    assert place.get("a").status_code == 404
    power = served.at("resources/aircraft/power")
    answer = power.send("PUT", "", f"<> {rdf.value} <http://ex.org/on> .", "text/turtle")
    assert answer.status_code in (409, 422)
    assert "http://ex.org/on" in answer.text


def test_4_2_4_5_a_stale_if_match_is_refused(place: Place, kinds: dict[str, str], served: Served) -> None:
    for url in (*kinds.values(), served.url + "parameters/aircraft/seats"):
        before = place.get(url)
        media_type = before.headers["content-type"]
        answer = place.send("PUT", url, before.content, media_type, If_Match='"another"')
        assert answer.status_code == 412
        assert place.send("DELETE", url, If_Match='"another"').status_code == 412
        assert place.get(url).content == before.content
        assert place.send("PUT", url, before.content, media_type, If_Match=before.headers["etag"]).is_success


def test_4_2_4_5_where_if_match_is_demanded_its_absence_is_428(demanding: Served) -> None:
    place = demanding.place("guarded")
    place.put("a", "<> <http://ex.org/p> 1 .")
    update = "INSERT DATA { <> <http://ex.org/p> 3 }"
    assert place.send("PUT", "a", "<> <http://ex.org/p> 2 .", "text/turtle").status_code == 428
    place.put("a", "<> <http://ex.org/p> 2 .", If_Match=place.get("a").headers["etag"])
    assert place.send("PATCH", "a", update, "application/sparql-update").status_code == 204
    assert place.send("DELETE", "a").status_code == 204


def test_4_2_4_6_put_makes_resources_and_the_containers_on_the_way(place: Place) -> None:
    answer = place.send("PUT", "x/y/z", "<> <http://ex.org/p> 1 .", "text/turtle")
    assert answer.status_code == 201
    assert answer.headers["location"] == place.at("x/y/z")
    assert place.contained() == {place.at("x/")}
    assert place.contained("x/y/") == {place.at("x/y/z")}


def test_4_2_6_1_head_is_get_without_a_body(everything: list[str], kinds: dict[str, str], place: Place) -> None:
    for url in everything:
        head, got = place.send("HEAD", url), place.get(url)
        assert (head.status_code, head.content) == (200, b"")
        for name in ("content-type", "allow", "vary", *(("content-length", "etag") if url in kinds.values() else ())):
            assert head.headers.get(name) == got.headers.get(name), (url, name)


def test_4_2_7_1_options_lists_the_patch_formats(everything: list[str], place: Place, kinds: dict[str, str]) -> None:
    for url in everything:
        answer = place.send("OPTIONS", url)
        assert answer.status_code in (200, 204), url
        assert ("PATCH" in answer.headers["allow"]) == ("accept-patch" in answer.headers), url
        if url in kinds.values() and not url.endswith(".txt"):
            formats = answer.headers["accept-patch"].split(", ")
            assert {"application/sparql-update", "text/n3"} <= set(formats)


def test_4_2_8_2_allow_tells_the_truth(
    place: Place, kinds: dict[str, str], robots: list[Place], served: Served
) -> None:
    writes = {"PUT", "POST", "PATCH", "DELETE"}
    for url in (*kinds.values(), place.at("file.txt.meta"), served.url + "data/", *(robot.url for robot in robots)):
        allowed = set(place.send("OPTIONS", url).headers["allow"].split(", "))
        assert {"GET", "HEAD", "OPTIONS"} <= allowed
        for method in writes - allowed:
            answer = place.send(method, url, "<> <http://ex.org/p> 2 .", "text/turtle")
            assert answer.status_code == 405, (method, url)
            assert set(answer.headers["allow"].split(", ")) == allowed
        for method in writes & allowed if url in kinds.values() else ():
            answer = place.send(method, url, "?", "text/turtle", If_Match='"another"')
            assert answer.status_code != 405, (method, url)
    assert "DELETE" not in served.at("data/").send("OPTIONS").headers["allow"]
