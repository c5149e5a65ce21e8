"""Documents of search results and of members."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import TypeRef
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, boolean, double, integer, statements, text, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, hydra, rdf, rdfs, ros, schema_org

_TYPE_RELATIONS: Mapping[NamedNode, NamedNode] = {
    ros.Topic: ros.hasMessageType,
    ros.Service: ros.hasServiceType,
    ros.Action: ros.hasActionType,
}


class MemberOutline(Struct, frozen=True):
    """A resource in a list: its URL, its class (or None), its name, and known values.

    `types` are its ROS types; two or more contradict each other. `rate` is in messages a second, `value`
    brief plain JSON; both are None if unknown.
    """

    url: str
    kind: NamedNode | None
    name: str | None
    types: tuple[TypeRef | str, ...] = ()
    rate: float | None = None
    value: str | None = None


def member_triples(member: MemberOutline, space: Space) -> list[Triple]:
    """Return the triples of a member of a list."""
    relation = None if member.kind is None else _TYPE_RELATIONS.get(member.kind)
    name = member.name and (member.name.rstrip("/") or "/")  # as a container says it of itself
    return triples_about(
        NamedNode(member.url),
        (rdf.type, member.kind),
        (ros.name, text(name)),
        *(() if relation is None else _types(relation, member.types, space)),
        (ros.rate, None if member.rate is None else double(member.rate)),
        (ros.briefValue, None if member.value is None else Literal(member.value, datatype=rdf.JSON)),
    )


def _types(
    relation: NamedNode, types: tuple[TypeRef | str, ...], space: Space
) -> list[tuple[NamedNode, NamedNode | Literal]]:
    if len(types) == 1:
        (type,) = types
        return [(relation, NamedNode(space.class_of(type if isinstance(type, str) else type.name)))]
    return [(ros.conflictingType, NamedNode(space.type(type))) for type in types]


class SearchResult(Struct, frozen=True):
    """A search result: `kind` is the kind of resource in a word, `match` the part that matched.

    `field` is the path of the matching field. `resource` is the equivalent URL below `/resources/`.
    """

    member: MemberOutline
    kind: str
    match: str
    field: str | None = None
    resource: str | None = None


def search_template(space: Space) -> str:
    """Return the template of the URLs at which something is searched for (RFC 6570)."""
    return f"{space.base}find{{?q}}"


def search_triples(subject: NamedNode, space: Space) -> list[Triple]:
    """Return the hydra:IriTemplate of the search, as a property of `subject`."""
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
    """Return the results, the best first, as a schema:ItemList with positions. `total` is the number of all matches."""
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
    """Return the search itself, while nothing is searched for."""
    subject = NamedNode(url)
    triples = [*triples_about(subject, *RDF_SOURCE, (dcterms.title, text("Search"))), *search_triples(subject, space)]
    return Document(url, tuple(triples))
