"""HTTP under `/data/`: preconditions, ranges, preferences, URLs; `tests/server/http` tests the rest."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import httpx
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import xsd

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
TURTLE = "text/turtle"
ONE, TWO = "<> <http://ex.org/p> 1 .", "<> <http://ex.org/p> 2 ."
BYTES = bytes(range(256)) * 8


def test_http_a_current_representation_is_304(place: Place, kinds: dict[str, str], served: Served) -> None:
    for url in (*kinds.values(), served.url + "parameters/"):
        etag = place.get(url).headers["etag"]
        for method in ("GET", "HEAD"):
            answer = place.send(method, url, If_None_Match=etag)
            assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", etag)
        assert place.get(url, If_None_Match='"another"').status_code == 200


def test_http_preconditions_on_existence(place: Place) -> None:
    assert place.send("PUT", "a", ONE, TURTLE, If_Match="*").status_code == 412
    assert place.get("a").status_code == 404
    for name, media_type in (("a", TURTLE), ("file", "image/png")):
        assert place.send("PUT", name, ONE, media_type, If_None_Match="*").status_code == 201
        assert place.send("PUT", name, TWO, media_type, If_None_Match="*").status_code == 412
    assert place.get("file").text == ONE


def test_http_a_partial_put_is_refused(place: Place, kinds: dict[str, str], served: Served) -> None:
    for url in (*kinds.values(), place.at("absent"), served.url + "parameters/aircraft/seats"):
        before = place.get(url)
        answer = place.send("PUT", url, TWO, TURTLE, Content_Range="bytes 0-2/100")
        assert answer.status_code == 400, answer.text
        after = place.get(url)
        assert (after.status_code, after.headers.get("etag")) == (before.status_code, before.headers.get("etag"))


def test_http_ranges_of_a_file(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    head = place.send("HEAD", "a").headers
    assert (head["content-length"], head["accept-ranges"]) == ("2048", "bytes")
    part = place.get("a", Range="bytes=100-199", If_Range=head["etag"])
    assert (part.status_code, part.content, part.headers["etag"]) == (206, BYTES[100:200], head["etag"])
    assert part.headers["content-range"] == "bytes 100-199/2048"
    parts = place.get("a", Range="bytes=0-9,1000-1009")
    assert parts.headers["content-type"].startswith("multipart/byteranges; boundary=")
    assert BYTES[1000:1010] in parts.content
    beyond = place.get("a", Range="bytes=2048-")
    assert (beyond.status_code, beyond.headers["content-range"]) == (416, "bytes */2048")
    place.send("PUT", "a", BYTES[::-1], "image/png")
    changed = place.get("a", Range="bytes=0-9", If_Range=head["etag"])
    assert (changed.status_code, changed.content) == (200, BYTES[::-1])


def test_http_a_write_answers_as_much_as_is_preferred(place: Place) -> None:
    less = place.send("POST", "", ONE, TURTLE, Prefer="return=minimal")
    assert (less.status_code, less.content) == (201, b"")
    assert less.headers["preference-applied"] == "return=minimal"
    place.put("a", ONE)
    more = place.send("PUT", "a", TWO, TURTLE, Prefer="return=representation", Accept=TURTLE)
    assert (more.status_code, more.headers["preference-applied"]) == (200, "return=representation")
    assert more.text == place.get("a", Accept=TURTLE).text


def test_http_waiting_ends_with_the_next_change(place: Place) -> None:
    place.put("a", ONE)
    etag = place.get("a").headers["etag"]
    assert place.get("a?timeout=0.05&after=" + etag.strip('"')).status_code == 304
    with ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(httpx.get, place.at("a"), params={"after": etag, "timeout": "10"}, timeout=15)
        place.put("a", TWO)
        answer = waiting.result(15)
    assert (answer.status_code, answer.headers["etag"] == etag) == (200, False)


def test_http_a_stream_sends_each_change(place: Place) -> None:
    place.put("a", ONE)
    with place.http.stream("GET", place.at("a"), headers={"Accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        assert any('"1"' in line for line in lines)
        place.put("a", TWO)
        assert any('"2"' in line for line in lines)


def test_http_a_missing_resource_tells_what_creates_it(place: Place, served: Served) -> None:
    """RFC 9110, 10.2.1: Comunica and rdflib.js read these headers before they create a resource."""
    place.put("gone", ONE)
    assert place.send("DELETE", "gone").status_code == 204
    for name, status in (("nothing", 404), ("gone", 410), ("box/", 404)):
        for method in ("GET", "HEAD", "DELETE", "OPTIONS"):
            answer = place.send(method, name)
            assert answer.status_code == (204 if method == "OPTIONS" else status)
            assert {"PUT", "PATCH"} <= set(answer.headers["allow"].split(", "))
            assert TURTLE in answer.headers["accept-put"]
            assert {"application/sparql-update", "text/n3"} <= set(answer.headers["accept-patch"].split(", "))
    for path in ("topics/nothing", "nothing", "data/nothing.meta"):
        assert "accept-patch" not in served.at(path).get().headers


def test_http_a_name_has_one_url_however_it_is_encoded(place: Place) -> None:
    names = {"%61": "a", "%7Etilde": "~tilde", "a;b": "a%3Bb", "a%2Fb": "a%2Fb", "%c3%bc": "%C3%BC"}
    for sent, url in names.items():
        answer = place.send("PUT", sent, ONE, TURTLE)
        assert (answer.status_code, answer.headers["location"]) == (201, place.at(url))
        read = place.get(sent)
        moved = (200, None) if sent == url else (308, place.at(url))
        assert (read.status_code, read.headers.get("location")) == moved
    assert place.contained() == {place.at(url) for url in names.values()}
    assert place.send("PUT", "%FF", ONE, TURTLE).status_code == 400
    assert place.objects("a", P) == {Literal("1", datatype=xsd.integer)}
    place.put("c/", "", model="BasicContainer")
    answer = place.get("c")
    assert (answer.status_code, answer.headers["location"]) == (308, place.at("c/"))
