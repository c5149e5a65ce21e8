"""Blobs: bytes that are stored unchanged, and removed once nothing references them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import anyio
import pytest

from rosld.server.storage.blobs import Blobs
from rosld.server.storage.record import Blob, Conflict, Model, Put
from rosld.server.storage.sqlite import Records, open_records
from tests.server.storage.conftest import Opened

FILE = Model.NON_RDF_SOURCE
TYPE = "image/x-test; charset=UTF-8"


async def chunks(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        await asyncio.sleep(0)
        yield part


async def receive(records: Records, *parts: bytes, limit: int = 10**8) -> Blob:
    return await records.receive(chunks(*parts), TYPE, limit=limit)


def files(records: Records, blob: Blob) -> list[str]:
    """Return all files with this blob."""
    return sorted(path.name for path in records.file(blob).parent.iterdir())


async def test_more_bytes_than_are_allowed_leave_nothing_behind(records: Opened) -> None:
    async with records() as kept:
        blob = await receive(kept, b"12345", b"67890", limit=10)
        with pytest.raises(ValueError, match="more than 10 bytes"):
            await receive(kept, b"12345", b"678901", limit=10)
        with pytest.raises(ValueError, match="more than 600000 bytes"):
            await receive(kept, *(b"x" * 100_000 for _ in range(7)), limit=600_000)
        assert files(kept, blob) == [blob.id]


async def test_a_sender_that_goes_away_leaves_nothing_behind(records: Opened) -> None:
    async def broken() -> AsyncIterator[bytes]:
        yield b"x" * 1_000_000
        raise ConnectionResetError

    async def endless() -> AsyncIterator[bytes]:
        while True:
            yield b"x" * 300_000

    async with records() as kept:
        blob = await receive(kept, b"x")
        with pytest.raises(ConnectionResetError):
            await kept.receive(broken(), TYPE, limit=10**8)
        receiving = asyncio.create_task(kept.receive(endless(), TYPE, limit=10**10))
        while len(files(kept, blob)) == 1:  # noqa: ASYNC110 - a folder tells nobody
            await asyncio.sleep(0)
        receiving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await receiving
        assert files(kept, blob) == [blob.id]


async def test_what_a_write_was_refused_with_may_be_tried_in_another(records: Opened) -> None:
    async with records() as kept:
        blob = await receive(kept, b"x")
        with pytest.raises(Conflict):
            await kept.write(Put("data/no/a", FILE, blob=blob))
        with pytest.raises(Conflict):
            await kept.write(Put("data/a", FILE, blob=blob), Put("data/no/a", Model.RDF_SOURCE))
        await kept.write(Put("data/a", FILE, blob=blob))
        assert kept.file(blob).read_bytes() == b"x"


async def test_what_is_discarded_is_removed_unless_a_record_has_it(records: Opened) -> None:
    async with records() as kept:
        used, unused = await receive(kept, b"x"), await receive(kept, b"y")
        await kept.write(Put("data/a", FILE, blob=used))
        for blob in (used, unused, unused, Blob("none", 0, TYPE)):
            kept.discard(blob)
        assert files(kept, used) == [used.id]


async def test_what_no_write_refers_to_is_thrown_away_after_a_while(tmp_path: Path) -> None:
    kept = open_records(tmp_path, keep_seconds=0.05)
    used, unused = await receive(kept, b"x"), await receive(kept, b"y")
    await kept.write(Put("data/a", FILE, blob=used))
    with anyio.fail_after(20):
        while unused.id in files(kept, used):  # noqa: ASYNC110 - a folder tells nobody
            await asyncio.sleep(0.01)
    with pytest.raises(Conflict, match="no longer available"):
        await kept.write(Put("data/b", FILE, blob=unused))
    assert files(kept, used) == [used.id]
    await kept.close()


async def test_in_memory_files_are_private_and_end_with_the_records() -> None:
    kept = open_records(None)
    blob = await receive(kept, b"x")
    folder = kept.file(blob).parent.parent
    assert folder.stat().st_mode & 0o077 == 0
    await kept.close()
    assert not folder.exists()


async def test_an_earlier_process_leaves_nothing_behind(tmp_path: Path) -> None:
    kept = open_records(tmp_path)
    used = await receive(kept, b"x")
    await kept.write(Put("data/a", FILE, blob=used))
    await kept.close()
    for name in ("0" * 32, "1" * 32 + ".part", "README"):
        (tmp_path / "blobs" / name).write_text("x")
    blobs = Blobs(tmp_path / "blobs", durable=True)
    with blobs.hold_files():  # like a dump, or an unfinished load
        kept = open_records(tmp_path)
        assert len(files(kept, used)) == 4
        await kept.close()
    blobs.close()
    kept = open_records(tmp_path)
    assert files(kept, used) == sorted([used.id, "README"])
    await kept.close()


async def test_whoever_keeps_files_still_delays_their_removal(tmp_path: Path) -> None:
    kept = open_records(tmp_path)
    first, second = await receive(kept, b"first"), await receive(kept, b"second")
    await kept.write(Put("data/a", FILE, blob=first))
    blobs = Blobs(tmp_path / "blobs", durable=True)
    with blobs.hold_files():
        await kept.write(Put("data/a", FILE, blob=second))
        await kept.write(Put("data/b", Model.RDF_SOURCE))
        assert kept.file(first).read_bytes() == b"first"
    blobs.close()
    with anyio.fail_after(20):
        while first.id in files(kept, second):  # noqa: ASYNC110 - a folder tells nobody
            await asyncio.sleep(0.01)
    await kept.close()
