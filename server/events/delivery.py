"""Delivery: the notifications of a channel sent one after another, no faster than its rate and its receiver allow.

Nothing is queued. A receiver that is slow, away, or wants few notifications gets one that tells of the latest state.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import Awaitable, Callable
from typing import TypeAlias

import orjson

from rosld.ontology.notifications import ACTIVITY_CONTEXT, CONTEXT, Activity, with_context
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.server.events.broadcaster import Broadcaster, Broadcasters, Observation, Waiter
from rosld.server.events.notification_channels import Channel, Channels

Send: TypeAlias = Callable[[bytes], Awaitable[None]]
KEEP_ALIVE_SECONDS = 15.0
_RDF = {"text/turtle": Syntax.TURTLE, "application/n-triples": Syntax.N_TRIPLES}


class Delivery:
    """Sends the notifications of a channel by `send`, and calls `idle` whenever nothing was sent for a while."""

    def __init__(
        self, channels: Channels, broadcasters: Broadcasters, channel: Channel, send: Send, idle: Send | None
    ) -> None:
        self._channels = channels
        self._broadcasters = broadcasters
        self._channel = channel
        self._send = send
        self._idle = idle

    async def run(self) -> None:
        """Deliver until the topic is gone for good, or this is cancelled."""
        with self._channels.attach_receiver(self._channel):
            await self._pause(self._channel.seconds_to_start)
            with self._broadcasters.subscribe(self._channel.resource) as broadcaster:
                await self._follow(broadcaster)

    async def _follow(self, broadcaster: Broadcaster) -> None:
        waiter = Waiter()
        version = 0
        while True:
            if broadcaster.version == version:
                await self._wait(broadcaster, waiter, version)
                if broadcaster.version == version:
                    await self._still_here()
                    continue
            await self._pause(self._channel.due - time.monotonic())
            version = broadcaster.version
            moment = broadcaster.current() or await broadcaster.observe()
            may_read = self._channel.auth.is_valid()
            if may_read:
                await self._tell(moment)
            if moment.is_final or not may_read:
                self._channels.close(self._channel)
                return

    async def _tell(self, moment: Observation) -> None:
        channel = self._channel
        news, told = self._channels.next_notification(channel, moment)
        if news is None:
            channel.last_sent = told
            return
        chunk = notification(moment, news, channel.terms.accept)
        channel.due = time.monotonic() + channel.terms.interval
        await self._send(chunk)
        channel.last_sent = told

    async def _wait(self, broadcaster: Broadcaster, waiter: Waiter, version: int) -> None:
        """Until the topic may have changed, or it has been quiet for a while."""
        if self._idle is None:
            await broadcaster.wait(waiter, version)
            return
        timer = asyncio.get_running_loop().call_later(KEEP_ALIVE_SECONDS, waiter.wake)
        try:
            await broadcaster.wait(waiter, version)
        finally:
            timer.cancel()

    async def _pause(self, seconds: float) -> None:
        """Sleep, giving signs of life."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            await asyncio.sleep(min(left, KEEP_ALIVE_SECONDS))
            if left > KEEP_ALIVE_SECONDS:
                await self._still_here()

    async def _still_here(self) -> None:
        if self._idle is not None:
            await self._idle(b"\n")


def notification(observation: Observation, activity: Activity, media_type: str) -> bytes:
    """The notification that tells the news of a moment: made once for all channels that tell the same."""
    key = f"{media_type} {activity}"
    found = observation.chunks.get(key)
    if found is None:
        found = observation.chunks[key] = _write(activity, media_type)
    return found


def _write(news: Activity, media_type: str) -> bytes:
    id, published = uuid.uuid4().urn, time.time_ns() // 1_000_000 * 1_000_000
    syntax = _RDF.get(media_type)
    if syntax is not None:
        return serialize(news.document(id, published), syntax)
    return orjson.dumps(with_context(news.members(id, published), ACTIVITY_CONTEXT, CONTEXT))
