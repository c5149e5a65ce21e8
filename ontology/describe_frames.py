"""Frames described: the newest transform of each, by the fields of geometry_msgs/TransformStamped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from urllib.parse import quote

from pyoxigraph import NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, statements, text, triples_about
from rosld.ontology.vocab import dcterms, rdfs, ros

_TYPE = "geometry_msgs/msg/TransformStamped"


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: its parent and when that was said, None of a root; the URLs of the nodes that say it; what is odd."""

    name: str
    parent: str | None
    received_ns: int | None
    publishers: tuple[str, ...]
    problem: str


def frames_document(url: str, frames: Sequence[Frame], types: str) -> Document:
    """The frames of a robot; `types` is the namespace of message types."""

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
            (NamedNode(f"{types}{_TYPE}#child_frame_id"), None if each.parent is None else text(each.name)),
            (dcterms.isPartOf, None if each.parent is None else node(each.parent)),
            (ros.received, date_time_literal(each.received_ns)),
            *statements(rdfs.seeAlso, map(NamedNode, each.publishers)),
        )
    return Document(url, tuple(triples))
