"""Channels: their notifications of changes, their lifetime, and that nothing accumulates."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from msgspec.structs import replace

from rosld.adapters.base import Watch
from rosld.ontology.describe_graph import container_document
from rosld.ontology.urls import Space
from rosld.server.events import notification_channels
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.channel_request import ChannelRequest
from rosld.server.events.delivery import Delivery
from rosld.server.events.notification_channels import Channel, Channels
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import BASIC_CONTAINER, Resource
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import Signal

URL = "http://robot.example/things/"


class Things(Resource):
    """A container that reports its changes."""

    links = (BASIC_CONTAINER,)

    def __init__(self) -> None:
        super().__init__(Space("http://127.0.0.1/"), URL)
        self.members: tuple[str, ...] = ()
        self.problem: Problem | None = None
        self.looks = 0
        self._signal = Signal()

    async def state(self) -> State:
        self.looks += 1
        if self.problem is not None:
            raise self.problem
        members = self.members
        return State(lambda: container_document(URL, [URL + one for one in members], "Things"))

    async def watch(self, wake: Callable[[], None]) -> Watch:
        return self._signal.watch(wake)

    def become(self, *members: str, problem: Problem | None = None) -> None:
        self.members, self.problem = members, problem
        self._signal.emit()


class Told:
    """The output of a channel, and a receiver that can pause."""

    def __init__(self) -> None:
        self.chunks: list[bytes] = []
        self.takes = asyncio.Event()
        self.takes.set()
        self._came = asyncio.Condition()

    async def send(self, chunk: bytes) -> None:
        await self.takes.wait()
        async with self._came:
            self.chunks.append(chunk)
            self._came.notify_all()

    async def until(self, count: int) -> list[dict[str, str]]:
        async with self._came:
            await asyncio.wait_for(self._came.wait_for(lambda: len(self.chunks) >= count), 60)
        return [json.loads(chunk) for chunk in self.chunks]


async def soon(true: Callable[[], bool]) -> None:
    """Wait until a condition holds, for at most some seconds."""
    for _ in range(5000):
        if true():
            return
        await asyncio.sleep(0.001)
    raise AssertionError("it did not come to be so")


class Set:
    """Channels on one resource."""

    def __init__(self) -> None:
        self.things = Things()
        self.channels = Channels("boot")
        self.broadcasters = Broadcasters(Signal())

    async def open(self, wish: ChannelRequest | None = None) -> Channel:
        wish = wish or ChannelRequest(URL, interval=0.01)
        state = await self.things.state()
        return self.channels.open(wish, "T", self.things, state, lambda token: (URL + token, URL + "ws"))

    @asynccontextmanager
    async def delivering(self, channel: Channel, told: Told) -> AsyncIterator[asyncio.Task[None]]:
        """Receive, after the first state was read."""
        task = asyncio.create_task(Delivery(self.channels, self.broadcasters, channel, told.send, None).run())
        await soon(lambda: channel.last_sent.container is not None or task.done())
        try:
            yield task
        finally:
            task.cancel()
            await asyncio.wait({task})


async def test_changes_are_told_by_what_happened() -> None:
    one, told = Set(), Told()
    channel = await one.open()
    async with one.delivering(channel, told):
        one.things.become("a")
        await told.until(1)
        one.things.become("a", "b")
        await told.until(2)
        one.things.become("a")
        await told.until(3)
        one.things.become("x", "y", "z")
        await told.until(4)
        one.things.become(problem=Problem(404, "gone"))
        await told.until(5)
        one.things.become("x")
        came = await told.until(6)
        one.things.become(problem=Problem(503, "no robot"))
        looks = one.things.looks
        await soon(lambda: one.things.looks > looks)
        one.things.become("x", "y")
        assert (await told.until(7))[6]["type"] == "Add", "what cannot be read for a while is no news"
    assert [activity["type"] for activity in came] == ["Add", "Add", "Remove", "Update", "Delete", "Create"]
    assert [activity["object"] for activity in came] == [f"{URL}a", f"{URL}b", f"{URL}b", URL, URL, URL]
    assert [activity.get("target") for activity in came] == [URL, URL, URL, None, None, None]
    assert "state" not in came[4]
    assert came[0]["state"] == came[2]["state"] != came[1]["state"]
    assert len({activity["id"] for activity in came}) == 6


async def test_the_channel_of_a_resource_that_is_gone_for_good_ends() -> None:
    one, told = Set(), Told()
    channel = await one.open()
    async with one.delivering(channel, told) as task:
        one.things.become(problem=Problem(410, "gone"))
        (last,) = await told.until(1)
        await asyncio.wait_for(task, 60)
    assert last["type"] == "Delete"
    assert not one.channels.has(channel)


async def test_a_receiver_that_stands_still_gets_the_latest_and_nothing_piles_up() -> None:
    one, told = Set(), Told()
    channel = await one.open()
    told.takes.clear()
    async with one.delivering(channel, told):
        for number in range(200):
            one.things.become(str(number))
            await asyncio.sleep(0)
        looked = one.things.looks
        told.takes.set()
        came = await told.until(2)
        state = one.channels.state_name(await one.things.state())
    assert looked < 20
    assert came[-1]["state"] == state
    assert len(came) == 2


async def test_nothing_is_told_before_the_start() -> None:
    one, told = Set(), Told()
    began = time.time_ns()
    channel = await one.open(ChannelRequest(URL, interval=0.01, start_at=began + 300_000_000, state="other"))
    task = asyncio.create_task(Delivery(one.channels, one.broadcasters, channel, told.send, None).run())
    await told.until(1)
    assert time.time_ns() - began >= 290_000_000
    task.cancel()
    await asyncio.wait({task})


async def test_channels_without_a_receiver_are_forgotten() -> None:
    one = Set()
    channel = await one.open()
    assert one.channels.find(channel.token) is channel
    channel.since -= notification_channels.IDLE_SECONDS
    with pytest.raises(Problem, match="subscribe again"):
        one.channels.find(channel.token)
    over = await one.open()
    over.terms = replace(over.terms, end_at=time.time_ns() - 1)
    with pytest.raises(Problem, match="404"):
        one.channels.find(over.token)
    assert len(one.channels) == 0
    tokens = {(await one.open()).token for _ in range(100)}
    assert (len(tokens), min(map(len, tokens)) >= 32) == (100, True), "tokens cannot be guessed"


async def test_when_all_places_are_taken_the_longest_idle_gives_way() -> None:
    one = Set()
    one.channels = Channels("boot", limit=3)
    first, second, third = [await one.open() for _ in range(3)]
    async with one.delivering(first, Told()):
        fourth = await one.open()
        assert [one.channels.has(each) for each in (first, second, third, fourth)] == [True, False, True, True]
        async with one.delivering(third, Told()), one.delivering(fourth, Told()):
            with pytest.raises(Problem) as caught:
                await one.open()
            assert caught.value.status == 503
            assert "Retry-After" in caught.value.headers
