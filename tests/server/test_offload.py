"""Worker processes: their results and exceptions are returned, and one that dies does not affect the next."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

import pytest

from rosld.ontology.body import BodyError, read_ntriples
from rosld.ontology.violations import LoweringError, Violation
from rosld.server.http.problem import Problem
from rosld.server.runtime.offload import WorkerPool

pytestmark = pytest.mark.slow


def _raise(error: Exception) -> None:
    raise error


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@asynccontextmanager
async def pool(seconds: float = 60.0, memory: int = 4 << 30) -> AsyncIterator[WorkerPool]:
    """A pool of one worker, which after everything else still does what it is given."""
    workers = WorkerPool(limit=1, seconds=seconds, memory=memory)
    try:
        yield workers
        assert await workers.run(partial(sum, (1, 2))) == 3
    finally:
        await workers.close()


async def test_results_and_errors_come_back_from_another_process() -> None:
    async with pool() as workers:
        assert await workers.run(partial(os.getpid)) != os.getpid()
        with pytest.raises(BodyError) as body:
            await workers.run(partial(read_ntriples, b"<a>\n<b> .", "text/turtle", "http://example.org/"))
        assert body.value.line == 2
        with pytest.raises(Problem) as problem:
            await workers.run(partial(_raise, Problem(409, "It is taken.", headers={"Retry-After": "1"})))
        told = problem.value
        assert (told.status, told.detail, told.headers) == (409, "It is taken.", {"Retry-After": "1"})
        with pytest.raises(LoweringError) as lowering:
            await workers.run(partial(_raise, LoweringError(Violation("field", "does not fit"))))
        assert lowering.value.violations[0].message == "does not fit"
        with pytest.raises(FileNotFoundError):
            await workers.run(partial(os.stat, "/nowhere/at/all"))
        here = partial(lambda: os.getpid())  # which cannot be sent to another process
        assert await workers.run(here) == os.getpid()


async def test_work_that_takes_too_long_or_too_much_is_refused_and_the_next_is_done() -> None:
    async with pool(seconds=1.5) as workers:
        with pytest.raises(Problem) as late:
            await workers.run(partial(time.sleep, 60))
        assert late.value.status == 503
    async with pool(memory=2 << 30) as workers:
        with pytest.raises(Problem) as large:
            await workers.run(partial(bytes, 8 << 30))
        assert large.value.status == 507
    async with pool() as workers:
        with pytest.raises(Problem) as dead:
            await workers.run(partial(_die))
        assert dead.value.status == 503
