"""Recordings: finished, running, and waiting for a trigger."""

from __future__ import annotations

import asyncio
import contextlib
import math
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import ClassVar
from urllib.parse import quote

import orjson
from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import Literal
from starlette.responses import Response

from rosld.adapters.base import RecordedTopic, Recording, Watch
from rosld.adapters.catalogue import Catalogue, Row
from rosld.adapters.model import RosError
from rosld.ontology.describe_bags import BagView, bag_document
from rosld.ontology.describe_datasets import CROISSANT, structured_data
from rosld.ontology.document import Document
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ros
from rosld.server.auth.redaction import redact_document
from rosld.server.history.armed_recordings import ArmedRecording
from rosld.server.history.recordings import Recordings, RunningRecording
from rosld.server.html.forms import ChoiceForm, DeleteForm, Form
from rosld.server.html.page import Csrf, Figure, Notice, NoticeLevel, Page, SequenceLink
from rosld.server.html.site import Site
from rosld.server.html.timeline import PARTS, Mark, timeline_svg
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.fields import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import JsonSchema, MessageSchemas, json_object
from rosld.server.patches.single_change import PATCHES, SingleChange
from rosld.server.resources.annotations import ANNOTATIONS, Annotations, annotations_form, patch_of_form, read_patch
from rosld.server.resources.base import Services, SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS
from rosld.server.rest.path_item import FORMAT, PathItem, WriteMethod
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, READ, RESOURCE, Answer, Resource, ShownAnswer
from rosld.server.rest.responses import bytes_response
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import call_every, loop_time


class BagBase(SessionResource):
    """Base class of recordings and their parts."""

    is_cacheable = False

    def __init__(self, services: Services, url: str) -> None:
        super().__init__(services, url)
        self.recordings = services.recordings


class UnfinishedView(Struct, frozen=True):
    """Description of a recording that is not readable yet, because it is waiting for its trigger or running."""

    name: str
    topics: Mapping[str, RecordedTopic] = {}
    silent: Sequence[str] = ()
    count: int = 0
    start_ns: int = 0
    end_ns: int = 0
    first: int = 0
    format: str = "MCAP"


def bag_urls(space: Space, recordings: Recordings) -> tuple[str, ...]:
    """Return the URLs of all recordings, including running and waiting ones."""
    history = (recordings.history.recording.name,) if recordings.history.is_enabled else ()
    names = (*history, *recordings.catalogue.names(), *recordings.running, *recordings.armed)
    return tuple(map(space.bag, dict.fromkeys(names)))


def describe_bag(space: Space, recordings: Recordings, recording: Recording) -> Document:
    """Return the document of a readable recording."""
    history = recordings.history
    if recording is history.recording:
        return bag_document(BagView(recording, dropped=history.dropped(), problem=history.problem), space)
    catalogue, row = recordings.catalogue, recordings.catalogue.at(recording.path)
    size: int | None = None
    with contextlib.suppress(OSError):
        size = recording.path.stat().st_size if recording.path.is_file() else None
    why = recordings.interruptions.reason(recording.name)
    digest, status = history.digests.peek(recording.path), None if why is None else "interrupted"
    view = BagView(recording, digest, size=size, problem=why, status=status)
    if row is not None:
        if size is None and not row.is_own:
            view = view._replace(size=row.size, is_folder=True)
        view = view._replace(tags=catalogue.tags(row.id), events=catalogue.events(row.id))
    return bag_document(view, space)


def describe_row(space: Space, recordings: Recordings, name: str) -> Document:
    """Return the document of a catalogued recording, which may be damaged or missing."""
    recording, row = recordings.readable.get(name), recordings.catalogue.find(name)
    if recording is not None or row is None:
        return Document(space.bag(name), ()) if recording is None else describe_bag(space, recordings, recording)
    return _describe_lost(space, recordings.catalogue, row)


def _describe_lost(space: Space, catalogue: Catalogue, row: Row) -> Document:
    topics = {topic.name: topic for topic in catalogue.topics(row.id)}
    bag = UnfinishedView(row.name, topics, row.silent, row.count, row.start_ns, row.end_ns, 0, row.format or "unknown")
    problem, status = (f"{_MISSING}.", "missing") if row.is_missing else (row.problem, "damaged")
    return bag_document(
        BagView(
            bag,
            size=row.size,
            problem=problem,
            status=status,
            is_readable=False,
            tags=catalogue.tags(row.id),
            events=catalogue.events(row.id),
        ),
        space,
    )


_MISSING = "Its file has vanished, or its folder is not there"


def describe_running(space: Space, recordings: Recordings, one: RunningRecording) -> Document:
    """Return the document of a running recording."""
    writer = one.writer
    types, counts = writer.types, dict(writer.counts)
    topics = {topic: RecordedTopic(topic, types[topic], n) for topic, n in counts.items() if topic in types}
    view = BagView(
        UnfinishedView(one.name, topics, recordings.silent(one), writer.count, writer.start_ns, writer.end_ns),
        dropped=recordings.dropped(one),
        problem=writer.problem,
        size=writer.size,
        status="recording",
        order=one.order,
    )
    return bag_document(view, space)


def describe_armed(space: Space, one: ArmedRecording) -> Document:
    """Return the document of a recording waiting for its trigger."""
    status, problem = ("armed", one.problem) if one.suspended is None else ("suspended", one.suspended)
    view = BagView(UnfinishedView(one.name), problem=problem, status=status, order=one.order, triggered=one.count)
    return bag_document(view, space)


_TOPIC_BYTES = 200
"""Approximate bytes of a recording's document per topic."""


_CROISSANT, _JSON_LD = "croissant", Syntax.JSON_LD.media_type
_SVG = "svg"
_FORMAT = replace(FORMAT, schema={"type": "string", "enum": [*FORMATS, _CROISSANT, _SVG]})


class BagResource(BagBase):
    """One readable recording."""

    kind = "Recording"
    shape = "Bag"
    accepts: Mapping[str, Sequence[str]] = {"PATCH": PATCHES}
    in_turn = frozenset({"PATCH"})

    def __init__(self, services: Services, recording: Recording) -> None:
        super().__init__(services, services.space.bag(recording.name))
        self.recording = recording
        writes = {"PATCH": WriteMethod("Replaces its tags and events", sends=ANNOTATIONS)}
        self.item = PathItem(f"The recording {self.recording.name}", query=(_FORMAT,), writes=writes)
        croissant = Link(
            f"{self.url}?format={_CROISSANT}", "alternate", type=_JSON_LD, attributes=(("profile", CROISSANT),)
        )
        self.links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER, croissant)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the recording as a dataset in the profile Croissant, or its time line, if the client asks for it."""
        wanted = exchange.format
        if wanted == _SVG:
            return await self._timeline(exchange)
        if wanted != _CROISSANT and (wanted is not None or CROISSANT not in (exchange.accept or "")):
            return None
        document = redact_document((await self.state()).document, exchange.permissions)
        data = orjson.dumps(structured_data(document))
        return bytes_response(exchange, data, f'{_JSON_LD};profile="{CROISSANT}"', ETag(digest(data), _CROISSANT))

    async def _timeline(self, exchange: Exchange) -> Response:
        """Return the time line of the topics that the agent may read. Raises a 406 Problem for the history."""
        recording, row, catalogue = self.recording, self.row, self.recordings.catalogue
        try:
            density = await asyncio.to_thread(recording.density, PARTS)
        except RosError as error:
            raise problem_of(error) from error
        if not density or row is None:
            raise Problem(406, f"{recording.name} has no time line.")
        readable = {name: counts for name, counts in density.items() if exchange.permissions.may_read_topic(name)}
        marks = [Mark(*event) for event in catalogue.events(row.id)]
        data = timeline_svg(recording.start_ns, recording.end_ns, readable, marks).encode()
        return bytes_response(exchange, data, "image/svg+xml", ETag(digest(data), _SVG))

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        """Return its page with the time line, and links to the messages of each topic."""
        page = super().page(site, state, forms, csrf, notices)
        if not isinstance(page, Page) or not self.recording.count or self.row is None:
            return page
        topics = [name for name in self.recording.topics if site.may("GET", self.space.topic(name))]
        links = {name: f"messages/?topic={quote(name, safe='/')}" for name in topics}
        words = f"When each of {len(topics)} topics has messages, and when events were"
        return replace(page, figure=Figure(f"?format={_SVG}", words, links))

    def methods(self) -> frozenset[str]:
        if self.session.settings.read_only or self.recording is self.recordings.history.recording:
            return READ
        return READ | ({"PATCH", "DELETE"} if self.recording.name in self.recordings.finished else {"PATCH"})

    def deny_reason(self, method: str) -> str:
        if method in ("PATCH", "DELETE") and self.recording is self.recordings.history.recording:
            return (
                "The history runs as long as rosld, within --history-time and --history-size, and cannot be ended or "
                "deleted. POST to /bags/ to record its content."
            )
        return super().deny_reason(method)

    async def state(self) -> State:
        recording, history = self.recording, self.recordings.history
        is_history = recording is history.recording
        digest = None if is_history else history.digests.get(recording.path)
        trouble = (history.problem, sum(history.dropped().values())) if is_history else None
        why, row = self.recordings.interruptions.reason(recording.name), self.row
        noted = None if row is None else row.version
        version = recording.first, recording.count, recording.start_ns, trouble, digest, why, noted
        # not a partial, which another process would be asked to evaluate
        return self.states.get_or_make(
            self.url,
            version,
            lambda: State(
                lambda: describe_bag(self.space, self.recordings, recording),
                weight=len(recording.topics) * _TOPIC_BYTES,
            ),
        )

    @property
    def row(self) -> Row | None:
        """Its entry in the catalogue; the history has none."""
        is_history = self.recording is self.recordings.history.recording
        return None if is_history else self.recordings.catalogue.at(self.recording.path)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        history = self.recordings.history
        return None if self.recording is history.recording else history.digests.watch(self.recording.path, wake)

    async def forms(self) -> Sequence[Form]:
        row, methods = self.row, self.methods()
        tags = (
            () if row is None or "PATCH" not in methods else (annotations_form(self.recordings.catalogue.tags(row.id)),)
        )
        about = "The recording and its file are deleted."
        ends = (DeleteForm("Delete the recording", "Delete", about),) if "DELETE" in methods else ()
        return (*tags, *ends)

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """Return a link to download the recording if it is a single file."""
        is_file = self.recording is not self.recordings.history.recording and self.recording.path.is_file()
        return (SequenceLink("enclosure", f"{self.url}file"),) if is_file else ()

    async def patch(self, exchange: Exchange) -> Answer:
        """Replace tags and events, as a merge patch or a patch of its RDF has them. Raises a 507 Problem."""
        row, catalogue = self.row, self.recordings.catalogue
        if row is None:
            raise self.not_allowed("PATCH")
        before = Annotations(catalogue.tags(row.id), catalogue.events(row.id))
        document = describe_bag(self.space, self.recordings, self.recording)
        data = await exchange.body()
        if exchange.typed:
            data = patch_of_form(data, before)
        after = read_patch(data, exchange.media_type, self.url, document.triples, before)
        try:
            await self.recordings.annotate(row, after.tags, after.events)
        except sqlite3.Error as error:
            raise Problem(507, f"The tags and events cannot be stored: {error}.") from error
        return ShownAnswer(self, await self.state())

    async def delete(self, exchange: Exchange) -> Answer:
        """Delete the recording and its file."""
        await self.recordings.delete(self.recording.name)
        return Response(status_code=204)


class LostBag(BagBase):
    """A catalogued recording that is damaged or missing. DELETE forgets a missing one."""

    kind = "Recording that cannot be read"
    shape = "Bag"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, services: Services, row: Row) -> None:
        super().__init__(services, services.space.bag(row.name))
        self.row = row
        self.item = PathItem(f"The recording {row.name}, which cannot be read")

    def methods(self) -> frozenset[str]:
        return READ | {"DELETE"} if self.row.is_missing and not self.session.settings.read_only else READ

    async def state(self) -> State:
        return State(partial(_describe_lost, self.space, self.recordings.catalogue, self.row))

    async def forms(self) -> Sequence[Form]:
        about = "Its name, tags and events are deleted. If its file returns, it is new."
        return (DeleteForm("Forget the recording", "Forget", about),) if "DELETE" in self.methods() else ()

    async def delete(self, exchange: Exchange) -> Answer:
        """Forget the recording."""
        await self.recordings.forget(self.row)
        return Response(status_code=204)


_WORDS = 'A recording can only be ended: send {"status": "ended"}, or have ros:recordingStatus be "ended".'
_END = SingleChange({"status": "ended"}, ros.recordingStatus, Literal("ended"), _WORDS)


_LOOK_SECONDS = 1.0
"""Seconds between updates to clients that follow a running recording."""


class UnfinishedBag(BagBase):
    """A recording that is not complete: PATCH ends it."""

    shape = "Bag"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"PATCH": PATCHES}
    writes: ClassVar[frozenset[str]] = frozenset({"PATCH", "DELETE"})

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, services.space.bag(name))
        self.name = name

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        ends: JsonSchema = json_object({"status": {"const": "ended"}})
        return PathItem(f"The recording {self.name}", writes={"PATCH": WriteMethod("Ends it", sends=ends)})


class RunningBag(UnfinishedBag):
    """A running recording and its progress. PATCH ends it, DELETE discards it."""

    kind = "Running recording"

    def __init__(self, services: Services, one: RunningRecording) -> None:
        super().__init__(services, one.name)
        self.one = one

    @property
    def _finished(self) -> Resource | None:
        """The readable recording once it has ended, so that clients that follow it see the end; else None."""
        recording = self.recordings.readable.get(self.one.name)
        return None if recording is None else BagResource(self.services, recording)

    async def state(self) -> State:
        if self._finished is not None:
            return await self._finished.state()
        if self.one.name not in self.recordings.running:
            raise Problem(410, f"The recording {self.one.name} was deleted.")
        writer, describe = self.one.writer, partial(describe_running, self.space, self.recordings, self.one)
        text = f"{writer.count} {writer.size} {writer.problem} {len(writer.types)} {self._seconds_left}"
        return State(describe, token=digest(text.encode("utf-8", "replace")))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return call_every(_LOOK_SECONDS, wake)

    @property
    def _seconds_left(self) -> int | None:
        """The seconds until the recording ends by itself, or None if it does not."""
        ends_at = self.one.ends_at
        return None if ends_at is None else max(0, math.ceil(ends_at - loop_time()))

    def page(
        self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]
    ) -> Page | bytes:
        finished, writer = self._finished, self.one.writer
        if finished is not None:
            return finished.page(site, state, forms, csrf, notices)
        left = "until it is ended" if self._seconds_left is None else f"{self._seconds_left} s are left"
        counted = f"{writer.count:,} messages of {len(writer.counts)} topics, {writer.size / 1e6:,.1f} MB"
        notice = Notice(f"Recording, {left}: {counted}", NoticeLevel.INFO, is_lasting=True)
        return super().page(site, state, forms, csrf, (notice, *notices))

    async def patch(self, exchange: Exchange) -> Answer:
        """End the recording with `{"status": "ended"}`, or with "ended" as its new `ros:recordingStatus`.

        Returns the recording. Raises a 507 Problem if it could not be completed.
        """
        before = describe_running(self.space, self.recordings, self.one).triples
        _END.require(await exchange.body(), exchange.media_type, self.url, before)
        await self.recordings.end(self.one.name)
        resource = self._finished
        if resource is None:
            raise Problem(507, self.one.writer.problem or f"The recording {self.one.name} could not be completed.")
        return ShownAnswer(resource, await resource.state())

    async def forms(self) -> Sequence[Form]:
        if self._finished is not None:
            return await self._finished.forms()
        if "PATCH" not in self.methods():
            return ()
        about = "It can then be read."
        end = ChoiceForm(
            "status", ("ended",), "End the recording", method="PATCH", about=about, labels={"ended": "End"}
        )
        return (end, DeleteForm("Delete the recording", "Delete", "It is ended and deleted."))

    async def delete(self, exchange: Exchange) -> Answer:
        """End the recording and delete its file."""
        await self.recordings.delete(self.one.name)
        return Response(status_code=204)


class ArmedBag(UnfinishedBag):
    """A recording waiting for its trigger. PATCH and DELETE cancel it."""

    kind = "Recording that waits for its trigger"

    def __init__(self, services: Services, one: ArmedRecording) -> None:
        super().__init__(services, one.name)
        self.one = one

    async def state(self) -> State:
        return State(partial(describe_armed, self.space, self.one))

    async def forms(self) -> Sequence[Form]:
        about = "It stops waiting for its trigger. Recordings already started are kept."
        return (DeleteForm("Disarm", "Disarm", about),) if "DELETE" in self.methods() else ()

    async def patch(self, exchange: Exchange) -> Answer:
        """Cancel the recording."""
        before = describe_armed(self.space, self.one).triples
        _END.require(await exchange.body(), exchange.media_type, self.url, before)
        return await self.delete(exchange)

    async def delete(self, exchange: Exchange) -> Answer:
        """Cancel the recording."""
        try:
            await self.recordings.disarm(self.one.name)
        except OSError as error:
            raise Problem(507, f"Disarming the recording cannot be stored: {error.strerror or error}.") from error
        return Response(status_code=204)
