"""TimeMaps described: the mementos of a resource, each with its time (RFC 7089, in the terms of mementoweb.org)."""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, statements, triples_about
from rosld.ontology.vocab import memento, rdf, xhv


def time_map_document(
    url: str, original: str, mementos: Sequence[tuple[str, int]], after: str | None = None
) -> Document:
    """The TimeMap at `url`: `mementos` are URLs and times (ns), `after` is the TimeMap of those that follow."""
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
