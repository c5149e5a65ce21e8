"""Bodies in their declared charset (RFC 9110 8.3.2); Java's clients declare ISO-8859-1 for everything."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING
from urllib.parse import quote

from pyoxigraph import Literal, NamedNode

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

P = NamedNode("http://ex.org/p")
TURTLE = "text/turtle"
SAID = '<> <http://ex.org/p> "Zoë" .'
LATIN = "; charset=ISO-8859-1"
RESULTS = "application/sparql-results+json"
RDF_XML = (
    '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:e="http://ex.org/">'
    '<rdf:Description rdf:about=""><e:p>Zoë</e:p></rdf:Description></rdf:RDF>'
)
JSON_LD = json.dumps({"@id": "", "http://ex.org/p": "Zoë"}, ensure_ascii=False)


def test_charset_rdf_is_read_in_the_stated_one(place: Place) -> None:
    charsets = {"ISO-8859-1": "latin-1", "windows-1252": "cp1252", '"utf-8"': "utf-8", "UTF-16LE": "utf-16-le"}
    bodies = [(TURTLE, SAID, *each) for each in (*charsets.items(), ("UTF-16", "utf-16"), ("UTF-16", "utf-16-be"))]
    for media_type, text in (("application/ld+json", JSON_LD), ("application/rdf+xml", RDF_XML)):
        bodies += [(media_type, text, "iso-8859-1", "latin-1"), (media_type, text, "UTF-16", "utf-16")]
    wrong = []
    for number, (media_type, text, charset, codec) in enumerate(bodies):
        stated = f"{media_type}; charset={charset}"
        for method, name in (("PUT", f"a{number}"), ("POST", "")):
            answer = place.send(method, name, text.encode(codec), stated)
            url = answer.headers.get("location", place.at(name))
            if not answer.is_success or place.objects(url, P) != {Literal("Zoë")}:
                wrong.append((method, stated, codec, answer.text))
    assert not wrong, wrong


def test_charset_xml_is_read_in_the_declared_one_unless_the_header_states_another(place: Place) -> None:
    def declared(charset: str) -> str:
        return f'<?xml version="1.0" encoding="{charset}"?>\n{RDF_XML}'

    for number, (data, stated) in enumerate(
        (
            (declared("ISO-8859-1").encode("latin-1"), ""),
            (declared("windows-1252").encode("cp1252"), ""),
            (declared("UTF-16").encode("utf-16"), ""),
            (declared("UTF-8").encode("utf-8-sig"), ""),
            (RDF_XML.encode("utf-16"), ""),
            (f'<?xml version="1.0"?>{RDF_XML}'.encode("utf-16-be"), ""),
            (declared("ISO-8859-1").encode(), "; charset=utf-8"),
        )
    ):
        answer = place.send("PUT", f"a{number}", data, f"application/rdf+xml{stated}")
        assert answer.status_code == 201, (number, answer.text)
        assert place.objects(f"a{number}", P) == {Literal("Zoë")}
    for charset, status in (("klingon", 415), ("US-ASCII", 400)):
        assert place.send("PUT", "b", declared(charset).encode(), "application/rdf+xml").status_code == status


def test_charset_bytes_that_are_not_of_it_are_400_and_an_unknown_one_is_415(place: Place, served: Served) -> None:
    for charset, data in (("us-ascii", SAID.encode()), ("utf-16", b"\xd8\x00\xd8\x00")):
        answer = place.send("PUT", "a", data, f"{TURTLE}; charset={charset}")
        assert answer.status_code == 400
        assert charset in answer.json()["detail"]
    for method, name in (("PUT", "a"), ("POST", "")):
        answer = place.send(method, name, SAID, f"{TURTLE}; charset=klingon")
        assert answer.status_code == 415
        assert "ISO-8859-1" in answer.json()["detail"]
    seats = served.at("parameters/aircraft/seats")
    assert seats.send("PUT", "", "7", "application/json; charset=klingon").status_code == 415


def test_charset_json_of_the_robot_is_read_in_the_stated_one(served: Served) -> None:
    robot = served.at("parameters/aircraft/charset_test")
    assert robot.send("PUT", "", '"Zoë"'.encode("latin-1"), f"application/json{LATIN}").status_code == 201
    assert robot.get(Accept="application/json").json() == "Zoë"


def test_charset_patches_are_read_in_the_stated_one_and_a_file_stays_in_its_own(place: Place) -> None:
    place.put("a", "<> <http://ex.org/p> 1 .")
    update = 'DELETE { <> <http://ex.org/p> 1 } INSERT { <> <http://ex.org/p> "Zoë" } WHERE {}'
    assert place.send("PATCH", "a", update.encode("latin-1"), f"application/sparql-update{LATIN}").status_code == 204
    assert place.objects("a", P) == {Literal("Zoë")}
    for charset in ("ISO-8859-1", "UTF-16"):
        stated = f"application/json; charset={charset}"
        place.send("PUT", "file", '{"a": "Zoë"}'.encode(charset), stated)
        patch = '{"b": "ë"}'.encode("latin-1")
        assert place.send("PATCH", "file", patch, f"application/merge-patch+json{LATIN}").status_code == 204
        answer = place.get("file")
        assert answer.headers["content-type"] == stated
        assert json.loads(answer.content.decode(charset)) == {"a": "Zoë", "b": "ë"}
    assert place.send("PUT", "strange", b"\xff", "text/plain; charset=klingon").status_code == 201


def test_charset_queries_and_updates_are_read_in_the_stated_one(place: Place, served: Served) -> None:
    graph, sparql = place.at("g"), served.at("sparql")
    update = f'INSERT DATA {{ GRAPH <{graph}> {{ <{graph}> <http://ex.org/p> "Zoë" }} }}'.encode("latin-1")
    assert sparql.send("POST", "", update, f"application/sparql-update{LATIN}").is_success
    query = f'ASK {{ GRAPH <{graph}> {{ ?s ?p "Zoë" }} }}'
    form = f"query={quote(query, encoding='latin-1')}"
    for body, media_type in ((query, "application/sparql-query"), (form, "application/x-www-form-urlencoded")):
        answer = sparql.send("POST", "", body.encode("latin-1"), media_type + LATIN, Accept=RESULTS)
        assert answer.json()["boolean"] is True
    queries = served.at("queries/")
    text = f"# Letters.\n{query}".encode("latin-1")
    url = queries.send("POST", "", text, f"application/sparql-query{LATIN}", Slug="letters").headers["location"]
    assert queries.get(url, Accept=RESULTS).json()["boolean"] is True
    assert queries.send("DELETE", url).status_code == 204


def test_charset_each_part_of_a_form_is_read_in_its_own(place: Place, served: Served) -> None:
    part = f"Content-Type: {TURTLE}{LATIN}\r\n\r\n".encode() + SAID.encode("latin-1")
    body = b'--xx\r\nContent-Disposition: form-data; name="a"\r\n' + part + b"\r\n--xx--\r\n"
    graphs, graph = served.at("graphs"), f"?graph={place.at('g')}"
    for more, status in (("", 201), (LATIN, 204)):
        assert graphs.send("POST", graph, body, f"multipart/form-data; boundary=xx{more}").status_code == status
    assert place.objects("g", P) == {Literal("Zoë")}
