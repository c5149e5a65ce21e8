"""The container of recordings, which records what is posted to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from rosld.ontology.describe_graph import container_document
from rosld.server.history.ordered_recording import RecordingOrder, RecordingRefused
from rosld.server.history.recordings import Recordings
from rosld.server.html.forms import Form
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.message_schemas import MessageSchemas
from rosld.server.resources.bag_descriptions import bag_urls
from rosld.server.resources.recording_form import recording_form
from rosld.server.resources.recording_order import MEDIA_TYPES, SCHEMA, read_order
from rosld.server.resources.recording_trigger import (
    NOTHING_IS_RECORDED,
    RecordingTriggers,
    can_record,
    may_read_topic,
    require_topics,
    urls_of,
)
from rosld.server.resources.unfinished_bags import ArmedBag, RunningBag
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem, WriteMethod
from rosld.server.rest.resource import BASIC_CONTAINER, RDF_SOURCE, READ, RESOURCE, Answer, CreatedAnswer, Resource
from rosld.server.rest.state import State
from rosld.server.robot.session import Session
from rosld.server.runtime.version_cache import VersionCache


class BagContainer(Resource):
    """`/bags/`: the recordings of this source, the history, and those that clients make or send."""

    kind = "Recordings"
    links = (RESOURCE, RDF_SOURCE, BASIC_CONTAINER)
    accepts: Mapping[str, Sequence[str]] = {"POST": MEDIA_TYPES}

    def __init__(
        self,
        session: Session,
        states: VersionCache[State],
        recordings: Recordings,
        triggers: RecordingTriggers | None = None,
    ) -> None:
        """`triggers` follows what a recording may wait for; without it none can."""
        super().__init__(session.space.container("bags"))
        self.session = session
        self.states = states
        self.recordings = recordings
        self._triggers = triggers

    async def forms(self) -> Sequence[Form]:
        if "POST" not in self.methods():
            return ()
        space = self.session.space
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
        return PathItem("The recordings", writes={"POST": post}, also=(507,))

    @property
    def conforms_to(self) -> Sequence[str]:
        return (self.session.space.document_shape("Container"),)

    @property
    def constrained_by(self) -> str | None:
        return self.session.space.shape("recording")

    async def state(self) -> State:
        members = bag_urls(self.session.space, self.recordings)
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
        """What is to be recorded, by the body and `Slug`. Raises a 403 Problem for a topic that must not be read."""
        order = read_order(await exchange.body(), exchange.media_type, self.url, is_form=bool(exchange.typed))
        slug = exchange.header("slug")
        if order.name is None and slug is not None and self.recordings.can_be_named(slug):
            order = replace(order, name=slug)
        space = self.session.space
        exchange.audit.add_step(f"record {', '.join(order.topics)}", *urls_of(order, space))
        require_topics(order, exchange.permissions, space)
        return order

    async def _begin(self, order: RecordingOrder, exchange: Exchange) -> RunningBag | ArmedBag:
        """The recording that was begun, or that waits for its trigger. Raises RecordingRefused, OSError."""
        space, settings = self.session.space, self.session.settings
        if order.trigger is None:
            may_record = partial(may_read_topic, space, exchange.permissions)
            return RunningBag(space, settings, self.states, self.recordings, self.recordings.begin(order, may_record))
        if self._triggers is None:
            raise RecordingRefused("nothing waits for triggers here")
        await self._triggers.follow(order, exchange.permissions)
        armed = await self.recordings.arm(order, exchange.agent, self._triggers.occurrences)
        return ArmedBag(space, settings, self.recordings, armed)
