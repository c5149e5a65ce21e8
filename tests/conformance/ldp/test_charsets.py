"""Bodies in the charset they state (RFC 9110 8.3.2), as Java's clients state ISO-8859-1 with everything."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING
from urllib.parse import quote

import pytest
from pyoxigraph import Literal, NamedNode

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
TURTLE = "text/turtle"
SAID = '<> <http://ex.org/p> "Zoë" .'
CHARSETS = [
    ("ISO-8859-1", "latin-1"),
    ("iso-8859-1", "latin-1"),
    ("windows-1252", "cp1252"),
    ("UTF-8", "utf-8"),
    ('"utf-8"', "utf-8"),
    ("UTF-16", "utf-16"),
    ("UTF-16", "utf-16-be"),
    ("UTF-16LE", "utf-16-le"),
]
RDF_XML = (
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:e="http://ex.org/">'
    '<rdf:Description rdf:about=""><e:p>Zoë</e:p></rdf:Description></rdf:RDF>'
)
JSON_LD = json.dumps({"@id": "", "http://ex.org/p": "Zoë"}, ensure_ascii=False)


@pytest.mark.parametrize(("charset", "codec"), CHARSETS)
def test_charset_rdf_is_read_in_what_it_states(charset: str, codec: str, place: Place) -> None:
    stated = f"{TURTLE}; charset={charset}"
    assert place.send("PUT", "a", SAID.encode(codec), stated).status_code == 201
    assert place.objects("a", P) == {Literal("Zoë")}
    assert place.send("PUT", "a", "<> <http://ex.org/p> 1 .".encode(codec), stated).status_code == 204
    answer = place.send("POST", "", SAID.encode(codec), stated)
    assert place.objects(answer.headers["location"], P) == {Literal("Zoë")}


@pytest.mark.parametrize(("media_type", "text"), [("application/ld+json", JSON_LD), ("application/rdf+xml", RDF_XML)])
@pytest.mark.parametrize(("charset", "codec"), CHARSETS[:2] + CHARSETS[5:6])
def test_charset_every_syntax_of_rdf_is(media_type: str, text: str, charset: str, codec: str, place: Place) -> None:
    assert place.send("PUT", "a", text.encode(codec), f"{media_type}; charset={charset}").status_code == 201
    assert place.objects("a", P) == {Literal("Zoë")}


def test_charset_ascii_is_read(place: Place) -> None:
    assert place.send("PUT", "a", b'<> <http://ex.org/p> "Zo" .', f"{TURTLE}; charset=US-ASCII").status_code == 201
    assert place.objects("a", P) == {Literal("Zo")}


@pytest.mark.parametrize(("charset", "data"), [("US-ASCII", SAID.encode()), ("utf-16", b"\xd8\x00\xd8\x00")])
def test_charset_bytes_that_are_none_of_it_are_400(charset: str, data: bytes, place: Place) -> None:
    answer = place.send("PUT", "a", data, f"{TURTLE}; charset={charset}")
    assert answer.status_code == 400
    assert charset.lower() in answer.json()["detail"]


def test_charset_that_nobody_knows_is_415(place: Place, served: Served) -> None:
    for method, name in (("PUT", "a"), ("POST", "")):
        answer = place.send(method, name, SAID, f"{TURTLE}; charset=klingon")
        assert answer.status_code == 415
        assert "ISO-8859-1" in answer.json()["detail"]
    seats = served.at("parameters/aircraft/seats")
    assert seats.send("PUT", "", "7", "application/json; charset=klingon").status_code == 415


def test_charset_patches_are_read_in_what_they_state(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    update = 'DELETE { <> <http://ex.org/p> 1 } INSERT { <> <http://ex.org/p> "Zoë" } WHERE {}'
    answer = place.send("PATCH", "a", update.encode("latin-1"), "application/sparql-update; charset=ISO-8859-1")
    assert answer.status_code == 204, answer.text
    assert place.objects("a", P) == {Literal("Zoë")}


def test_charset_json_of_the_robot_is_read_in_what_it_states(served: Served) -> None:
    robot = served.at("parameters/aircraft/charset_test")
    stated = "application/json; charset=ISO-8859-1"
    assert robot.send("PUT", "", '"Zoë"'.encode("latin-1"), stated).status_code == 201
    assert robot.get(Accept="application/json").json() == "Zoë"


def test_charset_of_a_file_is_kept_with_its_bytes(place: Place) -> None:
    stated, data = "text/plain; charset=ISO-8859-1", "Zoë".encode("latin-1")
    assert place.send("PUT", "file", data, stated).status_code == 201
    answer = place.get("file")
    assert (answer.headers["content-type"], answer.content) == (stated, data)
    assert place.send("PUT", "strange", data, "text/plain; charset=klingon").status_code == 201


@pytest.mark.parametrize(("charset", "codec"), [("ISO-8859-1", "latin-1"), ("UTF-16", "utf-16")])
def test_charset_a_json_file_is_patched_in_its_own(charset: str, codec: str, place: Place) -> None:
    stated = f"application/json; charset={charset}"
    place.send("PUT", "file", '{"a": "Zoë"}'.encode(codec), stated)
    patch = '{"b": "ë"}'.encode("latin-1")
    answer = place.send("PATCH", "file", patch, "application/merge-patch+json; charset=ISO-8859-1")
    assert answer.status_code == 204, answer.text
    answer = place.get("file")
    assert answer.headers["content-type"] == stated
    assert json.loads(answer.content.decode(codec)) == {"a": "Zoë", "b": "ë"}


@pytest.mark.parametrize(("charset", "codec"), [("ISO-8859-1", "latin-1"), ("UTF-8", "utf-8")])
def test_charset_forms_are_read_in_what_they_state(charset: str, codec: str, served: Served) -> None:
    form = "query=" + quote('SELECT (STRLEN("Zoë") AS ?n) {}', encoding=codec)
    answer = served.at("sparql").send(
        "POST", "", form, f"application/x-www-form-urlencoded; charset={charset}", Accept="text/csv"
    )
    assert (answer.status_code, answer.text.split()) == (200, ["n", "3"])


def test_charset_queries_and_updates_are_read_in_what_they_state(place: Place, served: Served) -> None:
    graph = place.at("g")
    update = f'INSERT DATA {{ GRAPH <{graph}> {{ <{graph}> <http://ex.org/p> "Zoë" }} }}'.encode("latin-1")
    answer = served.at("sparql").send("POST", "", update, "application/sparql-update; charset=ISO-8859-1")
    assert answer.status_code in (200, 204), answer.text
    assert place.objects("g", P) == {Literal("Zoë")}
    query = f'ASK {{ GRAPH <{graph}> {{ ?s ?p "Zoë" }} }}'.encode("latin-1")
    answer = served.at("sparql").send(
        "POST", "", query, "application/sparql-query; charset=ISO-8859-1", Accept="application/sparql-results+json"
    )
    assert answer.json()["boolean"] is True


@pytest.mark.parametrize("charset", ["", "; charset=ISO-8859-1"])
def test_charset_a_body_of_parts_is_taken_the_first_time_and_the_second(
    charset: str, place: Place, served: Served
) -> None:
    part = f"Content-Type: {TURTLE}; charset=ISO-8859-1\r\n\r\n".encode() + SAID.encode("latin-1")
    body = b'--xx\r\nContent-Disposition: form-data; name="a"\r\n' + part + b"\r\n--xx--\r\n"
    for status in (201, 204):
        answer = served.http.post(
            f"{served.url}graphs?graph={place.at('g')}",
            content=body,
            headers={"Content-Type": f"multipart/form-data; boundary=xx{charset}"},
        )
        assert answer.status_code == status, answer.text
    assert place.objects("g", P) == {Literal("Zoë")}


@pytest.mark.parametrize(
    ("declared", "codec"),
    [("ISO-8859-1", "latin-1"), ("windows-1252", "cp1252"), ("UTF-16", "utf-16"), ("UTF-8", "utf-8-sig")],
)
def test_charset_xml_is_read_in_what_it_declares(declared: str, codec: str, place: Place) -> None:
    text = f'<?xml version="1.0" encoding="{declared}"?>\n{RDF_XML}'
    answer = place.send("PUT", "a", text.encode(codec), "application/rdf+xml")
    assert answer.status_code == 201, answer.text
    assert place.objects("a", P) == {Literal("Zoë")}


def test_charset_xml_in_utf_16_needs_no_declaration(place: Place) -> None:
    for number, data in enumerate((RDF_XML.encode("utf-16"), f'<?xml version="1.0"?>{RDF_XML}'.encode("utf-16-be"))):
        assert place.send("PUT", f"a{number}", data, "application/rdf+xml").status_code == 201
        assert place.objects(f"a{number}", P) == {Literal("Zoë")}


def test_charset_what_the_header_states_comes_before_what_xml_declares(place: Place) -> None:
    text = f'<?xml version="1.0" encoding="ISO-8859-1"?>{RDF_XML}'
    assert place.send("PUT", "a", text.encode(), "application/rdf+xml; charset=utf-8").status_code == 201
    assert place.objects("a", P) == {Literal("Zoë")}


def test_charset_that_xml_declares_and_nobody_knows_is_415(place: Place) -> None:
    text = f'<?xml version="1.0" encoding="klingon"?>{RDF_XML}'
    assert place.send("PUT", "a", text.encode(), "application/rdf+xml").status_code == 415
    text = f'<?xml version="1.0" encoding="US-ASCII"?>{RDF_XML}'
    assert place.send("PUT", "a", text.encode(), "application/rdf+xml").status_code == 400


def test_charset_a_stored_query_is_read_in_its_own(served: Served) -> None:
    queries = served.at("queries/")
    stated, data = "application/sparql-query; charset=ISO-8859-1", 'ASK { FILTER(STRLEN("Zoë") = 3) }'.encode("latin-1")
    answer = queries.send("POST", "", b"# Three letters.\n" + data, stated, Slug="three")
    assert answer.status_code == 201, answer.text
    url = answer.headers["location"]
    assert queries.get(url, Accept="application/sparql-results+json").json()["boolean"] is True
    assert queries.send("DELETE", url).status_code == 204
