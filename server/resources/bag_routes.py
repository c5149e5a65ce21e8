"""Container of recordings, their files and uploads, and the routes below `/bags/`."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Mapping, Sequence
from functools import partial
from io import FileIO
from pathlib import Path
from typing import ClassVar

from msgspec.structs import replace
from starlette.responses import Response

from rosld.adapters.base import Recording
from rosld.adapters.model import Encoding, RosError
from rosld.ontology.urls import Location
from rosld.server.history.bag_export import EXPORT_FORMATS, CannotExport, ExportFormat, require_encoding
from rosld.server.history.cut import CutRefused, selected
from rosld.server.history.recording_orders import RecordingOrder, RecordingRefused
from rosld.server.history.recordings import Recordings
from rosld.server.html.forms import Form
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.resources.bag_listing import FILTERS, ListedBags
from rosld.server.resources.bag_messages import BagMessage, BagMessages, bag_moment
from rosld.server.resources.bags import ArmedBag, BagBase, BagResource, LostBag, RunningBag
from rosld.server.resources.base import Services
from rosld.server.resources.event_stream import EventStreamResource, event_stream_page
from rosld.server.resources.ldp.bodies import single_chunk
from rosld.server.resources.past_messages import may_read_recording
from rosld.server.resources.recording_cut import CutOrder, asking, cut_order_of, spans_of
from rosld.server.resources.recording_order import MEDIA_TYPES, SCHEMA, order_of, read_members, recording_form
from rosld.server.resources.recording_trigger import (
    RecordingTriggers,
    can_record,
    may_read_topic,
    require_topics,
    urls_of,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import ANY_TYPE, BYTES, FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import (
    ABSENT,
    BASIC_CONTAINER,
    RDF_SOURCE,
    READ,
    RESOURCE,
    Answer,
    CreatedAnswer,
    Resource,
    permanent_redirect,
)
from rosld.server.rest.responses import UNKNOWN, cancel_on_disconnect, file_response, file_stream, resource_headers
from rosld.server.rest.ros_problems import problem_of
from rosld.server.rest.state import State

_EXPORTED = tuple(each.media_type for each in EXPORT_FORMATS.values())
_FORMAT = QueryParameter(
    "format",
    "Converted, before Accept: " + "; ".join(f"`{one.name}` is {one.about}" for one in EXPORT_FORMATS.values()) + ".",
    {"type": "string", "enum": [*EXPORT_FORMATS]},
)


class BagFile(BagBase):
    """The bytes of a recording, whole or in ranges, or converted into a bag of ROS 1 or ROS 2."""

    kind = "File of a recording"
    links = (RESOURCE,)

    def __init__(self, services: Services, recording: Recording) -> None:
        super().__init__(services, f"{services.space.bag(recording.name)}file")
        self.recording = recording

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        reads, about = (BYTES, *_EXPORTED), f"The file of {self.recording.name}"
        return PathItem(about, reads=reads, query=(_FORMAT,), streams=False)

    async def state(self) -> State:
        raise Problem(406, "The file of a recording is available only as its bytes.")

    async def custom_get(self, exchange: Exchange) -> Response | None:
        path, found = self.recording.path, await asyncio.to_thread(_file_status, self.recording.path)
        if found is None:
            raise Problem(
                404, f"{self.recording.name} is not a single file: POST to /bags/ to create one from its content."
            )
        wanted = self._wanted(exchange)
        etag = ETag(digest(f"{found.st_size} {found.st_mtime_ns}".encode()), "bin" if wanted is None else wanted.name)
        headers = {**resource_headers(self), "vary": "Accept", "cache-control": "no-cache"}
        if exchange.check_preconditions(etag):
            return Response(status_code=304, headers={**headers, "etag": str(etag)})
        if wanted is not None:
            return await self._export(exchange, wanted, {**headers, "etag": str(etag)})
        try:
            return await file_response(
                path,
                found.st_size,
                UNKNOWN,
                str(etag),
                headers=headers,
                name=path.name,
                range_=exchange.header("range"),
                if_range=exchange.header("if-range"),
                head=exchange.method == "HEAD",
            )
        except FileNotFoundError as error:
            raise Problem(410, f"{self.recording.name} has just been deleted.") from error

    @property
    def _encoding(self) -> Encoding:
        return self.recording.encoding

    def _wanted(self, exchange: Exchange) -> ExportFormat | None:
        """Return the requested format to convert to, or None for the original file. Raises a 406 Problem."""
        name = exchange.format
        if name is None:
            own = [each.media_type for each in EXPORT_FORMATS.values() if each.encoding is self._encoding]
            media_type = choose_offer(exchange.accept, (UNKNOWN, *own))
            media_type = media_type or choose_offer(exchange.accept, _EXPORTED)  # a refused conversion gives the reason
            return next((one for one in EXPORT_FORMATS.values() if one.media_type == media_type), None)
        if name not in EXPORT_FORMATS:
            others = " and ".join(f"?format={each}" for each in EXPORT_FORMATS)
            raise Problem(
                406, f"?format={name[:40]} is unknown: there are {others}, and omit it for the original file."
            )
        return EXPORT_FORMATS[name]

    async def _export(self, exchange: Exchange, wanted: ExportFormat, headers: Mapping[str, str]) -> Response:
        """Return the converted recording. Raises Problems: 406, 410, 503, 507."""
        recording = self.recording
        shown = {
            **headers,
            "content-type": wanted.media_type,
            "content-disposition": f'attachment; filename="{recording.name}{wanted.suffix}"',
            "x-content-type-options": "nosniff",
        }
        try:
            encoding = self._encoding
            if encoding is wanted.encoding and recording.path.suffix == wanted.suffix:
                file = await asyncio.to_thread(FileIO, recording.path)  # the file already has the format
            else:
                require_encoding(recording.name, encoding, wanted)
                if exchange.method == "HEAD":
                    return Response(headers=shown)
                file = await cancel_on_disconnect(exchange.receive, self.recordings.export(recording, wanted))
        except CannotExport as error:
            raise Problem(406, f"{str(error)[:1].upper()}{str(error)[1:]}.") from error
        except FileNotFoundError as error:
            raise Problem(410, f"{recording.name} has just been deleted.") from error
        except OSError as error:
            raise Problem(507, f"The recording cannot be converted: {error.strerror or error}.") from error
        except RosError as error:
            raise problem_of(error) from error
        size = os.fstat(file.fileno()).st_size
        raw = [(name.encode(), value.encode()) for name, value in {**shown, "content-length": str(size)}.items()]
        return file_stream(raw, file, size)


class BagUpload(BagBase):
    """`/bags/NAME` without a final slash: target of uploads; the recording itself has the slash."""

    kind = "Recording to upload"
    takes_forms = False

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, services.space.url("bags", (name,)))
        self.name = name

    def methods(self) -> frozenset[str]:
        is_there = self._is_there
        sent = frozenset[str]() if self.session.settings.read_only else frozenset({"PUT"})
        return (READ if is_there else ABSENT) | sent

    @property
    def _is_there(self) -> bool:
        bags = self.recordings
        return self.name in self.recordings.readable or self.name in bags.running or self.name in bags.armed

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        put = WriteMethod(
            "Uploads a recording: a ROS 1 bag, an MCAP file or a ROS 2 database, optionally compressed with zstd.",
            done=(201,),
            accepts=(ANY_TYPE,),
        )
        return PathItem("Upload of a recording", writes={"PUT": put})

    def streams_body(self, exchange: Exchange) -> bool:
        return exchange.method == "PUT"

    async def state(self) -> State:
        if self._is_there:
            raise permanent_redirect(self.space.bag(self.name))
        raise Problem(404, f"There is no recording {self.name}.")

    async def put(self, exchange: Exchange) -> Answer:
        """Stream a recording from the body: 201 once it is readable.

        Raises a 409 Problem if the name is taken, 422 if the body is not a recording, 507 if it cannot be stored.
        """
        limit, whole = self.session.settings.upload_limit, exchange.consumed_body
        chunks = exchange.chunks(limit=limit) if whole is None else single_chunk(whole)
        try:
            await self.recordings.receive(self.name, chunks)
        except RecordingRefused as error:
            status = 409 if error.is_conflict else 413 if error.is_too_large else 422
            raise Problem(status, f"{error}.") from error
        except OSError as error:
            raise Problem(507, f"The recording cannot be stored: {error.strerror or error}.") from error
        resource = BagResource(self.services, self.recordings.readable[self.name])
        return CreatedAnswer(resource.url, resource, await resource.state())


class UnreadableBag(BagBase):
    """`/bags/NAME/` of a file that cannot be opened, which occupies the name until DELETE removes it."""

    kind = "File that cannot be opened"

    def __init__(self, services: Services, name: str) -> None:
        super().__init__(services, services.space.bag(name))
        self.name = name
        self.item = PathItem(f"The file {self.name}, which cannot be opened")

    def methods(self) -> frozenset[str]:
        return ABSENT if self.session.settings.read_only else ABSENT | {"DELETE"}

    async def state(self) -> State:
        raise Problem(404, f"{self.recordings.unreadable[self.name].problem}. DELETE removes its file.")

    async def delete(self, exchange: Exchange) -> Answer:
        """Delete the file."""
        await self.recordings.delete(self.name)
        return Response(status_code=204)


def _file_status(path: Path) -> os.stat_result | None:
    """Return the status of a file, or None if there is none at the path."""
    try:
        return path.stat() if path.is_file() else None
    except OSError:
        return None


class BagContainer(ListedBags):
    """`/bags/`: the recordings of this source, the history, and recordings that clients start or upload."""

    kind = "Recordings"
    shape = "Container"
    constraint = "recording"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"POST": MEDIA_TYPES}
    writes: ClassVar[frozenset[str]] = frozenset({"POST"})
    is_cacheable = True

    def __init__(self, services: Services, triggers: RecordingTriggers | None = None) -> None:
        """`triggers` follows the triggers of recordings; without it, they are refused."""
        super().__init__(services, services.space.container("bags"))
        self._triggers = triggers

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        space = self.space
        only_cuts = not can_record(self.session.settings, self.session.adapter.capabilities)
        return (recording_form({name: space.topic(name) for name in self.session.graph.topics}, only_cuts=only_cuts),)

    def deny_reason(self, method: str) -> str:
        if method == "POST":
            return "This server is read-only: it makes no recordings."
        return super().deny_reason(method)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        post = WriteMethod(
            "Records topics, with the last seconds of the history on request, or cuts a recording",
            sends=SCHEMA,
            done=(201,),
        )
        return PathItem("The recordings", query=(FORMAT, *FILTERS), writes={"POST": post}, is_paged=True)

    async def post(self, exchange: Exchange) -> Answer:
        """Start a recording of topics that the agent may read, let it wait for its trigger, or cut another one: 201.

        Raises a 403 Problem for a topic that the agent may not read, 409 if the name is taken, 507 if storing fails.
        """
        body = await exchange.body()
        members = read_members(body, exchange.media_type, self.url, is_form=bool(exchange.typed))
        try:
            resource: BagResource | RunningBag | ArmedBag
            if "of" in members:
                order = cut_order_of(members)
                resource = await self._cut(order._replace(selection=self._allowed(order.selection, exchange)), exchange)
            else:
                resource = await self._begin(self._allowed(order_of(members), exchange), exchange)
        except RecordingRefused as error:
            raise Problem(409 if error.is_conflict else 422, f"{error}.") from error
        except CutRefused as error:
            raise Problem(422, f"{str(error)[:1].upper()}{str(error)[1:]}.") from error
        except RosError as error:
            raise problem_of(error) from error
        except OSError as error:
            raise Problem(507, f"The recording cannot be stored: {error.strerror or error}.") from error
        return CreatedAnswer(resource.url, resource, await resource.state())

    def _allowed(self, order: RecordingOrder, exchange: Exchange) -> RecordingOrder:
        """Return an order, named by `Slug`. Raises a 403 Problem for a topic that the agent may not read."""
        slug = exchange.header("slug")
        if order.name is None and slug is not None and self.recordings.can_be_named(slug):
            order = replace(order, name=slug)
        space = self.space
        exchange.audit.add_step(f"record {', '.join(order.topics)}", *urls_of(order, space))
        require_topics(order, exchange.permissions, space)
        return order

    async def _begin(self, order: RecordingOrder, exchange: Exchange) -> RunningBag | ArmedBag:
        """Start a recording, or let it wait for its trigger, and return it. Raises RecordingRefused, OSError."""
        if not can_record(self.session.settings, self.session.adapter.capabilities):
            raise RecordingRefused("this server has nothing live to record: use `of` to cut a recording")
        if order.trigger is None:
            may_record = partial(may_read_topic, self.space, exchange.permissions)
            return RunningBag(self.services, self.recordings.begin(order, may_record))
        if self._triggers is None:
            raise RecordingRefused("triggers are not available on this server")
        await self._triggers.follow(order, exchange.permissions)
        armed = await self.recordings.arm(order, exchange.agent, self._triggers.occurrences)
        return ArmedBag(self.services, armed)

    async def _cut(self, order: CutOrder, exchange: Exchange) -> BagResource:
        """Cut a recording that the agent may read, and return the first cut.

        Raises RecordingRefused, CutRefused, OSError, RosError and Problems.
        """
        space, permissions, recording = self.space, exchange.permissions, self.recordings.find(order.of)
        if recording is None or not may_read_recording(space, permissions, recording):
            raise Problem(422, f"There is no recording {order.of[:100]} to cut.")
        selects, may_record = selected(order.selection.topics), partial(may_read_topic, space, permissions)
        spans = await spans_of(order, recording, asking(self.services.sparql, permissions), may_record)
        cuts = self.recordings.cut(
            recording, order.selection.name, lambda topic: selects(topic) and may_record(topic), spans
        )
        names = await asyncio.shield(asyncio.ensure_future(cuts))
        return BagResource(self.services, self.recordings.finished[names[0]])


def bag_route(services: Services, location: Location, *, triggers: RecordingTriggers | None = None) -> Resource:
    """Return the resource at `/bags/` or below. Raises a 404 Problem, or 308 if only the slash differs."""
    space, recordings = services.space, services.recordings
    match location.segments, location.is_container:
        case (), True:
            return BagContainer(services, triggers)
        case (name,), False:
            return BagUpload(services, name)
        case (name,), True:
            return _bag(services, name)
        case (name, "file"), False:
            return BagFile(services, _recording(recordings, name))
        case (name, "at"), False:
            return bag_moment(services, _recording(recordings, name))
        case (name, "ldes"), False:
            return EventStreamResource(services, _recording(recordings, name))
        case (name, "ldes"), True:  # target of the breadcrumb on pages of the stream
            raise permanent_redirect(space.bag_stream(name))
        case (name, "ldes", page), False:
            return event_stream_page(services, _recording(recordings, name), page)
        case (name, "messages"), True:
            return BagMessages(services, _recording(recordings, name))
        case (name, "messages", index), False:
            recording = _recording(recordings, name)
            return BagMessage(services, recording, _message_index(recording, index))
        case (), False:
            raise permanent_redirect(space.container("bags"))
        case (name, "messages"), False:
            raise permanent_redirect(space.bag_messages(_recording(recordings, name).name))
    raise Problem(404, "There is no such resource: /bags/NAME/ has only messages/, ldes, at and file.")


def _bag(services: Services, name: str) -> Resource:
    """Return the recording of a name, in any state. Raises a 404 Problem if there is none."""
    recordings = services.recordings
    if name in recordings.armed:
        return ArmedBag(services, recordings.armed[name])
    if name in recordings.unreadable:
        return UnreadableBag(services, name)
    row = recordings.catalogue.find(name)
    if row is not None and not row.is_readable and name not in recordings.readable:
        return LostBag(services, row)
    running = recordings.running.get(name)
    return BagResource(services, _recording(recordings, name)) if running is None else RunningBag(services, running)


def _message_index(recording: Recording, segment: str) -> int:
    """Return the index of an existing message. Raises a 410 Problem if it was removed, else 404."""
    first, beyond = recording.first, recording.first + recording.count
    is_number = segment.isascii() and segment.isdigit() and str(int(segment)) == segment
    if is_number and first <= int(segment) < beyond:
        return int(segment)
    if is_number and int(segment) < first:
        raise Problem(410, f"Message {segment} of {recording.name} was removed: the oldest is {first}.")
    raise Problem(404, f"{recording.name} has no message {segment}: its messages are {first} to {beyond - 1}.")


def _recording(recordings: Recordings, name: str) -> Recording:
    found = recordings.readable.get(name)
    if found is None and name in recordings.armed:
        raise Problem(404, f"The recording {name} is waiting for its trigger: it has no messages yet.")
    if found is None and name in recordings.running:
        raise Problem(404, f'The recording {name} is still running: PATCH it with {{"status": "ended"}} first.')
    row = recordings.catalogue.find(name) if found is None else None
    if row is not None:
        raise Problem(404, f"The recording {name} cannot be read: {row.problem or 'its file has vanished'}.")
    if found is None:
        raise Problem(404, f"There is no recording {name}: /bags/ lists the recordings.")
    return found
