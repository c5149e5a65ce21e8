"""WebSocket bridges: the connection, which is opened again whenever it is lost, and the feeds and the graph over it."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol
from urllib.parse import parse_qsl, urlsplit

from rosld.adapters.base import Sink
from rosld.adapters.model import Encoding, Graph, RosError, Sample, Sent, TimedOut, TypeRef, Unreachable
from rosld.adapters.slots import received_ns
from rosld.adapters.thread import LiveFeed

_FIRST_PAUSE, _LONGEST_PAUSE = 0.2, 5.0
_OPEN_SECONDS = 5.0
_PING_SECONDS = 5.0
"""Interval and patience of pings: a bridge that lost its network is Stale after at most twice this time."""
_MAX_UNSENT = 1000
"""Maximum number of messages that wait for a slow bridge; further ones are refused."""
_ECHO_SECONDS = 2.0
_MAX_ECHOES = 64


class BridgeSource(NamedTuple):
    """A WebSocket URL, and the options of a source."""

    url: str
    options: Mapping[str, str]


def read_source(source: str, scheme: str, port: int, options: Sequence[str] = ()) -> BridgeSource:
    """Return the URL in `SCHEME://HOST:PORT/PATH?OPTION=VALUE`; `SCHEMEs` is over TLS.

    Raises ValueError with a sentence for the user.
    """
    example = f"{scheme}://HOST:{port}"
    try:
        parts = urlsplit(source)
        host, given = parts.hostname, parts.port
        pairs = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)))
    except ValueError as error:
        raise ValueError(f"{source!r} cannot be read ({error}): write {example}") from error
    if not host:
        raise ValueError(f"{source!r} does not name a host: write {example}")
    for name in pairs:
        if name not in options:
            known = f"the options are {' and '.join(options)}" if options else "there are none"
            raise ValueError(f"{name!r} is not an option of {scheme}: {known}")
    address = f"[{host}]" if ":" in host else host
    tls = "s" if parts.scheme == f"{scheme}s" else ""
    return BridgeSource(f"ws{tls}://{address}:{given or port}{parts.path}", pairs)


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
        url: str,
        session: Session,
        *,
        message_limit: int,
        subprotocols: Sequence[str] = (),
        name: str = "bridge",
        shown: str | None = None,
    ) -> None:
        """`shown` is the URL in messages, without credentials."""
        self._url = url
        self._session = session
        self._limit = message_limit
        self._subprotocols = subprotocols
        self._name = f"the {name} at {shown or url}"
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
            self._session.end(TimedOut(f"{self._name} does not answer in time"))

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
            raise Unreachable(f"{self._name} is not connected")
        try:
            self._unsent.put_nowait(message)
        except asyncio.QueueFull as error:
            raise Unreachable(f"{self._name} does not read what it is sent") from error

    async def _run(self) -> None:
        pause = _FIRST_PAUSE
        while True:
            started = time.monotonic()
            try:
                await self._connect()
                error: RosError = Unreachable(f"{self._name} closed the connection")
            except RosError as problem:
                error = problem
            except Exception as problem:  # what libraries raise about a broken handshake has no common class
                words = " ".join(str(problem).split()) or type(problem).__name__
                error = Unreachable(f"{self._name} cannot be reached: {words}")
            self._session.end(error)
            self._tried.set()
            pause = _FIRST_PAUSE if time.monotonic() - started > _LONGEST_PAUSE else min(2 * pause, _LONGEST_PAUSE)
            await asyncio.sleep(pause)

    async def _connect(self) -> None:
        """Hold one connection until it ends."""
        from websockets.asyncio.client import connect  # 20 ms, only for those who have a bridge

        async with connect(
            self._url,
            subprotocols=list(self._subprotocols) or None,  # type: ignore[arg-type]
            compression=None,
            max_size=self._limit,
            open_timeout=_OPEN_SECONDS,
            ping_interval=_PING_SECONDS,
            ping_timeout=_PING_SECONDS,
            close_timeout=0.5,
            proxy=None,
        ) as socket:
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
    """Messages of one topic that arrive through a bridge, which does not say who published them.

    The adapter's thread calls `put` and replaces `publisher`, the only publisher of the topic or an empty string;
    everything else belongs to the server's event loop.
    """

    def __init__(self, topic: str, encoding: Encoding, changed: Callable[[Any], None]) -> None:
        super().__init__(topic, changed)
        self.publisher = ""
        self.latched = False
        self._encoding = encoding
        self._server = asyncio.get_running_loop()
        self._received: tuple[Sample, ...] = ()
        self._woken = False
        self._known: tuple[tuple[Sample, ...], tuple[Sample, ...]] = ((), ())
        self._views: dict[int, tuple[Sample, ...]] = {}

    def put(self, data: bytes, type: TypeRef, sequence: int) -> None:
        """Add a message: the `sequence`th that was received on the topic."""
        origin = self.publisher, time.time_ns(), sequence
        sample = Sample(data, self._encoding, type, *origin, latched=self.latched)
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


class Echoes:
    """Messages that rosld published a moment ago, which a bridge returns to rosld as a subscriber of the topic."""

    def __init__(self) -> None:
        self._published: deque[tuple[float, str, bytes]] = deque(maxlen=_MAX_ECHOES)

    def note(self, topic: str, data: bytes) -> None:
        """Expect the echo of a message."""
        self._published.append((time.monotonic(), topic, data))

    def take(self, topic: str, data: bytes) -> bool:
        """Whether a received message is an echo that was not recognized before."""
        now = time.monotonic()
        for each in self._published:
            if each[2] == data and each[1] == topic and now - each[0] < _ECHO_SECONDS:
                self._published.remove(each)
                return True
        return False


class BridgeGraph:
    """The current graph, which any thread may read; changes are reported to the sink."""

    def __init__(self, graph: Graph, sink: Sink) -> None:
        self.current = graph
        self._sink = sink

    def update(self, **parts: Any) -> None:
        """Replace parts of the graph, which is live."""
        self._show(self.current.updated(**parts))

    def mark_stale(self, error: RosError) -> None:
        """Mark the graph as the last one known, because of an error."""
        self._show(self.current.as_stale(error.sentence))

    def _show(self, graph: Graph) -> None:
        if graph is not self.current:
            self.current = graph
            self._sink.graph_changed(graph)
