"""Recordings that are not complete: being made, or waiting for their trigger."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.urls import Space
from rosld.server.history.armed_recordings import ArmedRecording
from rosld.server.history.recordings import Recordings, RunningRecording
from rosld.server.html.forms import ChoiceForm, DeleteForm, Form
from rosld.server.html.page import Csrf, Notice, NoticeLevel, Page
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.data_schema import DataSchema
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.bag_descriptions import describe_armed, describe_running
from rosld.server.resources.bags import BagResource
from rosld.server.resources.recording_patch import PATCHES, require_end
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, READ, RESOURCE, Answer, Resource, ShownAnswer
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import call_every, loop_time
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings

_LOOK_SECONDS = 1.0
"""Between two looks of those who follow a recording that is being made."""


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

    @property
    def _finished(self) -> Resource | None:
        """The recording as it can be read, once it has ended: who follows it sees it end."""
        recording = self.recordings.readable.get(self.one.name)
        if recording is None:
            return None
        return BagResource(self.space, self.settings, self.states, self.recordings, recording)

    async def state(self) -> State:
        if self._finished is not None:
            return await self._finished.state()
        if self.one.name not in self.recordings.running:
            raise Problem(410, f"The recording {self.one.name} was deleted.")
        writer, describe = self.one.writer, partial(describe_running, self.space, self.recordings, self.one)
        said = f"{writer.count} {writer.size} {writer.problem} {len(writer.types)} {self._seconds_left}"
        return State(describe, token=digest(said.encode("utf-8", "replace")))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return call_every(_LOOK_SECONDS, wake)

    @property
    def _seconds_left(self) -> int | None:
        """The seconds until it ends by itself, None where it does not."""
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
        told = Notice(f"Recording, {left}: {counted}", NoticeLevel.INFO, is_lasting=True)
        return super().page(site, state, forms, csrf, (told, *notices))

    async def patch(self, exchange: Exchange) -> Answer:
        """End it: `{"status": "ended"}`, or that `ros:recordingStatus` is "ended" from now on.

        Answers with the recording, or a 507 Problem where it could not be completed.
        """
        before = describe_running(self.space, self.recordings, self.one).triples
        require_end(await exchange.body(), exchange.media_type, self.url, before)
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
        try:
            await self.recordings.disarm(self.one.name)
        except OSError as error:
            raise Problem(507, f"That it waits no more cannot be stored: {error.strerror or error}.") from error
        return Response(status_code=204)
