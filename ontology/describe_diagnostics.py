"""Diagnostics described: what each part of a robot said last, by the fields of diagnostic_msgs/DiagnosticStatus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pyoxigraph import Literal, NamedNode

from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, date_time_literal, statements, text, triples_about
from rosld.ontology.vocab import dcterms, rdfs, ros, xsd

_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"


@dataclass(frozen=True, slots=True)
class PartState:
    """What a part said last: the URL of the topic, since when it is at this level; `number` is the level it gave."""

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
    """The states of parts; `types` is the namespace of message types."""

    def field(name: str) -> NamedNode:
        return NamedNode(f"{types}{_TYPE}#{name}")

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
