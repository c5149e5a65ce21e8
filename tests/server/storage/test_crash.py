"""Records survive a kill of their process at any moment."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import random
import sqlite3
import time
from pathlib import Path

import pytest

from rosld.server.storage.sqlite import Records, open_records
from tests.server.storage import writer

pytestmark = pytest.mark.slow

KILLS = 16
LONGEST = 0.12
"""Maximum time in seconds that a writer runs."""
_CONTEXT = multiprocessing.get_context("forkserver")


def killed(folder: Path, first: int, delay: float, *, opening: bool) -> list[list[str]]:
    """Return the output of a writer killed this many seconds after its start, or after it has opened the records."""
    reading, writing = _CONTEXT.Pipe(duplex=False)
    process = _CONTEXT.Process(target=writer.run, args=(folder, first, writing))
    process.start()
    writing.close()
    said: list[list[str]] = []
    try:
        if not opening:
            said.append(reading.recv())
        time.sleep(delay)  # the test varies this moment
    finally:
        process.kill()
    with contextlib.suppress(EOFError, OSError):  # even in the middle of a message
        while True:
            said.append(reading.recv())
    process.join()
    assert process.exitcode == -9
    return said


class Expected:
    """Required records: for each lane and kind, the last acknowledged write and a pending one."""

    def __init__(self) -> None:
        self.done: dict[tuple[int, str], int] = {}
        self.begun: dict[tuple[int, str], int] = {}
        self.versions: set[int] = set()
        self.brief: set[str] = set()
        self.away: set[str] = set()
        self.acknowledged = 0

    def said(self, lines: list[list[str]]) -> None:
        self.begun.clear()
        for verb, *words in lines:
            if verb == "open":
                continue
            lane, kind, number = int(words[0]), words[1], int(words[2])
            if verb == "began":
                self.begun[lane, kind] = number
                continue
            assert self.begun.pop((lane, kind)) == number
            self.done[lane, kind] = number
            self.acknowledged += 1
            version = int(words[3])
            assert version not in self.versions
            if version:
                self.versions.add(version)
            name = writer.paths(lane, kind, number)[0]
            if kind == "brief":
                self.brief.add(name)
            if kind == "away":
                self.brief.discard(name)
                self.away.add(name)

    def check(self, records: Records) -> None:
        for lane in range(writer.LANES):
            for kind in ("rdf", "file", "pair"):
                self._check(records, lane, kind)
            self._check_brief(records, lane)
            container = records.get(f"data/{lane}/")
            assert container is None or container.count == len(records.members(f"data/{lane}/", limit=10**6))

    def _check(self, records: Records, lane: int, kind: str) -> None:
        """Check that each record is whole, and is the last acknowledged or the pending one."""
        possible = {self.done.get((lane, kind)), self.begun.get((lane, kind), self.done.get((lane, kind)))}
        found = [records.get(path) for path in writer.paths(lane, kind, 0)]
        number = None
        if found[0] is not None:
            number = int(found[0].triples.split(b'"')[1].split(b",")[0])
        assert number in possible
        self.done.pop((lane, kind), None)
        if number is None:
            assert found == [None] * len(found)
            return
        self.done[lane, kind] = number
        for record in found:
            assert record is not None
            assert record.triples == writer.text(number)
            if kind == "file":
                assert record.blob is not None
                assert record.blob.size == len(writer.data(number))
                assert records.file(record.blob).read_bytes() == writer.data(number)

    def _check_brief(self, records: Records, lane: int) -> None:
        under_way = {
            writer.paths(lane, kind, self.begun[lane, kind])[0]
            for kind in ("brief", "away")
            if (lane, kind) in self.begun
        }
        there = {one.path for one in records.members(f"data/{lane}/", limit=10**6) if "brief" in one.path}
        assert {path for path in self.brief if path.startswith(f"data/{lane}/")} ^ there <= under_way
        self.brief = {path for path in self.brief if not path.startswith(f"data/{lane}/")} | there
        assert all(records.is_tombstone(path) and records.get(path) is None for path in self.away)


async def check(folder: Path, expected: Expected) -> None:
    records = open_records(folder)
    try:
        expected.check(records)
        used = set()
        for lane in range(writer.LANES):
            file = records.get(f"data/{lane}/file")
            if file is not None and file.blob is not None:
                used.add(file.blob.id)
        assert {path.name for path in (folder / "blobs").iterdir()} == used
    finally:
        await records.close()
    with contextlib.closing(sqlite3.connect(folder / "records.sqlite")) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


def test_every_acknowledged_write_survives_a_kill_at_any_moment(tmp_path: Path) -> None:
    seed = int(os.environ.get("SEED") or time.time_ns() % 10**9)
    print(f"SEED={seed}")
    chance, expected = random.Random(seed), Expected()
    for number in range(KILLS):
        opening = number % 8 == 5
        delay = chance.uniform(0, 0.3) if opening else chance.uniform(0, LONGEST)
        expected.said(killed(tmp_path, number * 100_000, delay, opening=opening))
        asyncio.run(check(tmp_path, expected))
    assert expected.acknowledged > KILLS
