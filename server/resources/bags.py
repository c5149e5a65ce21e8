"""Recordings: `/bags/B/`, made by POST to `/bags/`, its messages in LDP pages, and each under its own URL."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from starlette.responses import Response

from rosld.adapters.base import RecordedMessage, RecordedTopic, Recording, Watch
from rosld.adapters.model import NotFound
from rosld.ontology.describe_bags import bag_document, bag_messages_document
from rosld.ontology.describe_containers import container_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.history.history import History
from rosld.server.history.recordings import ArmedRecording, RecordingRefused, Recordings, RunningRecording
from rosld.server.html import ChoiceForm, DeleteForm, Form, SequenceLink
from rosld.server.http.link import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.data_schema import DataSchema
from rosld.server.hypermedia.json_schema import ANYTHING
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.pictures.picture_cache import PictureCache
from rosld.server.resources.bag_selection import PARAMETERS, selection_of
from rosld.server.resources.messages import decode, field_response, lift_sample
from rosld.server.resources.pictures import explicit_picture_type, picture_response, require_picture
from rosld.server.resources.point_clouds import cloud_is_preferred, cloud_response
from rosld.server.resources.recorded_messages import DecodedRecord, learn_type, record_document
from rosld.server.resources.recording_form import recording_form
from rosld.server.resources.recording_order import MEDIA_TYPES, SCHEMA, read_order
from rosld.server.resources.recording_patch import PATCHES, require_end
from rosld.server.resources.recording_trigger import Find, trigger_of
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FIELD, FIELD_READS, FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import (
    BASIC_CONTAINER,
    RDF_SOURCE,
    READ,
    RESOURCE,
    Answer,
    CreatedAnswer,
    Resource,
    ShownAnswer,
)
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings

PAGE = 100
"""Messages on one page of `/bags/B/messages/`."""

_PAGE = QueryParameter("page", "A page of messages, from 0.", {"type": "integer", "minimum": 0})


class BagContainer(Resource):
    """`/bags/`: the recordings of this source, the history, and those that clients make or send."""

    kind = "Bags"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"POST": MEDIA_TYPES}

    def __init__(
        self,
        session: Session,
        affordances: AffordanceService[State],
        states: VersionCache[State],
        mappings: Mappings,
        recordings: Recordings,
        find: Find | None = None,
    ) -> None:
        """`find` gives the resource at a path below the base, which a trigger may be about."""
        super().__init__(session.space.container("bags"))
        self.session = session
        self.affordances = affordances
        self.states = states
        self.mappings = mappings
        self.recordings = recordings
        self._find = find

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        space = self.session.space
        return (recording_form({name: space.topic(name) for name in self.session.graph.topics}),)

    def methods(self) -> frozenset[str]:
        return READ | {"POST"} if can_record(self.session) else READ

    def deny_reason(self, method: str) -> str:
        if method == "POST":
            return "Nothing is recorded here: this server is read-only, or serves a recording."
        return super().deny_reason(method)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        post = WriteMethod("Records topics, the last seconds of the history before them", sends=SCHEMA, done=(201,))
        return PathItem("The recordings", writes={"POST": post}, also=(507,))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Container"),)

    async def state(self) -> State:
        members = bag_urls(self.session.space, self.recordings)
        version = members, tuple(self.session.graph.topics)  # the page has a form that names them
        return self.states.get_or_make(
            self.url, version, lambda: State(lambda: container_document(self.url, members, "Recordings"))
        )

    async def post(self, exchange: Exchange) -> Answer:
        """Begin a recording of topics that who asks may read."""
        order = read_order(await exchange.body(), exchange.media_type, self.url, is_form=bool(exchange.typed))
        slug = exchange.header("slug")
        if order.name is None and slug is not None and self.recordings.can_be_named(slug):
            order = replace(order, name=slug)
        space, permissions = self.session.space, exchange.permissions
        for topic in order.topics:
            if not set(topic) & set("*?[") and not permissions.may_read(space.topic(topic)):
                raise Problem(403, f"You may not read {topic}, so you may not record it.")

        def may_record(topic: str) -> bool:
            return permissions.may_read(space.topic(topic))

        resource: Resource
        try:
            if order.trigger is None:
                resource = RunningBag(
                    self.session.space,
                    self.session.settings,
                    self.states,
                    self.recordings,
                    self.recordings.begin(order, may_record),
                )
            else:
                occurrences = await trigger_of(
                    self.session.space,
                    self.session.changes,
                    self.affordances,
                    self.mappings,
                    order.trigger,
                    self._find,
                    exchange,
                )
                resource = ArmedBag(
                    self.session.space,
                    self.session.settings,
                    self.recordings,
                    self.recordings.arm(order, may_record, occurrences),
                )
        except RecordingRefused as error:
            raise Problem(409 if error.taken else 422, f"{error}.") from error
        except OSError as error:
            raise Problem(507, f"The recording cannot be stored: {error.strerror or error}.") from error
        return CreatedAnswer(resource.url, resource, await resource.state())


class BagResource(Resource):
    """One recording that can be read."""

    kind = "Bag"
    is_cacheable = False
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(
        self,
        space: Space,
        settings: Settings,
        states: VersionCache[State],
        recordings: Recordings,
        recording: Recording,
    ) -> None:
        super().__init__(space.bag(recording.name))
        self.space = space
        self.settings = settings
        self.states = states
        self.recordings = recordings
        self.recording = recording

    def methods(self) -> frozenset[str]:
        is_own = self.recording.name in self.recordings.finished and not self.settings.read_only
        return READ | {"DELETE"} if is_own else READ

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"The recording {self.recording.name}")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.space.document_shape("Bag"),)

    async def state(self) -> State:
        recording, history = self.recording, self.recordings.history
        is_history = recording is history.recording
        digest = None if is_history else history.digests.get(recording.path)
        trouble = (history.problem, sum(history.dropped().values())) if is_history else None
        version = recording.first, recording.count, recording.start_ns, trouble, digest
        return self.states.get_or_make(
            self.url, version, lambda: State(partial(describe_bag, self.space, self.recordings.history, recording))
        )

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        history = self.recordings.history
        return None if self.recording is history.recording else history.digests.watch(self.recording.path, wake)

    async def forms(self) -> Sequence[Form]:
        about = "The recording and its file are deleted."
        return (DeleteForm("Delete the recording", "Delete", about),) if "DELETE" in self.methods() else ()

    async def delete(self, exchange: Exchange) -> Answer:
        """Delete the recording and its file."""
        await self.recordings.delete(self.recording.name)
        return Response(status_code=204)


class UnfinishedBag(Resource):
    """A recording that is not complete: PATCH ends it."""

    is_cacheable = False
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"PATCH": PATCHES}

    def __init__(self, space: Space, settings: Settings, name: str) -> None:
        super().__init__(space.bag(name))
        self.space = space
        self.settings = settings
        self.name = name

    def methods(self) -> frozenset[str]:
        return READ if self.settings.read_only else READ | {"PATCH", "DELETE"}

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        ends: DataSchema = {"type": "object", "properties": {"status": {"const": "ended"}}, "required": ["status"]}
        return PathItem(f"The recording {self.name}", writes={"PATCH": WriteMethod("Ends it", sends=ends)})

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.space.document_shape("Bag"),)


class RunningBag(UnfinishedBag):
    """A recording that is being made: how far it is. PATCH ends it, DELETE gives it up."""

    kind = "Recording being made"

    def __init__(
        self,
        space: Space,
        settings: Settings,
        states: VersionCache[State],
        recordings: Recordings,
        one: RunningRecording,
    ) -> None:
        super().__init__(space, settings, one.name)
        self.states = states
        self.recordings = recordings
        self.one = one

    async def state(self) -> State:
        return State(partial(describe_running, self.space, self.recordings, self.one))

    async def patch(self, exchange: Exchange) -> Answer:
        """End it: `{"status": "ended"}`, or that `ros:recordingStatus` is "ended" from now on."""
        before = describe_running(self.space, self.recordings, self.one).triples
        require_end(await exchange.body(), exchange.media_type, self.url, before)
        await self.recordings.end(self.one.name)
        recording = self.recordings.readable.get(self.one.name)
        if recording is None:
            raise Problem(507, self.one.writer.problem or f"The recording {self.one.name} could not be completed.")
        resource = BagResource(self.space, self.settings, self.states, self.recordings, recording)
        return ShownAnswer(resource, await resource.state())

    async def forms(self) -> Sequence[Form]:
        if "PATCH" not in self.methods():
            return ()
        end = ChoiceForm("status", ("ended",), "End the recording", method="PATCH", about="It can then be read.")
        return (end, DeleteForm("Delete the recording", "Delete", "It ends, and what there is of it is deleted."))

    async def delete(self, exchange: Exchange) -> Answer:
        """End it, and delete what there is of it."""
        await self.recordings.delete(self.one.name)
        return Response(status_code=204)


class ArmedBag(UnfinishedBag):
    """A recording that waits for its trigger. PATCH and DELETE have it wait no more."""

    kind = "Recording that waits for its trigger"

    def __init__(self, space: Space, settings: Settings, recordings: Recordings, one: ArmedRecording) -> None:
        super().__init__(space, settings, one.name)
        self.recordings = recordings
        self.one = one

    async def state(self) -> State:
        return State(partial(describe_armed, self.space, self.one))

    async def forms(self) -> Sequence[Form]:
        about = "It waits no more for its trigger. What that has begun stays."
        return (DeleteForm("Disarm", "Disarm", about),) if "DELETE" in self.methods() else ()

    async def patch(self, exchange: Exchange) -> Answer:
        """Have it wait no more."""
        before = describe_armed(self.space, self.one).triples
        require_end(await exchange.body(), exchange.media_type, self.url, before)
        return await self.delete(exchange)

    async def delete(self, exchange: Exchange) -> Answer:
        """Have it wait no more."""
        self.recordings.disarm(self.one.name)
        return Response(status_code=204)


class ArmedView:
    """A recording that waits for its trigger, as it is described."""

    format = "MCAP"
    first = count = start_ns = end_ns = 0
    topics: Mapping[str, RecordedTopic] = {}

    def __init__(self, name: str) -> None:
        self.name = name


class RunningView:
    """A recording that is being made, as it is described."""

    format = "MCAP"
    first = 0

    def __init__(self, one: RunningRecording) -> None:
        self.name = one.name
        self.count = one.writer.count
        self.start_ns = one.writer.start_ns
        self.end_ns = one.writer.end_ns
        types = one.writer.types
        counts = dict(one.writer.counts)
        self.topics = {topic: RecordedTopic(topic, types[topic], n) for topic, n in counts.items() if topic in types}


def can_record(session: Session) -> bool:
    """Whether clients may have anything recorded here."""
    return not session.settings.read_only and session.adapter.capabilities.system != "recording"


def bag_urls(space: Space, recordings: Recordings) -> tuple[str, ...]:
    """The URLs of all recordings, those that are being made, and those that wait to be, included."""
    names = (*recordings.readable, *recordings.running, *recordings.armed)
    return tuple(map(space.bag, dict.fromkeys(names)))


def describe_bag(space: Space, history: History, recording: Recording) -> Document:
    """The document of a recording that can be read."""
    if recording is history.recording:
        return bag_document(recording, space, dropped=history.dropped(), problem=history.problem)
    size: int | None = None
    with contextlib.suppress(OSError):
        size = recording.path.stat().st_size if recording.path.is_file() else None
    return bag_document(recording, space, history.digests.known(recording.path), size=size)


def describe_running(space: Space, recordings: Recordings, one: RunningRecording) -> Document:
    """The document of a recording that is being made."""
    writer, dropped = one.writer, recordings.dropped(one)
    view = RunningView(one)
    return bag_document(view, space, dropped=dropped, problem=writer.problem, size=writer.size, order=one.order)


def describe_armed(space: Space, one: ArmedRecording) -> Document:
    """The document of a recording that waits for its trigger."""
    view = ArmedView(one.name)
    return bag_document(view, space, problem=one.problem, order=one.order, triggered=one.count)


class BagMessages(Resource):
    """The messages of a recording: a container in pages (`?page=N` from 0; without it, links only)."""

    kind = "Messages"
    is_cacheable = False
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(
        self, session: Session, states: VersionCache[State], recording: Recording, page: int | None = None
    ) -> None:
        base = session.space.bag_messages(recording.name)
        super().__init__(base if page is None else f"{base}?page={page}")
        self.session = session
        self.states = states
        self.recording = recording
        self.number = page

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"The messages of {self.recording.name}", query=(FORMAT, _PAGE, *PARAMETERS))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Container"),)

    async def state(self) -> State:
        recording, space, page = self.recording, self.session.space, self.number
        version = recording.first, recording.count
        return self.states.get_or_make(
            self.url, version, lambda: State(lambda: bag_messages_document(recording, space, page, PAGE))
        )

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        base = self.session.space.bag_messages(self.recording.name)
        first, last = _pages(self.recording)
        if self.number is None:
            places = {"first": first, "last": last}
        else:
            places = {"first": first, "prev": self.number - 1, "next": self.number + 1, "last": last}
        return tuple(SequenceLink(rel, f"{base}?page={at}") for rel, at in places.items() if first <= at <= last)

    async def select_variant(self, exchange: Exchange) -> Resource:
        """The page that `?page=`, or a filter, asks for; a 404 Problem where there is none."""
        wanted = exchange.query.get("page")
        if wanted is None:
            return selection_of(self.session, self.recording, exchange) or self
        first, last = _pages(self.recording)
        if not (wanted.isascii() and wanted.isdigit()) or int(wanted) > last:
            raise Problem(404, f"?page={wanted}: the pages of {self.recording.name} are {first} to {last}.")
        if int(wanted) < first:
            raise Problem(410, f"?page={wanted}: the oldest messages were removed, the pages are {first} to {last}.")
        return BagMessages(self.session, self.states, self.recording, int(wanted))


class BagMessage(Resource):
    """One message of a recording."""

    kind = "Recorded message"
    is_cacheable = False

    def __init__(
        self, session: Session, states: VersionCache[State], pictures: PictureCache, recording: Recording, index: int
    ) -> None:
        super().__init__(session.space.bag_message(recording.name, index))
        self.session = session
        self.states = states
        self.pictures = pictures
        self.recording = recording
        self.index = index
        self.title = f"{recording.name}, message {index}"
        self.links = (*Resource.links, *(Link(step.url, step.rel) for step in self.navigation_links()))

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """The messages before and after, first and last (RFC 8288)."""
        first, last = self.recording.first, self.recording.first + self.recording.count - 1
        places = {"first": first, "prev": self.index - 1, "next": self.index + 1, "last": last}
        links = ((rel, self.session.space.bag_message(self.recording.name, at)) for rel, at in places.items())
        there = {rel for rel, at in places.items() if first <= at <= last}
        return tuple(SequenceLink(rel, url) for rel, url in links if rel in there)

    async def message(self) -> RecordedMessage:
        """The message, read off the loop; a 404 Problem where there is none."""
        try:
            message = await asyncio.to_thread(self.recording.message, self.index)
        except NotFound as error:
            raise Problem(410 if self.index < self.recording.first else 404, error.sentence) from error
        await learn_type(self.session.schemas, self.recording, message)
        return message

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"A message of {self.recording.name}", FIELD_READS, ANYTHING, (FORMAT, FIELD))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Record"),)

    async def state(self) -> State:
        known = self.states.find(self.url, 0)
        if known is not None:
            return known
        message = await self.message()
        recording = self.recording
        decoded = await decode(self.session.schemas, message.sample)

        def plain() -> bytes:
            if decoded.schema is None or decoded.message is None:
                raise Problem(406, f"The message cannot be read: {decoded.reason}.")
            return lift_sample(self.session.space, self.session.lifting, decoded).lifter.json(decoded.message, self.url)

        def describe() -> Document:
            return record_document(self.session, recording, DecodedRecord(message, decoded))

        shapes = () if decoded.schema is None else self.session.space.shapes_of(decoded.schema)
        return self.states.put(self.url, 0, State(describe, plain, shapes=shapes))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """`?field=PATH`: the bytes of one field; or its picture or points, where that is preferred."""
        if cloud_is_preferred(exchange, is_cloud=False):
            sample = (await self.message()).sample
            return await cloud_response(self, self.session.schemas, self.pictures, self.url, sample, exchange)
        wanted = explicit_picture_type(exchange)
        if wanted is not None:
            message = await self.message()
            require_picture(message.topic, (message.sample.schema,))
            return await picture_response(
                self, self.session.schemas, self.pictures, self.url, message.sample, exchange, wanted
            )
        if "field" not in exchange.query:
            return None
        return await field_response(self.session.schemas, (await self.message()).sample, exchange.query["field"])


def _pages(recording: Recording) -> tuple[int, int]:
    """The first and the last page of a recording's messages."""
    return recording.first // PAGE, max(0, (recording.first + recording.count - 1) // PAGE)
