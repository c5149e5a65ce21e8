"""The ontology over HTTP: each module in every syntax at a URL of its own."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import Any

import httpx
import pytest
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, RdfFormat, Triple, parse

from rosld.ontology.modules import MODULES, OWN, VERSION, home_of_terms, module_url, served_triples
from rosld.ontology.vocab import rdfs

pytestmark = pytest.mark.slow

SYNTAXES = {
    "text/turtle": RdfFormat.TURTLE,
    "application/n-triples": RdfFormat.N_TRIPLES,
    "application/ld+json": RdfFormat.JSON_LD,
    "application/rdf+xml": RdfFormat.RDF_XML,
}


def canonical(triples: Any) -> Dataset:
    """Return the triples with blank nodes named by their content, so that equal graphs are equal."""
    dataset = Dataset(Quad(each.subject, each.predicate, each.object) for each in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return dataset


def test_every_module_is_served_and_there_are_all_syntaxes(http: httpx.Client) -> None:
    assert len(MODULES) > len(SYNTAXES)
    for name, (media_type, syntax) in zip(MODULES, cycle(SYNTAXES.items())):
        answer = http.get(module_url(name, "/"), headers={"Accept": media_type})
        assert (answer.status_code, answer.headers["content-type"].partition(";")[0]) == (200, media_type)
        served = canonical(served_triples(name))
        assert canonical(parse(answer.content, format=syntax, base_iri=str(answer.url))) == served


def test_every_term_has_an_anchor_on_the_page_of_its_module(http: httpx.Client) -> None:
    for name in OWN:
        page = http.get(module_url(name, "/"), headers={"Accept": "text/html"}).text
        terms = {iri.partition("#")[2] for iri, home in home_of_terms().items() if home == name}
        assert {term for term in terms if page.count(f'id="{term}"') != 1} == set()


def test_a_term_on_a_page_leads_to_where_it_is_defined(http: httpx.Client) -> None:
    call = http.post("/services/aircraft/start", json={}).headers["location"]
    page = http.get(call, headers={"Accept": "text/html"}).text
    assert 'href="/ontology/interaction#Call"' in page


def test_the_core_has_one_url_and_a_404_names_the_modules_that_there_are(http: httpx.Client) -> None:
    for path in ("/ontology/none", f"/ontology/{VERSION}", "/ontology/mapping/none"):
        answer = http.get(path)
        assert answer.status_code == 404
        assert "align-prov" in answer.json()["detail"]
    for path in ("/ontology/core", "/ontology/"):
        answer = http.get(path)
        assert (answer.status_code, answer.headers["location"]) == (308, f"{http.base_url}ontology")


def test_every_module_is_a_graph_of_the_dataset(http: httpx.Client, triples_of: Callable[..., set[Triple]]) -> None:
    query = "SELECT ?g WHERE { GRAPH ?g { ?o a owl:Ontology } }"
    rows = http.get("/sparql", params={"query": query}, headers={"Accept": "text/csv"}).text.split()[1:]
    assert set(rows) == {module_url(name, str(http.base_url)) for name in MODULES}
    graph = triples_of(
        http.get("/graphs", params={"graph": f"{http.base_url}ontology"}, headers={"Accept": "text/turtle"})
    )
    assert Triple(NamedNode("https://w3id.org/rosld"), rdfs.seeAlso, NamedNode("https://w3id.org/rosld/types")) in graph
