"""Plots described: the numbers that are drawn together over time, each a series of a topic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, statements, text, triples_about
from rosld.ontology.vocab import rdf, rdfs, ros


@dataclass(frozen=True, slots=True)
class PlottedNumber:
    """A number of a topic that is drawn: the topic's URL, the path of the field, its type in ROS.

    `series` is the URL of what is recorded of it, None where nothing is.
    """

    topic: str
    field: str
    type: str
    series: str | None


def plot_document(url: str, numbers: Sequence[PlottedNumber]) -> Document:
    """The plot at a URL."""
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
