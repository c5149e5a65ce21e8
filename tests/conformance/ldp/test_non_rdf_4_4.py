"""LDP 4.4: non-RDF sources."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import dcterms, ldp, rdf
from tests.conformance.ldp.conftest import links, models

if TYPE_CHECKING:
    from tests.conformance.ldp.conftest import Place, Served

BYTES = bytes(range(256)) * 40
P = NamedNode("http://ex.org/p")


def test_4_4_1_1_bytes_and_media_type_come_back_as_they_were(place: Place) -> None:
    for media_type in ("image/png", "text/plain; charset=iso-8859-1", "application/json", "text/html"):
        assert place.send("PUT", "a", BYTES, media_type).status_code == 201
        answer = place.get("a")
        assert (answer.content, answer.headers["content-type"]) == (BYTES, media_type)
        for method in ("GET", "HEAD", "OPTIONS"):
            assert models(place.send(method, "a")) == {"Resource", "NonRDFSource"}
        assert place.send("DELETE", "a").status_code == 204


def test_4_4_1_1_an_rdf_file_may_be_kept_as_bytes(place: Place) -> None:
    body = "# a comment\n<> <http://ex.org/p>   1 ."
    assert place.send("PUT", "a.ttl", body, "text/turtle", model="NonRDFSource").status_code == 201
    assert place.get("a.ttl", Accept="text/turtle").text == body


def test_4_4_1_2_the_files_of_pages_tell_it_too(served: Served) -> None:
    for path in ("style.css", "icon.svg", "live.js"):
        assert models(served.at(path).send("OPTIONS")) == {"Resource", "NonRDFSource"}


def test_4_4_1_1_its_description_is_an_rdf_source_of_its_own(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    (target,) = {each.target for each in links(place.get("a")) if each.rel == "describedby"}
    assert target == place.at("a.meta")
    assert {"Resource", "RDFSource"} <= models(place.get(target))
    about = {each.predicate: each.object for each in place.graph(target) if each.subject == NamedNode(place.at("a"))}
    assert about[dcterms.format] == Literal("image/png")
    assert ldp.NonRDFSource in {each.object for each in place.graph(target) if each.predicate == rdf.type}


def test_4_4_1_1_its_description_can_be_changed_but_not_deleted(place: Place) -> None:
    place.send("PUT", "a", BYTES, "image/png")
    file = place.at("a")
    place.put("a.meta", f'<{file}> <http://ex.org/p> "a picture" .')
    update = f"INSERT DATA {{ <{file}> <http://ex.org/p> 'of us' }}"
    assert place.send("PATCH", "a.meta", update, "application/sparql-update").is_success
    said = {each.object for each in place.graph("a.meta") if each.predicate == P}
    assert said == {Literal("a picture"), Literal("of us")}
    assert place.send("DELETE", "a.meta").status_code == 405
    assert place.get("a").content == BYTES
