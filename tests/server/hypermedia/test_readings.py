"""Readings: calls shared by several readers, while they connect, disconnect and refresh."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import cast

import pytest
from msgspec.structs import replace

from rosld.adapters.aircraft import Aircraft
from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.model import Encoding, Graph, ServiceSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.server.hypermedia.catalogue import Getter, Property
from rosld.server.hypermedia.property_reader import PropertyReader
from rosld.server.hypermedia.type_inference import value_fields
from rosld.server.hypermedia.value import Reading, plain_json
from rosld.server.robot.session import Session
from rosld.server.settings import Settings
from rosld.shapes.value import OpenShape

LIFTING = LiftSettings()
LIBRARY = TypeLibrary(ros_version=1)


async def turns(count: int = 5) -> None:
    """Let all pending callbacks run."""
    for _ in range(count):
        await asyncio.sleep(0)


def plain(reading: Reading) -> object:
    """Return the value as JSON, or the failure's text."""
    return plain_json(reading.value, LIFTING).decode() if reading.value is not None else reading.failure


GET = LIBRARY.find(TypeRef("rosld_aircraft/srv/GetNumber"))
assert isinstance(GET, ServiceSchema)


def number(value: float) -> bytes:
    assert isinstance(GET, ServiceSchema)
    message = lowerer(GET.response).from_json({"data": value})
    return GET.response.codec.encode(message, Encoding.ROS1)


class Fake:
    """The part of an adapter that readings need: one service, which answers 1, 2, 3..., or hangs until released."""

    def __init__(self) -> None:
        self.capabilities = replace(Aircraft(AdapterOptions()).capabilities, system="fake")
        self.graph = Graph(1)
        self.calls: list[str] = []
        self.running = 0
        self.max_running = 0
        self.begun = asyncio.Event()
        self.release = asyncio.Event()
        self.hangs = False

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        assert request == b""
        self.calls.append(service)
        turn = len(self.calls)
        self.running += 1
        self.max_running = max(self.running, self.max_running)
        try:
            self.begun.set()
            if self.hangs:
                await self.release.wait()
            return number(turn)
        finally:
            self.running -= 1


class Bench:
    """Readings of a fake robot."""

    def __init__(self) -> None:
        self.fake = Fake()
        settings = Settings(first_value_wait=0.0, freshness=60.0, call_deadline=10.0)
        session = Session(cast(Adapter, self.fake), settings)
        self.topics = session.topics
        self.readings = PropertyReader(session)
        self.property = Property("/robot/x", OpenShape(), (Getter("/robot/get_x", GET, value_fields(GET)),))

    async def read(self, *, refresh: bool = False) -> Reading:
        deadline = asyncio.get_running_loop().time() + 5.0
        return (await self.readings.read([self.property], deadline=deadline, refresh=refresh))["/robot/x"]


@asynccontextmanager
async def benched() -> AsyncIterator[Bench]:
    """Yield readings of a robot, and check that nothing is left running afterwards."""
    bench = Bench()
    tasks = len(asyncio.all_tasks())
    yield bench
    await bench.readings.stop()
    await bench.topics.stop()
    await turns()
    assert len(asyncio.all_tasks()) == tasks, "something is left running"


async def test_a_reader_that_is_cancelled_takes_the_call_from_nobody() -> None:
    async with benched() as bench:
        bench.fake.hangs = True
        impatient, patient = (asyncio.ensure_future(bench.read()) for _ in range(2))
        await bench.fake.begun.wait()
        impatient.cancel()
        with suppress(asyncio.CancelledError):
            await impatient
        bench.fake.release.set()
        assert plain(await patient) == "1.0"
        assert len(bench.fake.calls) == 1


async def test_a_call_goes_on_when_all_its_readers_have_gone_and_its_answer_is_kept() -> None:
    async with benched() as bench:
        bench.fake.hangs = True
        reader = asyncio.ensure_future(bench.read())
        await bench.fake.begun.wait()
        reader.cancel()
        bench.fake.release.set()
        await turns()
        assert plain(await bench.read()) == "1.0"
        assert len(bench.fake.calls) == 1


async def test_a_reading_anew_shares_only_calls_that_began_after_it() -> None:
    async with benched() as bench:
        bench.fake.hangs = True
        before = asyncio.ensure_future(bench.read())
        await turns()
        anew = [asyncio.ensure_future(bench.read(refresh=True)) for _ in range(3)]
        await turns()
        assert len(bench.fake.calls) == 2
        after = asyncio.ensure_future(bench.read())
        await turns()
        assert len(bench.fake.calls) == 2
        bench.fake.release.set()
        assert plain(await before) in ("1.0", "2.0")
        assert [plain(each) for each in await asyncio.gather(*anew, after)] == ["2.0"] * 4
        assert plain(await bench.read()) == "2.0", "the older answer does not replace the newer"


async def test_readings_anew_of_a_getter_that_hangs_do_not_pile_up() -> None:
    async with benched() as bench:
        bench.fake.hangs = True
        readers = []
        for _ in range(30):
            readers.append(asyncio.ensure_future(bench.read(refresh=True)))
            await turns()
        assert len(bench.fake.calls) == 2
        bench.fake.release.set()
        found = [plain(each) for each in await asyncio.gather(*readers)]
        assert found == ["1.0", "2.0", *["3.0"] * 28]
        assert bench.fake.max_running == 2


@pytest.mark.parametrize("steps", [0, 1, 2, 3, 4, 6])
async def test_whenever_freshness_ends_what_was_asked_before_is_never_known_after(steps: int) -> None:
    """This tests every iteration of the loop between the answer and the reader that receives it."""
    async with benched() as bench:
        bench.fake.hangs = True
        before = asyncio.ensure_future(bench.read())
        await turns()
        bench.fake.release.set()
        await turns(steps)
        bench.readings.invalidate(["/robot/x"])
        after = asyncio.ensure_future(bench.read())
        assert plain(await before) == "1.0"
        assert plain(await after) == "2.0"
        known = bench.readings.cached(bench.property)
        assert known is not None
        assert plain(known) == "2.0"


async def test_stopping_cancels_what_runs_and_tells_who_waits() -> None:
    async with benched() as bench:
        bench.fake.hangs = True
        reader = asyncio.ensure_future(bench.read())
        await bench.fake.begun.wait()
        await bench.readings.stop()
        assert bench.fake.running == 0
        assert (await reader).value is None
