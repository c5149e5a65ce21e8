"""The query process and the server's end of it: order, limits, and what is told when it dies."""

from __future__ import annotations

import asyncio
import logging
import os
import pickle
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import BinaryIO, NamedTuple

import pytest
import uvloop

from rosld.server.dataset import Edit, MemoryStore
from rosld.server.http.problem import Problem
from rosld.server.sparql.process.child import ChildProcess
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.frames import Cancel, Kind, Reply, SharedStatus, pack
from rosld.server.sparql.process.work import DumpGraphs, ListGraphs
from rosld.server.sparql.query_limits import Limits

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


def abort(store: MemoryStore, output: BinaryIO) -> None:
    os.abort()


def kill(store: MemoryStore, output: BinaryIO) -> None:
    output.write(b"half of it")
    os.kill(os.getpid(), signal.SIGKILL)


def greedy(store: MemoryStore, output: BinaryIO) -> None:
    bytearray(2 * LIMITS.memory)


def endless(store: MemoryStore, output: BinaryIO) -> None:
    time.sleep(600)


def surprise(store: MemoryStore, output: BinaryIO) -> None:
    raise ZeroDivisionError("so it is")


def large(store: MemoryStore, output: BinaryIO) -> None:
    for number in range(4000):
        output.write(b"%01023d\n" % number)


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


async def done(process: QueryProcess, work: Do | DumpGraphs | ListGraphs, seconds: float = 20.0) -> bytes:
    limits = LIMITS._replace(seconds=seconds)
    return await process.result(work, limits, time.monotonic() + seconds)


async def refused(process: QueryProcess, work: Do, seconds: float = 20.0) -> Problem:
    with pytest.raises(Problem) as caught:
        await done(process, work, seconds)
    return caught.value


@running
async def test_work_sees_all_changes_that_were_sent_before_it_and_where_it_need_not_wait_none_after(
    process: QueryProcess,
) -> None:
    coming = []
    for number in range(200):
        process.change({}, [Edit(G, f'<http://h/s> {P} "{number}" .\n')])
        coming.append(asyncio.ensure_future(done(process, Do(count, may_fork=number in (0, 199)))))
        await asyncio.sleep(0)
    assert [int(each) for each in await asyncio.gather(*coming)] == list(range(1, 201))


@running
async def test_a_change_larger_than_any_buffer_arrives_whole(process: QueryProcess) -> None:
    text = "".join(f'<http://h/s{number}> {P} "{"x" * 1000}" .\n' for number in range(8000))
    process.change({G: text, "http://h/h": f'_:b {P} "1" .\n'})
    assert (await done(process, Do(count))) == b"1000"
    assert sorted(pickle.loads(await done(process, ListGraphs()))) == [G, "http://h/h"]
    process.change({G: None})
    assert pickle.loads(await done(process, DumpGraphs((G, "http://h/h"))))[G] is None


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
async def test_a_graph_that_cannot_be_stored_hides_no_other(process: QueryProcess) -> None:
    process.change({"http://h/bad": "} ; DROP ALL", G: f'<http://h/s> {P} "1" .\n'}, [Edit(G, "no triple")])
    assert pickle.loads(await done(process, ListGraphs())) == [G]


@running
async def test_what_a_fork_is_refused_is_raised_here(process: QueryProcess) -> None:
    assert (await refused(process, Do(greedy))).extra["reason"] == "memory"
    assert (await refused(process, Do(endless), 0.3)).extra["reason"] == "time"
    killed = await refused(process, Do(kill))
    assert (killed.status, "signal 9" in killed.detail) == (500, True)
    with pytest.raises(ZeroDivisionError, match="so it is"):
        await done(process, Do(surprise))
    with pytest.raises(ZeroDivisionError, match="so it is"):
        await done(process, Do(surprise, may_fork=False))


@running
async def test_a_large_answer_comes_in_pieces_and_in_order(process: QueryProcess) -> None:
    for work in (Do(large), Do(large, may_fork=False)):
        body = await process.answer(work, LIMITS, time.monotonic() + 20)
        assert isinstance(body, AsyncIterator)
        found = b"".join([chunk async for chunk in body])
        assert [int(line) for line in found.split()] == list(range(4000))


@running
async def test_more_than_may_be_at_work_waits_and_more_than_may_wait_is_refused(process: QueryProcess) -> None:
    assert await done(process, Do(count, may_fork=False)) == b"0"  # it is there, which may take its time
    begun = [asyncio.ensure_future(done(process, Do(endless), 2.0)) for _ in range(8)]
    ends = await asyncio.gather(*begun, return_exceptions=True)
    reasons = [end.extra["reason"] for end in ends if isinstance(end, Problem)]
    assert reasons.count("busy") >= 2
    assert reasons.count("time") >= 2
    assert len(reasons) == 8
    assert await done(process, Do(count)) == b"0"


def test_the_work_that_ends_the_process_is_answered_500_and_named_and_all_else_is_to_come_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    starts: list[int] = []

    @running
    async def scenario(process: QueryProcess) -> None:
        process.on_start(lambda: starts.append(process.generation))
        process.change({G: f'<http://h/s> {P} "1" .\n'})
        assert await done(process, Do(count)) == b"1"
        others = [asyncio.ensure_future(done(process, Do(endless))) for _ in range(4)]
        await asyncio.sleep(0)
        guilty = await refused(process, Do(abort, may_fork=False))
        assert guilty.status == 500
        for other in await asyncio.gather(*others, return_exceptions=True):
            assert isinstance(other, Problem)
            assert (other.status, other.headers["Retry-After"]) == (503, "1")
        await process.wait_ready(time.monotonic() + 20)
        assert await done(process, Do(count)) == b"0"

    with caplog.at_level(logging.ERROR, "rosld.sparql"):
        scenario()
    assert starts == [2]
    assert "abort" in caplog.text


@running
async def test_work_that_was_thought_to_be_short_cannot_hold_the_process_for_long(process: QueryProcess) -> None:
    assert (await refused(process, Do(endless, may_fork=False))).status in (500, 503)
    await process.wait_ready(time.monotonic() + 20)
    assert await done(process, Do(count)) == b"0"


@pytest.mark.parametrize("new_loop", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_a_death_is_noticed_also_with_requests_unread_and_replies_on_their_way(
    new_loop: Callable[[], asyncio.AbstractEventLoop], tmp_path: Path
) -> None:
    seen: list[object] = []
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    (tmp_path / "at-work").write_bytes(bytes(SharedStatus.SIZE))
    loop, lost = new_loop(), asyncio.Event()

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
