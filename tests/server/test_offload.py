"""Worker processes: their results and exceptions are returned, and one that dies does not affect the next."""

from __future__ import annotations

import asyncio
import os
import signal
import time
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


def run(work: partial[object], **limits: float) -> object:
    """Return the result of work, after checking that further work succeeds."""

    async def do() -> object:
        workers = WorkerPool(limit=1, seconds=limits.get("seconds", 60.0), memory=int(limits.get("memory", 4 << 30)))
        try:
            try:
                return await workers.run(work)
            finally:
                assert await workers.run(partial(sum, (1, 2))) == 3
        finally:
            await workers.close()

    return asyncio.run(do())


def test_work_is_done_in_another_process() -> None:
    assert run(partial(os.getpid)) != os.getpid()


def test_errors_come_back_as_they_were_raised() -> None:
    with pytest.raises(BodyError) as body:
        run(partial(read_ntriples, b"<a>\n<b> .", "text/turtle", "http://example.org/"))
    assert body.value.line == 2
    with pytest.raises(Problem) as problem:
        run(partial(_raise, Problem(409, "It is taken.", headers={"Retry-After": "1"})))
    assert (problem.value.status, problem.value.detail, problem.value.headers) == (
        409,
        "It is taken.",
        {"Retry-After": "1"},
    )
    with pytest.raises(LoweringError) as lowering:
        run(partial(_raise, LoweringError(Violation("field", "does not fit"))))
    assert lowering.value.violations[0].message == "does not fit"
    with pytest.raises(FileNotFoundError):
        run(partial(os.stat, "/nowhere/at/all"))


def test_work_that_takes_too_long_or_too_much_is_refused_and_the_next_is_done() -> None:
    with pytest.raises(Problem) as late:
        run(partial(time.sleep, 60), seconds=1.5)
    assert late.value.status == 503
    with pytest.raises(Problem) as large:
        run(partial(bytes, 8 << 30), memory=2 << 30)
    assert large.value.status == 507
    with pytest.raises(Problem) as dead:
        run(partial(_die))
    assert dead.value.status == 503


def test_what_cannot_be_told_to_another_process_is_done_in_this_one() -> None:
    assert run(partial(lambda: os.getpid())) == os.getpid()
