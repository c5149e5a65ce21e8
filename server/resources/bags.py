"""Recordings: `/bags/B/`, its messages in LDP pages, and each message under its own URL."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from starlette.responses import Response

from rosld.adapters.base import RecordedMessage, Recording, Watch
from rosld.adapters.model import NotFound, UnknownType
from rosld.ontology.describe_bags import bag_document, bag_message_document, bag_messages_document
from rosld.ontology.describe_containers import container_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Location
from rosld.server.html import SequenceLink
from rosld.server.http.link import Link
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.context import Robot
from rosld.server.resources.messages import decode, field_response, lift_sample
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import FIELD, FIELD_READS, FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, RESOURCE, Resource, permanent_redirect
from rosld.server.rest.state import State

PAGE = 100
"""Messages on one page of `/bags/B/messages/`."""

_PAGE = QueryParameter("page", "A page of messages, from 0.", {"type": "integer", "minimum": 0})


class BagContainer(Resource):
    """`/bags/`: the recordings of this source."""

    kind = "Bags"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.space.container("bags"))
        self.robot = robot

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem("The recordings")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Container"),)

    async def state(self) -> State:
        members = [self.robot.space.bag(name) for name in self.robot.recordings]
        return self.robot.states.get_or_make(
            self.url, len(members), lambda: State(lambda: container_document(self.url, members, "Recordings"))
        )


class BagResource(Resource):
    """One recording."""

    kind = "Bag"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot, recording: Recording) -> None:
        super().__init__(robot.space.bag(recording.name))
        self.robot = robot
        self.recording = recording

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"The recording {self.recording.name}")

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Bag"),)

    async def state(self) -> State:
        recording, space, history = self.recording, self.robot.space, self.robot.history
        is_history = recording is history.recording
        digest = None if is_history else history.digests.get(recording.path)
        dropped, problem = (history.dropped(), history.problem) if is_history else ({}, None)
        version = recording.first, recording.count, problem, sum(dropped.values()), digest
        describe = partial(bag_document, recording, space, digest, dropped=dropped, problem=problem)
        return self.robot.states.get_or_make(self.url, version, lambda: State(describe))

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        history = self.robot.history
        return None if self.recording is history.recording else history.digests.watch(self.recording.path, wake)


class BagMessages(Resource):
    """The messages of a recording: a container in pages (`?page=N` from 0; without it, links only)."""

    kind = "Messages"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)

    def __init__(self, robot: Robot, recording: Recording, page: int | None = None) -> None:
        base = robot.space.bag_messages(recording.name)
        super().__init__(base if page is None else f"{base}?page={page}")
        self.robot = robot
        self.recording = recording
        self.number = page

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"The messages of {self.recording.name}", query=(FORMAT, _PAGE))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Container"),)

    async def state(self) -> State:
        recording, space, page = self.recording, self.robot.space, self.number
        version = recording.first, recording.count
        return self.robot.states.get_or_make(
            self.url, version, lambda: State(lambda: bag_messages_document(recording, space, page, PAGE))
        )

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        base = self.robot.space.bag_messages(self.recording.name)
        first, last = _pages(self.recording)
        if self.number is None:
            places = {"first": first, "last": last}
        else:
            places = {"first": first, "prev": self.number - 1, "next": self.number + 1, "last": last}
        return tuple(SequenceLink(rel, f"{base}?page={at}") for rel, at in places.items() if first <= at <= last)

    async def select_variant(self, exchange: Exchange) -> Resource:
        """The page that `?page=` asks for; a 404 Problem where there is none."""
        wanted = exchange.query.get("page")
        if wanted is None:
            return self
        first, last = _pages(self.recording)
        if not (wanted.isascii() and wanted.isdigit()) or int(wanted) > last:
            raise Problem(404, f"?page={wanted}: the pages of {self.recording.name} are {first} to {last}.")
        if int(wanted) < first:
            raise Problem(410, f"?page={wanted}: the oldest messages were removed, the pages are {first} to {last}.")
        return BagMessages(self.robot, self.recording, int(wanted))


class BagMessage(Resource):
    """One message of a recording."""

    kind = "Recorded message"

    def __init__(self, robot: Robot, recording: Recording, index: int) -> None:
        super().__init__(robot.space.bag_message(recording.name, index))
        self.robot = robot
        self.recording = recording
        self.index = index
        self.title = f"{recording.name}, message {index}"
        self.links = (*Resource.links, *(Link(step.url, step.rel) for step in self.navigation_links()))

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """The messages before and after, first and last (RFC 8288)."""
        first, last = self.recording.first, self.recording.first + self.recording.count - 1
        places = {"first": first, "prev": self.index - 1, "next": self.index + 1, "last": last}
        links = ((rel, self.robot.space.bag_message(self.recording.name, at)) for rel, at in places.items())
        there = {rel for rel, at in places.items() if first <= at <= last}
        return tuple(SequenceLink(rel, url) for rel, url in links if rel in there)

    async def message(self) -> RecordedMessage:
        """The message, read off the loop; a 404 Problem where there is none."""
        try:
            message = await asyncio.to_thread(self.recording.message, self.index)
        except NotFound as error:
            raise Problem(410 if self.index < self.recording.first else 404, error.sentence) from error
        type = message.sample.schema
        if self.robot.schemas.find_cached(type) is None:
            with contextlib.suppress(UnknownType):
                self.robot.schemas.add(type, await asyncio.to_thread(self.recording.schema, type))
        return message

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return PathItem(f"A message of {self.recording.name}", FIELD_READS, ANYTHING, (FORMAT, FIELD))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.robot.space.document_shape("Record"),)

    async def state(self) -> State:
        known = self.robot.states.find(self.url, 0)
        if known is not None:
            return known
        message = await self.message()
        robot, recording = self.robot, self.recording
        decoded = await decode(robot, message.sample)

        def plain() -> bytes:
            if decoded.schema is None or decoded.message is None:
                raise Problem(406, f"The message cannot be read: {decoded.reason}.")
            return lift_sample(robot, decoded).lifter.json(decoded.message, self.url)

        def describe() -> Document:
            found = lift_sample(robot, decoded) if decoded.message is not None else None
            said = bag_message_document(recording, message, robot.space, found, unreadable=decoded.reason)
            return replace(said, simulated_time=robot.graph.simulated_time)

        shapes = () if decoded.schema is None else robot.space.shapes_of(decoded.schema)
        return robot.states.put(self.url, 0, State(describe, plain, shapes=shapes))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        if "field" not in exchange.query:
            return None
        return await field_response(self.robot, (await self.message()).sample, exchange.query["field"])


def bag_route(robot: Robot, location: Location) -> Resource:
    """`/bags/` and below."""
    match location.segments:
        case ():
            return BagContainer(robot) if location.is_container else _slash(robot, location)
        case (name,):
            recording = _recording(robot, name)
            return BagResource(robot, recording) if location.is_container else _slash(robot, location)
        case (name, "messages"):
            recording = _recording(robot, name)
            return BagMessages(robot, recording) if location.is_container else _slash(robot, location)
        case (name, "messages", index) if not location.is_container:
            recording = _recording(robot, name)
            first, beyond = recording.first, recording.first + recording.count
            is_number = index.isascii() and index.isdigit() and str(int(index)) == index
            if is_number and first <= int(index) < beyond:
                return BagMessage(robot, recording, int(index))
            if is_number and int(index) < first:
                raise Problem(410, f"Message {index} of {name} was removed: the oldest is {first}.")
            raise Problem(404, f"{name} has the messages {first} to {beyond - 1}, not {index}.")
    raise Problem(404, "Under /bags/B/ there is messages/ and nothing else.")


def _slash(robot: Robot, location: Location) -> Resource:
    url = robot.space.container("bags", location.segments)
    raise permanent_redirect(url)


def _recording(robot: Robot, name: str) -> Recording:
    found = robot.recordings.get(name)
    if found is None:
        raise Problem(404, f"There is no recording {name}.")
    return found


def _pages(recording: Recording) -> tuple[int, int]:
    """The first and the last page of a recording's messages."""
    return recording.first // PAGE, max(0, (recording.first + recording.count - 1) // PAGE)
