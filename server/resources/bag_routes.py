"""The container of recordings, which starts those that are posted to it, and the routes below it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from rosld.adapters.base import Recording
from rosld.ontology.describe_graph import container_document
from rosld.ontology.urls import Location
from rosld.server.history.recording_orders import RecordingOrder, RecordingRefused
from rosld.server.history.recordings import Recordings
from rosld.server.html.forms import Form
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import MessageSchemas
from rosld.server.resources.bag_files import BagFile, BagUpload, UnreadableBag
from rosld.server.resources.bag_messages import BagMessage, BagMessages, bag_moment
from rosld.server.resources.bags import ArmedBag, BagBase, BagResource, Bags, RunningBag, bag_urls
from rosld.server.resources.event_stream import EventStreamResource, event_stream_page
from rosld.server.resources.recording_order import MEDIA_TYPES, SCHEMA, read_order, recording_form
from rosld.server.resources.recording_trigger import (
    NOTHING_IS_RECORDED,
    RecordingTriggers,
    can_record,
    may_read_topic,
    require_topics,
    urls_of,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import (
    BASIC_CONTAINER,
    RDF_SOURCE,
    READ,
    RESOURCE,
    Answer,
    CreatedAnswer,
    Resource,
    permanent_redirect,
)
from rosld.server.rest.state import State


class BagContainer(BagBase):
    """`/bags/`: the recordings of this source, the history, and those that clients make or send."""

    kind = "Recordings"
    shape = "Container"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"POST": MEDIA_TYPES}

    is_cacheable = True

    def __init__(self, bags: Bags, triggers: RecordingTriggers | None = None) -> None:
        """`triggers` follows what a recording may wait for; without it none can."""
        super().__init__(bags, bags.session.space.container("bags"))
        self._triggers = triggers

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        space = self.space
        return (recording_form({name: space.topic(name) for name in self.session.graph.topics}),)

    def methods(self) -> frozenset[str]:
        is_open = can_record(self.session.settings, self.session.adapter.capabilities)
        return READ | {"POST"} if is_open else READ

    def deny_reason(self, method: str) -> str:
        if method == "POST":
            return NOTHING_IS_RECORDED
        return super().deny_reason(method)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        post = WriteMethod("Records topics, the last seconds of the history before them", sends=SCHEMA, done=(201,))
        return PathItem("The recordings", writes={"POST": post})

    @property
    def constrained_by(self) -> str | None:
        return self.space.shape("recording")

    async def state(self) -> State:
        members = bag_urls(self.space, self.recordings)
        version = members, tuple(self.session.graph.topics)  # the page has a form that names them
        return self.states.get_or_make(
            self.url, version, lambda: State(lambda: container_document(self.url, members, "Recordings"))
        )

    async def post(self, exchange: Exchange) -> Answer:
        """Begin a recording of topics that who asks may read, or have it wait for its trigger: 201 with either.

        Raises a 403 Problem for a topic that must not be read, 409 where the name is taken, 507 where nothing can be
        stored.
        """
        order = await self._read_order(exchange)
        try:
            resource = await self._begin(order, exchange)
        except RecordingRefused as error:
            raise Problem(409 if error.taken else 422, f"{error}.") from error
        except OSError as error:
            raise Problem(507, f"The recording cannot be stored: {error.strerror or error}.") from error
        return CreatedAnswer(resource.url, resource, await resource.state())

    async def _read_order(self, exchange: Exchange) -> RecordingOrder:
        """Return the order in a body and `Slug`. Raises a 403 Problem for a topic that must not be read."""
        order = read_order(await exchange.body(), exchange.media_type, self.url, is_form=bool(exchange.typed))
        slug = exchange.header("slug")
        if order.name is None and slug is not None and self.recordings.can_be_named(slug):
            order = replace(order, name=slug)
        space = self.space
        exchange.audit.add_step(f"record {', '.join(order.topics)}", *urls_of(order, space))
        require_topics(order, exchange.permissions, space)
        return order

    async def _begin(self, order: RecordingOrder, exchange: Exchange) -> RunningBag | ArmedBag:
        """Return the recording that was begun, or that waits for its trigger. Raises RecordingRefused, OSError."""
        if order.trigger is None:
            may_record = partial(may_read_topic, self.space, exchange.permissions)
            return RunningBag(self.bags, self.recordings.begin(order, may_record))
        if self._triggers is None:
            raise RecordingRefused("nothing waits for triggers here")
        await self._triggers.follow(order, exchange.permissions)
        armed = await self.recordings.arm(order, exchange.agent, self._triggers.occurrences)
        return ArmedBag(self.bags, armed)


def bag_route(bags: Bags, location: Location, *, triggers: RecordingTriggers | None = None) -> Resource:
    """Return the resource at `/bags/` or below. Raises a 404 Problem, or 308 if only the slash differs."""
    space, recordings = bags.session.space, bags.recordings
    match location.segments, location.is_container:
        case (), True:
            return BagContainer(bags, triggers)
        case (name,), False:
            return BagUpload(bags, name)
        case (name,), True:
            return _bag(bags, name)
        case (name, "file"), False:
            return BagFile(bags, _recording(recordings, name))
        case (name, "at"), False:
            return bag_moment(bags, _recording(recordings, name))
        case (name, "ldes"), False:
            return EventStreamResource(bags, _recording(recordings, name))
        case (name, "ldes"), True:  # where the breadcrumb of a page of the stream leads
            raise permanent_redirect(space.bag_stream(name))
        case (name, "ldes", page), False:
            return event_stream_page(bags, _recording(recordings, name), page)
        case (name, "messages"), True:
            return BagMessages(bags, _recording(recordings, name))
        case (name, "messages", index), False:
            recording = _recording(recordings, name)
            return BagMessage(bags, recording, _message_index(recording, index))
        case (), False:
            raise permanent_redirect(space.container("bags"))
        case (name, "messages"), False:
            raise permanent_redirect(space.bag_messages(_recording(recordings, name).name))
    raise Problem(404, "Under /bags/B/ there are messages/, ldes, at and file, and nothing else.")


def _bag(bags: Bags, name: str) -> Resource:
    """Return the recording of a name, in any state. Raises a 404 Problem if there is none."""
    recordings = bags.recordings
    if name in recordings.armed:
        return ArmedBag(bags, recordings.armed[name])
    if name in recordings.unreadable:
        return UnreadableBag(bags, name)
    running = recordings.running.get(name)
    return BagResource(bags, _recording(recordings, name)) if running is None else RunningBag(bags, running)


def _message_index(recording: Recording, segment: str) -> int:
    """Return the index of an existing message. Raises a 410 Problem if it was removed, else 404."""
    first, beyond = recording.first, recording.first + recording.count
    is_number = segment.isascii() and segment.isdigit() and str(int(segment)) == segment
    if is_number and first <= int(segment) < beyond:
        return int(segment)
    if is_number and int(segment) < first:
        raise Problem(410, f"Message {segment} of {recording.name} was removed: the oldest is {first}.")
    raise Problem(404, f"{recording.name} has the messages {first} to {beyond - 1}, not {segment}.")


def _recording(recordings: Recordings, name: str) -> Recording:
    found = recordings.readable.get(name)
    if found is None and name in recordings.armed:
        raise Problem(404, f"The recording {name} waits for its trigger: it has no messages yet.")
    if found is None and name in recordings.running:
        raise Problem(404, f'The recording {name} is still being made: PATCH it with {{"status": "ended"}} first.')
    if found is None:
        raise Problem(404, f"There is no recording {name}: /bags/ lists those that there are.")
    return found
