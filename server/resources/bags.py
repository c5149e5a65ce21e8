"""Recordings: `/bags/B/`, made by POST to `/bags/`, its messages in LDP pages, and each under its own URL."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from starlette.responses import Response

from rosld.adapters.base import Recording, Watch
from rosld.ontology.urls import Space
from rosld.server.history.recordings import Recordings
from rosld.server.html.forms import DeleteForm, Form
from rosld.server.html.page import SequenceLink
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.bag_descriptions import describe_bag
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, READ, RESOURCE, Answer, Resource
from rosld.server.rest.state import State
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings

_TOPIC_BYTES = 200
"""Bytes that a recording says of a topic."""


class BagResource(Resource):
    """One recording that can be read."""

    kind = "Recording"
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

    def deny_reason(self, method: str) -> str:
        if method in ("PATCH", "DELETE") and self.recording is self.recordings.history.recording:
            return (
                "The history goes on while rosld runs, within --history-time and --history-size: it is neither ended "
                "nor deleted. POST to /bags/ makes a recording of what it holds."
            )
        if method == "PATCH" and self.recording.name in self.recordings.finished:
            return f"The recording {self.recording.name} has ended: nothing of it can be changed."
        return super().deny_reason(method)

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
        why = self.recordings.interruption(recording.name)
        version = recording.first, recording.count, recording.start_ns, trouble, digest, why
        # not a partial, which another process would be asked to evaluate
        return self.states.get_or_make(
            self.url,
            version,
            lambda: State(
                lambda: describe_bag(self.space, self.recordings, recording),
                weight=len(recording.topics) * _TOPIC_BYTES,
            ),
        )

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        history = self.recordings.history
        return None if self.recording is history.recording else history.digests.watch(self.recording.path, wake)

    async def forms(self) -> Sequence[Form]:
        about = "The recording and its file are deleted."
        return (DeleteForm("Delete the recording", "Delete", about),) if "DELETE" in self.methods() else ()

    def navigation_links(self) -> tuple[SequenceLink, ...]:
        """A button that saves its file, where it is one."""
        is_file = self.recording is not self.recordings.history.recording and self.recording.path.is_file()
        return (SequenceLink("enclosure", f"{self.url}file"),) if is_file else ()

    async def delete(self, exchange: Exchange) -> Answer:
        """Delete the recording and its file."""
        await self.recordings.delete(self.recording.name)
        return Response(status_code=204)
