"""The query process, its workers and the server's end of them, in states that tests over HTTP cannot reach."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple

import pytest
import uvloop
from pyoxigraph import Literal, NamedNode, Quad

from rosld.server.dataset import MemoryStore
from rosld.server.http.problem import Problem
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.connection import ChildProcess
from rosld.server.sparql.process.frames import Drop, Refused, SharedStatus, pack
from rosld.server.sparql.query_limits import Limits

pytestmark = pytest.mark.slow

LIMITS = Limits(20.0, 256 * 1024 * 1024)
G, P = "http://h/g", "<http://h/p>"
MUCH = 16_000_000


class Do(NamedTuple):
    """Work that calls a function of this module."""

    what: Callable[[MemoryStore, BinaryIO], object]

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        self.what(store, output)


def endless(store: MemoryStore, output: BinaryIO) -> None:
    time.sleep(600)


def count(store: MemoryStore, output: BinaryIO) -> None:
    output.write(str(store.count(G, 1000)).encode())


def pid(store: MemoryStore, output: BinaryIO) -> None:
    output.write(str(os.getpid()).encode())


def add(store: MemoryStore, output: BinaryIO) -> None:
    store.add(Quad(NamedNode("http://h/s"), NamedNode("http://h/p"), Literal("2"), NamedNode(G)))
    assert store.count(G, 1000) == 2
    pid(store, output)


def much(store: MemoryStore, output: BinaryIO) -> None:
    for _ in range(MUCH // 1_000_000):
        output.write(bytes(1_000_000))


def running(scenario: Callable[[QueryProcess], Awaitable[None]]) -> Callable[[], None]:
    def run() -> None:
        async def whole() -> None:
            process = QueryProcess(2, 4)
            await process.start()
            try:
                await asyncio.wait_for(scenario(process), 120)
            finally:
                await process.close()

        asyncio.run(whole())

    run.__name__ = scenario.__name__
    return run


async def done(process: QueryProcess, work: Do, seconds: float = 20.0) -> bytes:
    limits = LIMITS._replace(seconds=seconds)
    return await process.result(work, limits, time.monotonic() + seconds)


async def refused(process: QueryProcess, work: Do, seconds: float = 20.0) -> Problem:
    with pytest.raises(Problem) as caught:
        await done(process, work, seconds)
    return caught.value


@running
async def test_work_that_waits_for_changes_for_too_long_is_to_come_again(process: QueryProcess) -> None:
    assert await done(process, Do(count)) == b"0"
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    try:
        process.change({G: f'<http://h/s> {P} "1" .\n'})
        assert await done(process, Do(count)) == b"1", "a worker makes changes itself"
        process.change({f"{G}{number}": f'<http://h/s> {P} "{number}" .\n' for number in range(10_000)})
        late = await refused(process, Do(count), 0.2)
    finally:
        os.kill(process.pid, signal.SIGCONT)
    assert (late.status, late.headers["Retry-After"], late.extra["reason"]) == (503, "1", "starting")
    assert await done(process, Do(count)) == b"1"
    assert (await refused(process, Do(endless), 0.3)).extra["reason"] == "time"


@running
async def test_a_worker_is_used_again_and_replaced_after_work_that_changed_its_dataset(process: QueryProcess) -> None:
    first = await done(process, Do(pid))
    process.change({G: f'<http://h/s> {P} "1" .\n'})
    assert await done(process, Do(count)) == b"1"
    assert await done(process, Do(add)) == first
    assert await done(process, Do(count)) == b"1"
    assert await done(process, Do(pid)) != first


@running
async def test_a_small_result_is_not_kept_waiting_by_a_reader_who_stops(process: QueryProcess) -> None:
    unread = await process.answer(Do(much), LIMITS, time.monotonic() + 20)
    assert not isinstance(unread, bytes)
    assert await done(process, Do(count)) == b"0"
    assert len(b"".join([part async for part in unread])) == MUCH


def test_a_death_is_noticed_also_with_requests_unread_and_replies_on_their_way(tmp_path: Path) -> None:
    seen: list[object] = []
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    (tmp_path / "at-work").write_bytes(bytes(SharedStatus.SIZE))
    loop, lost = uvloop.new_event_loop(), asyncio.Event()

    def on_lost() -> None:
        seen.append("lost")
        lost.set()

    with (tmp_path / "at-work").open("r+b") as file, subprocess.Popen(["true"]) as popen:
        spawned = (popen, ours, SharedStatus(file.fileno()))
        child = ChildProcess(spawned, loop, seen.append, on_lost)
        child.send(pack(Drop(1)))
        theirs.sendall(pack(Refused("http://h/g", "why")))
        theirs.close()

        try:
            loop.run_until_complete(asyncio.wait_for(lost.wait(), 20))
        finally:
            child.close()
            loop.close()
    assert seen == [Refused("http://h/g", "why"), "lost"]
