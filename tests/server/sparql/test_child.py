"""Queries in processes of their own: stopped when the time or the memory is over, leaving nothing behind."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import BinaryIO

import pytest

from rosld.server.http.problem import Problem
from rosld.server.sparql import child
from rosld.server.sparql.child import Leash
from rosld.server.sparql.limits import Limits
from rosld.server.store import MemoryStore, QueryError

pytestmark = pytest.mark.skipif(not child.AVAILABLE, reason="only Linux forks safely")
ROOM = Limits(20.0, 256 * 1024 * 1024)


def answered(
    work: Callable[[BinaryIO], None],
    limits: Limits = ROOM,
    check: Callable[[], None] = lambda: None,
    leash: Leash | None = None,
) -> bytes:
    """What a child writes."""
    output = io.BytesIO()
    child.answer(work, output, check, limits, nullcontext(), leash or Leash())
    return output.getvalue()


def children() -> set[str]:
    """The processes that this one has begun and not yet seen end, of those it is to see."""
    child.buried()
    return set(Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split())


def test_what_a_child_writes_arrives_whole_and_in_order() -> None:
    pieces = [os.urandom(size) for size in (0, 1, 65536, 300_000, 7)]
    assert answered(lambda pipe: [pipe.write(piece) for piece in pieces] and None) == b"".join(pieces)


def test_a_child_s_refusals_are_raised_here() -> None:
    def words(pipe: BinaryIO) -> None:
        raise QueryError("expected a variable")

    def problem(pipe: BinaryIO) -> None:
        raise Problem(406, "not so", headers={"X": "y"})

    with pytest.raises(QueryError, match="expected a variable"):
        answered(words)
    with pytest.raises(Problem) as refusal:
        answered(problem)
    assert (refusal.value.status, refusal.value.detail, refusal.value.headers) == (406, "not so", {"X": "y"})


def test_a_child_that_takes_too_much_memory_is_ended_and_this_process_lives() -> None:
    def greedy(pipe: BinaryIO) -> None:
        bytearray(2 * ROOM.memory)

    with pytest.raises(Problem, match="256 MiB of memory") as refusal:
        answered(greedy)
    assert refusal.value.status == 503


def test_a_child_is_killed_as_soon_as_nobody_wants_its_answer() -> None:
    began = time.monotonic()

    def unwanted() -> None:
        if time.monotonic() - began > 0.2:
            raise TimeoutError

    before = children()
    with pytest.raises(TimeoutError):
        answered(lambda pipe: time.sleep(60), check=unwanted)
    assert time.monotonic() - began < 30
    assert children() == before


def test_a_query_that_sorts_everything_with_everything_ends_within_its_memory() -> None:
    store = MemoryStore()
    lines = "".join(f"<http://a/{n}> <http://a/p> <http://a/{n + 1}> .\n" for n in range(2000))
    store.replace({"http://a/": lines})
    query = "SELECT * { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i } ORDER BY ?a ?d ?g"

    def sort(pipe: BinaryIO) -> None:
        for _ in store.query(query):  # type: ignore[union-attr]
            pipe.write(b"row")

    with pytest.raises(Problem, match="memory"):
        answered(sort)
    assert list(store.query("SELECT ?s { ?s ?p ?o } LIMIT 1"))  # type: ignore[arg-type]


def test_the_store_is_whole_in_every_child_while_it_changes() -> None:
    store = MemoryStore()
    stop = threading.Event()

    def change() -> None:
        number = 0
        while not stop.is_set():
            number += 1
            lines = "".join(f"<http://a/{n}> <http://a/p> <http://v/{number}> .\n" for n in range(200))
            store.replace({"http://a/": lines})

    changing = threading.Thread(target=change)
    store.replace({"http://a/": "<http://a/0> <http://a/p> <http://v/0> .\n"})
    changing.start()
    try:
        for _ in range(50):
            output = io.BytesIO()

            def count(pipe: BinaryIO) -> None:
                (row,) = store.query("SELECT (COUNT(DISTINCT ?o) AS ?n) { ?s <http://a/p> ?o }")  # type: ignore[misc]
                pipe.write(row[0].value.encode())  # type: ignore[index]

            child.answer(count, output, lambda: None, ROOM, store.still(), Leash())
            assert output.getvalue() == b"1"
    finally:
        stop.set()
        changing.join()


def test_a_child_on_a_leash_dies_at_once_and_whoever_waited_for_it_goes_on() -> None:
    leash = Leash()
    begun = threading.Event()

    def unwanted() -> None:
        if leash_pulled.is_set():
            raise TimeoutError

    leash_pulled = threading.Event()

    def endless(pipe: BinaryIO) -> None:
        pipe.write(b"begun" * 20_000)
        while True:
            pass

    class Noticing(io.BytesIO):
        def write(self, data: bytes) -> int:  # type: ignore[override]
            begun.set()
            return super().write(data)

    failures: list[BaseException] = []

    def wait() -> None:
        try:
            child.answer(endless, Noticing(), unwanted, ROOM, nullcontext(), leash)
        except TimeoutError as error:
            failures.append(error)

    waiting = threading.Thread(target=wait)
    waiting.start()
    assert begun.wait(60)
    leash_pulled.set()
    began = time.monotonic()
    leash.pull()
    waiting.join(60)
    assert failures
    assert time.monotonic() - began < 30


@pytest.mark.parametrize(
    ("end", "told"),
    [
        (lambda: os._exit(7), "exit 7"),
        (lambda: os._exit(0), "exit 0"),
        (lambda: os.kill(os.getpid(), signal.SIGKILL), "signal 9"),
        (lambda: os.kill(os.getpid(), signal.SIGSEGV), "signal 11"),
    ],
)
def test_a_child_that_crashes_is_one_failure_and_the_next_one_answers(end: Callable[[], None], told: str) -> None:
    def crash(pipe: BinaryIO) -> None:
        pipe.write(b"half of it")
        end()

    with pytest.raises(Problem, match=told) as failure:
        answered(crash)
    assert failure.value.status == 500
    assert answered(lambda pipe: pipe.write(b"whole") and None) == b"whole"


def test_what_nobody_foresaw_in_a_child_is_a_crash_too() -> None:
    def surprise(pipe: BinaryIO) -> None:
        raise ZeroDivisionError

    with pytest.raises(Problem) as failure:
        answered(surprise)
    assert failure.value.status == 500


@pytest.mark.parametrize(("module", "warns"), [("rosld.server.sparql.child", False), ("rosld.server.sparql", True)])
def test_of_all_forks_only_that_of_a_query_is_silent(module: str, warns: bool) -> None:
    words = "This process (pid=1) is multi-threaded, use of fork() may lead to deadlocks in the child."
    code = (
        "import warnings, rosld.server.sparql.child\n"
        f"warnings.warn_explicit({words!r}, DeprecationWarning, 'a.py', 1, module={module!r})"
    )
    done = subprocess.run([sys.executable, "-W", "default", "-c", code], capture_output=True, text=True, check=True)
    assert ("multi-threaded" in done.stderr) is warns, done.stderr
