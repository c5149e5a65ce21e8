"""Channels: what they tell of which change, how long they are kept, and that nothing piles up."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.adapters.base import Watch
from rosld.ontology.describe_containers import container_document
from rosld.ontology.notifications import activity, notify
from rosld.server.events import notification_channels
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.channel_request import ChannelRequest
from rosld.server.events.delivery import Delivery
from rosld.server.events.notification_channels import Channel, Channels
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import BASIC_CONTAINER, Resource
from rosld.server.rest.state import State
from rosld.server.runtime.signals import Signal

URL = "http://robot.example/things/"


class Things(Resource):
    """A container that says when it changes."""

    links = (BASIC_CONTAINER,)

    def __init__(self) -> None:
        super().__init__(URL)
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
    """What came out of a channel, and a receiver that can stand still."""

    def __init__(self) -> None:
        self.chunks: list[bytes] = []
        self.at: list[float] = []
        self.takes = asyncio.Event()
        self.takes.set()
        self._came = asyncio.Condition()

    async def send(self, chunk: bytes) -> None:
        await self.takes.wait()
        async with self._came:
            self.chunks.append(chunk)
            self.at.append(time.monotonic())
            self._came.notify_all()

    async def until(self, count: int) -> list[dict[str, str]]:
        async with self._came:
            await asyncio.wait_for(self._came.wait_for(lambda: len(self.chunks) >= count), 60)
        return [json.loads(chunk) for chunk in self.chunks]


async def soon(true: Callable[[], bool]) -> None:
    """Until something is so, for at most some seconds."""
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
        """Receive, and have looked once."""
        task = asyncio.create_task(Delivery(self.channels, self.broadcasters, channel, told.send, None).run())
        await soon(lambda: channel.last_sent.container is not None or task.done())
        try:
            yield task
        finally:
            task.cancel()
            await asyncio.wait({task})


def test_changes_are_told_by_what_happened() -> None:
    async def run() -> None:
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
        assert [activity["type"] for activity in came] == ["Add", "Add", "Remove", "Update", "Delete", "Create"]
        assert [activity["object"] for activity in came] == [f"{URL}a", f"{URL}b", f"{URL}b", URL, URL, URL]
        assert [activity.get("target") for activity in came] == [URL, URL, URL, None, None, None]
        assert "state" not in came[4]
        assert came[0]["state"] == came[2]["state"] != came[1]["state"]
        assert len({activity["id"] for activity in came}) == 6

    asyncio.run(run())


def test_the_present_state_is_told_at_once_to_whom_has_another() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        channel = await one.open(ChannelRequest(URL, state="boot-long-ago"))
        async with one.delivering(channel, told):
            (first,) = await told.until(1)
        quiet = Told()
        same = await one.open(ChannelRequest(URL, interval=0.01, state=f'"{first["state"]}.ttl"'))
        async with one.delivering(same, quiet):
            one.things.become("a")
            (second,) = await quiet.until(1)
        assert first["type"] == second["type"].replace("Add", "Update") == "Update"
        assert second["state"] != first["state"]

    asyncio.run(run())


def test_what_changed_before_the_receiver_came_or_while_it_was_away_is_told_once() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        channel = await one.open()
        one.things.become("a")
        async with one.delivering(channel, told):
            await told.until(1)
        one.things.become("a", "b")
        one.things.become("a", "b", "c")
        async with one.delivering(channel, told):
            await told.until(2)
        async with one.delivering(channel, told):
            one.things.become()
            came = await told.until(3)
        assert [activity["type"] for activity in came] == ["Update", "Update", "Update"]

    asyncio.run(run())


def test_what_cannot_be_read_for_a_while_is_no_news() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        channel = await one.open()
        async with one.delivering(channel, told):
            looks = one.things.looks
            one.things.become(problem=Problem(503, "no robot"))
            await soon(lambda: one.things.looks > looks)
            one.things.become("a")
            (only,) = await told.until(1)
        assert only["type"] == "Add"

    asyncio.run(run())


def test_a_topic_that_is_gone_for_good_ends_its_channel() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        channel = await one.open()
        async with one.delivering(channel, told) as task:
            one.things.become(problem=Problem(410, "gone"))
            (last,) = await told.until(1)
            await asyncio.wait_for(task, 60)
        assert last["type"] == "Delete"
        assert not one.channels.has(channel)

    asyncio.run(run())


def test_the_rate_is_the_least_time_between_two_notifications() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        channel = await one.open(ChannelRequest(URL, interval=0.1))
        async with one.delivering(channel, told):
            for number in range(60):
                one.things.become(str(number))
                await asyncio.sleep(0.01)
        between = [later - earlier for earlier, later in zip(told.at, told.at[1:], strict=False)]
        assert 4 <= len(told.chunks) <= 8
        assert min(between) >= 0.099

    asyncio.run(run())


def test_a_receiver_that_stands_still_gets_the_latest_and_nothing_piles_up() -> None:
    async def run() -> None:
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

    asyncio.run(run())


def test_a_change_is_written_once_however_many_channels_tell_it() -> None:
    async def run() -> None:
        one = Set()
        tolds = [Told() for _ in range(20)]
        tasks = []
        for told in tolds:
            channel = await one.open()
            tasks.append(asyncio.create_task(Delivery(one.channels, one.broadcasters, channel, told.send, None).run()))
        await asyncio.sleep(0.05)
        looks = one.things.looks
        one.things.become("a")
        for told in tolds:
            await told.until(1)
        assert one.things.looks == looks + 1
        assert len({id(told.chunks[0]) for told in tolds}) == 1
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)

    asyncio.run(run())


def test_turtle_says_what_jsonld_says() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        channel = await one.open(ChannelRequest(URL, accept="text/turtle"))
        async with one.delivering(channel, told):
            one.things.become("a")
            await soon(lambda: bool(told.chunks))
        said = {quad.predicate: quad.object for quad in parse(told.chunks[0], RdfFormat.TURTLE)}
        assert said[activity.object] == NamedNode(f"{URL}a")
        assert said[activity.target] == NamedNode(URL)
        assert {activity.published, notify.state} <= set(said)

    asyncio.run(run())


def test_nothing_is_told_before_the_start() -> None:
    async def run() -> None:
        one, told = Set(), Told()
        began = time.time_ns()
        channel = await one.open(ChannelRequest(URL, interval=0.01, start_at=began + 300_000_000, state="other"))
        task = asyncio.create_task(Delivery(one.channels, one.broadcasters, channel, told.send, None).run())
        await told.until(1)
        assert time.time_ns() - began >= 290_000_000
        task.cancel()
        await asyncio.wait({task})

    asyncio.run(run())


def test_a_second_receiver_takes_the_place_of_the_first() -> None:
    async def run() -> None:
        one, old, new = Set(), Told(), Told()
        channel = await one.open()
        async with one.delivering(channel, old) as first:
            second = asyncio.create_task(Delivery(one.channels, one.broadcasters, channel, new.send, None).run())
            await asyncio.wait({first}, timeout=5)
            assert first.cancelled()
            assert channel.receiver is second
            one.things.become("a")
            await new.until(1)
            assert not old.chunks
            second.cancel()
            await asyncio.wait({second})
        assert channel.receiver is None

    asyncio.run(run())


def test_channels_nobody_receives_from_are_forgotten() -> None:
    async def run() -> None:
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

    asyncio.run(run())


def test_when_all_places_are_taken_the_longest_idle_gives_way() -> None:
    async def run() -> None:
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

    asyncio.run(run())


def test_tokens_cannot_be_guessed() -> None:
    async def run() -> None:
        one = Set()
        tokens = {(await one.open()).token for _ in range(100)}
        assert len(tokens) == 100
        assert min(map(len, tokens)) >= 32

    asyncio.run(run())
