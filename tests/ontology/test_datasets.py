"""Descriptions of datasets: terms of VoID and DCAT, and structured data in pages."""

from __future__ import annotations

import pytest
import rdflib
from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.describe_datasets import structured_data, void_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.ontology.vocab import Namespace, dcat, dcterms, rdf, ros, void
from rosld.server.html.render import structured_data_script

URL = "http://127.0.0.1/"


@pytest.mark.parametrize(("ours", "published"), [(void, rdflib.VOID), (dcat, rdflib.DCAT)])
def test_terms_are_those_that_w3c_published(ours: Namespace, published: object) -> None:
    assert ours.terms
    for term in ours.terms.values():
        assert rdflib.URIRef(term.value) in published, term  # type: ignore[operator]


def test_the_catalogue_has_the_recordings_and_the_dataset_its_endpoint() -> None:
    triples = void_document(f"{URL}.well-known/void", Space(URL), "rover", [f"{URL}bags/x/"]).triples
    found = {(each.predicate, each.object) for each in triples}
    assert (dcat.dataset, NamedNode(f"{URL}bags/x/")) in found
    assert (void.sparqlEndpoint, NamedNode(f"{URL}sparql")) in found
    assert (void.exampleResource, NamedNode(f"{URL}topics/")) in found


def test_a_page_has_structured_data_of_a_graph_and_no_string_ends_its_script() -> None:
    title = Triple(NamedNode(URL), dcterms.title, Literal("</script><!--"))
    assert structured_data(Document(URL, (title,))) is None
    document = Document(URL, (title, Triple(NamedNode(URL), rdf.type, ros.Graph)))
    assert structured_data(document) == {**(structured_data(document) or {}), "@type": "DataCatalog", "url": URL}
    assert "<" not in str(structured_data_script(document))
