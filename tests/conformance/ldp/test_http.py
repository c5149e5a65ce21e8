"""HTTP as an LDP server is to speak it: conditional requests, ranges, preferences, refusals."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest
from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import xsd
from tests.waiting import once_started

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
TURTLE = "text/turtle"
ONE, TWO = "<> <http://ex.org/p> 1 .", "<> <http://ex.org/p> 2 ."
ADDED = "INSERT DATA { <> <http://ex.org/p> 2 }"
BYTES = bytes(range(256)) * 8


# Conditional requests (RFC 9110 13)


def test_http_what_is_known_is_304(place: Place, kinds: dict[str, str]) -> None:
    for url in kinds.values():
        etag = place.get(url).headers["etag"]
        for method in ("GET", "HEAD"):
            answer = place.send(method, url, If_None_Match=etag)
            assert (answer.status_code, answer.content) == (304, b"")
            assert answer.headers["etag"] == etag
        assert place.get(url, If_None_Match='"another"').status_code == 200


def test_http_the_robots_containers_answer_304(robots: list[Place]) -> None:
    """Some tell the latest values of their members, which may change between two requests."""
    for robot in robots:
        answers = (robot.get(If_None_Match=robot.get().headers["etag"]) for _ in range(100))
        assert any(answer.status_code == 304 for answer in answers), robot.url


def test_http_one_syntax_is_not_another(place: Place) -> None:
    place.put("a", ONE)
    etag = place.get("a", Accept=TURTLE).headers["etag"]
    answer = place.get("a", Accept="application/ld+json", If_None_Match=etag)
    assert answer.status_code == 200
    assert answer.headers["etag"] != etag


def test_http_what_was_read_in_one_syntax_guards_a_write_in_another(place: Place) -> None:
    place.put("a", ONE)
    etag = place.get("a", Accept="application/ld+json").headers["etag"]
    place.put("a", TWO, If_Match=etag)


def test_http_if_none_match_makes_only_what_is_not_there(place: Place) -> None:
    place.put("a", ONE, If_None_Match="*")
    assert place.send("PUT", "a", TWO, TURTLE, If_None_Match="*").status_code == 412
    assert place.send("PUT", "file", b"1", "image/png", If_None_Match="*").status_code == 201
    assert place.send("PUT", "file", b"2", "image/png", If_None_Match="*").status_code == 412
    assert place.get("file").content == b"1"


@pytest.mark.parametrize("method", ["PUT", "PATCH", "DELETE"])
@pytest.mark.parametrize("kind", ["RDFSource", "NonRDFSource", "BasicContainer"])
def test_http_a_write_unless_it_is_the_current_state_is_412_on_it(
    method: str, kind: str, place: Place, kinds: dict[str, str]
) -> None:
    url = kinds[kind]
    seen = place.get(url)
    body, media_type = {"PUT": (TWO, TURTLE), "PATCH": (ADDED, "application/sparql-update")}.get(method, (None, None))
    if kind == "NonRDFSource" and method != "DELETE":
        body, media_type = ("other words", "text/plain") if method == "PUT" else ("{}", "application/merge-patch+json")
    for etag in (seen.headers["etag"], f'"x", W/{seen.headers["etag"]}'):
        assert place.send(method, url, body or "", media_type, If_None_Match=etag).status_code == 412
    after = place.get(url)
    assert (after.headers["etag"], after.content) == (seen.headers["etag"], seen.content)


def test_http_a_parameter_is_not_written_unless_it_is_the_current_state(served: Served) -> None:
    seats = served.at("parameters/aircraft/seats")
    etag = seats.get().headers["etag"]
    answer = seats.send("PUT", "", "7", "application/json", If_None_Match=etag)
    assert (answer.status_code, seats.get().headers["etag"]) == (412, etag)


@pytest.mark.parametrize("tag", ["This is not the tag you look for", "a b", "{}", "\\"])
@pytest.mark.parametrize("method", ["PUT", "DELETE"])
def test_http_an_entity_tag_of_odd_characters_matches_nothing(tag: str, method: str, place: Place) -> None:
    place.put("a", ONE)
    assert place.send(method, "a", TWO, TURTLE, If_Match=f'"{tag}"').status_code == 412
    assert place.send(method, "a", TWO, TURTLE, If_Match=tag).status_code == 400
    assert place.objects("a", P) == {Literal("1", datatype=xsd.integer)}


@pytest.mark.parametrize("name", ["a", "file.txt", "absent", "absent.bin"])
def test_http_a_part_is_not_put_in_place_of_the_whole(name: str, place: Place, kinds: dict[str, str]) -> None:
    place.put("a", ONE)
    before = place.get(name)
    media_type = TURTLE if name == "a" else "application/octet-stream"
    answer = place.send("PUT", name, TWO, media_type, Content_Range="bytes 0-2/100")
    assert answer.status_code == 400, answer.text
    assert (place.get(name).status_code, place.get(name).content[:40]) == (before.status_code, before.content[:40])


def test_http_the_robot_takes_no_part_for_the_whole_either(served: Served) -> None:
    seats = served.at("parameters/aircraft/seats")
    assert seats.send("PUT", "", "7", "application/json", Content_Range="bytes 0-0/2").status_code == 400


def test_http_if_match_makes_nothing(place: Place) -> None:
    assert place.send("PUT", "a", ONE, TURTLE, If_Match="*").status_code == 412
    assert place.get("a").status_code == 404


def test_http_of_two_writes_on_one_state_one_wins(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 0 .")
    etag = place.get("a").headers["etag"]

    def write(number: int) -> int:
        return place.send("PUT", "a", f"<> <http://ex.org/p> {number} .", TURTLE, If_Match=etag).status_code

    with ThreadPoolExecutor(8) as threads:
        statuses = sorted(threads.map(write, range(8)))
    assert [status for status in statuses if status < 300] == [204]
    assert set(statuses[1:]) <= {409, 412}


def test_http_of_two_that_make_the_same_one_wins(place: Place) -> None:
    def make(number: int) -> int:
        return place.send("PUT", "a", f"<> <http://ex.org/p> {number} .", TURTLE, If_None_Match="*").status_code

    with ThreadPoolExecutor(8) as threads:
        statuses = sorted(threads.map(make, range(8)))
    assert statuses == [201, *[412] * 7]


def test_http_a_write_tells_the_new_etag_or_none(place: Place) -> None:
    """RFC 9110 8.8.3: an ETag in the answer to a write is that of the new state."""
    for said in (ONE, TWO):
        answer = place.put("a", said)
        if "etag" in answer.headers:
            assert answer.headers["etag"] == place.get("a").headers["etag"]


# Ranges (RFC 9110 14)


@pytest.mark.parametrize(
    ("asked", "start", "stop"), [("bytes=0-0", 0, 1), ("bytes=100-199", 100, 200), ("bytes=-5", 2043, 2048)]
)
def test_http_a_range_of_a_file_is_sent(asked: str, start: int, stop: int, place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    answer = place.get("a", Range=asked)
    assert answer.status_code == 206
    assert answer.content == BYTES[start:stop]
    assert answer.headers["content-range"] == f"bytes {start}-{stop - 1}/2048"
    assert answer.headers["etag"] == place.get("a").headers["etag"]


def test_http_several_ranges_come_in_parts(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    answer = place.get("a", Range="bytes=0-9,1000-1009")
    assert answer.status_code == 206
    assert answer.headers["content-type"].startswith("multipart/byteranges; boundary=")
    assert answer.content.count(b"Content-Range: bytes ") == 2
    assert BYTES[1000:1010] in answer.content


def test_http_a_range_beyond_the_end_is_416(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    answer = place.get("a", Range="bytes=2048-")
    assert answer.status_code == 416
    assert answer.headers["content-range"] == "bytes */2048"


def test_http_a_range_of_another_state_is_the_whole(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    etag = place.get("a").headers["etag"]
    assert place.get("a", Range="bytes=0-9", If_Range=etag).status_code == 206
    place.send("PUT", "a", BYTES[::-1], "image/png")
    answer = place.get("a", Range="bytes=0-9", If_Range=etag)
    assert (answer.status_code, answer.content) == (200, BYTES[::-1])


def test_http_head_of_a_file_tells_its_length_and_that_it_has_ranges(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    answer = place.send("HEAD", "a")
    assert answer.headers["content-length"] == "2048"
    assert answer.headers["accept-ranges"] == "bytes"


# Refusals


def test_http_media_types_nobody_has_are_406(place: Place) -> None:
    place.put("a", ONE)
    assert place.get("a", Accept="video/mp4").status_code == 406
    assert place.send("PUT", "a", TWO, "text/plain").status_code in (409, 415)


def test_http_media_types_that_are_not_taken_are_415_and_told(place: Place, kinds: dict[str, str]) -> None:
    answer = place.send("PATCH", kinds["RDFSource"], "x", "text/x-diff")
    assert answer.status_code == 415
    assert "application/sparql-update" in answer.headers["accept-patch"]


def test_http_methods_that_are_not_allowed_are_405_and_told(place: Place, kinds: dict[str, str]) -> None:
    answer = place.send("POST", kinds["NonRDFSource"], ONE, TURTLE)
    assert answer.status_code == 405
    assert "PUT" in answer.headers["allow"]


def test_http_refusals_are_problem_details(place: Place) -> None:
    answer = place.send("PUT", "a", "this is no Turtle", TURTLE)
    assert answer.status_code == 400
    assert answer.headers["content-type"] == "application/problem+json"
    assert "line 1" in answer.json()["detail"]


def test_http_a_slash_too_few_leads_to_the_container(place: Place) -> None:
    place.put("c/", "", model="BasicContainer")
    answer = place.get("c")
    assert (answer.status_code, answer.headers["location"]) == (308, place.at("c/"))


# Preferences (RFC 7240)


def test_http_a_write_answers_as_much_as_is_preferred(place: Place) -> None:
    less = place.send("POST", "", ONE, TURTLE, Prefer="return=minimal")
    assert (less.status_code, less.content) == (201, b"")
    assert less.headers["preference-applied"] == "return=minimal"
    place.put("a", ONE)
    more = place.send("PUT", "a", TWO, TURTLE, Prefer="return=representation", Accept=TURTLE)
    assert more.status_code == 200
    assert more.headers["preference-applied"] == "return=representation"
    assert more.text == place.get("a", Accept=TURTLE).text


# More than LDP says


def test_http_what_is_kept_is_in_the_same_dataset_as_the_robot(place: Place, served: Served) -> None:
    place.put("a", f"<> <http://ex.org/about> <{served.url}topics/aircraft/engine/speed> .")
    query = (
        "SELECT ?topic WHERE { "
        f"<{place.at('a')}> <http://ex.org/about> ?topic . ?topic a <https://w3id.org/rosld#Topic> }}"
    )
    headers = {"Content-Type": "application/sparql-query", "Accept": "application/sparql-results+json"}
    answer = once_started(lambda: served.http.post(f"{served.url}sparql", content=query, headers=headers))
    rows = answer.json()["results"]["bindings"]
    assert [row["topic"]["value"] for row in rows] == [f"{served.url}topics/aircraft/engine/speed"]


# What could be made (RFC 9110 10.2.1; Comunica and rdflib.js look there before they create)


@pytest.mark.parametrize("method", ["GET", "HEAD", "DELETE", "OPTIONS"])
@pytest.mark.parametrize("name", ["nothing", "gone", "box/"])
def test_http_what_is_not_there_says_what_could_be_made(method: str, name: str, place: Place) -> None:
    place.put("gone", ONE)
    assert place.send("DELETE", "gone").status_code == 204
    answer = place.send(method, name)
    assert answer.status_code == (204 if method == "OPTIONS" else 410 if name == "gone" else 404)
    assert {"PUT", "PATCH"} <= set(answer.headers["allow"].split(", "))
    assert TURTLE in answer.headers["accept-put"]
    assert "application/sparql-update" in answer.headers["accept-patch"]
    assert "text/n3" in answer.headers["accept-patch"]


def test_http_what_nobody_can_make_says_nothing_of_it(served: Served) -> None:
    for path in ("topics/nothing", "nothing", "data/nothing.meta"):
        assert "accept-patch" not in served.at(path).get().headers


@pytest.mark.parametrize(
    ("sent", "url"), [("%61", "a"), ("%7Etilde", "~tilde"), ("a;b", "a%3Bb"), ("a%2Fb", "a%2Fb"), ("%c3%bc", "%C3%BC")]
)
def test_http_a_name_has_one_url_however_it_is_encoded(sent: str, url: str, place: Place) -> None:
    answer = place.send("PUT", sent, ONE, TURTLE)
    assert (answer.status_code, answer.headers["location"]) == (201, place.at(url))
    read = place.get(sent)
    assert (read.status_code, read.headers.get("location")) == ((200, None) if sent == url else (308, place.at(url)))
    assert place.contained() == {place.at(url)}
    assert place.send("PUT", "%FF", ONE, TURTLE).status_code == 400
