"""Documents of views on topics: series, plots, frames, diagnostics, and time maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from urllib.parse import quote

from msgspec import Struct
from pyoxigraph import Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, double, integer, statements, text, triples_about
from rosld.ontology.vocab import dcterms, ldp, memento, rdf, rdfs, ros, xhv, xsd


def series_document(
    url: str,
    topic: str,
    field: str,
    points: Sequence[tuple[int, float, float, float, int]],
    *,
    is_reduced: bool,
) -> Document:
    """Return a series of the field of the topic at a URL.

    `points` are time (ns), minimum, maximum, sum and count of numbers; `is_reduced`: each is of an interval that begins
    then, else of one message.
    """
    nodes = [NamedNode(f"{url}#point.{number}") for number in range(len(points))]
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Series),
        (rdf.type, ldp.Resource),
        (rdf.type, ldp.RDFSource),
        (ros.seriesOf, NamedNode(topic)),
        (ros.seriesField, text(field)),
        *statements(ros.hasPoint, nodes),
    )
    for node, (time_ns, minimum, maximum, total, count) in zip(nodes, points, strict=True):
        numbers: tuple[tuple[NamedNode, Literal | None], ...] = (
            (ros.minimum, double(minimum)),
            (ros.maximum, double(maximum)),
            (ros.meanValue, double(total / count)),
            (ros.count, integer(count)),
        )
        triples += triples_about(
            node,
            (rdf.type, ros.SeriesPoint),
            (ros.pointTime, date_time_literal(time_ns)),
            *(numbers if is_reduced else ((ros.pointValue, double(minimum)),)),
        )
    return Document(url, tuple(triples))


class PlottedNumber(Struct, frozen=True):
    """A number of a topic that is drawn: the topic's URL, the path of the field, its type in ROS.

    `series` is the URL of what is recorded of it, None where nothing is.
    """

    topic: str
    field: str
    type: str
    series: str | None


def plot_document(url: str, numbers: Sequence[PlottedNumber]) -> Document:
    """Return the plot at a URL."""
    nodes = [NamedNode(f"{url}#series.{place}") for place in range(len(numbers))]
    triples = triples_about(NamedNode(url), (rdf.type, ros.Plot), *RDF_SOURCE, *statements(ros.plots, nodes))
    for node, number in zip(nodes, numbers, strict=True):
        triples += triples_about(
            node,
            (rdf.type, ros.Series),
            (ros.seriesOf, NamedNode(number.topic)),
            (ros.seriesField, text(number.field)),
            (rdfs.seeAlso, None if number.series is None else NamedNode(number.series)),
        )
    return Document(url, tuple(triples))


_FRAME_TYPE = "geometry_msgs/msg/TransformStamped"


class Frame(Struct, frozen=True):
    """A frame: its parent and when that was said, None of a root; the URLs of the nodes that say it; what is odd."""

    name: str
    parent: str | None
    received_ns: int | None
    publishers: tuple[str, ...]
    problem: str


def frames_document(url: str, frames: Sequence[Frame], types: str) -> Document:
    """Return the frames of a robot; `types` is the namespace of message types."""

    def node(name: str) -> NamedNode:
        return NamedNode(f"{url}#{quote(name.encode('utf-8', 'replace'), safe='/')}")

    triples = triples_about(
        NamedNode(url),
        *RDF_SOURCE,
        (dcterms.title, text("Frames")),
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
    """Latest state of a part: the URL of the topic, the time since it has this level; `number` is the level as sent."""

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
        subject, *RDF_SOURCE, (dcterms.title, text("Diagnostics")), *statements(dcterms.hasPart, nodes)
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


def time_map_document(
    url: str, original: str, mementos: Sequence[tuple[str, int]], after: str | None = None
) -> Document:
    """Return the TimeMap at `url`: `mementos` are URLs and times (ns), `after` is the TimeMap of those that follow."""
    nodes = [NamedNode(each) for each, _ in mementos]
    triples = triples_about(
        NamedNode(url),
        (rdf.type, memento.TimeMap),
        *RDF_SOURCE,
        (memento.original, NamedNode(original)),
        (memento.timegate, NamedNode(original)),
        *statements(memento.memento, nodes),
        (xhv.next, None if after is None else NamedNode(after)),
    )
    for node, (_, time_ns) in zip(nodes, mementos, strict=True):
        triples += triples_about(
            node, (rdf.type, memento.Memento), (memento.mementoDatetime, date_time_literal(time_ns))
        )
    return Document(url, tuple(triples))
