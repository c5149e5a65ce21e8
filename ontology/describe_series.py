"""Series described: one number of a topic over a time, a node a point."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import date_time_literal, double, integer, statements, text, triples_about
from rosld.ontology.vocab import ldp, rdf, ros


def series_document(
    url: str,
    topic: str,
    field: str,
    points: Sequence[tuple[int, float, float, float, int]],
    *,
    is_reduced: bool,
) -> Document:
    """A series of the field of the topic at a URL.

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
