"""Plots of numbers of topics, each referenced by a URL with the path of a field as fragment, and their streams."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import NamedTuple, TypeAlias
from urllib.parse import quote

import numpy as np
import orjson
from starlette.responses import Response

from rosld.adapters.base import Adapter
from rosld.adapters.model import Array, Message, MessageSchema, RosError, Sample, TypeRef
from rosld.ontology.describe_types import definition_text
from rosld.ontology.describe_views import PlottedNumber, plot_document
from rosld.ontology.document import Document
from rosld.ontology.fields import field_at, number_type
from rosld.ontology.units import quantity_at
from rosld.server.auth.errors import not_found
from rosld.server.auth.permissions import Permissions
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS, EndlessResponse, EventWriter, SendChunk, event_frame
from rosld.server.events.query_params import EVENT_STREAM, stream_is_preferred
from rosld.server.history.topic_feed import MAX_BYTES, TopicFeed
from rosld.server.html.forms import Form
from rosld.server.html.graphics import plot_query
from rosld.server.html.page import Csrf, Notice, PlotPage
from rosld.server.html.render import render_plot
from rosld.server.html.site import Site
from rosld.server.http.conditional import digest
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.catalogue import TopicSource
from rosld.server.hypermedia.json_schema import TEXT, URI, JsonSchema, json_array, json_object
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.memento import is_recorded
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import OFFERS
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter
from rosld.server.rest.resource import RDF_SOURCE, RESOURCE, Resource
from rosld.server.rest.responses import RawResponse
from rosld.server.rest.state import State

PERIOD = 0.1
"""Seconds between two events."""
MAX_ELEMENTS = 16
"""Maximum number of array elements in an event."""
_DEPTH = 32
_MOST = 200
"""Maximum number of messages of a topic per event; of more, every second, third etc. is sent, and the newest."""

NAMED_ARRAYS: Mapping[str, tuple[str, ...]] = {"sensor_msgs/msg/JointState": ("position", "velocity", "effort")}
"""Arrays of a type whose elements are named by the neighbouring array `name`."""

Numbers: TypeAlias = "float | list[float | None] | None"
"""A number, or those of an array; None for anything but a finite number."""
SchemaOf: TypeAlias = Callable[[TypeRef], Awaitable[MessageSchema]]


class FollowedTopic(NamedTuple):
    """A topic and the paths of its numbers, each with its index in the stream."""

    topic: str
    fields: tuple[tuple[int, str], ...]


class SampleStream(EndlessResponse):
    """Stream of the numbers of topics, until its reader disconnects or the server ends.

    Each event is a JSON list with an object for each topic that has new messages: `times` in milliseconds since 1970,
    `values` by index, each as long as `times`, and `lost`, the number of skipped messages. `names` by index are the
    robot's names of array elements, if its messages contain them.
    """

    def __init__(
        self,
        broadcasters: Broadcasters,
        adapter: Adapter,
        schema_of: SchemaOf,
        topics: Sequence[FollowedTopic],
        is_valid: Callable[[], bool],
    ) -> None:
        """Initialize; `is_valid` returns whether the reader is still permitted to read."""
        super().__init__(broadcasters, HEADERS)
        self._adapter = adapter
        self._numbers = [TopicNumbers(each, schema_of) for each in topics]
        self._is_valid = is_valid

    async def write(self, send_chunk: SendChunk) -> None:
        writer = EventWriter(send_chunk)
        await writer.open()
        try:
            while self._is_valid():
                points = [found for each in self._numbers if (found := await each.take(self._adapter)) is not None]
                await (writer.send(event_frame(orjson.dumps(points))) if points else writer.keep_alive())
                await asyncio.sleep(PERIOD)
        finally:
            for each in self._numbers:
                each.close()


class TopicNumbers:
    """New numbers of one topic."""

    def __init__(self, followed: FollowedTopic, schema_of: SchemaOf) -> None:
        self._followed = followed
        self._schema_of = schema_of
        self._schemas: dict[TypeRef, MessageSchema] = {}
        self._feed: TopicFeed | None = None

    async def take(self, adapter: Adapter) -> dict[str, object] | None:
        """Return the new values; None without any, or if the topic cannot be subscribed to now."""
        with contextlib.suppress(RosError):
            if self._feed is None:
                subscription = await adapter.subscribe(self._followed.topic, depth=_DEPTH)
                self._feed = TopicFeed(self._followed.topic, subscription, _DEPTH)
            return await self._take(adapter, self._feed)
        return None

    def close(self) -> None:
        """Close the subscription. Idempotent."""
        feed, self._feed = self._feed, None
        if feed is not None:
            feed.subscription.close()

    async def _take(self, adapter: Adapter, feed: TopicFeed) -> dict[str, object] | None:
        new = feed.take()
        lost, feed.dropped = feed.dropped, 0
        depth = feed.next_depth(new, MAX_BYTES) if new else feed.depth
        if depth != feed.depth:
            await feed.resubscribe(adapter, depth)
        selected = _thinned(new)
        lost += len(new) - len(selected)
        if not selected and not lost:
            return None
        rows, names, fields = list[list[Numbers]](), dict[str, list[str]](), self._followed.fields
        for sample in selected:
            message = await self._decode(sample)
            rows.append([None if message is None else number_at(*message, path) for _, path in fields])
            if message is not None and sample is selected[-1]:
                names = {str(place): found for place, path in fields if (found := element_names(*message, path))}
        return {
            "times": [each.received_ns / 1e6 for each in selected],
            "values": {str(place): [row[column] for row in rows] for column, (place, _) in enumerate(fields)},
            "lost": lost,
            **({"names": names} if names else {}),
        }

    async def _decode(self, sample: Sample) -> tuple[MessageSchema, Message] | None:
        """Return the message of a sample and its schema, None if it cannot be decoded."""
        schema = self._schemas.get(sample.schema)
        if schema is None:
            schema = self._schemas[sample.schema] = await self._schema_of(sample.schema)
        try:
            return schema, schema.codec.decode(sample.data, sample.encoding)
        except ValueError:
            return None


def number_at(schema: MessageSchema, message: Message, path: str) -> Numbers:
    """Return the number, or the first numbers of the array, at a path of a message; None if there is none."""
    try:
        _, value = field_at(schema, message, path)
    except ValueError:
        return None
    if isinstance(value, list | tuple | np.ndarray):
        return [_finite(each) for each in islice(value, MAX_ELEMENTS)]
    return _finite(value)


def element_names(schema: MessageSchema, message: Message, path: str) -> list[str]:
    """Return the robot's names of the numbers at a path of a message; empty unless each has one."""
    if path not in NAMED_ARRAYS.get(schema.ref.name, ()):
        return []
    names, values = list(getattr(message, "name", ())), getattr(message, path, ())
    return [str(each) for each in names[:MAX_ELEMENTS]] if len(names) == len(values) else []


def _finite(value: object) -> float | None:
    if isinstance(value, str) or not hasattr(value, "__float__"):
        return None
    number = float(value)
    return number if math.isfinite(number) else None


def _thinned(samples: Sequence[Sample]) -> Sequence[Sample]:
    """Return a limited number of values, evenly spaced, including the newest."""
    if len(samples) <= _MOST:
        return samples
    step = -(-len(samples) // _MOST)
    return samples[::-1][::step][::-1]


_MAX_REFERENCE = 1000


class NumberReference(NamedTuple):
    """Reference to a plotted number: the name of the topic and the path of the field."""

    topic: str
    field: str


class NumberFinder:
    """Finder of the numbers of a robot that an agent may see."""

    def __init__(self, services: Services, permissions: Permissions) -> None:
        self._session = services.session
        self._affordances = services.affordances
        self._history = services.history
        self._permissions = permissions

    async def locate(self, reference: str) -> NumberReference:
        """Return the topic and the field named by a `y`. Raises Problems."""
        url, _, path = reference.partition("#")
        space = self._session.space
        if len(reference) > _MAX_REFERENCE:
            raise Problem(400, f"?y={reference[:60]}... is too long.")
        url = space.absolute(url)
        if not path and f"/{url}".find("/topics/") >= 0:
            raise Problem(400, f"?y={reference[:100]}: add the field after # as %23, such as %23data.")
        location = None if "?" in url else space.location(url)
        if location is None or location.is_container or location.kind not in ("topics", "resources"):
            words = "does not name a topic or property of this robot, such as topics/odom#twist.twist.linear.x"
            raise Problem(400, f"?y={reference[:100]} {words}, with # as %23.")
        if not self._permissions.may_read(url):
            raise not_found()
        if location.kind == "resources":
            return await self._of_property(location.name, url, path)
        if location.name not in self._session.graph.topics:
            raise Problem(404, f"There is no topic {location.name}.")
        return NumberReference(location.name, path)

    async def _of_property(self, name: str, url: str, path: str) -> NumberReference:
        """Return the field of the topic that provides a property."""
        plan = (await self._affordances.tree()).property(name)
        if plan is None:
            raise Problem(404, f"There is no property {name}.")
        source = next((each for each in plan.source.readers if isinstance(each, TopicSource)), None)
        if source is None or not self._permissions.may_read(self._session.space.topic(source.name)):
            raise Problem(422, f"{url} is not read from a topic: only topics can be plotted over time.")
        fields = [] if source.schema is None else source.schema.type.fields
        return NumberReference(source.name, path or (fields[0].name if len(fields) == 1 else ""))

    async def describe(self, number: NumberReference) -> PlottedNumber:
        """Return the description and recording of a number. Raises Problems."""
        topic = self._session.graph.topics[number.topic]
        url = self._session.space.topic(number.topic)
        if topic.type is None:
            raise Problem(422, f"{number.topic} has publishers of several types.")
        try:
            schema = await self._session.schemas.message(TypeRef(topic.type.name, topic.type.hash))
            kind = number_type(schema, number.field)
        except ValueError as error:
            raise Problem(422, f"?y={number.topic}#{number.field[:60]}: {error}.") from error
        except RosError as error:
            raise Problem(422, f"The type of {number.topic} is not known: {error.sentence}") from error
        has_series = not isinstance(kind, Array) and is_recorded(self._history, number.topic)
        series = f"{url}?series={quote(number.field, safe='.')}" if has_series else None
        return PlottedNumber(url, number.field, definition_text(kind), series, quantity_at(schema, number.field))


MAX_NUMBERS = 16
"""Maximum number of curves in a plot."""
_PARAMETERS = (
    QueryParameter(
        "y",
        "A number to plot: the URL of a topic or property, absolute or below the base, then # and the path of the "
        "field. Repeatable.",
        {"type": "array", "items": TEXT},
    ),
    FORMAT,
)
_PLAIN: JsonSchema = json_object(
    {
        "y": json_array(
            json_object(
                {"topic": URI, "field": TEXT, "type": TEXT, "series": {"type": ["string", "null"]}, "unit": TEXT}
            )
        )
    }
)


class PlotResource(SessionResource):
    """The plot of the selected numbers, or a form to select them."""

    kind = "Plot"
    shape = "Plot"
    item = PathItem("A plot of numbers over time", (*OFFERS, EVENT_STREAM), _PLAIN, query=_PARAMETERS, streams=False)
    links = (RESOURCE, RDF_SOURCE)
    is_cacheable = False
    references: tuple[str, ...] = ()

    path = "plot"
    _numbers: Sequence[PlottedNumber] = ()

    def __init__(self, services: Services, broadcasters: Broadcasters) -> None:
        super().__init__(services)
        self._broadcasters = broadcasters

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the plot of the numbers named by `y`, with the agent's permissions. Raises Problems."""
        references = exchange.query_values("y")
        if len(references) > MAX_NUMBERS:
            raise Problem(
                400, f"?y= is given {len(references)} times: at most {MAX_NUMBERS} numbers can be drawn together."
            )
        url = self.url + plot_query(references)
        return self.variant(url=url, references=tuple(references), _permissions=exchange.permissions)

    def document(self) -> Document:
        """Return the document without a selection."""
        return plot_document(self.url, ())

    async def state(self) -> State:
        finder = NumberFinder(self.services, self._permissions)
        numbers = self._numbers = [await finder.describe(await finder.locate(each)) for each in self.references]
        plain = orjson.dumps({"y": [number_json(each) for each in numbers]})
        return State(partial(plot_document, self.url, numbers), lambda: plain, digest(plain))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        """Return the event stream of the numbers if preferred, else None.

        Raises a 400 Problem without numbers, 404 for a missing one.
        """
        if not stream_is_preferred(exchange.accept, OFFERS):
            return None
        if not self.references:
            raise Problem(400, "Choose the numbers with ?y=, such as y=topics/odom%23twist.twist.linear.x.")
        finder = NumberFinder(self.services, self._permissions)
        fields: dict[str, list[tuple[int, str]]] = {}
        for place, reference in enumerate(self.references):
            number = await finder.locate(reference)
            await finder.describe(number)
            fields.setdefault(number.topic, []).append((place, number.field))
        if exchange.method == "HEAD":
            return RawResponse(200, b"", HEADERS)
        self._broadcasters.require_capacity(exchange.request.client)
        topics = [FollowedTopic(topic, tuple(each)) for topic, each in fields.items()]
        schema_of, is_valid = self.session.schemas.message, exchange.auth.is_valid
        return SampleStream(self._broadcasters, self.session.adapter, schema_of, topics, is_valid)

    def page(self, site: Site, state: State, forms: Sequence[Form], csrf: Csrf, notices: Sequence[Notice]) -> bytes:
        return render_plot(PlotPage(site, self.url, tuple(self._numbers), self.references, tuple(notices)))


def number_json(number: PlottedNumber) -> dict[str, str | None]:
    """Return a number as plain JSON."""
    plain = {"topic": number.topic, "field": number.field, "type": number.type, "series": number.series}
    return {**plain, "unit": number.quantity.symbol}
