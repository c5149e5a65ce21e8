"""The query process and the server's end of it, where a test over HTTP cannot bring them: stopped, and misjudged."""

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

from rosld.server.dataset import MemoryStore
from rosld.server.http.problem import Problem
from rosld.server.sparql.process.child import ChildProcess
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.frames import Cancel, Kind, Reply, SharedStatus, pack
from rosld.server.sparql.query_limits import Limits

pytestmark = pytest.mark.slow

LIMITS = Limits(20.0, 256 * 1024 * 1024)
G, P = "http://h/g", "<http://h/p>"


class Do(NamedTuple):
    """Work that calls a function of this module."""

    what: Callable[[MemoryStore, BinaryIO], object]
    may_fork: bool = True

    def may_take_long(self, store: MemoryStore) -> bool:
        return self.may_fork

    def __call__(self, store: MemoryStore, output: BinaryIO) -> None:
        self.what(store, output)


def endless(store: MemoryStore, output: BinaryIO) -> None:
    time.sleep(600)


def count(store: MemoryStore, output: BinaryIO) -> None:
    output.write(str(store.count(G, 1000)).encode())


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
        late = await refused(process, Do(count), 0.2)
    finally:
        os.kill(process.pid, signal.SIGCONT)
    assert (late.status, late.headers["Retry-After"], late.extra["reason"]) == (503, "1", "starting")
    assert await done(process, Do(count)) == b"1"
    assert not process.is_behind
    assert (await refused(process, Do(endless), 0.3)).extra["reason"] == "time"


@running
async def test_work_that_was_thought_to_be_short_cannot_hold_the_process_for_long(process: QueryProcess) -> None:
    assert (await refused(process, Do(endless, may_fork=False))).status in (500, 503)
    await process.wait_ready(time.monotonic() + 20)
    assert await done(process, Do(count)) == b"0"


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
        child = ChildProcess(spawned, loop, lambda reply, descriptors: seen.append(reply), on_lost)
        child.send(pack(Cancel(1)))
        theirs.sendall(pack(Reply(Kind.WAITING, 2)))
        theirs.close()

        try:
            loop.run_until_complete(asyncio.wait_for(lost.wait(), 20))
        finally:
            child.close()
            loop.close()
    assert seen == [Reply(Kind.WAITING, 2), "lost"]
