"""Documents of recordings: their content, pages of messages, single messages, and event streams (LDES)."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple, Protocol
from urllib.parse import urljoin

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.adapters.model.recorded import Event, RecordedMessage, RecordedTopic, RecordingOrder, Trigger
from rosld.ontology import kinds
from rosld.ontology.describe_datasets import IANA
from rosld.ontology.describe_topics import MESSAGE, type_url
from rosld.ontology.document import Document, LiftedMessage
from rosld.ontology.literals import date_time
from rosld.ontology.node_shape import CONTAINER_TYPES, SOURCE, NodeShape, many, one, optional
from rosld.ontology.observations import SENSOR, Observed
from rosld.ontology.triples import (
    CONTAINER,
    Statement,
    date_time_literal,
    integer,
    labelled,
    statements,
    text,
    triples_about,
)
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcat, dcterms, ldes, ldp, prov, rdf, rdfs, ros, sosa, spdx, tree, xhv, xsd


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
    def topics(self) -> Mapping[str, RecordedTopic]: ...
    @property
    def silent(self) -> Sequence[str]: ...


class BagView(NamedTuple):
    """A recording with all that its document describes.

    `sha256` is the digest of its file in hexadecimal, if known. `dropped` is the number of lost messages by topic,
    `problem` the reason why recording stopped. `size` is the size of its file in bytes, `status` is None for a complete
    recording, `order` has the parameters of one in progress, which has no readable messages yet. `triggered` is the
    number of recordings that its trigger has started, if it waits for that. `is_readable`: its messages can be read;
    `is_folder`: it consists of several files. `tags` and `events` are those that clients have added.
    """

    bag: Bag
    sha256: str | None = None
    dropped: Mapping[str, int] = MappingProxyType({})
    problem: str | None = None
    size: int | None = None
    status: str | None = None
    order: RecordingOrder | None = None
    triggered: int | None = None
    is_readable: bool = True
    is_folder: bool = False
    tags: Sequence[str] = ()
    events: Sequence[Event] = ()

    @property
    def has_file(self) -> bool:
        return self.size is not None and self.order is None and self.is_readable and not self.is_folder


_OCTETS = NamedNode(f"{IANA}application/octet-stream")
_SIZE: kinds.Kind[int] = kinds.Kind(
    lambda size: Literal(str(size), datatype=xsd.nonNegativeInteger), "sh:datatype xsd:nonNegativeInteger"
)
_STATUS = 'sh:in ( "armed" "suspended" "recording" "interrupted" "ended" "damaged" "missing" )'
_BAG = NodeShape[BagView]("Bag", "a recording", ros.Bag, dcat.Dataset, *CONTAINER_TYPES).with_properties(
    one(ros.name, kinds.TEXT, lambda view: view.bag.name),
    one(dcterms.title, kinds.TEXT, lambda view: view.bag.name),
    one(dcterms.description, kinds.TEXT, lambda view: f"A recording of {view.bag.count} messages of ROS."),
    one(dcterms.format, kinds.TEXT, lambda view: view.bag.format),
    optional(dcterms.issued, kinds.DATE_TIME, lambda view: view.bag.end_ns if view.bag.count else None),
    optional(dcterms.temporal, kinds.FRAGMENT, lambda view: "#time" if view.bag.count else None),
    many(dcat.keyword, kinds.TEXT, lambda view: (*view.bag.topics, *view.tags)),
    optional(dcat.distribution, kinds.FRAGMENT, lambda view: "file" if view.has_file else None),
    one(ros.count, kinds.COUNT, lambda view: view.bag.count),
    optional(ros.recordingProblem, kinds.TEXT, lambda view: view.problem),
    optional(ros.recordedBytes, kinds.COUNT, lambda view: view.size),
    optional(ros.recordedFile, kinds.FRAGMENT, lambda view: "file" if view.has_file else None),
    optional(ros.recordingStatus, kinds.TEXT.where(_STATUS), lambda view: view.status),
    optional(ros.triggerCount, kinds.COUNT, lambda view: view.triggered),
    optional(ros.triggerShape, kinds.IRI),
    optional(ros.triggerCondition, kinds.TEXT),
    optional(ros.triggerResource, kinds.IRI),
    optional(ros.triggerLimit, kinds.COUNT),
    many(ros.recordsTopic, kinds.TEXT, lambda view: view.order.topics if view.order else ()),
    optional(ros.secondsBefore, kinds.DECIMAL, lambda view: (view.order.before or None) if view.order else None),
    optional(ros.secondsLong, kinds.DECIMAL, lambda view: view.order.duration if view.order else None),
    optional(ros.start, kinds.DATE_TIME, lambda view: view.bag.start_ns if view.bag.count else None),
    optional(ros.end, kinds.DATE_TIME, lambda view: view.bag.end_ns if view.bag.count else None),
    optional(ldp.contains, kinds.IRI.where('sh:pattern "/bags/"')),
    optional(rdfs.seeAlso, kinds.IRI.where('sh:pattern "/ldes$"')),
    many(ros.hasRecordedTopic, kinds.IRI.where("sh:class ros:BagTopic")),
    many(ros.silentTopic, kinds.TEXT.where('sh:pattern "^[/*]"'), lambda view: view.bag.silent),
    many(ros.hasEvent, kinds.IRI.where("sh:class ros:RecordedEvent")),
    optional(spdx.checksum, kinds.node("Checksum")),
)
_PERIOD = NodeShape[Bag]("PeriodOfTime", "the time of a recording", dcterms.PeriodOfTime).with_properties(
    one(dcat.startDate, kinds.DATE_TIME, lambda bag: bag.start_ns),
    one(dcat.endDate, kinds.DATE_TIME, lambda bag: bag.end_ns),
)
_FILE = NodeShape[BagView]("Distribution", "the file of a recording", dcat.Distribution).with_properties(
    one(dcterms.title, kinds.TEXT, lambda view: f"File of {view.bag.name}"),
    one(dcat.accessURL, kinds.BAG, lambda view: view.bag.name),
    one(dcat.downloadURL, kinds.FRAGMENT, lambda view: ""),
    one(dcat.mediaType, kinds.TERM, lambda view: _OCTETS),
    one(dcat.byteSize, _SIZE, lambda view: view.size),
    optional(spdx.checksum, kinds.node("Checksum")),
)
_ALGORITHM = "sh:hasValue spdx:checksumAlgorithm_sha256"
_SHA256: kinds.Kind[str] = kinds.Kind(
    lambda value: Literal(value, datatype=xsd.hexBinary), 'sh:datatype xsd:hexBinary ; sh:pattern "^[0-9a-f]{64}$"'
)
_CHECKSUM = NodeShape[str]("Checksum", "the checksum of the file of a recording", spdx.Checksum).with_properties(
    one(spdx.algorithm, kinds.TERM.where(_ALGORITHM), lambda _: spdx.checksumAlgorithm_sha256),
    one(spdx.checksumValue, _SHA256, lambda sha256: sha256),
)
_EVENT = NodeShape[Event]("RecordedEvent", "an event in a recording", ros.RecordedEvent, prov.Activity).with_properties(
    one(rdfs.label, kinds.TEXT, lambda event: event.name),
    one(prov.startedAtTime, kinds.DATE_TIME, lambda event: event.start_ns),
    one(prov.endedAtTime, kinds.DATE_TIME, lambda event: event.start_ns if event.end_ns is None else event.end_ns),
)
_TRACK = NodeShape[RecordedTopic]("BagTopic", "a topic of a recording", ros.BagTopic).with_properties(
    one(ros.name, kinds.NAME, lambda track: track.name),
    one(ros.hasMessageType, kinds.CLASS, lambda track: track.type),
    one(ros.count, kinds.COUNT, lambda track: track.count),
    optional(ros.dropped, kinds.COUNT),
    optional(ros.unreadable, kinds.TEXT, lambda track: track.unreadable),
    one(rdfs.seeAlso, kinds.TOPIC, lambda track: track.name),
)


def bag_document(view: BagView, space: Space) -> Document:
    """Return a recording: its storage, its time span, its topics with their types and counts."""
    bag = view.bag
    url, messages, stream = space.bag(bag.name), space.bag_messages(bag.name), space.bag_stream(bag.name)
    checksum = None if view.sha256 is None else NamedNode(f"{url}#checksum")
    tracks = {
        NamedNode(space.fragment(url, "topic", *name[1:].split("/"))): track for name, track in bag.topics.items()
    }
    events = {NamedNode(f"{url}#event-{_event_key(event)}"): event for event in view.events}
    has_messages = view.order is None and view.is_readable
    readable = ((ldp.contains, NamedNode(messages)), (rdfs.seeAlso, NamedNode(stream))) if has_messages else ()
    trigger = _trigger(view.order.trigger, space) if view.order and view.order.trigger else ()
    more = (
        *(*readable, *trigger, *statements(ros.hasRecordedTopic, tracks), *statements(ros.hasEvent, events)),
        (spdx.checksum, checksum),
    )
    triples = _BAG.triples(NamedNode(url), view, space, *more)
    if checksum and view.sha256:
        triples += _CHECKSUM.triples(checksum, view.sha256, space)
    if bag.count:
        triples += _PERIOD.triples(NamedNode(f"{url}#time"), bag, space)
    if view.has_file:
        triples += _FILE.triples(NamedNode(f"{url}file"), view, space, (spdx.checksum, checksum))
    for node, event in events.items():
        triples += _EVENT.triples(node, event, space)
    if has_messages:
        triples.append(Triple(NamedNode(messages), rdfs.label, Literal(f"Messages of {bag.name}")))
    for node, track in tracks.items():
        lost = integer(view.dropped.get(track.name) or None)
        triples += _TRACK.triples(node, track, space, (ros.dropped, lost))
    for ref in dict.fromkeys(track.type for track in bag.topics.values()):
        triples += type_url(ref, space)
    return Document(url, tuple(triples))


def _event_key(event: Event) -> str:
    return f"{zlib.crc32(f'{event.name} {event.start_ns} {event.end_ns}'.encode()):08x}"


def _trigger(trigger: Trigger, space: Space) -> tuple[Statement, ...]:
    """Return the condition: a shape, or the text of a query and its subject."""
    limit = (ros.triggerLimit, integer(trigger.limit))
    if trigger.resource is None:
        return (ros.triggerShape, NamedNode(trigger.condition)), limit
    resource = NamedNode(urljoin(space.base, trigger.resource))
    return (ros.triggerCondition, text(trigger.condition)), (ros.triggerResource, resource), limit


def bag_messages_document(bag: Bag, space: Space, page: int | None = None, size: int = 100) -> Document:
    """Return page `page` (from 0) of `size` messages of a recording; without a page, links to the first and last.

    LDP Paging: the members are those of the container, listed by its pages.
    """
    container = NamedNode(space.bag_messages(bag.name))
    begin, last = bag.first // size, max(0, (bag.first + bag.count - 1) // size)
    pages = [NamedNode(f"{container.value}?page={number}") for number in (begin, last)]
    subject = container if page is None else NamedNode(f"{container.value}?page={page}")
    triples = _container(bag, space)
    triples += triples_about(subject, (xhv.first, pages[0]), (xhv.last, pages[1]))
    if page is not None:
        first, beyond = max(page * size, bag.first), min((page + 1) * size, bag.first + bag.count)
        members = [NamedNode(space.bag_message(bag.name, index)) for index in range(first, beyond)]
        triples += triples_about(
            subject,
            (rdf.type, ldp.Page),
            (rdfs.label, text(f"Page {page} of the messages of {bag.name}")),
            (ldp.pageSequence, container),
            (xhv.prev, NamedNode(f"{container.value}?page={page - 1}") if page > begin else None),
            (xhv.next, NamedNode(f"{container.value}?page={page + 1}") if page < last else None),
        )
        triples += triples_about(container, *statements(ldp.contains, members))
    return Document(subject.value, tuple(triples))


def bag_selection_document(bag: Bag, space: Space, url: str, messages: Sequence[RecordedMessage]) -> Document:
    """Return some messages of a recording, as listed by the page at `url`: their numbers, topics and times."""
    records = {NamedNode(space.bag_message(bag.name, each.index)): each for each in messages}
    triples = [
        *_container(bag, space),
        *triples_about(NamedNode(space.bag_messages(bag.name)), *statements(ldp.contains, records)),
    ]
    for node, message in records.items():
        triples += _RECORD.triples(node, (bag, message), space)
    return Document(url, tuple(triples))


def _container(bag: Bag, space: Space) -> list[Triple]:
    return triples_about(
        NamedNode(space.bag_messages(bag.name)),
        *CONTAINER,
        *labelled(dcterms.title, f"Messages of {bag.name}"),
        (ros.recordedIn, NamedNode(space.bag(bag.name))),
        (ros.count, integer(bag.count)),
    )


_MOMENT = NodeShape[tuple[Bag, int]]("Moment", "a moment of a recording", ros.Moment, *SOURCE).with_properties(
    one(rdfs.label, kinds.TEXT, lambda of: f"{of[0].name} at {date_time(0, of[1])}"),
    one(ros.momentOf, kinds.BAG, lambda of: of[0].name),
    one(ros.momentTime, kinds.DATE_TIME, lambda of: of[1]),
    many(ros.newestRecord, kinds.IRI.where("sh:class ros:Record")),
)


def bag_moment_document(bag: Bag, space: Space, url: str, at_ns: int, messages: Sequence[RecordedMessage]) -> Document:
    """Return the newest message of each topic of a recording at a time."""
    records = {NamedNode(space.bag_message(bag.name, each.index)): each for each in messages}
    triples = _MOMENT.triples(NamedNode(url), (bag, at_ns), space, *statements(ros.newestRecord, records))
    for node, message in records.items():
        triples += _RECORD.triples(node, (bag, message), space)
    return Document(url, tuple(triples))


_RECORD = NodeShape[tuple[Bag, RecordedMessage]](
    "Record", "the record of a message", ros.Record, *SOURCE
).with_properties(
    one(rdfs.label, kinds.TEXT, lambda of: f"Message {of[1].index} of {of[0].name}"),
    one(ros.recordedIn, kinds.BAG, lambda of: of[0].name),
    one(ros.index, kinds.COUNT, lambda of: of[1].index),
    one(ros.onTopic, kinds.TOPIC, lambda of: of[1].topic),
    one(ros.recordedAt, kinds.DATE_TIME, lambda of: of[1].sample.received_ns),
    optional(ros.opensRecording, kinds.FLAG, lambda of: of[1].is_opening or None),
    optional(ros.recordedMessage, kinds.MESSAGE),
    optional(ros.unreadable, kinds.TEXT),
)


def bag_message_document(
    bag: Bag, message: RecordedMessage, space: Space, lifted: LiftedMessage | None, *, unreadable: str | None = None
) -> Document:
    """Return one recorded message: its time, its topic, and the message itself or the reason why it cannot be read."""
    url = space.bag_message(bag.name, message.index)
    more = (ros.recordedMessage, NamedNode(url + MESSAGE) if lifted else None), (ros.unreadable, text(unreadable))
    triples = _RECORD.triples(NamedNode(url), (bag, message), space, *more)
    return Document(url, tuple(triples), (lifted,) if lifted else ())


STREAM = "#stream"


class StreamProfile(Enum):
    """Profile of the description of a stream's members; the value is its IRI."""

    RECORD = ros.iri
    OBSERVATION = sosa.iri

    @property
    def time(self) -> NamedNode:
        """The property for the time of a member."""
        return ros.recordedAt if self is StreamProfile.RECORD else sosa.resultTime

    @property
    def version_of(self) -> NamedNode:
        """The property that links a member, as a version, to its subject."""
        return ros.onTopic if self is StreamProfile.RECORD else sosa.madeBySensor


class StreamLink(NamedTuple):
    """A link of a page to another: all messages behind it lie between two times (ns), as far as they are known."""

    url: str
    from_ns: int | None = None
    to_ns: int | None = None


_STREAM = NodeShape[StreamProfile]("EventStream", "an event stream", ldes.EventStream).with_properties(
    one(tree.view, kinds.IRI.where('sh:pattern "/ldes"')),
    one(ldes.timestampPath, kinds.TERM, lambda profile: profile.time),
    one(ldes.versionOfPath, kinds.TERM, lambda profile: profile.version_of),
    optional(tree.shape, kinds.IRI),
    many(tree.member, kinds.IRI.where('sh:pattern "/messages/[0-9]+$"')),
)
_PAGE = NodeShape[Sequence[BlankNode]]("StreamPage", "a page of an event stream", tree.Node).with_properties(
    one(rdfs.label, kinds.TEXT, lambda relations: "Page of the event stream"),
    many(tree.relation, kinds.node("StreamRelation"), lambda relations: relations),
)
_RELATIONS = "tree:Relation tree:GreaterThanOrEqualToRelation tree:LessThanOrEqualToRelation"
_RELATION = NodeShape[tuple[StreamLink, StreamProfile, NamedNode, int | None]](
    "StreamRelation", "a link to a page of an event stream", target=""
).with_properties(
    one(rdf.type, kinds.TERM.where(f"sh:in ( {_RELATIONS} )"), lambda of: of[2]),
    one(tree.node, kinds.IRI.where('sh:pattern "/ldes/"'), lambda of: of[0].url),
    optional(tree.path, kinds.TERM, lambda of: None if of[3] is None else of[1].time),
    optional(tree.value, kinds.DATE_TIME, lambda of: of[3]),
)


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
    shapes = (tree.shape, None if shape is None else NamedNode(shape))
    triples = _STREAM.triples(stream, profile, None, (tree.view, NamedNode(root)), shapes)
    relations = {
        BlankNode(f"relation{number}x{place}"): (link, profile, *bound)
        for number, link in enumerate(links)
        for place, bound in enumerate(_bounds(link))
    }
    triples += _PAGE.triples(page, [*relations], None)
    for node, relation in relations.items():
        triples += _RELATION.triples(node, relation, None)
    triples += [Triple(stream, tree.member, NamedNode(member.url)) for member in members]
    return Document(url, tuple(triples), parts=tuple(members))


def _bounds(link: StreamLink) -> list[tuple[NamedNode, int | None]]:
    """Return the relations of a page to another, with the time of each."""
    bounds = ((tree.GreaterThanOrEqualToRelation, link.from_ns), (tree.LessThanOrEqualToRelation, link.to_ns))
    return [bound for bound in bounds if bound[1] is not None] or [(tree.Relation, None)]


def observation_triples(
    url: str, message: RecordedMessage, space: Space, lifted: Sequence[Triple], fields: Sequence[Observed]
) -> list[Triple]:
    """Return a recorded message as an observation by the sensor of its topic, or as a collection of several.

    `lifted` are the triples of the message itself, `fields` its observed fields; without any the topic is observed.
    """
    name, topic = message.sample.schema.name, space.topic(message.topic)
    observed = [space.property_of(name, each.field) for each in fields] or [topic]
    sample, node = message.sample, NamedNode(url + MESSAGE)
    values = [each for each in lifted if each.subject == node and each.predicate.value.startswith(space.types)]
    simple = values[0].object if len(values) == 1 and isinstance(values[0].object, Literal) else None
    return triples_about(
        NamedNode(url),
        (rdf.type, sosa.Observation if len(observed) == 1 else sosa.ObservationCollection),
        *statements(sosa.observedProperty, map(NamedNode, observed)),
        (sosa.resultTime, date_time_literal(sample.received_ns)),
        (sosa.madeBySensor, NamedNode(topic + SENSOR)),
        (sosa.hasResult, node if lifted else None),
        (sosa.hasSimpleResult, simple),
    )
