"""Documents of views: search results, series, plots, frames, diagnostics, and time maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from msgspec import Struct
from pyoxigraph import Literal, NamedNode, Triple

from rosld.adapters.model import TypeRef
from rosld.ontology import kinds
from rosld.ontology.document import Document
from rosld.ontology.geometry import frame_iri
from rosld.ontology.node_shape import SOURCE, NodeShape, many, one, optional
from rosld.ontology.triples import (
    RDF_SOURCE,
    Statement,
    date_time_literal,
    double,
    labelled,
    statements,
    text,
    triples_about,
)
from rosld.ontology.units import UNKNOWN, Quantity
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, hydra, memento, qudt, rdf, rdfs, ros, schema_org, xhv, xsd

_TYPE_RELATIONS: Mapping[NamedNode, NamedNode] = {
    ros.Topic: ros.hasMessageType,
    ros.Service: ros.hasServiceType,
    ros.Action: ros.hasActionType,
}


class MemberOutline(Struct, frozen=True):
    """A resource in a list: its URL, its class (or None), its name, and known values.

    `types` are its ROS types; two or more contradict each other. `rate` is in messages per second, `value` brief plain
    JSON; both are None if unknown. `label` is None if it is the name.
    """

    url: str
    kind: NamedNode | None
    name: str | None
    types: tuple[TypeRef | str, ...] = ()
    rate: float | None = None
    value: str | None = None
    label: str | None = None


def member_triples(member: MemberOutline, space: Space) -> list[Triple]:
    """Return the triples of a member of a list."""
    relation = None if member.kind is None else _TYPE_RELATIONS.get(member.kind)
    name = member.name and (member.name.rstrip("/") or "/")  # as in its container
    return triples_about(
        NamedNode(member.url),
        (rdf.type, member.kind),
        (ros.name, text(name)),
        (rdfs.label, text(member.label or name)),
        *(() if relation is None else _types(relation, member.types, space)),
        (ros.rate, None if member.rate is None else double(member.rate)),
        (ros.briefValue, None if member.value is None else Literal(member.value, datatype=rdf.JSON)),
    )


def _types(relation: NamedNode, types: tuple[TypeRef | str, ...], space: Space) -> list[Statement]:
    if len(types) == 1:
        (type,) = types
        return [(relation, NamedNode(space.class_of(type if isinstance(type, str) else type.name)))]
    return [(ros.conflictingType, NamedNode(space.type(type))) for type in types]


class SearchResult(Struct, frozen=True):
    """A search result: `kind` is the kind of resource in a word, `match` the part that matched.

    `field` is the path of the matching field. `resource` is the equivalent URL below `/resources/`, `offer` that of
    what can be sent to it, or None.
    """

    member: MemberOutline
    kind: str
    match: str
    field: str | None = None
    resource: str | None = None
    offer: str | None = None


class SearchOutline(NamedTuple):
    """The results of a search: the number of matches, whether they match all words, and the best ones.

    `about` has the URLs of what the robot has instead, by concept.
    """

    total: int
    is_complete: bool
    results: Sequence[SearchResult]
    about: Mapping[str, str]


def search_template(space: Space) -> str:
    """Return the template of the URLs of searches (RFC 6570)."""
    return f"{space.base}find{{?q}}"


_SEARCH = NodeShape[str]("Search", "how the server is searched", hydra.IriTemplate).with_properties(
    one(hydra.template, kinds.TEXT, lambda template: template),
    one(hydra.variableRepresentation, kinds.TERM, lambda template: hydra.BasicRepresentation),
    many(hydra.mapping, kinds.IRI.where("sh:class hydra:IriTemplateMapping"), minimum=1),
)
_VARIABLE = NodeShape[str]("SearchVariable", "a variable of a search", hydra.IriTemplateMapping).with_properties(
    one(hydra.variable, kinds.TEXT, lambda name: name),
    one(hydra.property, kinds.TERM, lambda name: hydra.freetextQuery),
    one(hydra.required, kinds.BOOLEAN, lambda name: True),
)


def search_triples(subject: NamedNode, space: Space) -> list[Triple]:
    """Return the hydra:IriTemplate of the search, as a property of `subject`."""
    search, variable = NamedNode(f"{space.base}find#search"), NamedNode(f"{space.base}find#q")
    return [
        Triple(subject, hydra.search, search),
        *_SEARCH.triples(search, search_template(space), space, (hydra.mapping, variable)),
        *_VARIABLE.triples(variable, "q", space),
    ]


def _words_about(found: SearchOutline) -> str | None:
    return None if found.is_complete or not found.results else "These results match some of the words."


_RESULTS = NodeShape[SearchOutline]("SearchResults", "what was found", schema_org.ItemList, *SOURCE).with_properties(
    one(dcterms.title, kinds.TEXT),
    one(schema_org.numberOfItems, kinds.COUNT, lambda found: found.total),
    optional(schema_org.description, kinds.TEXT, _words_about),
    many(schema_org.about, kinds.IRI),
    many(schema_org.itemListElement, kinds.IRI.where("sh:class schema:ListItem")),
)
_RESULT = NodeShape[tuple[int, SearchResult]](
    "SearchResult", "something that was found", schema_org.ListItem
).with_properties(
    one(schema_org.position, kinds.COUNT, lambda item: item[0]),
    one(schema_org.item, kinds.IRI, lambda item: item[1].member.url),
    one(ros.matchedBy, kinds.TEXT, lambda item: item[1].match),
    optional(ros.fieldPath, kinds.TEXT, lambda item: item[1].field),
)


def search_document(url: str, query: str, found: SearchOutline, space: Space) -> Document:
    """Return the results, the best first, as a schema:ItemList with positions."""
    items = {NamedNode(f"{url}#{number}"): (number, result) for number, result in enumerate(found.results, 1)}
    title, elements = labelled(dcterms.title, f"Search: {query}"), statements(schema_org.itemListElement, items)
    about = {concept: NamedNode(each) for concept, each in found.about.items()}
    instead = statements(schema_org.about, about.values())
    triples = _RESULTS.triples(NamedNode(url), found, space, *title, *elements, *instead)
    triples += [Triple(each, schema_org.keywords, Literal(concept)) for concept, each in about.items()]
    for node, item in items.items():
        triples += _RESULT.triples(node, item, space)
        member, resource = item[1].member, item[1].resource
        triples += member_triples(member, space)
        if resource is not None:
            triples.append(Triple(NamedNode(member.url), rdfs.seeAlso, NamedNode(resource)))
    return Document(url, tuple(triples))


def unasked_document(url: str, space: Space) -> Document:
    """Return the document of the search without a query."""
    subject = NamedNode(url)
    triples = [
        *triples_about(subject, *RDF_SOURCE, *labelled(dcterms.title, "Search")),
        *search_triples(subject, space),
    ]
    return Document(url, tuple(triples))


class PlottedNumber(Struct, frozen=True):
    """A plotted number of a topic: the topic's URL, the path of the field, its ROS type.

    `series` is the URL of its recorded values, or None. `quantity` is what it measures.
    """

    topic: str
    field: str
    type: str = ""
    series: str | None = None
    quantity: Quantity = UNKNOWN


_SERIES = NodeShape[PlottedNumber]("Series", "a number over a time", ros.Series).with_properties(
    one(rdfs.label, kinds.TEXT, lambda number: f"{number.field} of {unquote(urlsplit(number.topic).path)}"),
    one(ros.seriesOf, kinds.IRI.where('sh:pattern "/topics/"'), lambda number: number.topic),
    one(ros.seriesField, kinds.TEXT, lambda number: number.field),
    many(ros.hasPoint, kinds.node("SeriesPoint")),
    optional(rdfs.seeAlso, kinds.IRI, lambda number: number.series),
    optional(qudt.hasUnit, kinds.IRI, lambda number: number.quantity.unit),
    optional(qudt.hasQuantityKind, kinds.IRI, lambda number: number.quantity.kind),
)


class Point(NamedTuple):
    """A point of a series: its time (ns), and the number of one message, or those of an interval that begins then."""

    time_ns: int
    value: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    mean: float | None = None
    messages: int | None = None


_POINT = NodeShape[Point]("SeriesPoint", "a point of a series", ros.SeriesPoint, target="").with_properties(
    one(ros.pointTime, kinds.DATE_TIME, lambda point: point.time_ns),
    optional(ros.pointValue, kinds.DOUBLE, lambda point: point.value),
    optional(ros.minimum, kinds.DOUBLE, lambda point: point.minimum),
    optional(ros.maximum, kinds.DOUBLE, lambda point: point.maximum),
    optional(ros.meanValue, kinds.DOUBLE, lambda point: point.mean),
    optional(ros.count, kinds.COUNT, lambda point: point.messages),
)


def series_document(
    url: str,
    topic: str,
    field: str,
    points: Sequence[tuple[int, float, float, float, int]],
    *,
    is_reduced: bool,
    quantity: Quantity = UNKNOWN,
) -> Document:
    """Return a series of the field of the topic at a URL.

    `points` are time (ns), minimum, maximum, sum and count of numbers; `is_reduced`: each is of an interval that begins
    then, else of one message.
    """
    nodes = [NamedNode(f"{url}#point.{number}") for number in range(len(points))]
    subject, series = NamedNode(url), PlottedNumber(topic, field, quantity=quantity)
    triples = _SERIES.triples(subject, series, None, *RDF_SOURCE, *statements(ros.hasPoint, nodes))
    for node, (time_ns, minimum, maximum, total, count) in zip(nodes, points, strict=True):
        numbers = (None, minimum, maximum, total / count, count) if is_reduced else (minimum,)
        triples += _POINT.triples(node, Point(time_ns, *numbers), None)
    return Document(url, tuple(triples))


_PLOT = NodeShape[Sequence[NamedNode]]("Plot", "numbers drawn together over time", ros.Plot, *SOURCE).with_properties(
    one(rdfs.label, kinds.TEXT, lambda nodes: "Plot"),
    many(ros.plots, kinds.TERM.where("sh:class ros:Series"), lambda nodes: nodes),
)


def plot_document(url: str, numbers: Sequence[PlottedNumber]) -> Document:
    """Return the plot at a URL."""
    nodes = [NamedNode(f"{url}#series.{place}") for place in range(len(numbers))]
    triples = _PLOT.triples(NamedNode(url), nodes, None)
    for node, number in zip(nodes, numbers, strict=True):
        triples += _SERIES.triples(node, number, None)
    return Document(url, tuple(triples))


_FRAME_TYPE = "geometry_msgs/msg/TransformStamped"


class Frame(Struct, frozen=True):
    """A frame: its parent and the time of that transform (None for a root), its nodes' URLs, and its problems."""

    name: str
    parent: str | None
    received_ns: int | None
    publishers: tuple[str, ...]
    problem: str


def frames_document(url: str, frames: Sequence[Frame], types: str) -> Document:
    """Return the frames of a robot; `types` is the namespace of message types."""

    def node(name: str) -> NamedNode:
        return NamedNode(frame_iri(url, name))

    triples = triples_about(
        NamedNode(url),
        *RDF_SOURCE,
        *labelled(dcterms.title, "Frames"),
        *statements(dcterms.hasPart, [node(each.name) for each in frames]),
    )
    for each in frames:
        triples += triples_about(
            node(each.name),
            (rdfs.label, text(each.name)),
            (rdfs.comment, text(each.problem) if each.problem else None),
            (NamedNode(f"{types}{_FRAME_TYPE}#child_frame_id"), None if each.parent is None else text(each.name)),
            (dcterms.isPartOf, None if each.parent is None else node(each.parent)),
            (ros.received, date_time_literal(each.received_ns)),
            *statements(rdfs.seeAlso, map(NamedNode, each.publishers)),
        )
    return Document(url, tuple(triples))


_DIAGNOSTIC_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"


class PartState(Struct, frozen=True):
    """Latest state of a part: the topic's URL, the time since it has this level; `number` is the level as sent."""

    topic: str
    name: str
    hardware: str
    level: str
    number: int
    message: str
    values: Mapping[str, str]
    received_ns: int
    since_ns: int


def diagnostics_document(url: str, states: Sequence[PartState], types: str) -> Document:
    """Return the states of parts; `types` is the namespace of message types."""

    def field(name: str) -> NamedNode:
        return NamedNode(f"{types}{_DIAGNOSTIC_TYPE}#{name}")

    nodes = [NamedNode(f"{url}#part.{place}") for place in range(len(states))]
    subject = NamedNode(url)
    triples = triples_about(
        subject, *RDF_SOURCE, *labelled(dcterms.title, "Diagnostics"), *statements(dcterms.hasPart, nodes)
    )
    for node, state in zip(nodes, states, strict=True):
        triples += triples_about(
            node,
            (rdfs.label, text(f"{state.name}: {state.level}")),
            (field("name"), text(state.name)),
            (field("level"), Literal(str(state.number), datatype=xsd.byte)),
            (field("message"), text(state.message)),
            (field("hardware_id"), text(state.hardware)),
            (rdfs.seeAlso, NamedNode(state.topic)),
            (ros.received, date_time_literal(state.received_ns)),
        )
    return Document(url, tuple(triples))


_TIME_MAP = NodeShape[str]("TimeMap", "the mementos of a resource", memento.TimeMap, *SOURCE).with_properties(
    one(rdfs.label, kinds.TEXT, lambda original: f"Mementos of {original}"),
    one(memento.original, kinds.IRI, lambda original: original),
    one(memento.timegate, kinds.IRI, lambda original: original),
    many(memento.memento, kinds.node("Memento")),
    optional(xhv.next, kinds.IRI),
)
_MEMENTO = NodeShape[int]("Memento", "a memento in a list of them", memento.Memento, target="").with_properties(
    one(memento.mementoDatetime, kinds.DATE_TIME, lambda time_ns: time_ns)
)


def time_map_document(
    url: str, original: str, mementos: Sequence[tuple[str, int]], after: str | None = None
) -> Document:
    """Return the TimeMap at `url`: `mementos` are URLs and times (ns), `after` is the TimeMap of later ones."""
    nodes = {NamedNode(each): time_ns for each, time_ns in mementos}
    triples = _TIME_MAP.triples(
        NamedNode(url),
        original,
        None,
        *statements(memento.memento, nodes),
        (xhv.next, None if after is None else NamedNode(after)),
    )
    for node, time_ns in nodes.items():
        triples += _MEMENTO.triples(node, time_ns, None)
    return Document(url, tuple(triples))
