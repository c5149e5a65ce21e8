"""Many readers of one resource: what they share, and the cost of one for the others."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import pytest

from rosld.adapters.base import Watch
from rosld.adapters.model import TypeRef, Unreachable
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.events import broadcaster, event_stream
from rosld.server.events.event_stream import KEEP_ALIVE_COMMENT
from rosld.server.http.problem import Problem
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import Signal

pytestmark = pytest.mark.slow

SPEED = "/topics/aircraft/engine/speed"
DISPLAY = "/topics/cockpit/display"


async def show(app: Any, text: str) -> None:
    """Publish on the cockpit's display."""
    schema = await app.session.schemas.message(TypeRef("std_msgs/msg/String"))
    encoding = app.session.adapter.capabilities.encoding
    data = schema.codec.encode(schema.codec.build(schema.ref.name, {"data": text}), encoding)
    deadline = asyncio.get_running_loop().time() + 5
    await app.session.adapter.publish("/cockpit/display", schema.ref, data, deadline=deadline)


async def test_fifty_readers_of_each_format_cost_one_rendering_of_each_value(opened: Any, reader: Any) -> None:
    async with opened() as app:
        began = time.monotonic()
        readers = [reader(app, f"{SPEED}?format={name}") for name in ("json", "ttl", "nt") for _ in range(50)]
        for one in readers:
            await one.until(lambda one: len(one.events) >= 3)
        messages = 10 * (time.monotonic() - began)  # the topic has 10 per second
        made = {id(chunk) for one in readers for chunk in one.events}
        values = {chunk for one in readers for chunk in one.events}
        assert len(values) <= 3 * (messages + 5)
        assert len(made) == len(values), "an event was rendered more than once"
        for one in readers:
            await one.leave()


async def test_a_slow_reader_loses_what_lies_between_and_holds_up_nobody(opened: Any, reader: Any) -> None:
    async with opened() as app:
        slow, quick = reader(app, f"{DISPLAY}?rate=100"), reader(app, f"{DISPLAY}?rate=100")
        for one in (slow, quick):
            await one.until(lambda one: len(one.events) == 1)
        slow.takes.clear()
        for number in range(50):
            await show(app, f"number {number}")
            await quick.until(lambda one, number=number: f'number {number}"'.encode() in one.events[-1])
        assert len(quick.events) == 51
        slow.takes.set()
        await slow.until(lambda one: b"number 49" in one.events[-1])
        assert len(slow.events) <= 3, "more than one rendering waited for it"
        for one in (slow, quick):
            await one.leave()


async def test_a_stream_tells_a_topic_of_50_hz_whole_and_a_slower_one_says_how_many_messages_it_left_out(
    opened: Any, reader: Any
) -> None:
    def skipped(one: Any) -> int:
        return sum(int(chunk.split()[2]) for chunk in one.chunks if chunk.startswith(b": skipped "))

    async with opened() as app:
        await show(app, "the first")
        whole, some = reader(app, DISPLAY), reader(app, f"{DISPLAY}?rate=2")
        for one in (whole, some):
            await one.until(lambda one: len(one.events) == 1)
        for number in range(30):
            await show(app, f"number {number}")
            await asyncio.sleep(0.02)
        for one in (whole, some):
            await one.until(lambda one: b"number 29" in one.events[-1])
            assert len(one.events) + skipped(one) == 31
        assert len(whole.events) > 22
        assert len(some.events) < 10
        for one in (whole, some):
            await one.leave()


async def tag(app: Any, reader: Any) -> str:
    """Return the current entity tag of a parameter."""
    read = reader(app, "/parameters/cockpit/night", "application/json")
    await read.task
    return str(read.headers["etag"]).strip('"')


async def test_a_topic_that_is_watched_stays_subscribed_and_no_longer(opened: Any, reader: Any) -> None:
    async with opened(idle_time=0.0, subscription_budget=1) as app:
        watched = reader(app, SPEED)
        await watched.until(lambda one: bool(one.events))
        other = reader(app, DISPLAY, "application/json")
        await other.task
        count = len(watched.events)
        await watched.until(lambda one: len(one.events) >= count + 4)
        assert "/aircraft/engine/speed" in app.session.topics.subscribed()
        await watched.leave()
        deadline = time.monotonic() + 5
        while app.session.topics.subscribed():
            assert time.monotonic() < deadline
            await asyncio.sleep(0.05)


async def test_one_reader_too_many_is_told_to_come_back(
    opened: Any, reader: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(broadcaster, "MAX_READERS", 2)
    async with opened() as app:
        readers = [reader(app, SPEED) for _ in range(2)]
        for one in readers:
            await one.until(lambda one: bool(one.events))
        third = reader(app, SPEED)
        await third.task
        assert third.status == 503
        assert third.headers["retry-after"] == "10"
        plain = reader(app, SPEED, "application/json")
        await plain.task
        assert plain.status == 200
        await readers.pop().leave()
        readers.append(reader(app, SPEED))
        await readers[-1].until(lambda one: bool(one.events))
        for one in readers:
            await one.leave()


async def test_a_stream_in_which_nothing_happens_is_kept_alive(
    opened: Any, reader: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_stream, "KEEP_ALIVE_SECONDS", 0.05)
    async with opened() as app:
        quiet = reader(app, "/ontology")
        await quiet.until(lambda one: one.chunks.count(KEEP_ALIVE_COMMENT) >= 3)
        assert len(quiet.events) == 1
        await quiet.leave()


async def test_what_changes_unseen_is_not_read(opened: Any, reader: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader at 4 Hz of a topic at 10 Hz costs four renderings per second."""
    reads = 0
    async with opened() as app:
        slow = reader(app, f"{SPEED}?rate=4")
        await slow.until(lambda one: bool(one.events))
        (followed,) = app.broadcasters.resources
        state = followed.state

        async def counted() -> State:
            nonlocal reads
            reads += 1
            return await state()

        monkeypatch.setattr(followed, "state", counted)
        await slow.until(lambda one: len(one.events) >= 5)
        assert reads <= 6
        await slow.leave()


async def test_a_failure_nobody_foresaw_is_told_and_logged(
    opened: Any, reader: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with opened() as app:
        one = reader(app, DISPLAY)
        await one.until(lambda one: bool(one.events))

        def broken(topic: str) -> None:
            raise RuntimeError("the inside")

        with monkeypatch.context() as patched:
            patched.setattr(app.session.topics, "find_view", broken)
            await show(app, "unseen")
            await one.until(lambda one: b"event: problem" in one.events[-1])
        assert b"the inside" not in one.events[-1]
        await show(app, "seen")
        await one.until(lambda one: b'"seen"' in one.events[-1])
        await one.leave()
    assert "the inside" in caplog.text


class Made(Resource):
    """A resource whose content differs on each read."""

    def __init__(self) -> None:
        super().__init__(Space("http://127.0.0.1/"), "http://127.0.0.1/made")
        self.sources: list[Signal] = []
        self.fails = False

    async def watch(self, wake: Callable[[], None]) -> Watch:
        if self.fails:
            raise Unreachable("its source is not there")
        self.sources.append(Signal())
        return self.sources[-1].watch(wake)

    async def state(self) -> State:
        return State(lambda: Document(self.url, ()), token=f"{len(self.sources)}")


async def test_what_a_resource_is_made_of_is_found_anew_whenever_anything_in_general_changed() -> None:
    general, resource = Signal(), Made()
    with broadcaster.Broadcasters(general).subscribe(resource) as followed:
        assert (await followed.observe()).name == "1"
        general.emit()
        assert (await followed.observe()).name == "2"
        seen = followed.version
        resource.sources[0].emit()
        assert followed.version == seen
        resource.sources[1].emit()
        assert followed.version == seen + 1
    resource.sources[1].emit()
    general.emit()
    assert followed.version == seen + 1


async def test_what_cannot_be_watched_is_a_problem_until_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(broadcaster, "LOOK_AGAIN_SECONDS", 0.01)
    resource = Made()
    resource.fails = True
    with broadcaster.Broadcasters(Signal()).subscribe(resource) as followed:
        broken = (await followed.observe()).state
        assert isinstance(broken, Problem)
        assert broken.status == 503
        resource.fails = False
        version, waiter = followed.version, broadcaster.Waiter()
        await asyncio.wait_for(followed.wait(waiter, version), 60)
        assert isinstance((await followed.observe()).state, State)
