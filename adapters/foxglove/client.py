"""The session with a Foxglove server, on the thread of the adapter."""

from __future__ import annotations

import asyncio
import itertools
import logging
import struct
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rosld.adapters.base import AdapterOptions, Sink
from rosld.adapters.bridge_connection import (
    BridgeConnection,
    BridgeFeed,
    BridgePublication,
    BridgeSource,
    BridgeSystem,
    Calls,
)
from rosld.adapters.foxglove.graph import Peer, compose
from rosld.adapters.foxglove.parameters import Parameters
from rosld.adapters.foxglove.types import (
    Channel,
    json_of_message,
    message_of_json,
    read_channel,
    read_service,
)
from rosld.adapters.model import (
    Encoding,
    Graph,
    MessageSchema,
    NotFound,
    ParameterValue,
    Refused,
    RosError,
    Schema,
    Sent,
    TimedOut,
    TypeRef,
    UnknownType,
)
from rosld.adapters.model import foxglove_protocol as protocol
from rosld.adapters.model.foxglove_protocol import Json, ServiceMessage
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.names import global_name
from rosld.adapters.thread import LiveActions, Tasks

_SETTLE = 0.05
_GRAPH_PATIENCE = 1.0
"""Seconds to wait for the connection graph before the graph is shown without it."""
_NEW_PARAMETERS = 30.0
"""Seconds between searches for new parameters; servers do not announce them."""
_ALL = "rosld-all"
_log = logging.getLogger("rosld.foxglove")
_INVALID = (KeyError, TypeError, ValueError, AttributeError, struct.error)


class Types:
    """The type library and the encoding of a server, which is ROS 1's or ROS 2's: its first connection tells."""

    def __init__(self, options: AdapterOptions) -> None:
        self._options = options
        self.encoding = Encoding.CDR
        self.library = TypeLibrary(ros_version=2, folders=options.types)
        self._is_decided = False

    def decide(self, encodings: Iterable[str]) -> None:
        """Choose the ROS by the first encodings that belong to one."""
        found = {"ros1", "cdr"}.intersection(encodings)
        if found and not self._is_decided:
            self._is_decided = True
            if found == {"ros1"}:
                self.encoding = Encoding.ROS1
                self.library = TypeLibrary(ros_version=1, folders=self._options.types)


class Client(BridgeSystem):
    """rosld as a client of one server."""

    actions: LiveActions
    """There are none: the adapter refuses goals before it would need them."""

    def __init__(self, source: BridgeSource, graph: Graph, options: AdapterOptions, types: Types, sink: Sink) -> None:
        super().__init__(graph, sink, latches=False)
        limit, subprotocols = options.message_limit, protocol.SUBPROTOCOLS
        self._connection = BridgeConnection("Foxglove server", source, self, limit, subprotocols)
        self.types = types
        self.peer = Peer()
        self.parameters = Parameters(self)
        self._feeds: dict[str, BridgeFeed] = {}
        self._calls = Calls()
        self._numbers = itertools.count(1)
        self._tasks = Tasks()
        self._timer: asyncio.TimerHandle | None = None
        self._is_shown = asyncio.Event()

    async def open(self, patience: float) -> None:
        """Start to connect; wait until the graph is known or the first attempt has failed, at most `patience` s."""
        self._tasks.begin(self._search_parameters())
        await self._connection.open(patience)

    async def close(self) -> None:
        """Disconnect."""
        await self._connection.close()
        self._tasks.cancel()
        await self._tasks.wait(1.0)

    # --- the connection

    async def begin(self) -> None:
        """Wait until the graph of a new session is known."""
        self._is_shown.clear()
        await self._is_shown.wait()

    async def receive(self, message: str | bytes) -> None:
        """Process a message of the server; an invalid one is ignored."""
        try:
            if isinstance(message, bytes):
                self._on_binary(message)
            else:
                await self._on_op(protocol.read_op(message))
        except _INVALID as error:
            _log.debug("an invalid message of the Foxglove server is ignored: %r", error)

    def end(self, error: RosError) -> None:
        """Mark the graph as stale, and fail what waits for answers."""
        self.publications.is_connected = False
        self._calls.fail("the connection to the Foxglove server was lost")
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self.show(self.graph.as_stale(error.sentence))

    async def _search_parameters(self) -> None:
        while True:
            await asyncio.sleep(_NEW_PARAMETERS)
            if self._connection.is_open:
                self._request_all_parameters()

    # --- what the server says

    def _on_binary(self, data: bytes) -> None:
        if data[0] == protocol.MESSAGE_DATA:
            id, _, payload = protocol.read_message_data(data)
            channel = self.peer.subscriptions.get(id)
            feed = None if channel is None else self._feeds.get(channel.topic)
            if channel is not None and feed is not None and channel.schema is not None:
                if channel.is_json:
                    payload = channel.schema.codec.encode(message_of_json(channel.schema, payload), self.types.encoding)
                self.deliver(feed, payload, channel.schema.ref)
        elif data[0] == protocol.SERVICE_RESPONSE:
            response = protocol.read_service_message(data)
            self._calls.settle(response.call_id, response.payload)

    async def _on_op(self, message: Json) -> None:
        peer = self.peer
        match message["op"]:
            case "serverInfo":
                self._greet(message)
                return
            case "advertise":
                await self._learn_channels(message["channels"])
            case "unadvertise":
                for id in message["channelIds"]:
                    peer.channels.pop(id, None)
                    peer.subscriptions = {sub: each for sub, each in peer.subscriptions.items() if each.id != id}
            case "advertiseServices":
                for entry in message["services"]:
                    peer.services[entry["id"]] = await self._off_loop(read_service, entry)
            case "unadvertiseServices":
                for id in message["serviceIds"]:
                    peer.services.pop(id, None)
            case "connectionGraphUpdate":
                peer.update_connections(message)
            case "parameterValues":
                self._take_parameters(message)
            case "serviceCallFailure":
                error = Refused("the service failed", words=message.get("message"), sent=Sent.YES)
                self._calls.settle(message["callId"], error)
            case "status" if message.get("level") == protocol.ERROR:
                peer.words = str(message.get("message"))[:500]
                _log.info("the Foxglove server reports: %s", peer.words)
        self._refresh_soon()

    def _greet(self, info: Json) -> None:
        """Begin a session: request what the server offers, and publish again what rosld publishes."""
        self.peer = Peer(info, since=time.monotonic())
        self.types.decide(info.get("supportedEncodings") or ())
        if self.peer.can("connectionGraph"):
            self._connection.send(protocol.op("subscribeConnectionGraph"))
        self._request_all_parameters()
        for each in self.publications.values():
            self._connection.send(_advertisement(each))
        self.publications.is_connected = True
        self._refresh_soon()

    def _request_all_parameters(self) -> None:
        if self.peer.can("parameters"):
            self._connection.send(protocol.op("getParameters", parameterNames=[], id=_ALL))

    async def _learn_channels(self, entries: Sequence[Json]) -> None:
        self.types.decide(each["encoding"] for each in entries)
        for entry in entries:
            channel = await self._off_loop(read_channel, entry)
            self.peer.channels[channel.id] = channel
            if channel.topic in self._feeds:
                self._subscribe(channel)

    async def _off_loop(self, read: Any, entry: Json) -> Any:
        """Parse a definition on another thread: a large one takes seconds."""
        types = self.types
        return await asyncio.get_running_loop().run_in_executor(None, read, types.library, types.encoding, entry)

    def _take_parameters(self, message: Json) -> None:
        """Store values, follow new parameters, and report changes."""
        peer, id = self.peer, message.get("id")
        values = [protocol.read_parameter(each) for each in message["parameters"]]
        if id == _ALL:
            given = {global_name(name) for name, _ in values}
            for name in peer.parameters.keys() - given:
                del peer.parameters[name]
        new = []
        for name, value in values:
            known = peer.parameters.pop(global_name(name), None)
            if value is not None:
                peer.parameters[global_name(name)] = (name, value)
                new += [name] if known is None else []
            if known is not None and (known[1] != value or type(known[1]) is not type(value)):
                self.sink.parameter_changed(global_name(name))
        if new and peer.can("parametersSubscribe"):
            self._connection.send(protocol.op("subscribeParameterUpdates", parameterNames=new))
        if isinstance(id, str):
            self._calls.settle(id, {global_name(name): value for name, value in values if value is not None})

    # --- the graph

    def _refresh_soon(self) -> None:
        """Show the graph once for all messages that arrive together."""
        if self._timer is None and self._connection.is_open:
            self._timer = asyncio.get_running_loop().call_later(_SETTLE, self.refresh)

    def refresh(self) -> None:
        """Show the graph, as soon as there is one."""
        self._timer = None
        peer = self.peer
        is_due = time.monotonic() - peer.since > _GRAPH_PATIENCE
        awaits_connections = peer.can("connectionGraph") and peer.connections is None
        awaits_channels = not peer.channels and not peer.services
        if not self._connection.is_open or not peer.info:
            return
        if (awaits_connections or awaits_channels) and not is_due:
            self._refresh_soon()
            return
        self._is_shown.set()
        published = {each.topic: each.ref for each in self.publications.values()}
        parts, matched = compose(peer, self.graph.own_node, published)
        for each in self.publications.values():
            each.match(matched[each.topic])
        self.show(self.graph.updated(**parts))

    # --- what the adapter asks for

    def read(self, feed: BridgeFeed) -> None:
        """Subscribe to the channels of a topic, now and whenever they appear."""
        self._feeds[feed.topic] = feed
        for channel in tuple(self.peer.channels.values()):
            if channel.topic == feed.topic:
                self._subscribe(channel)

    def _subscribe(self, channel: Channel) -> None:
        if channel.schema is None or not self._connection.is_open:
            return
        id = next(self._numbers)
        self.peer.subscriptions[id] = channel
        self._connection.send(protocol.op("subscribe", subscriptions=[{"id": id, "channelId": channel.id}]))

    def stop_reading(self, feed: BridgeFeed) -> None:
        """Unsubscribe from the channels of a topic."""
        if self._feeds.get(feed.topic) is feed:
            del self._feeds[feed.topic]
            ids = [id for id, channel in self.peer.subscriptions.items() if channel.topic == feed.topic]
            for id in ids:
                del self.peer.subscriptions[id]
            if ids and self._connection.is_open:
                self._connection.send(protocol.op("unsubscribe", subscriptionIds=ids))

    async def schema(self, ref: TypeRef) -> Schema:
        """Return the schema of a type. Raises UnknownType."""
        return await asyncio.get_running_loop().run_in_executor(None, self.types.library.find, ref)

    async def advertise(self, topic: str, type: TypeRef, latch: bool, until: float) -> BridgePublication:
        """Advertise a channel. Raises Refused, Unreachable, UnknownType."""
        schema = await self.schema(type)
        if not isinstance(schema, MessageSchema):
            raise UnknownType(f"{type.name} is not a message type")
        if not self.peer.can("clientPublish"):
            raise Refused("the Foxglove server accepts no messages of clients")
        encoding = self._write_encoding()
        publication = BridgePublication(topic, schema, self._publish, id=next(self._numbers), encoding=encoding)
        self._connection.send(_advertisement(publication))
        if (former := self.publications.get(topic)) is not None:
            self._connection.send(protocol.op("unadvertise", channelIds=[former.id]))
        self.publications[topic] = publication
        self.refresh()
        await publication.wait_matched(1, until, 0.0)
        return publication

    def _write_encoding(self) -> str:
        """Return the encoding of what rosld sends. Raises Refused if the server reads none that rosld writes."""
        encodings = self.peer.encodings
        found = next((each for each in (self.types.encoding.value, "json") if each in encodings), None)
        if found is None:
            raise Refused(f"the Foxglove server reads none of {self.types.encoding.value} and json")
        return found

    def _publish(self, publication: BridgePublication, data: bytes) -> None:
        self.expect_echo(publication.topic, data)
        if publication.encoding == "json":
            data = json_of_message(publication.schema, publication.schema.codec.decode(data, self.types.encoding))
        self._connection.send(protocol.client_message_data(publication.id, data))

    async def unadvertise(self, topic: str) -> None:
        """Stop publishing a topic. Raises NotFound."""
        publication = self.publications.pop(topic, None)
        if publication is None:
            raise NotFound(f"rosld does not advertise {topic}")
        if self._connection.is_open:
            self._connection.send(protocol.op("unadvertise", channelIds=[publication.id]))
            self.refresh()

    async def call(self, service: str, type: TypeRef, request: bytes, until: float) -> bytes:
        """Return the response of a service. Raises Refused with the server's message, TimedOut, Unreachable."""
        offer = next((each for each in self.peer.services.values() if each.name == service), None)
        if offer is None:
            raise NotFound(f"there is no service {service}")
        if offer.schema is None or offer.type is None or offer.type.name != type.name:
            raise Refused(f"the service {service} cannot be called as {type.name}")
        asked, answered = offer.encodings
        encoding = asked or self._write_encoding()
        if encoding == "json":
            codec = offer.schema.request.codec
            request = json_of_message(offer.schema.request, codec.decode(request, self.types.encoding))
        id = next(self._numbers)
        message = protocol.service_message(protocol.SERVICE_REQUEST, ServiceMessage(offer.id, id, encoding, request))
        response: bytes = await self._ask(message, id, service, until)
        if (answered or encoding) == "json":
            try:
                decoded = message_of_json(offer.schema.response, response)
            except ValueError as error:
                raise Refused(f"the response of {service} cannot be read: {error}", sent=Sent.YES) from error
            return offer.schema.response.codec.encode(decoded, self.types.encoding)
        return response

    async def _ask(self, message: str | bytes, id: str | int, name: str, until: float) -> Any:
        """Send a request, and return the answer to its id. Raises Refused, TimedOut, Unreachable."""
        if until <= time.monotonic():
            raise TimedOut(f"the deadline passed before {name} was asked")
        self._connection.send(message)
        return await self._calls.answer(id, name, until)

    async def request(self, operation: str, until: float, **members: object) -> Mapping[str, ParameterValue]:
        """Return values of parameters by ROS name. Raises Refused, TimedOut, Unreachable."""
        id = f"rosld-{next(self._numbers)}"
        message = protocol.op(operation, id=id, **members)
        values: Mapping[str, ParameterValue] = await self._ask(message, id, "the Foxglove server", until)
        return values


def _advertisement(publication: BridgePublication) -> str:
    """Return the advertisement of a topic that rosld publishes."""
    schema, is_ros1 = publication.schema, publication.encoding == "ros1"
    name = schema.ref.name.replace("/msg/", "/") if is_ros1 else schema.ref.name
    channel: Json = {"id": publication.id, "topic": publication.topic, "encoding": publication.encoding}
    channel |= {"schemaName": name}
    if publication.encoding != "json":
        channel |= {"schema": schema.definition, "schemaEncoding": "ros1msg" if is_ros1 else "ros2msg"}
    return protocol.op("advertise", channels=[channel])
