"""One client of Foxglove's protocol: what it receives, and the requests to the server that its writes become."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Coroutine, Iterable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import orjson
from msgspec import Struct
from starlette.types import Send

from rosld.adapters.base import Watch
from rosld.adapters.model import MessageSchema, RosError, Sample, ServiceSchema, TypeRef
from rosld.adapters.model import foxglove_protocol as protocol
from rosld.adapters.model.foxglove_protocol import ERROR, WARNING, Json, ServiceMessage
from rosld.adapters.model.names import global_name
from rosld.adapters.model.parameter import ParameterValue
from rosld.ontology.body import BodyError
from rosld.ontology.document import Document
from rosld.ontology.lift import lifter
from rosld.ontology.lower import lowerer
from rosld.ontology.parameters import parameter_document, plain_value
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.violations import LoweringError
from rosld.server.auth.authenticator import AuthContext
from rosld.server.foxglove.offers import Connections, Offer, Offers, connection_changes
from rosld.server.history.topic_feed import TopicFeed
from rosld.server.mcp.transport import Answer, Caller, Transport
from rosld.server.runtime.tasks import call_every, end_tasks, loop_time

_DEPTH, _LEAST_DEPTH = 64, 8
_MAX_BYTES = 8 * 1024 * 1024
"""Maximum bytes of the queue of one channel of one client, beyond its least depth."""
_TICK = 1.0
_MAX_CALLS = 32
_AT_ONCE = 100
"""Channels in one message."""
_JSON, _N_TRIPLES = "application/json", "application/n-triples"
_INVALID = (KeyError, TypeError, ValueError, AttributeError, struct.error, IndexError)


class _Subscribed(Struct):
    """A subscription: the queue of its channel, and the number of dropped messages that the client knows of."""

    offer: Offer
    feed: TopicFeed
    watch: Watch
    told: int = 0
    told_at: float = 0.0
    is_new: bool = True


class Connection:
    """The state of one connection: `handle` takes the client's messages, `run` sends what is not an answer to one."""

    def __init__(self, offers: Offers, transport: Transport, auth: AuthContext, caller: Caller, send: Send) -> None:
        self._offers = offers
        self._session = offers.session
        self._transport = transport
        self._auth = auth
        self._caller = caller
        self._send_event = send
        self._channels: dict[int, Offer] = {}
        self._services: dict[int, Offer] = {}
        self._subscribed: dict[int, _Subscribed] = {}
        self._due: set[int] = set()
        """Subscriptions that may have new messages."""
        self._published: dict[int, Json] = {}
        self._followed: set[str] = set()
        self._pending: dict[str, set[str]] = {"parameters": set(), "changes": {"graph"}, "learnt": set()}
        self._connections: Connections | None = None
        self._background: tuple[asyncio.Event, set[asyncio.Task[None]]] = (asyncio.Event(), set())

    # --- sending

    async def run(self) -> None:
        """Send until the permissions of the client end, or this is cancelled."""
        await self._send(protocol.op("serverInfo", **self._offers.server_info(self._auth.permissions)))
        woken, tasks = self._background
        with ExitStack() as watches:
            for watch in (
                self._session.changes.watch(self._note_change),
                self._session.parameter_changes.watch(woken.set, self._note_parameter),
                call_every(_TICK, woken.set),
            ):
                watches.callback(watch.close)
            try:
                while self._auth.is_valid():
                    woken.clear()
                    await self._send_news()
                    await woken.wait()
            finally:
                for each in self._subscribed.values():
                    each.watch.close()
                    each.feed.subscription.close()
                await end_tasks(tasks)

    async def _send_news(self) -> None:
        if self._pending["changes"]:
            self._pending["changes"].clear()
            await self._send_offers()
            await self._send_connections()
        if names := self._pending["parameters"]:
            self._pending["parameters"] = set()
            self._begin(self._send_parameters(names, None))
        due, self._due = self._due, set()
        for id in due:
            if id in self._subscribed:
                await self._forward(id)

    async def _forward(self, id: int) -> None:
        """Send the new messages of a subscription; while the client is slow, its queue drops the oldest ones."""
        subscribed = self._subscribed[id]
        feed = subscribed.feed
        new: Sequence[Sample] = feed.take()
        if not new:
            return
        depth = min(feed.next_depth(new, _MAX_BYTES), _MAX_BYTES // (max(len(each.data) for each in new) + 1))
        depth = max(depth, _LEAST_DEPTH)
        if subscribed.is_new:  # of what was sent before, all that is latched, and the newest
            subscribed.is_new = False
            new = [each for each in new if each.latched or each is new[-1]]
        name = subscribed.offer.schema.ref.name
        for sample in new:
            if sample.schema.name == name and id in self._subscribed:
                await self._send(protocol.message_data(id, sample.received_ns, sample.data))
        if self._offers.is_recording:
            await self._send(protocol.time_message(new[-1].received_ns + self._session.adapter.age_ns(new[-1])))
        if feed.dropped > subscribed.told and loop_time() - subscribed.told_at >= _TICK:
            dropped, subscribed.told, subscribed.told_at = feed.dropped - subscribed.told, feed.dropped, loop_time()
            words = f"{dropped} messages of {feed.topic} were dropped, because they could not be sent in time."
            await self._send_status(WARNING, words, f"slow {feed.topic}")
        if depth != feed.depth and id in self._subscribed:
            subscribed.watch.close()
            await feed.resubscribe(self._session.adapter, depth)
            subscribed.watch = feed.subscription.watch(partial(self._wake, id))
            self._wake(id)

    async def _send_offers(self) -> None:
        """Send the channels and services that are new, and those that are gone."""
        permissions = self._auth.permissions
        channels, missing = self._offers.channels(permissions)
        services, also_missing = self._offers.services(permissions)
        if gone := [id for id in self._channels if id not in channels]:
            for id, each in tuple(self._subscribed.items()):
                if any(self._channels[one] is each.offer for one in gone):
                    self._unsubscribe(id)
            await self._send(protocol.op("unadvertise", channelIds=gone))
        if gone := [id for id in self._services if id not in services]:
            await self._send(protocol.op("unadvertiseServices", serviceIds=gone))
        for operation, members, found, known in (
            ("advertise", "channels", channels, self._channels),
            ("advertiseServices", "services", services, self._services),
        ):
            new = [{"id": id, **offer.members} for id, offer in found.items() if id not in known]
            for start in range(0, len(new), _AT_ONCE):
                await self._send(protocol.op(operation, **{members: new[start : start + _AT_ONCE]}))
        self._channels = {id: self._channels.get(id, offer) for id, offer in channels.items()}
        self._services = dict(services)
        learnt = self._pending["learnt"]
        if types := [each for each in (*missing, *also_missing) if each.name not in learnt]:
            learnt.update(each.name for each in types)
            self._begin(self._learn(types))

    async def _learn(self, types: Iterable[TypeRef]) -> None:
        """Load the schemas of types, and look again for channels."""
        for each in types:
            with suppress(RosError):
                await self._session.schemas.get(each)
                self._note_change()

    async def _send_connections(self) -> None:
        if self._connections is None:
            return
        after = self._offers.connections(self._auth.permissions)
        changes = connection_changes(self._connections, after)
        if not self._connections or any(changes.values()):
            await self._send(protocol.op("connectionGraphUpdate", **changes))
        self._connections = after

    async def _send_parameters(self, names: Iterable[str], id: str | None) -> None:
        """Send the values of parameters, as far as the client may read them."""
        adapter, space = self._session.adapter, self._session.space
        readable = [each for each in names if self._auth.permissions.may_read(space.parameter(each))]
        deadline = loop_time() + self._session.settings.call_deadline
        try:
            values = await adapter.get_parameters(readable, deadline=deadline) if readable else {}
        except RosError as error:
            await self._send_status(ERROR, f"The parameters cannot be read: {error}.")
            return
        entries = [protocol.parameter_entry(name, _plain(value)) for name, value in values.items()]
        await self._send(protocol.op("parameterValues", parameters=entries, **({} if id is None else {"id": id})))

    async def _send_status(self, level: int, message: str, id: str | None = None) -> None:
        await self._send(protocol.op("status", level=level, message=message, **({} if id is None else {"id": id})))

    async def _send(self, data: str | bytes) -> None:
        with suppress(OSError):  # the client has just left
            await self._send_event({"type": "websocket.send", "text" if isinstance(data, str) else "bytes": data})

    def _wake(self, id: int) -> None:
        self._due.add(id)
        self._background[0].set()

    def _note_change(self) -> None:
        self._pending["changes"].add("graph")
        self._background[0].set()

    def _note_parameter(self, name: str) -> bool:
        """Note a change of a parameter, or of one above it; return whether the client follows it."""
        found = {each for each in self._followed if each == name or each.startswith(f"{name.rstrip('/')}/")}
        self._pending["parameters"] |= found
        return bool(found)

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        tasks = self._background[1]
        task = asyncio.get_running_loop().create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    # --- receiving

    async def handle(self, data: str | bytes) -> None:
        """Do what a message of the client asks for. An invalid one is answered with a status."""
        try:
            if isinstance(data, bytes):
                await self._handle_binary(data)
                return
            message = protocol.read_op(data)
            handler = getattr(self, f"_on_{_SNAKE.get(message['op'], message['op'])}", None)
            if handler is None:
                await self._send_status(ERROR, f"The operation {message['op'][:50]!r} is not supported.")
            else:
                await handler(message)
        except _INVALID as error:
            await self._send_status(ERROR, f"The message is not valid: {type(error).__name__}: {str(error)[:200]}")

    async def _handle_binary(self, data: bytes) -> None:
        if data[0] == protocol.CLIENT_MESSAGE_DATA:
            await self._publish(*protocol.read_client_message_data(data))
        elif data[0] == protocol.SERVICE_REQUEST:
            request = protocol.read_service_message(data)
            if len(self._background[1]) < _MAX_CALLS:
                self._begin(self._call(request))
            else:
                await self._fail(request, f"{_MAX_CALLS} requests are in progress, the maximum.")
        else:
            raise ValueError(f"unknown opcode {data[0]}")

    async def _on_subscribe(self, message: Json) -> None:
        for each in message["subscriptions"]:
            id, offer = each["id"], self._channels.get(each["channelId"])
            if offer is None or id in self._subscribed or not isinstance(id, int) or not 0 <= id < 1 << 32:
                words = f"there is no channel {each['channelId']}" if offer is None else "its id is not free"
                await self._send_status(ERROR, f"The subscription is refused: {words}.")
                continue
            subscription = await self._session.adapter.subscribe(offer.name, depth=_DEPTH)
            watch = subscription.watch(partial(self._wake, id))
            self._subscribed[id] = _Subscribed(offer, TopicFeed(offer.name, subscription, _DEPTH), watch)
            self._wake(id)

    async def _on_unsubscribe(self, message: Json) -> None:
        for id in message["subscriptionIds"]:
            self._unsubscribe(id)

    def _unsubscribe(self, id: int) -> None:
        if (subscribed := self._subscribed.pop(id, None)) is not None:
            subscribed.watch.close()
            subscribed.feed.subscription.close()

    async def _on_advertise(self, message: Json) -> None:
        for each in message["channels"]:
            if each["encoding"] in (self._offers.encoding, "json"):
                self._published[each["id"]] = {
                    "topic": global_name(each["topic"]),
                    "encoding": each["encoding"],
                    "type": self._offers.type_ref(each["schemaName"]),
                }
            else:
                words = f"The encoding of {each['topic']} must be {self._offers.encoding} or json."
                await self._send_status(ERROR, words)

    async def _on_unadvertise(self, message: Json) -> None:
        for id in message["channelIds"]:
            self._published.pop(id, None)

    async def _on_get_parameters(self, message: Json) -> None:
        names = message.get("parameterNames") or tuple(self._session.graph.parameters)
        self._begin(self._send_parameters([global_name(each) for each in names], message.get("id")))

    async def _on_set_parameters(self, message: Json) -> None:
        entries = [protocol.read_parameter(each) for each in message["parameters"]]
        for name, value in entries:
            url = self._session.space.parameter(global_name(name))
            if value is None:
                await self._request("DELETE", url)
            elif isinstance(value, bytes):
                document = parameter_document(global_name(name), value, self._session.space)
                await self._request("PUT", url, _N_TRIPLES, serialize(document, Syntax.N_TRIPLES))
            else:
                await self._request("PUT", url, _JSON, orjson.dumps(value))
        if "id" in message:
            self._begin(self._send_parameters([global_name(name) for name, _ in entries], message["id"]))

    async def _on_subscribe_parameters(self, message: Json) -> None:
        self._followed.update(map(global_name, message.get("parameterNames") or self._session.graph.parameters))

    async def _on_unsubscribe_parameters(self, message: Json) -> None:
        self._followed -= set(map(global_name, message.get("parameterNames") or self._followed))

    async def _on_subscribe_graph(self, message: Json) -> None:
        self._connections = {}
        self._note_change()

    async def _on_unsubscribe_graph(self, message: Json) -> None:
        self._connections = None

    async def _publish(self, id: int, data: bytes) -> None:
        """Send a message of the client as a PUT to its topic, which checks it and leaves a receipt."""
        channel = self._published.get(id)
        if channel is None:
            await self._send_status(ERROR, f"There is no channel {id}: advertise it first.")
            return
        session, name, ref = self._session, channel["topic"], channel["type"]
        url, topic = session.space.topic(name), session.graph.topics.get(name)
        schema: MessageSchema | None = None
        if topic is None or not topic.types or channel["encoding"] != "json":
            if topic is not None and topic.types and topic.types[0].name == ref.name:
                ref = topic.types[0]
            try:
                schema = await session.schemas.message(ref)
            except RosError as error:
                await self._send_status(ERROR, f"{name} cannot be published: {error}.")
                return
        if schema is None:
            await self._request("PUT", url, _JSON, data)
            return
        try:
            if channel["encoding"] == "json":
                message = lowerer(schema, session.lifting).from_json(orjson.loads(data), defaults=True)
            else:
                message = schema.codec.decode(data, session.adapter.capabilities.encoding)
        except (BodyError, LoweringError) as error:
            await self._send_status(ERROR, f"{name} cannot be published: {error}")
            return
        whole = lifter(schema, session.lifting.unelided)
        if topic is not None and topic.type is not None and topic.type.name == ref.name:
            await self._request("PUT", url, _JSON, whole.json(message, url))
        else:  # RDF states the type, which a new topic needs, and which must be that of an existing one
            document = Document(url, tuple(whole.triples(message, url, "#message")))
            await self._request("PUT", url, _N_TRIPLES, serialize(document, Syntax.N_TRIPLES))

    async def _call(self, request: ServiceMessage) -> None:
        """Send a request to a service as a POST, and its response to the client."""
        offer = self._services.get(request.service_id)
        encoding = self._session.adapter.capabilities.encoding
        if offer is None or not isinstance(offer.schema, ServiceSchema):
            await self._fail(request, f"There is no service {request.service_id}.")
            return
        url, schema, body = self._session.space.service(offer.name), offer.schema, request.payload
        if request.encoding != "json":
            try:
                message = schema.request.codec.decode(request.payload, encoding)
            except ValueError as error:
                await self._fail(request, f"The request cannot be decoded: {error}.")
                return
            body = lifter(schema.request, self._session.lifting.unelided).json(message, url)
        answer = await self._ask("POST", url, _JSON, body)
        location = answer.field("location") or ""
        call = None
        with suppress(LookupError):
            call = self._session.calls.find(location.rpartition("/")[2])
        if answer.status >= 400 or call is None or call.response is None:
            await self._fail(request, _words(answer))
            return
        if request.encoding == "json":
            payload = lifter(schema.response, self._session.lifting.unelided).json(call.response, location)
        else:
            payload = call.schema.response.codec.encode(call.response, encoding)
        response = request._replace(payload=payload)
        await self._send(protocol.service_message(protocol.SERVICE_RESPONSE, response))

    async def _fail(self, request: ServiceMessage, words: str) -> None:
        ids = {"serviceId": request.service_id, "callId": request.call_id}
        await self._send(protocol.op("serviceCallFailure", **ids, message=words))

    async def _request(self, method: str, url: str, type: str = _JSON, body: bytes = b"") -> None:
        """Make a request to the server; a refusal becomes a status."""
        answer = await self._ask(method, url, type, body)
        if answer.status >= 400:
            await self._send_status(ERROR, f"{method} {url}: {_words(answer)}", f"{method} {url}")

    async def _ask(self, method: str, url: str, type: str, body: bytes) -> Answer:
        fields = [("accept", f"{_JSON}, */*;q=0.1"), *([("content-type", type)] if body else [])]
        return await self._transport.send(self._caller, method, url, self._caller.fields(None, fields), body)


_SNAKE = {
    "getParameters": "get_parameters",
    "setParameters": "set_parameters",
    "subscribeParameterUpdates": "subscribe_parameters",
    "unsubscribeParameterUpdates": "unsubscribe_parameters",
    "subscribeConnectionGraph": "subscribe_graph",
    "unsubscribeConnectionGraph": "unsubscribe_graph",
}
"""Suffixes of the handlers of operations with long names."""


def _plain(value: ParameterValue) -> Any:
    """Return a value that JSON can represent; octets and floats keep their types."""
    return value if isinstance(value, bytes | float) else plain_value(value)


def _words(answer: Answer) -> str:
    """Return the explanation in the problem details of an answer."""
    try:
        detail = orjson.loads(answer.body or b"")["detail"]
    except (ValueError, KeyError, TypeError):
        detail = None
    return detail if isinstance(detail, str) else f"the server answered with status {answer.status}"
