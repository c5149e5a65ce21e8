"""Participant in a ROS 2 system whose middleware is rmw_zenoh: zenoh alone, without rclpy.

rosld declares tokens, which make an entity visible in ROS 2, only for what it publishes. zenoh calls back on threads of
its own, which only store what arrives.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any, Literal

from rosld.adapters.model import Qos, TypeRef, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import LibraryMessages
from rosld.adapters.ros2.middleware import (
    Client,
    DiscoveredEndpoint,
    Names,
    Participant,
    Reader,
    ReceivedMessage,
    Writer,
)
from rosld.adapters.ros2.wait_set import Waiter
from rosld.adapters.ros2.zenoh_keys import (
    CLIENT,
    NODE,
    PUBLISHER,
    SERVER,
    SPACE,
    SUBSCRIBER,
    Attachment,
    Token,
    data_key,
    parse_token,
    read_attachment,
    token_key,
    write_attachment,
)

_FOR_EVER = 1e9
_MAX_TOKENS = 100_000
_MAX_PENDING = 1000
_FIRST_SECONDS, _RETRY_SECONDS = 2.0, 1.0


class _Inbox:
    """Queue of at most `depth` received items. `pointer` and `with` are those of a `Handle`."""

    pointer = 0

    def __init__(self, depth: int) -> None:
        self._items: deque[Any] = deque(maxlen=depth)
        self._ready: Callable[[], None] | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...

    def put(self, item: object) -> None:
        """Add an item; notify once."""
        with self._lock:
            self._items.append(item)
            ready, self._ready = self._ready, None
        if ready is not None:
            ready()

    def take(self) -> Any:
        """Return the oldest item, or None."""
        with self._lock:
            return self._items.popleft() if self._items else None

    def arm(self, ready: Callable[[], None] | None) -> None:
        """Call `ready` once when there is an item; None stops that."""
        with self._lock:
            is_due = bool(self._items) and ready is not None
            self._ready = None if is_due else ready
        if is_due and ready is not None:
            ready()


class ZenohWaiter(Waiter):
    """Notifies readers and clients; needs no thread, because zenoh has its own."""

    def __init__(self) -> None: ...

    def start(self) -> None: ...

    def arm(self, handle: Any, kind: Literal["reader", "client"], ready: Callable[[], None]) -> None:
        """Call `ready` once, on the running event loop, when something can be taken."""
        handle.arm(partial(_call_soon, asyncio.get_running_loop(), ready))

    def disarm(self, handle: Any) -> None:
        """Stop notifications about a handle."""
        handle.arm(None)

    def stop(self, timeout: float) -> None: ...


class _ZenohMessages(LibraryMessages):
    """Messages whose unknown types may still be learnt from nodes."""

    def class_problem(self, type: str) -> str | None:
        """Return None: a type is found to be unknown when its schema is needed."""
        return None


class ZenohReader(Reader):
    """A subscription to the messages of one type on a topic, with any hash."""

    def __init__(self, key: str, qos: Qos, topic: str, of: ZenohParticipant) -> None:
        self.handle: Any = _Inbox(max(qos.depth, 1))
        self.qos = qos
        self.topic = topic
        self._key = key
        self._participant = of
        self._subscriber: Any = None

    def declare(self, session: Any) -> None:
        """Start reading."""
        import zenoh

        key, qos, remote = self._key, self.qos, zenoh.Locality.REMOTE
        if qos.durability == "transient_local":
            import zenoh.ext

            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=max(qos.depth, 1))
            self._subscriber = zenoh.ext.declare_advanced_subscriber(
                session, key, self._receive, history=history, allowed_origin=remote
            )
        else:
            self._subscriber = session.declare_subscriber(key, self._receive, allowed_origin=remote)

    def _receive(self, sample: Any) -> None:
        self.handle.put((time.time_ns(), sample))

    def take(self) -> ReceivedMessage | None:
        """Return the oldest message that was not taken."""
        item = self.handle.take()
        if item is None:
            return None
        received_ns, sample = item
        raw = sample.attachment
        attachment = None if raw is None else read_attachment(raw.to_bytes())
        number, source_ns, gid = attachment or Attachment(0, 0, b"")
        return ReceivedMessage(sample.payload.to_bytes(), source_ns, received_ns, number or None, gid or None)

    def publishers(self) -> int:
        """Return the number of publishers of the topic."""
        return len(self._participant.publishers(self.topic))

    def close(self) -> None:
        self._participant.readers.pop(id(self), None)
        if self._subscriber is not None:
            self._subscriber.undeclare()


class ZenohWriter(Writer):
    """A publisher of serialized messages, with its token."""

    def __init__(self, session: Any, key: str, token: Token, qos: Qos, topic: str, of: ZenohParticipant) -> None:
        self.qos = qos
        self._participant = of
        self._topic = topic
        self._numbers = itertools.count(1)
        if qos.durability == "transient_local":
            import zenoh.ext

            cache = zenoh.ext.CacheConfig(max_samples=max(qos.depth, 1))
            self._publisher = zenoh.ext.declare_advanced_publisher(session, key, cache=cache, publisher_detection=True)
        else:
            self._publisher = session.declare_publisher(key)
        token_key, self._undeclare = of.declare(token)
        self._gid = gid_of(token_key)

    def publish(self, data: bytes) -> None:
        """Publish a message. Raises ValueError if zenoh refuses it."""
        attachment = Attachment(next(self._numbers), time.time_ns(), self._gid)
        try:
            self._publisher.put(data, attachment=write_attachment(attachment))
        except Exception as error:
            raise ValueError(str(error)) from error

    def subscribers(self) -> int:
        """Return the number of subscribers, including our own reader, which has no token."""
        own = any(each.topic == self._topic for each in self._participant.readers.values())
        return len(self._participant.subscribers(self._topic)) + own

    def close(self) -> None:
        """Stop publishing."""
        self._undeclare()
        self._publisher.undeclare()


class ZenohClient(Client):
    """A client of one service."""

    def __init__(self, session: Any, service: str, type: str, of: ZenohParticipant) -> None:
        self.handle: Any = _Inbox(_MAX_PENDING)
        self._session = session
        self._service = service
        self._type = type
        self._participant = of
        self._numbers = itertools.count(1)
        self._gid = gid_of(f"{service} {id(self)}")

    def ready(self) -> bool:
        """Whether a node provides the service."""
        return self._participant.server(self._service, self._type) is not None

    def send(self, request: object) -> int:
        """Send a request; return the number of its response. Raises Unreachable."""
        import zenoh

        server = self._participant.server(self._service, self._type)
        if server is None:
            raise Unreachable(f"no node provides {self._service}")
        number = next(self._numbers)
        self._session.get(
            data_key(self._participant.domain, self._service, self._type, server.type.hash or "*"),
            partial(self._receive, number),
            payload=self._participant.messages.serialize(request, self._type, "Request"),
            attachment=write_attachment(Attachment(number, time.time_ns(), self._gid)),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_FOR_EVER,
        )
        return number

    def _receive(self, number: int, reply: Any) -> None:
        if reply.ok is not None:
            self.handle.put((number, reply.ok.payload.to_bytes()))

    def take(self) -> tuple[int, object] | None:
        """Return the next response with its number, or None; responses that cannot be read are dropped."""
        while (item := self.handle.take()) is not None:
            with suppress(ValueError):
                return item[0], self._participant.messages.deserialize(f"{self._type}_Response", item[1])
        return None

    def close(self) -> None: ...


class _Session:
    """The session with a router, opened on a thread as soon as there is one; zenoh itself opens it again later.

    `begin` is called with it.
    """

    def __init__(self, endpoint: str, begin: Callable[[Any], None]) -> None:
        self.found: Any = None
        self.lock = threading.RLock()
        self._endpoint = endpoint
        self._begin = begin
        self._words = "it does not answer in time"
        self._tried, self._closing = threading.Event(), threading.Event()
        threading.Thread(target=self._run, name="rosld-zenoh", daemon=True).start()
        self._tried.wait(_FIRST_SECONDS)

    def get(self) -> Any:
        """Return the session. Raises Unreachable."""
        if self.found is None:
            raise Unreachable(f"the router of zenoh at {self._endpoint} cannot be reached: {self._words}")
        return self.found

    def close(self) -> None:
        """Close the session, or stop trying."""
        self._closing.set()
        with self.lock:
            if self.found is not None:
                self.found.close()

    def _run(self) -> None:
        import zenoh

        while not self._closing.is_set():
            try:
                session: Any = zenoh.open(self._configuration())
            except Exception as error:
                self._words = str(error).partition("!")[0]
            else:
                with self.lock:
                    if self._closing.is_set():
                        session.close()
                    else:
                        self._begin(session)
                        self.found = session
                return
            finally:
                self._tried.set()
            self._closing.wait(_RETRY_SECONDS)

    def _configuration(self) -> Any:
        import zenoh

        config = zenoh.Config()
        for key, value in {
            "mode": "client",
            "connect/endpoints": [self._endpoint],
            "connect/timeout_ms": 0,
            "scouting/multicast/enabled": False,
            "timestamping/enabled": True,  # which caches of latched messages need
        }.items():
            config.insert_json5(key, json.dumps(value))
        return config


class ZenohParticipant(Participant):
    """rosld in a ROS 2 system over zenoh."""

    def __init__(self, endpoint: str, name: str, domain: int, namespace: str, library: TypeLibrary) -> None:
        self.domain = domain
        self.namespace = namespace
        self.hidden_name = f"{namespace.rstrip('/')}/{name}"
        self.visible_name: str | None = None
        self.messages = _ZenohMessages(library)
        self.readers: dict[int, ZenohReader] = {}
        self._library = library
        self._tokens: dict[str, Token] = {}
        self._index: dict[tuple[str, str], list[tuple[str, Token]]] | None = None
        self._own = ""
        self._ids = itertools.count(1)
        self._hide: Callable[[], None] | None = None
        self._session = _Session(endpoint, self._begin)

    def _begin(self, session: Any) -> None:
        """Discover the system and read topics, once there is a session; called on a thread of its own."""
        self._own = f"{SPACE}/{self.domain}/{session.zid()}/"
        session.liveliness().declare_subscriber(f"{SPACE}/{self.domain}/**", self._discover, history=True)
        for reader in list(self.readers.values()):
            reader.declare(session)

    def _discover(self, sample: Any) -> None:
        key = str(sample.key_expr)
        if key.startswith(self._own):
            return
        if str(sample.kind).endswith("DELETE"):
            self._tokens.pop(key, None)
        elif len(self._tokens) < _MAX_TOKENS and (token := parse_token(key)) is not None:
            self._tokens[key] = token
        self._index = None

    def _entities(self, kind: str, topic: str | None = None) -> list[tuple[str, Token]]:
        """Return the keys and tokens of a kind, of one topic or all."""
        index = self._index
        if index is None:
            index = {}
            self._index = index  # before the tokens are read, so that a token that arrives meanwhile is not missed
            for key, token in list(self._tokens.items()):
                for name in {"", token.topic}:
                    index.setdefault((token.kind, name), []).append((key, token))
        return index.get((kind, topic or ""), [])

    def node_names(self) -> tuple[str, ...]:
        """Return the nodes. Raises Unreachable while no router was ever reached."""
        self._session.get()
        return tuple(sorted(token.node for _, token in self._entities(NODE)))

    def topics(self) -> Names:
        """Return the topics and their types."""
        return _names(self._entities(PUBLISHER) + self._entities(SUBSCRIBER))

    def services(self) -> Names:
        """Return the services and their types."""
        return _names(self._entities(SERVER) + self._entities(CLIENT))

    def services_of(self, node: str) -> Names:
        """Return the services that a node provides."""
        return _names([each for each in self._entities(SERVER) if each[1].node == node])

    def clients_of(self, node: str) -> Names:
        """Return the services that a node has clients of."""
        return _names([each for each in self._entities(CLIENT) if each[1].node == node])

    def server(self, service: str, type: str) -> Token | None:
        """Return a server of a service, or None."""
        return next((token for _, token in self._entities(SERVER, service) if token.type.name == type), None)

    def counts(self, topic: str) -> tuple[int, int]:
        """Return the numbers of publishers and subscribers of a topic."""
        return len(self._entities(PUBLISHER, topic)), len(self._entities(SUBSCRIBER, topic))

    def publishers(self, topic: str) -> tuple[DiscoveredEndpoint, ...]:
        """Return the publishers of a topic."""
        return _endpoints(self._entities(PUBLISHER, topic))

    def subscribers(self, topic: str) -> tuple[DiscoveredEndpoint, ...]:
        """Return the subscribers of a topic."""
        return _endpoints(self._entities(SUBSCRIBER, topic))

    def show(self, name: str) -> None:
        """Declare a node of this name, to publish from."""
        if self._hide is None:
            self.visible_name = f"{self.namespace.rstrip('/')}/{name}"
            _, self._hide = self.declare(Token(NODE, self.visible_name, "", TypeRef(""), Qos()))

    def hide(self) -> None:
        """Remove the node."""
        if self._hide is not None:
            hide, self._hide, self.visible_name = self._hide, None, None
            hide()

    def declare(self, token: Token) -> tuple[str, Callable[[], None]]:
        """Declare an entity of ours, which is visible here at once; return its key and how to end it."""
        session = self._session.get()
        key = token_key(token, self.domain, str(session.zid()), 0, next(self._ids))
        declared = session.liveliness().declare_token(key)
        self._tokens[key], self._index = token, None

        def end() -> None:
            self._tokens.pop(key, None)
            self._index = None
            declared.undeclare()

        return key, end

    def reader(self, topic: str, type: str, qos: Qos) -> ZenohReader:
        """Return a new subscription. Raises ValueError."""
        reader = ZenohReader(data_key(self.domain, topic, type), qos, topic, self)
        with self._session.lock:
            self.readers[id(reader)] = reader
            if self._session.found is not None:
                reader.declare(self._session.found)
        return reader

    def writer(self, topic: str, type: str, qos: Qos) -> ZenohWriter:
        """Return a new publisher of the visible node. Raises UnknownType, ValueError."""
        used = (each.type for each in (*self.subscribers(topic), *self.publishers(topic)) if each.type.hash)
        ref = next((each for each in used if each.name == type), None) or self._library.find(TypeRef(type)).ref
        key = data_key(self.domain, topic, type, ref.hash or "*")
        token = Token(PUBLISHER, self.visible_name or self.hidden_name, topic, ref, qos)
        return ZenohWriter(self._session.get(), key, token, qos, topic, self)

    def client(self, service: str, type: str) -> ZenohClient:
        """Return a new client of a service."""
        return ZenohClient(self._session.get(), service, type, self)

    def close(self) -> None:
        """Leave the system."""
        self.hide()
        self._session.close()


@lru_cache(maxsize=10_000)
def gid_of(key: str) -> bytes:
    """Return the id of an entity: the XXH3 (128 bits) of the key of its token."""
    import xxhash

    return int(xxhash.xxh3_128_intdigest(key.encode())).to_bytes(16, "little")


def _names(entities: list[tuple[str, Token]]) -> Names:
    names: dict[str, dict[str, None]] = {}
    for _, token in entities:
        names.setdefault(token.topic, {})[token.type.name] = None
    return {name: tuple(sorted(types)) for name, types in sorted(names.items())}


def _endpoints(entities: list[tuple[str, Token]]) -> tuple[DiscoveredEndpoint, ...]:
    return tuple(DiscoveredEndpoint(token.node, token.type, token.qos, gid_of(key)) for key, token in sorted(entities))


def _call_soon(loop: asyncio.AbstractEventLoop, ready: Callable[[], None]) -> None:
    with suppress(RuntimeError):  # the loop has ended
        loop.call_soon_threadsafe(ready)
