"""The server as a dataset (VoID, DCAT), and recordings for readers of schema.org's datasets (Croissant)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pyoxigraph import BlankNode, Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.outline import Statements, Subject, outline
from rosld.ontology.triples import RDF_SOURCE, labelled, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import PREFIXES, dcat, dcterms, foaf, rdf, rdfs, ros, spdx, void

IANA = "https://www.iana.org/assignments/media-types/"
_VOCABULARIES = ("ros", "rdfs", "ldp", "dcterms", "dcat", "sosa", "qudt", "td", "prov", "sh")
_ABOUT = (
    "Nodes, topics, services, actions and parameters of a robot, its types and recordings, and documents of clients."
)


def void_document(url: str, space: Space, name: str, bags: Iterable[str]) -> Document:
    """Return the description of the dataset and the catalogue of a server, whose robot has this `name`.

    `bags` are the URLs of recordings.
    """
    dataset, catalog, publisher = (NamedNode(f"{url}#{part}") for part in ("dataset", "catalog", "publisher"))
    endpoint = NamedNode(f"{space.base}sparql")
    return Document(
        url,
        (
            *triples_about(
                NamedNode(url),
                *RDF_SOURCE,
                (rdf.type, void.DatasetDescription),
                (rdfs.label, Literal("Description of the dataset")),
                (foaf.primaryTopic, dataset),
            ),
            *triples_about(
                dataset,
                (rdf.type, void.Dataset),
                (rdf.type, dcat.Dataset),
                *labelled(dcterms.title, f"{name} as Linked Data"),
                (dcterms.description, Literal(_ABOUT)),
                (dcterms.publisher, publisher),
                (void.uriSpace, Literal(space.base)),
                (void.rootResource, NamedNode(space.base)),
                (void.sparqlEndpoint, endpoint),
                (void.dataDump, NamedNode(f"{space.base}graphs?all")),
                *statements(
                    void.exampleResource, (NamedNode(space.container(route)) for route in ("topics", "resources"))
                ),
                *statements(void.vocabulary, (NamedNode(PREFIXES[prefix]) for prefix in _VOCABULARIES)),
            ),
            *triples_about(
                catalog,
                (rdf.type, dcat.Catalog),
                *labelled(dcterms.title, f"Catalogue of {name}"),
                (dcterms.description, text(f"The recordings of {name}, and its description as Linked Data.")),
                (dcterms.publisher, publisher),
                (dcat.service, endpoint),
                *statements(dcat.dataset, (dataset, *map(NamedNode, bags))),
            ),
            *triples_about(publisher, (rdf.type, foaf.Agent), (foaf.name, text(name)), (rdfs.label, text(name))),
            *triples_about(
                endpoint,
                (rdf.type, dcat.DataService),
                *labelled(dcterms.title, "SPARQL endpoint"),
                (dcat.endpointURL, endpoint),
                (dcat.servesDataset, dataset),
            ),
        ),
    )


CROISSANT = "http://mlcommons.org/croissant/1.0"
"""The profile of JSON-LD that data loaders for machine learning read."""
_TERMS = (
    "citeAs column equivalentProperty extract field fileProperty fileObject fileSet format includes isLiveDataset "
    "jsonPath key md5 parentField path recordSet references regex repeated replace samplingRate separator source "
    "subField transform"
)
_CONTEXT: Mapping[str, object] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": dcterms.iri,
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    **{term: f"cr:{term}" for term in _TERMS.split()},
}
_COLUMNS = {"name": "sc:Text", "type": "sc:URL", "count": "sc:Integer"}


def structured_data(document: Document) -> Mapping[str, object] | None:
    """Return what a document says to readers of schema.org: the dataset of a recording (Croissant 1.0), or a catalogue.

    None for documents about anything else.
    """
    node = NamedNode(document.url)
    types = {each.object for each in document.triples if each.subject == node and each.predicate == rdf.type}
    if types.isdisjoint((ros.Graph, dcat.Dataset)):
        return None
    subjects = outline(document.triples).subjects
    own = subjects[node]
    common = {"@id": document.url, "url": document.url, "name": _text(own, dcterms.title)}
    if ros.Graph in types:
        return {"@context": "https://schema.org/", "@type": "DataCatalog", **common, "description": _ABOUT}
    (period,) = _linked(own, dcterms.temporal, subjects) or ({},)
    (checksum,) = _linked(own, spdx.checksum, subjects) or ({},)
    files = [
        {
            "@type": "cr:FileObject",
            "@id": "file",
            "name": _text(file, dcterms.title),
            "contentUrl": _text(file, dcat.downloadURL),
            "contentSize": f"{_text(file, dcat.byteSize)} B",
            "encodingFormat": (_text(file, dcat.mediaType) or "").removeprefix(IANA),
            "sha256": _text(checksum, spdx.checksumValue),
        }
        for file in _linked(own, dcat.distribution, subjects)
    ]
    found = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        **common,
        "conformsTo": CROISSANT,
        "description": _text(own, dcterms.description),
        "datePublished": _text(own, dcterms.issued),
        "temporalCoverage": period and f"{_text(period, dcat.startDate)}/{_text(period, dcat.endDate)}",
        "keywords": [term.value for term in own.get(dcat.keyword, ()) if isinstance(term, Literal)],
        "distribution": [{key: value for key, value in file.items() if value} for file in files],
        "recordSet": [_topics(_linked(own, ros.hasRecordedTopic, subjects))],
    }
    return {key: value for key, value in found.items() if value}


def _topics(topics: Iterable[Statements]) -> Mapping[str, object]:
    """Return the topics of a recording as a set of records: names, classes of messages, numbers of messages."""
    fields = [
        {"@type": "cr:Field", "@id": f"topics/{name}", "name": name, "description": f"The {name}.", "dataType": kind}
        for name, kind in _COLUMNS.items()
    ]
    data = [
        {
            "topics/name": _text(topic, ros.name),
            "topics/type": _text(topic, ros.hasMessageType),
            "topics/count": int(_text(topic, ros.count) or 0),
        }
        for topic in topics
    ]
    about = "Topics with the classes and the numbers of their messages."
    named = {"@type": "cr:RecordSet", "@id": "topics", "name": "topics"}
    return {**named, "description": about, "field": fields, "data": data}


def _linked(own: Statements, predicate: NamedNode, subjects: Mapping[Subject, Statements]) -> list[Statements]:
    """Return the statements about the objects of a predicate."""
    nodes = (node for node in own.get(predicate, ()) if isinstance(node, NamedNode | BlankNode))
    return [subjects[node] for node in nodes if node in subjects]


def _text(own: Statements, predicate: NamedNode) -> str | None:
    return next((term.value for term in own.get(predicate, ()) if isinstance(term, Literal | NamedNode)), None)
