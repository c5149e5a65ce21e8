"""Live topics: subscribed to on demand, for a limited time and within a budget."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Collection, Sequence
from fnmatch import fnmatchcase
from math import inf

from msgspec import Struct, field

from rosld.adapters.base import Adapter, Subscription, Watch
from rosld.adapters.model import Endpoint, Graph, Message, MessageSchema, RosError, Sample
from rosld.server.robot.schemas import Schemas
from rosld.server.robot.topic_view import (
    EMPTY_VIEW,
    FOLDS,
    QUEUE_DEPTH,
    FoldedTopic,
    RateEstimator,
    TopicView,
    decoder_of,
)
from rosld.server.runtime.tasks import Background, call_on_close, combine_watches, loop_time
from rosld.server.settings import Settings

_SWEEP = 0.5
"""Seconds between sweeps, which fold new messages and close idle subscriptions."""
_MEASURE = 2.5
"""Seconds between reads of all topics, which measure the rates of topics that no client reads."""


class _LiveTopic(Struct):
    """A subscription and its latest view.

    `awaited` are the publishers that sent nothing while awaited; `insisted`: a message was awaited even without
    publishers.
    """

    subscription: Subscription
    read_at: float = -inf
    eager: bool = False
    recorded: bool = False
    watches: int = 0
    folded: FoldedTopic | None = None
    rates: RateEstimator = field(default_factory=RateEstimator)
    latest: Sequence[Sample] | None = None
    view: TopicView = field(default_factory=TopicView)
    awaited: tuple[Endpoint, ...] = ()
    insisted: bool = False

    @property
    def is_exempt(self) -> bool:
        """Whether the subscription is currently exempt from closing."""
        return self.eager or self.recorded or self.watches > 0


class LiveTopics(Background):
    """The values of topics. Reading is free until a message arrives: it returns the same `TopicView`.

    A topic that is not in the graph has no values, even if messages were received before.
    """

    def __init__(self, adapter: Adapter, schemas: Schemas, settings: Settings) -> None:
        self.recorded: Callable[[], Collection[str]] = tuple
        """Function that returns the recorded topics; these stay subscribed to, so that values and rates are at hand."""
        self._adapter = adapter
        self._schemas = schemas
        self._settings = settings
        self._live: dict[str, _LiveTopic] = {}
        self._opening: dict[str, asyncio.Lock] = {}

    async def stop(self) -> None:
        """Close all subscriptions."""
        await super().stop()
        for topic in list(self._live):
            self._close(topic)

    def subscribed(self) -> Sequence[str]:
        """Return the currently subscribed topics."""
        return list(self._live)

    def always_subscribed(self) -> Sequence[str]:
        """Return the topics that stay subscribed to without being read, as far as they have a value."""
        there = self._adapter.graph.topics
        subscribed = ((topic, live) for topic, live in self._live.items() if live.eager or live.watches)
        present = [(topic, live) for topic, live in subscribed if topic in there]
        return [topic for topic, live in present if live.subscription.latest()]

    def find_view(self, topic: str) -> TopicView | None:
        """Return the view of a subscribed topic, without prolonging the subscription."""
        live = self._live.get(topic)
        if live is None or topic not in self._adapter.graph.topics:
            return None
        live.read_at = loop_time()
        view = self._refresh(live)
        return view if view.samples else None

    def peek(self, topic: str) -> TopicView | None:
        """Return the view of a subscribed topic without counting as a read, or None."""
        live = self._live.get(topic)
        return None if live is None or topic not in self._adapter.graph.topics else self._refresh(live)

    def current_view(self, topic: str) -> TopicView:
        """Return the current view without waiting; it is empty before the first message."""
        return self.find_view(topic) or self.last_view(topic) or EMPTY_VIEW

    def last_view(self, topic: str) -> TopicView | None:
        """Return the view of the last read (thread-safe)."""
        live = self._live.get(topic)
        return None if live is None or topic not in self._adapter.graph.topics else live.view

    def is_settled(self, topic: str) -> bool:
        """Whether `read` would return the same as `find_view`, without subscribing or waiting."""
        live = self._live.get(topic)
        if topic not in self._adapter.graph.topics:
            return True
        if live is None or live.view.samples:
            return live is not None
        return not live.subscription.latest() and set(self._publishers(topic)) <= set(live.awaited)

    async def read(self, topic: str, *, wait_for_publisher: bool = False) -> TopicView:
        """Return the view of a topic, subscribing if needed and then waiting a moment if the topic has publishers.

        The same publishers are awaited only once: a silent topic does not delay later reads. With `wait_for_publisher`
        the first read also waits if nobody publishes yet. A topic that is missing from the graph is neither subscribed
        to nor awaited.
        """
        view = self.find_view(topic)
        if view is not None:
            return view
        if topic not in self._adapter.graph.topics:
            return EMPTY_VIEW
        live = await self._open(topic)
        live.read_at = loop_time()
        await self._load_types(live)
        view = self._refresh(live)
        publishers = self._publishers(topic)
        is_new = wait_for_publisher and not live.insisted
        live.insisted |= wait_for_publisher
        if not view.samples and (is_new or not set(publishers) <= set(live.awaited)):
            await self._wait(live, self._settings.first_value_wait)
            await self._load_types(live)
            view = self._refresh(live)
            live.awaited = () if view.samples else publishers
        return view

    async def watch(self, topic: str, wake: Callable[[], None]) -> Watch:
        """Call `wake` after each new message; the topic stays subscribed to until the watch is closed."""
        live = await self._open(topic)
        live.watches += 1

        def end() -> None:
            live.watches -= 1
            live.read_at = loop_time()

        return combine_watches(live.subscription.watch(wake), call_on_close(end))

    async def subscribe_eager(self, graph: Graph) -> None:
        """Subscribe to the topics of this graph that match the eager globs."""
        for topic in graph.topics:
            if topic not in self._live and any(fnmatchcase(topic, glob) for glob in self._settings.subscribe):
                (await self._open(topic)).eager = True

    def _publishers(self, topic: str) -> tuple[Endpoint, ...]:
        """Return the publishers that can deliver messages."""
        entry = self._adapter.graph.topics.get(topic)
        return () if entry is None else tuple(one for one in entry.publishers if one.unreachable is None)

    async def _open(self, topic: str) -> _LiveTopic:
        async with self._opening.setdefault(topic, asyncio.Lock()):
            live = self._live.get(topic)
            if live is None:
                live = await self._subscribe(topic)
                self._keep_within_budget()
                self._live[topic] = live
        self._opening.pop(topic, None)
        return live

    async def _subscribe(self, topic: str) -> _LiveTopic:
        entry = self._adapter.graph.topics.get(topic)
        names = {ref.name for ref in entry.types} if entry else set()
        fold = next((FOLDS[name] for name in names if name in FOLDS), None)
        subscription = await self._adapter.subscribe(topic, depth=QUEUE_DEPTH if fold else 1)
        return _LiveTopic(subscription, folded=FoldedTopic(fold) if fold else None)

    async def _load_types(self, live: _LiveTopic) -> None:
        """Load the schemas needed for folding."""
        if live.folded is None:
            return
        for ref in {sample.schema for sample in live.subscription.latest()}:
            with contextlib.suppress(RosError):
                await self._schemas.get(ref)

    async def _wait(self, live: _LiveTopic, seconds: float) -> None:
        arrived = asyncio.Event()
        watch = live.subscription.watch(arrived.set)
        try:
            if not live.subscription.latest():
                with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
                    await asyncio.wait_for(arrived.wait(), seconds)
        finally:
            watch.close()

    def _refresh(self, live: _LiveTopic) -> TopicView:
        latest = live.subscription.latest()
        if latest is live.latest:
            return live.view
        if live.folded is None:
            samples = tuple(latest)
            live.view = TopicView(samples, live.rates.observe(samples))
        else:
            self._fold(live, live.folded, latest)
        live.latest = latest
        return live.view

    def _fold(self, live: _LiveTopic, folded: FoldedTopic, latest: Sequence[Sample]) -> None:
        ordered = tuple(latest)
        try:
            if not folded.take(ordered, self._decode):
                return
            whole = folded.sample(self._cached_schema(ordered[-1]))
        except (ValueError, LookupError):
            live.view = TopicView(ordered[-1:])  # a message that cannot be folded is shown unchanged
            return
        newest = {sample.publisher: sample for sample in ordered}
        rate = live.rates.observe(list(newest.values()))
        live.view = TopicView((whole,) if whole is not None else (), rate, folded.times())

    def _cached_schema(self, sample: Sample) -> MessageSchema:
        schema = self._schemas.find_cached(sample.schema)
        if not isinstance(schema, MessageSchema):
            raise LookupError(sample.schema.name)
        return schema

    def _decode(self, sample: Sample) -> Message:
        return decoder_of(self._cached_schema(sample))(sample)

    def _keep_within_budget(self) -> None:
        """Close idle subscriptions to make room for a new one."""
        over = len(self._live) + 1 - self._settings.subscription_budget
        if over > 0:
            idlest = sorted((live.read_at, topic) for topic, live in self._live.items() if not live.is_exempt)
            for _, topic in idlest[:over]:
                self._close(topic)

    def _close(self, topic: str) -> None:
        live = self._live.pop(topic, None)
        if live is not None:
            live.subscription.close()

    async def _run(self) -> None:
        measured = loop_time()
        while True:
            await asyncio.sleep(_SWEEP)
            await self._follow_recorded()
            now = loop_time()
            horizon = now - self._settings.idle_time
            if measures := now - measured >= _MEASURE:
                measured = now
            for topic, live in list(self._live.items()):
                is_gone = topic not in self._adapter.graph.topics
                if not live.is_exempt and (live.read_at < horizon or is_gone):
                    self._close(topic)
                    continue
                if live.awaited:  # publishers that return are awaited again
                    live.awaited = tuple(one for one in live.awaited if one in self._publishers(topic))
                if live.folded is not None:
                    await self._load_types(live)
                if measures or live.folded is not None or live.view.rate is None:
                    self._refresh(live)

    async def _follow_recorded(self) -> None:
        recorded = self.recorded()
        for topic in recorded:
            if topic in self._adapter.graph.topics and (live := self._live.get(topic)) is None:
                with contextlib.suppress(RosError):
                    await self._open(topic)
        for topic, live in self._live.items():
            live.recorded = topic in recorded
