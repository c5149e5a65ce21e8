"""Search described: the template of its URLs, and results in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pyoxigraph import NamedNode, Triple

from rosld.ontology.describe_members import MemberOutline, member_triples
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, boolean, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, hydra, rdf, rdfs, ros, schema_org


@dataclass(frozen=True, slots=True)
class SearchResult:
    """A resource that was found: `kind` says in a word what it is, `match` by what it was found.

    `field` is the path of the field that has a word of the query. `resource` is the URL below `/resources/` that stands
    for the same.
    """

    member: MemberOutline
    kind: str
    match: str
    field: str | None = None
    resource: str | None = None


def search_template(space: Space) -> str:
    """The template of the URLs at which something is searched for (RFC 6570)."""
    return f"{space.base}find{{?q}}"


def search_triples(subject: NamedNode, space: Space) -> list[Triple]:
    """What `subject` says of how the server is searched: a hydra:IriTemplate."""
    search, variable = NamedNode(f"{space.base}find#search"), NamedNode(f"{space.base}find#q")
    return [
        *triples_about(subject, (hydra.search, search)),
        *triples_about(
            search,
            (rdf.type, hydra.IriTemplate),
            (hydra.template, text(search_template(space))),
            (hydra.variableRepresentation, hydra.BasicRepresentation),
            (hydra.mapping, variable),
        ),
        *triples_about(
            variable,
            (rdf.type, hydra.IriTemplateMapping),
            (hydra.variable, text("q")),
            (hydra.property, hydra.freetextQuery),
            (hydra.required, boolean(True)),
        ),
    ]


def search_document(url: str, query: str, total: int, results: Sequence[SearchResult], space: Space) -> Document:
    """What was found, the best first: a schema:ItemList whose elements have positions. `total` are all that fit."""
    items = [NamedNode(f"{url}#{number}") for number in range(1, len(results) + 1)]
    triples = triples_about(
        NamedNode(url),
        (rdf.type, schema_org.ItemList),
        *RDF_SOURCE,
        (dcterms.title, text(f"Search: {query}")),
        (schema_org.numberOfItems, integer(total)),
        *statements(schema_org.itemListElement, items),
    )
    for position, (item, result) in enumerate(zip(items, results, strict=True), 1):
        triples += triples_about(
            item,
            (rdf.type, schema_org.ListItem),
            (schema_org.position, integer(position)),
            (schema_org.item, NamedNode(result.member.url)),
            (ros.matchedBy, text(result.match)),
            (ros.fieldPath, text(result.field)),
        )
        triples += member_triples(result.member, space)
        if result.resource is not None:
            triples += triples_about(NamedNode(result.member.url), (rdfs.seeAlso, NamedNode(result.resource)))
    return Document(url, tuple(triples))


def unasked_document(url: str, space: Space) -> Document:
    """The search itself, while nothing is searched for."""
    subject = NamedNode(url)
    triples = [*triples_about(subject, *RDF_SOURCE, (dcterms.title, text("Search"))), *search_triples(subject, space)]
    return Document(url, tuple(triples))
