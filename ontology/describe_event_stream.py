"""Event streams described: the messages of a recording as immutable members, in pages linked by time (LDES, TREE)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum
from typing import NamedTuple

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.describe_bags import BagMessage
from rosld.ontology.describe_topics import MESSAGE
from rosld.ontology.document import Document
from rosld.ontology.triples import date_time_literal, triples_about
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ldes, rdf, ros, sosa, tree

STREAM = "#stream"


class StreamProfile(Enum):
    """How the members of a stream are described, by the IRI of the profile."""

    RECORD = ros.iri
    OBSERVATION = sosa.iri

    @property
    def time(self) -> NamedNode:
        """The property that has the time of a member."""
        return ros.recordedAt if self is StreamProfile.RECORD else sosa.resultTime

    @property
    def version_of(self) -> NamedNode:
        """The property that has what a member is a version of."""
        return ros.onTopic if self is StreamProfile.RECORD else sosa.observedProperty


class StreamLink(NamedTuple):
    """A link of a page to another: all behind it lies from one time (ns) to another, as far as that is known."""

    url: str
    from_ns: int | None = None
    to_ns: int | None = None


def event_stream_document(
    root: str,
    url: str,
    profile: StreamProfile,
    links: Iterable[StreamLink],
    members: Sequence[Document],
    shape: str | None = None,
) -> Document:
    """The page at `url` of the event stream whose first page is at `root`, with its links and members."""
    stream, page = NamedNode(root.partition("?")[0] + STREAM), NamedNode(url)
    triples = triples_about(
        stream,
        (rdf.type, ldes.EventStream),
        (tree.view, NamedNode(root)),
        (ldes.timestampPath, profile.time),
        (ldes.versionOfPath, profile.version_of),
        (tree.shape, None if shape is None else NamedNode(shape)),
    )
    triples += triples_about(page, (rdf.type, tree.Node))
    for number, link in enumerate(links):
        triples += _relations(page, link, number, profile.time)
    triples += [Triple(stream, tree.member, NamedNode(member.url)) for member in members]
    return Document(url, tuple(triples), parts=tuple(members))


def observation_triples(url: str, message: BagMessage, space: Space, lifted: Sequence[Triple]) -> list[Triple]:
    """A recorded message as an observation of its topic; `lifted` is what is said of the message itself."""
    sample, node = message.sample, NamedNode(url + MESSAGE)
    values = [each for each in lifted if each.subject == node and each.predicate.value.startswith(space.types)]
    simple = values[0].object if len(values) == 1 and isinstance(values[0].object, Literal) else None
    return triples_about(
        NamedNode(url),
        (rdf.type, sosa.Observation),
        (sosa.observedProperty, NamedNode(space.topic(message.topic))),
        (sosa.resultTime, date_time_literal(sample.received_ns)),
        (sosa.madeBySensor, NamedNode(space.node(sample.publisher)) if sample.publisher else None),
        (sosa.hasResult, node if lifted else None),
        (sosa.hasSimpleResult, simple),
    )


def _relations(page: NamedNode, link: StreamLink, number: int, path: NamedNode) -> list[Triple]:
    bounds = (
        (tree.GreaterThanOrEqualToRelation, date_time_literal(link.from_ns)),
        (tree.LessThanOrEqualToRelation, date_time_literal(link.to_ns)),
    )
    known: list[tuple[NamedNode, Literal | None]] = [each for each in bounds if each[1] is not None]
    known = known or [(tree.Relation, None)]
    triples: list[Triple] = []
    for place, (kind, value) in enumerate(known):
        relation = BlankNode(f"relation{number}x{place}")
        triples.append(Triple(page, tree.relation, relation))
        triples += triples_about(
            relation,
            (rdf.type, kind),
            (tree.node, NamedNode(link.url)),
            (tree.path, None if value is None else path),
            (tree.value, value),
        )
    return triples
