"""Documents of recordings: their content, pages of messages, single messages, and event streams (LDES)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple, Protocol
from urllib.parse import urljoin

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model import Sample, TypeRef
from rosld.ontology.describe_topics import MESSAGE, type_url
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.triples import (
    CONTAINER,
    RDF_SOURCE,
    Statement,
    boolean,
    date_time_literal,
    integer,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, ldes, ldp, rdf, rdfs, ros, sosa, spdx, tree, xhv, xsd


class Track(Protocol):
    """A topic of a recording; `unreadable` is the reason why its messages cannot be read, if any."""

    @property
    def name(self) -> str: ...
    @property
    def type(self) -> TypeRef: ...
    @property
    def count(self) -> int: ...
    @property
    def unreadable(self) -> str | None: ...


class Bag(Protocol):
    """A recording. Times are nanoseconds after the epoch."""

    @property
    def name(self) -> str: ...
    @property
    def format(self) -> str: ...
    @property
    def first(self) -> int: ...
    @property
    def count(self) -> int: ...
    @property
    def start_ns(self) -> int: ...
    @property
    def end_ns(self) -> int: ...
    @property
    def topics(self) -> Mapping[str, Track]: ...
    @property
    def silent(self) -> Sequence[str]: ...


class BagMessage(Protocol):
    """A recorded message: its number, its topic, and the sample with its time."""

    @property
    def index(self) -> int: ...
    @property
    def topic(self) -> str: ...
    @property
    def sample(self) -> Sample: ...
    @property
    def is_opening(self) -> bool: ...


class Trigger(Protocol):
    """A trigger of recordings: a condition on a resource, and the maximum frequency."""

    @property
    def condition(self) -> str: ...
    @property
    def resource(self) -> str | None: ...
    @property
    def limit(self) -> int: ...


class RecordingOrder(Protocol):
    """Parameters of a recording: topics or globs, seconds before its start, duration in seconds."""

    @property
    def topics(self) -> Sequence[str]: ...
    @property
    def before(self) -> float: ...
    @property
    def duration(self) -> float | None: ...
    @property
    def trigger(self) -> Trigger | None: ...


def bag_document(
    bag: Bag,
    space: Space,
    sha256: str | None = None,
    *,
    dropped: Mapping[str, int] = MappingProxyType({}),
    problem: str | None = None,
    size: int | None = None,
    status: str | None = None,
    order: RecordingOrder | None = None,
    triggered: int | None = None,
) -> Document:
    """Return a recording: how it is stored, from when to when, its topics with their types and counts.

    `sha256` is the digest of its file in hexadecimal, where that is known.
    `dropped` are messages by topic that were sent and are not in it, `problem` says why it does not go on. `size` are
    the bytes of its file, `status` is missing of one that is complete, `order` says how it is being made: it has no
    messages that could be read yet. `triggered` is how many recordings its trigger has begun, where it waits for that.
    """
    url, messages = space.bag(bag.name), NamedNode(space.bag_messages(bag.name))
    tracks = _track_nodes(bag, space)
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Bag),
        *CONTAINER,
        (ros.name, text(bag.name)),
        (dcterms.format, text(bag.format)),
        (ros.count, integer(bag.count)),
        (ros.recordingProblem, text(problem)),
        (ros.recordedBytes, None if size is None else integer(size)),
        (ros.recordedFile, NamedNode(f"{url}file") if size is not None and order is None else None),
        (ros.recordingStatus, text(status)),
        (ros.triggerCount, integer(triggered)),
        *(() if order is None else _order(order, space)),
        (ros.start, date_time_literal(bag.start_ns) if bag.count else None),
        (ros.end, date_time_literal(bag.end_ns) if bag.count else None),
        (ldp.contains, messages if order is None else None),
        (rdfs.seeAlso, NamedNode(space.bag_stream(bag.name)) if order is None else None),
        *statements(ros.hasRecordedTopic, tracks),
        *((ros.silentTopic, text(topic)) for topic in bag.silent),
        (spdx.checksum, None if sha256 is None else NamedNode(f"{url}#checksum")),
    )
    if sha256 is not None:
        triples += _checksum_triples(url, sha256)
    if order is None:
        triples += triples_about(messages, (rdfs.label, text("Messages")))
    for node, track in tracks.items():
        lost = dropped.get(track.name)
        triples += triples_about(node, *_track(track, space), (ros.dropped, integer(lost) if lost else None))
    for ref in dict.fromkeys(track.type for track in bag.topics.values()):
        triples += type_url(ref, space)
    return Document(url, tuple(triples))


def _track_nodes(bag: Bag, space: Space) -> dict[NamedNode, Track]:
    """Return the topics of a recording by the fragments that identify them."""
    url = space.bag(bag.name)
    return {NamedNode(space.fragment(url, "topic", *name[1:].split("/"))): track for name, track in bag.topics.items()}


def _checksum_triples(url: str, sha256: str) -> list[Triple]:
    """Return the checksum of the file of the recording at `url`, as SPDX has it."""
    return triples_about(
        NamedNode(f"{url}#checksum"),
        (rdf.type, spdx.Checksum),
        (spdx.algorithm, spdx.checksumAlgorithm_sha256),
        (spdx.checksumValue, Literal(sha256, datatype=xsd.hexBinary)),
    )


def _order(order: RecordingOrder, space: Space) -> Iterator[Statement]:
    if order.trigger is not None:
        condition, resource = order.trigger.condition, order.trigger.resource
        yield ros.triggerShape, NamedNode(condition) if resource is None else None
        yield ros.triggerCondition, text(condition) if resource is not None else None
        yield ros.triggerResource, None if resource is None else NamedNode(urljoin(space.base, resource))
        yield ros.triggerLimit, integer(order.trigger.limit)
    yield from ((ros.recordsTopic, text(topic)) for topic in order.topics)
    yield ros.secondsBefore, _seconds(order.before) if order.before else None
    yield ros.secondsLong, None if order.duration is None else _seconds(order.duration)


def _seconds(value: float) -> Literal:
    return Literal(format(Decimal(str(value)), "f"), datatype=xsd.decimal)


def _track(track: Track, space: Space) -> list[Statement]:
    return [
        (rdf.type, ros.BagTopic),
        (ros.name, text(track.name)),
        (ros.hasMessageType, NamedNode(space.class_of(track.type.name))),
        (ros.count, integer(track.count)),
        (ros.unreadable, text(track.unreadable)),
        (rdfs.seeAlso, NamedNode(space.topic(track.name))),
    ]


def bag_messages_document(bag: Bag, space: Space, page: int | None = None, size: int = 100) -> Document:
    """Return page `page` (from 0) of `size` messages of a recording; without a page, links to the first and last.

    LDP Paging: the members are those of the container, listed by its pages.
    """
    container = NamedNode(space.bag_messages(bag.name))
    begin, last = bag.first // size, max(0, (bag.first + bag.count - 1) // size)
    pages = [NamedNode(f"{container.value}?page={number}") for number in (begin, last)]
    subject = container if page is None else NamedNode(f"{container.value}?page={page}")
    triples = triples_about(
        container,
        *CONTAINER,
        (dcterms.title, text(f"Messages of {bag.name}")),
        (ros.recordedIn, NamedNode(space.bag(bag.name))),
        (ros.count, integer(bag.count)),
    )
    triples += triples_about(subject, (xhv.first, pages[0]), (xhv.last, pages[1]))
    if page is not None:
        first, beyond = max(page * size, bag.first), min((page + 1) * size, bag.first + bag.count)
        members = [NamedNode(space.bag_message(bag.name, index)) for index in range(first, beyond)]
        triples += triples_about(
            subject,
            (rdf.type, ldp.Page),
            (ldp.pageSequence, container),
            (xhv.prev, NamedNode(f"{container.value}?page={page - 1}") if page > begin else None),
            (xhv.next, NamedNode(f"{container.value}?page={page + 1}") if page < last else None),
        )
        triples += triples_about(container, *statements(ldp.contains, members))
    return Document(subject.value, tuple(triples))


def bag_selection_document(bag: Bag, space: Space, url: str, messages: Sequence[BagMessage]) -> Document:
    """Some messages of a recording, as the page at `url` lists them: their numbers, topics and times."""
    container = NamedNode(space.bag_messages(bag.name))
    nodes = [NamedNode(space.bag_message(bag.name, each.index)) for each in messages]
    triples = triples_about(
        container,
        *CONTAINER,
        (dcterms.title, text(f"Messages of {bag.name}")),
        (ros.recordedIn, NamedNode(space.bag(bag.name))),
        (ros.count, integer(bag.count)),
        *statements(ldp.contains, nodes),
    )
    for node, message in zip(nodes, messages, strict=True):
        triples += triples_about(node, *_record(bag, message, space))
    return Document(url, tuple(triples))


def bag_moment_document(bag: Bag, space: Space, url: str, at_ns: int, messages: Sequence[BagMessage]) -> Document:
    """Return the messages of a recording that were the newest of their topics at a time."""
    nodes = [NamedNode(space.bag_message(bag.name, each.index)) for each in messages]
    triples = triples_about(
        NamedNode(url),
        (rdf.type, ros.Moment),
        *RDF_SOURCE,
        (ros.momentOf, NamedNode(space.bag(bag.name))),
        (ros.momentTime, date_time_literal(at_ns)),
        *statements(ros.newestRecord, nodes),
    )
    for node, message in zip(nodes, messages, strict=True):
        triples += triples_about(node, *_record(bag, message, space))
    return Document(url, tuple(triples))


def _record(bag: Bag, message: BagMessage, space: Space) -> list[Statement]:
    return [
        (rdf.type, ros.Record),
        *RDF_SOURCE,
        (ros.recordedIn, NamedNode(space.bag(bag.name))),
        (ros.index, integer(message.index)),
        (ros.onTopic, NamedNode(space.topic(message.topic))),
        (ros.recordedAt, date_time_literal(message.sample.received_ns)),
        (ros.opensRecording, boolean(True) if message.is_opening else None),
    ]


def bag_message_document(
    bag: Bag, message: BagMessage, space: Space, lifted: LiftedMessage | None, *, unreadable: str | None = None
) -> Document:
    """One recorded message: when it was recorded, on which topic, and the message itself or why it cannot be read."""
    url = space.bag_message(bag.name, message.index)
    triples = triples_about(
        NamedNode(url),
        *_record(bag, message, space),
        (ros.recordedMessage, NamedNode(url + MESSAGE) if lifted else None),
        (ros.unreadable, text(unreadable)),
    )
    return Document(url, tuple(triples), (lifted,) if lifted else ())


STREAM = "#stream"


class StreamProfile(Enum):
    """Profile of the description of a stream's members; the value is its IRI."""

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
    """Return the page at `url` of the event stream whose first page is at `root`, with its links and members."""
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
    """Return a recorded message as an observation of its topic; `lifted` is what is said of the message itself."""
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
