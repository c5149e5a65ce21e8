"""Recordings that are not complete: being made, or waiting for their trigger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from starlette.responses import Response

from rosld.ontology.urls import Space
from rosld.server.history.armed_recordings import ArmedRecording
from rosld.server.history.recordings import Recordings, RunningRecording
from rosld.server.html import ChoiceForm, DeleteForm, Form
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
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings


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
        """End it: `{"status": "ended"}`, or that `ros:recordingStatus` is "ended" from now on.

        Answers with the recording, or a 507 Problem where it could not be completed.
        """
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
        try:
            await self.recordings.disarm(self.one.name)
        except OSError as error:
            raise Problem(507, f"That it waits no more cannot be stored: {error.strerror or error}.") from error
        return Response(status_code=204)
