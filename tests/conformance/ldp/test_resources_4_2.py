"""LDP 4.2: resources."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import httpx
import pytest
from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.vocab import ldp
from tests.waiting import until

if TYPE_CHECKING:
    from rosld.server.http.link import Link
from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
READS = ("GET", "HEAD", "OPTIONS")
ROBOTS_OWN = (
    *("topics/aircraft/engine/speed", "nodes/aircraft", "services/aircraft/get_power", "parameters/aircraft/seats"),
    *("resources/aircraft/power", "types/std_msgs/msg/String", "shapes/std_msgs/msg/String", "mappings/aircraft"),
    *("queries/graph", "ontology"),
)
"""Resources of the robot that are no containers."""


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


def test_4_2_1_3_every_representation_has_an_etag(place: Place, kinds: dict[str, str]) -> None:
    for url in (*kinds.values(), place.url, place.at("file.txt.meta")):
        for method in ("GET", "HEAD"):
            answer = place.send(method, url)
            assert answer.status_code == 200
            assert answer.headers["etag"].startswith('"'), url


def test_4_2_1_3_the_robots_containers_have_etags(robots: list[Place]) -> None:
    def etags(robot: Place) -> tuple[str, str] | None:
        before, head, after = (robot.send(method).headers["etag"] for method in ("GET", "HEAD", "GET"))
        return (before, head) if before == after else None

    for robot in robots:
        got, head = until(lambda robot=robot: etags(robot), "a moment in which the robot says nothing else")
        assert got == head, robot.url


@pytest.mark.parametrize("path", ROBOTS_OWN)
def test_4_2_1_3_the_robots_resources_have_etags(path: str, served: Served) -> None:
    for method in ("GET", "HEAD"):
        answer = served.at(path).send(method)
        assert answer.status_code == 200, answer.text
        assert answer.headers["etag"].startswith('"')


def test_4_2_1_3_a_change_changes_the_etag(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    before = place.get("a").headers["etag"]
    assert place.get("a").headers["etag"] == before
    place.put("a", "<> <http://ex.org/p> 2 .")
    assert place.get("a").headers["etag"] != before


def test_4_2_1_3_a_new_member_and_one_less_change_the_etag_of_the_container(place: Place) -> None:
    seen = [place.get().headers["etag"]]
    made = place.post()
    seen.append(place.get().headers["etag"])
    assert place.send("DELETE", made).status_code == 204
    seen.append(place.get().headers["etag"])
    assert len(set(seen)) == 3


def test_4_2_1_4_every_answer_links_to_the_type(
    place: Place, kinds: dict[str, str], models: Callable[[httpx.Response], set[str]]
) -> None:
    for url in kinds.values():
        for method in READS:
            assert "Resource" in models(place.send(method, url)), (method, url)
    url = kinds["RDFSource"]
    assert "Resource" in models(place.put(url, "<> <http://ex.org/p> 2 ."))
    update = "INSERT DATA { <> <http://ex.org/p> 3 }"
    assert "Resource" in models(place.send("PATCH", url, update, "application/sparql-update"))
    assert "Resource" in models(place.send("POST", "basic/", "<> <http://ex.org/p> 1 .", "text/turtle"))
    etag = place.get(url).headers["etag"]
    assert "Resource" in models(place.get(url, If_None_Match=etag))


def test_4_2_1_4_refusals_link_to_the_type_too(
    place: Place, kinds: dict[str, str], models: Callable[[httpx.Response], set[str]]
) -> None:
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


def test_4_2_1_4_the_robots_containers_link_to_the_type(
    robots: list[Place], models: Callable[[httpx.Response], set[str]]
) -> None:
    for robot in robots:
        for method in READS:
            assert "Resource" in models(robot.send(method)), robot.url
        assert "Resource" in models(robot.get(Accept="video/mp4")), robot.url


@pytest.mark.parametrize("path", ROBOTS_OWN)
def test_4_2_1_4_the_robots_resources_link_to_the_type(
    path: str, served: Served, models: Callable[[httpx.Response], set[str]]
) -> None:
    for method in READS:
        assert "Resource" in models(served.at(path).send(method))


def test_4_2_1_5_relative_iris_are_resolved_against_the_resource(place: Place) -> None:
    said = "<> <http://ex.org/p> <x> , <#y> , <../z> ."
    url = NamedNode(place.at("deep/a"))

    def expected(base: str) -> set[Triple]:
        return {Triple(url, P, NamedNode(place.at(end))) for end in (f"{base}x", f"{base}a#y", "z")}

    for _ in ("made", "replaced"):
        place.put("deep/a", said)
        assert expected("deep/") <= place.graph("deep/a")


def test_4_2_1_5_what_is_posted_is_resolved_against_the_new_resource(place: Place) -> None:
    made = place.post("<> <http://ex.org/p> <#y> .")
    assert place.objects(made, P) == {f"{made}#y"}


def test_4_2_1_6_a_refused_body_links_to_what_constrains_it(
    place: Place, links: Callable[[httpx.Response], list[Link]]
) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    refused = (
        place.send("PUT", "a", "this is no Turtle", "text/turtle"),
        place.send("PUT", "", f"<> <{ldp.iri}contains> <elsewhere> .", "text/turtle"),
        place.send("POST", "", "this is no Turtle", "text/turtle"),
        place.send("PATCH", "a", "this is no update", "application/sparql-update"),
        place.send("PATCH", "a", "x", "text/x-diff"),
        place.send("PUT", "c/", "", "text/turtle", model="IndirectContainer"),
    )
    for answer in refused:
        assert 400 <= answer.status_code < 500
        (target,) = {each.target for each in links(answer) if each.rel == f"{ldp.iri}constrainedBy"}
        assert place.get(target).status_code == 200


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("PUT", "mappings/x", "<#x> a <https://w3id.org/rosld/mapping#ComplexResource> ."),
        ("PUT", "mappings/x", "this is no Turtle"),
        ("PUT", "parameters/aircraft/seats", "<> <https://w3id.org/rosld#value> <http://ex.org/x> ."),
        ("PUT", "resources/aircraft/power", "<> <http://www.w3.org/1999/02/22-rdf-syntax-ns#value> 4.5 ."),
    ],
)
def test_4_2_1_6_the_robots_resources_link_to_what_constrains_them(
    method: str, path: str, body: str, served: Served, links: Callable[[httpx.Response], list[Link]]
) -> None:
    answer = served.at(path).send(method, "", body, "text/turtle")
    assert 400 <= answer.status_code < 500
    (target,) = {each.target for each in links(answer) if each.rel == f"{ldp.iri}constrainedBy"}
    assert served.http.get(target).status_code == 200


def test_4_2_2_1_get_answers(place: Place, kinds: dict[str, str]) -> None:
    assert all(place.get(url).status_code == 200 for url in kinds.values())


def test_4_2_2_1_get_answers_on_the_robots_containers(robots: list[Place]) -> None:
    for robot in robots:
        assert robot.get().status_code == 200, robot.url


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
    """Server-managed triples come back with it, and are no obstacle."""
    place.put("a", "<> <http://ex.org/p> 1 .")
    place.put("basic/", "", model="BasicContainer")
    place.put("basic/m", "<> <http://ex.org/p> 1 .")
    for name in ("a", "basic/"):
        got = place.get(name, Accept="text/turtle")
        changed = got.text + "\n<> <http://ex.org/p> 2 ."
        place.put(name, changed, If_Match=got.headers["etag"])
        assert "2" in {each.value for each in place.objects(name, P) if isinstance(each, Literal)}
    assert place.contained("basic/") == {place.at("basic/m")}


def test_4_2_4_3_properties_that_the_server_manages_cannot_be_changed(place: Place) -> None:
    before = place.graph()
    answer = place.send("PUT", "", f"<> <{ldp.iri}contains> <elsewhere> .", "text/turtle")
    assert answer.status_code == 409
    assert "contains" in answer.text
    assert place.graph() == before


def test_4_2_4_4_what_cannot_be_kept_is_refused(place: Place) -> None:
    """Everything can be kept but graphs of other names, for a resource is one graph."""
    body = "<http://ex.org/g> { <> <http://ex.org/p> 1 }"
    answer = place.send("PUT", "a", body, "application/trig")
    assert 400 <= answer.status_code < 500
    assert "http://ex.org/g" in answer.text
    assert place.get("a").status_code == 404


def test_4_2_4_4_what_is_no_value_is_refused(served: Served) -> None:
    power = served.at("resources/aircraft/power")
    body = "<> <http://www.w3.org/1999/02/22-rdf-syntax-ns#value> <http://ex.org/on> ."
    answer = power.send("PUT", "", body, "text/turtle")
    assert answer.status_code in (409, 422)
    assert "http://ex.org/on" in answer.text


def test_4_2_4_5_a_stale_if_match_is_refused(place: Place, kinds: dict[str, str]) -> None:
    for url in kinds.values():
        is_file = url.endswith(".txt")
        before = place.get(url)
        media_type = "text/plain" if is_file else "text/turtle"
        answer = place.send("PUT", url, before.content, media_type, If_Match='"another"')
        assert answer.status_code == 412
        assert place.send("DELETE", url, If_Match='"another"').status_code == 412
        assert place.get(url).content == before.content
        assert place.send("PUT", url, before.content, media_type, If_Match=before.headers["etag"]).is_success


def test_4_2_4_5_the_robots_resources_refuse_a_stale_if_match(served: Served) -> None:
    parameter = served.at("parameters/aircraft/seats")
    assert parameter.send("PUT", "", "3", "application/json", If_Match='"another"').status_code == 412
    assert parameter.get(Accept="application/json").json() == 2


def test_4_2_4_5_where_if_match_is_demanded_its_absence_is_428(demanding: Served) -> None:
    place = demanding.place("guarded")
    place.put("a", "<> <http://ex.org/p> 1 .")
    update = "INSERT DATA { <> <http://ex.org/p> 3 }"
    assert place.send("PUT", "a", "<> <http://ex.org/p> 2 .", "text/turtle").status_code == 428
    assert place.send("PATCH", "a", update, "application/sparql-update").status_code == 428
    assert place.send("DELETE", "a").status_code == 428
    place.put("a", "<> <http://ex.org/p> 2 .", If_Match=place.get("a").headers["etag"])
    assert place.send("DELETE", "a", If_Match=place.get("a").headers["etag"]).status_code == 204


def test_4_2_4_6_put_makes_resources_and_the_containers_on_the_way(place: Place) -> None:
    answer = place.send("PUT", "x/y/z", "<> <http://ex.org/p> 1 .", "text/turtle")
    assert answer.status_code == 201
    assert answer.headers["location"] == place.at("x/y/z")
    assert place.contained() == {place.at("x/")}
    assert place.contained("x/y/") == {place.at("x/y/z")}


def test_4_2_6_1_head_is_get_without_a_body(place: Place, kinds: dict[str, str]) -> None:
    for url in kinds.values():
        head, got = place.send("HEAD", url), place.get(url)
        assert head.status_code == 200
        assert not head.content
        for name in ("content-type", "content-length", "etag", "link", "allow", "vary"):
            assert head.headers.get(name) == got.headers.get(name), (url, name)


def test_4_2_6_1_head_answers_on_the_robots_containers(robots: list[Place]) -> None:
    for robot in robots:
        head = robot.send("HEAD")
        assert (head.status_code, head.content) == (200, b""), robot.url
        assert int(head.headers["content-length"]) == len(robot.get().content), robot.url


def test_4_2_7_1_options_lists_the_patch_formats(containers: list[Place]) -> None:
    for container in containers:
        answer = container.send("OPTIONS")
        assert ("PATCH" in answer.headers["allow"]) == ("accept-patch" in answer.headers), container.url


def test_4_2_7_1_rdf_sources_take_sparql_update_and_n3(place: Place, kinds: dict[str, str]) -> None:
    for model, url in kinds.items():
        if model != "NonRDFSource":
            formats = place.send("OPTIONS", url).headers["accept-patch"].split(", ")
            assert {"application/sparql-update", "text/n3"} <= set(formats)


def test_4_2_8_1_options_answers(containers: list[Place]) -> None:
    for container in containers:
        assert container.send("OPTIONS").status_code in (200, 204), container.url


def test_4_2_8_2_allow_tells_the_truth(place: Place, kinds: dict[str, str]) -> None:
    for url in (*kinds.values(), place.at("file.txt.meta")):
        allowed = set(place.send("OPTIONS", url).headers["allow"].split(", "))
        assert {"GET", "HEAD", "OPTIONS"} <= allowed
        for method in {"PUT", "POST", "PATCH", "DELETE"} - allowed:
            answer = place.send(method, url, "<> <http://ex.org/p> 2 .", "text/turtle")
            assert answer.status_code == 405, (method, url)
            assert set(answer.headers["allow"].split(", ")) == allowed
        for method in {"PUT", "POST", "PATCH", "DELETE"} & allowed:
            answer = place.send(method, url, "?", "text/turtle", If_Match='"another"')
            assert answer.status_code != 405, (method, url)


def test_4_2_8_2_the_robots_containers_tell_the_truth(robots: list[Place]) -> None:
    for robot in robots:
        allowed = set(robot.send("OPTIONS").headers["allow"].split(", "))
        for method in {"PUT", "POST", "PATCH", "DELETE"} - allowed:
            assert robot.send(method, "", "?", "text/turtle").status_code == 405, method


def test_4_2_8_2_what_is_always_there_cannot_be_deleted(served: Served) -> None:
    data = served.at("data/")
    assert "DELETE" not in data.send("OPTIONS").headers["allow"]
    assert data.send("DELETE").status_code == 405
