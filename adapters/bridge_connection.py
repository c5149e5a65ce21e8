"""WebSocket bridges: the connection, which is opened again whenever it is lost, and the base of systems behind it."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol
from urllib.parse import parse_qsl, unquote, urlsplit

from rosld.adapters.base import Sink
from rosld.adapters.model import (
    Encoding,
    Graph,
    MessageSchema,
    RosError,
    Sample,
    Sent,
    TimedOut,
    TypeRef,
    Unreachable,
)
from rosld.adapters.registry import without_credentials
from rosld.adapters.slots import received_ns
from rosld.adapters.thread import LiveFeed, wait_event

_FIRST_PAUSE, _LONGEST_PAUSE = 0.2, 5.0
_OPEN_SECONDS = 5.0
_PING_SECONDS = 5.0
"""Interval and patience of pings: a bridge that lost its network is Stale after at most twice this time."""
_MAX_UNSENT = 1000
"""Maximum number of messages that wait for a slow bridge; further ones are refused."""
_ECHO_SECONDS = 2.0
_MAX_ECHOES = 64
_EPOCHS = itertools.count()
logging.getLogger("websockets.client").setLevel(logging.INFO)  # at lower levels it logs credentials


class BridgeSource(NamedTuple):
    """The address `HOST:PORT/PATH` of a bridge, the value of `Authorization` for it, and the options of a source."""

    address: str
    is_tls: bool
    authorization: str | None
    options: Mapping[str, str]


def read_source(source: str, port: int, options: Sequence[str] = ()) -> BridgeSource:
    """Return what `SCHEME://USER:PASSWORD@HOST:PORT/PATH?OPTION=VALUE` says; `SCHEMEs` is over TLS.

    All but the scheme may be left out. `:TOKEN@` is a bearer token. Raises ValueError with a sentence for the user, in
    which nothing that may be a password is repeated.
    """
    scheme = source.partition(":")[0]
    example = f"write {scheme}://HOST:{port}"
    try:
        parts = urlsplit(source if ":" in source else f"{source}:")
        if parts.path and not parts.path.startswith("/"):
            raise ValueError(parts.path)
        host, given = parts.hostname or "localhost", parts.port or port
        pairs = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)))
    except ValueError:
        shown = without_credentials(source)
        raise ValueError(f"{shown!r} does not name a host, a port and options: {example}") from None
    for name in pairs:
        if name not in options:
            known = f"the options are {' and '.join(options)}" if options else "there are none"
            raise ValueError(f"{name!r} is not an option of {scheme}: {known}; {example}")
    user, password = unquote(parts.username or ""), unquote(parts.password or "")
    authorization = f"Bearer {password}" if password else None
    if user:
        authorization = f"Basic {base64.b64encode(f'{user}:{password}'.encode()).decode()}"
    host = f"[{host}]" if ":" in host else host
    path = "" if parts.path == "/" else parts.path
    return BridgeSource(f"{host}:{given}{path}", scheme.endswith("s"), authorization, pairs)


class Session(Protocol):
    """The protocol spoken over a connection. All methods are called on the adapter's thread."""

    async def begin(self) -> None:
        """Start speaking on a new connection, which receives meanwhile. A RosError closes it, to be tried again."""

    async def receive(self, message: str | bytes) -> None:
        """Process a message, before the next one is read. A ValueError closes the connection."""

    def end(self, error: RosError) -> None:
        """Learn that there is no connection, after each lost one and each attempt that failed."""


class BridgeConnection:
    """A connection to a bridge, opened again after it was lost. Belongs to the adapter's thread."""

    def __init__(
        self,
        name: str,
        source: BridgeSource,
        session: Session,
        message_limit: int,
        subprotocols: Sequence[str] = (),
    ) -> None:
        self._url = f"{'wss' if source.is_tls else 'ws'}://{source.address}"
        self._headers = {"Authorization": source.authorization} if source.authorization else None
        self._session = session
        self._limit = message_limit
        self._subprotocols = subprotocols
        self.name = f"the {name} at {self._url}"
        self._unsent: asyncio.Queue[str | bytes] | None = None
        self._task: asyncio.Task[None] | None = None
        self._tried = asyncio.Event()

    @property
    def is_open(self) -> bool:
        """Whether there is a connection."""
        return self._unsent is not None

    async def open(self, patience: float) -> None:
        """Connect in the background; return once a session has begun or could not be begun, or after `patience`."""
        self._task = asyncio.get_running_loop().create_task(self._run())
        try:
            await asyncio.wait_for(self._tried.wait(), max(patience, 0.0))
        except asyncio.TimeoutError:
            self._session.end(TimedOut(f"{self.name} does not answer in time"))

    async def close(self) -> None:
        """Disconnect, after what was sent. Idempotent."""
        task, self._task = self._task, None
        if self._unsent is not None:
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._unsent.join(), 0.5)
        if task is not None:
            task.cancel()
            await asyncio.wait([task], timeout=1.0)

    def send(self, message: str | bytes) -> None:
        """Queue a message. Raises Unreachable without a connection, or if too many messages are queued."""
        if self._unsent is None:
            raise Unreachable(f"{self.name} is not connected")
        try:
            self._unsent.put_nowait(message)
        except asyncio.QueueFull as error:
            raise Unreachable(f"{self.name} does not read what it is sent") from error

    async def _run(self) -> None:
        pause = _FIRST_PAUSE
        while True:
            started = time.monotonic()
            try:
                await self._connect()
                error: RosError = Unreachable(f"{self.name} closed the connection")
            except RosError as problem:
                error = problem
            except Exception as problem:  # what libraries raise about a broken handshake has no common class
                words = " ".join(str(problem).split()) or type(problem).__name__
                error = Unreachable(f"{self.name} cannot be reached: {words}")
            self._session.end(error)
            self._tried.set()
            pause = _FIRST_PAUSE if time.monotonic() - started > _LONGEST_PAUSE else min(2 * pause, _LONGEST_PAUSE)
            await asyncio.sleep(pause)

    async def _connect(self) -> None:
        """Hold one connection until it ends."""
        from websockets.asyncio.client import connect  # 20 ms, only for those who have a bridge

        connecting = connect(
            self._url,
            additional_headers=self._headers,
            subprotocols=list(self._subprotocols) or None,  # type: ignore[arg-type]
            compression=None,
            max_size=self._limit,
            open_timeout=_OPEN_SECONDS,
            ping_interval=_PING_SECONDS,
            ping_timeout=_PING_SECONDS,
            close_timeout=0.5,
            proxy=None,
        )
        connecting.process_redirect = lambda error: error  # type: ignore[assignment,method-assign]  # no other host
        async with connecting as socket:
            if self._subprotocols and socket.subprotocol is None:
                raise ValueError(f"it speaks none of {', '.join(self._subprotocols)}")
            self._unsent = asyncio.Queue(_MAX_UNSENT)
            tasks = [asyncio.ensure_future(each) for each in (self._read(socket), self._write(socket, self._unsent))]
            beginning = asyncio.ensure_future(self._begin())
            try:
                done, _ = await asyncio.wait([*tasks, beginning], return_when=asyncio.FIRST_COMPLETED)
                if beginning in done:
                    beginning.result()
                    done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                done.pop().result()
            finally:
                self._unsent = None
                for task in (*tasks, beginning):
                    task.cancel()
                await asyncio.gather(*tasks, beginning, return_exceptions=True)
                await socket.close()  # before the context manager would, with the code of an internal error

    async def _begin(self) -> None:
        await self._session.begin()
        self._tried.set()

    async def _read(self, socket: Any) -> None:
        async for message in socket:
            await self._session.receive(message)

    async def _write(self, socket: Any, unsent: asyncio.Queue[str | bytes]) -> None:
        while True:
            await socket.send(await unsent.get())
            unsent.task_done()


class Calls:
    """Requests that are answered by messages with their ids. Belongs to the adapter's thread."""

    def __init__(self) -> None:
        self._pending: dict[object, asyncio.Future[Any]] = {}

    async def answer(self, id: object, what: str, until: float) -> Any:
        """Return the answer to the request with this id, which was just sent. Raises TimedOut, Unreachable."""
        loop = asyncio.get_running_loop()
        future = self._pending[id] = loop.create_future()
        try:
            return await asyncio.wait_for(future, None if until == math.inf else max(until - loop.time(), 0.0))
        except asyncio.TimeoutError as error:
            raise TimedOut(f"{what} did not answer in time", sent=Sent.MAYBE) from error
        finally:
            self._pending.pop(id, None)

    def settle(self, id: object, answer: object) -> bool:
        """Return an answer, or raise an error, in `answer`; return whether there was such a request."""
        future = self._pending.get(id)
        if future is None or future.done():
            return False
        if isinstance(answer, BaseException):
            future.set_exception(answer)
        else:
            future.set_result(answer)
        return True

    def fail(self, words: str) -> None:
        """Fail all pending requests, because the connection was lost."""
        for id in list(self._pending):
            self.settle(id, Unreachable(words, sent=Sent.MAYBE))


class BridgeFeed(LiveFeed):
    """Messages of one topic that arrive through a bridge.

    The adapter's thread calls `put`; everything else belongs to the server's event loop.
    """

    def __init__(self, topic: str, encoding: Encoding, changed: Callable[[Any], None]) -> None:
        super().__init__(topic, changed)
        self._encoding = encoding
        self._server = asyncio.get_running_loop()
        self._epoch = next(_EPOCHS)
        self._sequence = 0
        self._received: tuple[Sample, ...] = ()
        self._woken = False
        self._known: tuple[tuple[Sample, ...], tuple[Sample, ...]] = ((), ())
        self._views: dict[int, tuple[Sample, ...]] = {}

    def put(self, data: bytes, type: TypeRef, publisher: str) -> None:
        """Add a message."""
        self._sequence += 1
        sample = Sample(data, self._encoding, type, publisher, time.time_ns(), self._sequence, self._epoch)
        self._received = (*self._received, sample)[-self.depth :]
        if self.watches and not self._woken:
            self._woken = True
            with contextlib.suppress(RuntimeError):  # the server's event loop has ended
                self._server.call_soon_threadsafe(self._wake)

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest `depth` samples of others and of rosld; the same object if nothing is new."""
        known = self._received, self.own
        if known[0] is not self._known[0] or known[1] is not self._known[1]:
            self._known = known
            self._views.clear()
        view = self._views.get(depth)
        if view is None:
            newest = (*self._known[0][-depth:], *self._known[1][-depth:])
            view = self._views[depth] = tuple(sorted(newest, key=received_ns))
        return view

    def _wake(self) -> None:
        self._woken = False
        self.notify()


class BridgePublication:
    """A topic that rosld publishes through a bridge; `matched` is the number of subscribers in the graph."""

    def __init__(
        self,
        topic: str,
        schema: MessageSchema,
        transmit: Callable[[BridgePublication, bytes], None],
        *,
        id: int = 0,
        encoding: str = "",
        latched: bool = False,
    ) -> None:
        """`id` and `encoding` are those of a channel, for protocols that have them."""
        self.topic = topic
        self.schema = schema
        self.ref = schema.ref
        self.id = id
        self.encoding = encoding
        self.latched = latched
        self.matched = 0
        self._transmit = transmit
        self._changed = asyncio.Event()

    async def wait_matched(self, count: int, until: float, patience: float) -> None:
        """Wait until there are `count` subscribers, at most until a time of the thread's loop."""
        while self.matched < count and await wait_event(self._changed, until - time.monotonic()):
            self._changed.clear()

    def match(self, count: int) -> None:
        """Set the number of subscribers."""
        self.matched = count
        self._changed.set()

    def send(self, data: bytes, latch: bool) -> None:
        """Send a message, which is lost without a connection."""
        with contextlib.suppress(RosError, ValueError):
            self._transmit(self, data)


class BridgePublications(dict[str, BridgePublication]):
    """The publications by topic; `latches` is whether the bridge can latch messages."""

    is_connected = False

    def __init__(self, *, latches: bool) -> None:
        self._latches = latches

    def suitable(self, topic: str, type: TypeRef, latch: bool) -> BridgePublication | None:
        """Return the publication of a topic if messages of this type can be sent with it now (thread-safe)."""
        found = self.get(topic) if self.is_connected else None
        if found is None or found.ref.name != type.name or type.hash not in (None, found.ref.hash):
            return None
        return found if found.latched or not (latch and self._latches) else None

    def is_latched(self, publication: BridgePublication, latch: bool) -> bool:
        """Whether a message is latched: as its publication is."""
        return publication.latched


class BridgeSystem:
    """Base of the systems behind a bridge. Belongs to the adapter's thread, except for `graph`.

    A bridge returns what rosld published to rosld as a subscriber, and does not say who published a message.
    """

    def __init__(self, graph: Graph, sink: Sink, *, latches: bool) -> None:
        self.graph = graph
        self.sink = sink
        self.publications = BridgePublications(latches=latches)
        self._published: deque[tuple[float, str, bytes]] = deque(maxlen=_MAX_ECHOES)

    def show(self, graph: Graph) -> None:
        """Replace the graph."""
        if graph is not self.graph:
            self.graph = graph
            self.sink.graph_changed(graph)

    def expect_echo(self, topic: str, data: bytes) -> None:
        """Note a published message."""
        self._published.append((time.monotonic(), topic, data))

    def deliver(self, feed: BridgeFeed, data: bytes, type: TypeRef) -> None:
        """Add a received message to a feed, as one of the topic's only publisher; drop an echo."""
        since = time.monotonic() - _ECHO_SECONDS
        for each in self._published:
            if each[2] == data and each[1] == feed.topic and each[0] > since:
                self._published.remove(each)
                return
        topic = self.graph.topics.get(feed.topic)
        nodes = {each.node for each in topic.publishers} - {self.graph.own_node} if topic else ()
        feed.put(data, type, next(iter(nodes)) if len(nodes) == 1 else "")

    def deepen(self, feed: BridgeFeed) -> None:
        """Do nothing: a feed reads its depth with each message."""
