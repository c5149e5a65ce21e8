"""Records in a folder: durable, reopened, and with failures of the disk or the database."""

from __future__ import annotations

import asyncio
import resource
import sqlite3
from collections.abc import AsyncIterator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from rosld.server.storage.record import Model, Put, StorageError
from rosld.server.storage.sqlite import open_records
from rosld.server.storage.transactions import MAX_BATCHES
from tests.server.storage.conftest import Opened

RDF = Model.RDF_SOURCE


async def chunks(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


@pytest.fixture
def connections(monkeypatch: pytest.MonkeyPatch) -> list[sqlite3.Connection]:
    """The connections to databases, in order of creation."""
    made: list[sqlite3.Connection] = []
    connect = sqlite3.connect

    def noted(*arguments: Any, **options: Any) -> sqlite3.Connection:
        made.append(connect(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(sqlite3, "connect", noted)
    return made


async def test_writes_that_come_while_the_disk_is_at_work_are_one_transaction(
    tmp_path: Path, connections: list[sqlite3.Connection]
) -> None:
    kept = open_records(tmp_path)
    statements: list[str] = []
    connections[0].set_trace_callback(statements.append)
    with closing(sqlite3.connect(tmp_path / "records.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        first = asyncio.create_task(kept.write(Put("data/a", RDF)))
        while "BEGIN IMMEDIATE" not in statements:  # noqa: ASYNC110 - the thread of another tells nobody
            await asyncio.sleep(0)
        others = [asyncio.create_task(kept.write(Put(f"data/{n}", RDF))) for n in range(MAX_BATCHES)]
        await asyncio.sleep(0)
        assert kept.get("data/a") is None
        other.execute("COMMIT")
    await asyncio.gather(first, *others)
    assert statements.count("COMMIT") == 2
    await kept.close()


async def test_a_full_database_refuses_what_does_not_fit_and_goes_on(
    records: Opened, connections: list[sqlite3.Connection]
) -> None:
    async with records() as kept:
        connection = connections[0]
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count = {pages + 20}")
        await kept.write(Put("data/a", RDF, b"a"))
        version, container = kept.version, kept.get("data/")
        results = await asyncio.gather(
            kept.write(Put("data/b", RDF, b"b")),
            kept.write(Put("data/large", RDF, bytes(1_000_000))),
            kept.write(Put("data/c", RDF, b"c")),
            return_exceptions=True,
        )
        assert isinstance(results[1], StorageError)
        assert results[1].full
        assert "no space left" in str(results[1])
        assert [isinstance(result, list) for result in results] == [True, False, True]
        assert kept.get("data/large") is None
        assert kept.version > version
        assert [one.path for one in kept.members("data/")] == ["data/a", "data/b", "data/c"]
        assert kept.get("data/") != container
        kept.clear_cache()
        assert kept.get("data/large") is None
        connection.execute("PRAGMA max_page_count = 1000000")
        await kept.write(Put("data/large", RDF, bytes(1_000_000)))


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


async def test_files_that_cannot_grow_refuse_what_does_not_fit_and_go_on(tmp_path: Path) -> None:
    kept = open_records(tmp_path)
    await kept.write(Put("data/a", RDF, b"a"))
    with files_of_at_most(1_000_000):
        with pytest.raises(StorageError):
            await kept.write(Put("data/b", RDF, bytes(2_000_000)))
        with pytest.raises(StorageError, match="could not be stored") as caught:
            await kept.receive(chunks(*[bytes(300_000)] * 10), "x/y", limit=10**9)
        assert caught.value.full
        assert not list((tmp_path / "blobs").iterdir())
        await kept.write(Put("data/c", RDF, b"c"))
    assert kept.get("data/b") is None
    await kept.write(Put("data/b", RDF, bytes(2_000_000)))
    await kept.close()
    kept = open_records(tmp_path)
    assert [one.path for one in kept.members("data/")] == ["data/a", "data/c", "data/b"]
    await kept.close()


async def test_the_log_does_not_grow_with_the_writes(tmp_path: Path) -> None:
    kept, log, largest = open_records(tmp_path), tmp_path / "records.sqlite-wal", 0
    for number in range(100):
        await kept.write(*(Put(f"data/{number}-{n}", RDF, bytes(10_000)) for n in range(20)))
        largest = max(largest, log.stat().st_size)
    assert (tmp_path / "records.sqlite").stat().st_size > 15_000_000
    assert largest < 6_000_000
    await kept.close()


def test_a_folder_that_is_none_of_ours_is_refused_in_words(tmp_path: Path) -> None:
    def edited(name: str, statement: str) -> Path:
        folder = tmp_path / name
        asyncio.run(open_records(folder).close())
        with closing(sqlite3.connect(folder / "records.sqlite")) as connection:
            connection.execute(statement)
        return folder

    with pytest.raises(ValueError, match=r"records.sqlite was written by a newer rosld \(format 99"):
        open_records(edited("newer", "PRAGMA user_version = 99"))
    other = tmp_path / "other"
    other.mkdir()
    with closing(sqlite3.connect(other / "records.sqlite")) as connection:
        connection.execute("CREATE TABLE mine (x)")
        connection.execute("PRAGMA user_version = 1")
    with pytest.raises(ValueError, match="of another program"):
        open_records(other)
    (other / "records.sqlite").write_bytes(b"no database at all " * 1000)
    with pytest.raises(ValueError, match=r"not a database.*rosld load"):
        open_records(other)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OSError, match="exists"):
        open_records(tmp_path / "file")


async def test_a_corrupt_database_answers_what_it_can_and_says_what_it_cannot(tmp_path: Path) -> None:
    kept = open_records(tmp_path)
    for batch in range(20):
        await kept.write(*(Put(f"data/{batch}-{n}", RDF, b"%d" % n * 500) for n in range(50)))
    await kept.close()
    file = tmp_path / "records.sqlite"
    data = bytearray(file.read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 40 * 4096] = b"\xa5" * (40 * 4096)
    file.write_bytes(data)
    kept = open_records(tmp_path)
    failed = list[str]()
    for batch in range(20):
        for n in range(50):
            try:
                found = kept.get(f"data/{batch}-{n}")
                if batch % 5 == 0:
                    await kept.write(Put(f"data/{batch}-{n}", RDF, b"%d" % n * 500))
            except StorageError as error:
                failed.append(str(error))
            else:
                assert found is None or found.triples == b"%d" % n * 500
    assert 0 < len(failed) < 1000
    assert all("database of records failed" in words for words in failed)
    await kept.close()
