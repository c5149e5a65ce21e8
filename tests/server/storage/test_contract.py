"""The contract of records."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager
from typing import TypeAlias

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.storage.record import (
    Conflict,
    ConflictCause,
    Membership,
    Model,
    Put,
    Record,
    RecordChange,
    Remove,
    StorageError,
    Write,
)
from rosld.server.storage.sqlite import Records, open_records

Opened: TypeAlias = Callable[[], AbstractAsyncContextManager[Records]]
RDF, FILE, BASIC = Model.RDF_SOURCE, Model.NON_RDF_SOURCE, Model.BASIC_CONTAINER
TRIPLE = b'<http://a/b> <http://a/c> "01"^^<http://www.w3.org/2001/XMLSchema#integer> .\n'


async def chunks(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        await asyncio.sleep(0)
        yield part


async def put(records: Records, path: str, triples: bytes = b"", **more: object) -> Record:
    model = BASIC if path.endswith("/") else RDF
    (record,) = await records.write(Put(path, model, triples, **more))  # type: ignore[arg-type]
    assert record is not None
    return record


async def refused(records: Records, *writes: Write) -> Conflict:
    """Return why writes are refused, after checking that none had an effect."""
    before = records.version, records.changes_since(0)
    with pytest.raises(Conflict) as caught:
        await records.write(*writes)
    assert (records.version, records.changes_since(0)) == before
    return caught.value


def paths(changed: Sequence[RecordChange]) -> list[str]:
    return [one.path for one in changed]


async def test_what_is_replaced_twice_at_once_has_two_versions(records: Opened) -> None:
    async with records() as kept:
        made = await put(kept, "data/a")
        told: list[RecordChange] = []
        kept.watch(told.extend)
        (one,), (other,) = await asyncio.gather(
            kept.write(Put("data/a", RDF, b"", expected=made.version)), kept.write(Put("data/a", RDF, TRIPLE))
        )
        assert one is not None
        assert other is not None
        assert made.version < one.version < other.version
        assert kept.get("data/a") is other
        assert [each.path for each in told] == ["data/a", "data/a"]
        conflict = await refused(kept, Put("data/a", RDF, b"", expected=one.version))
        assert conflict.cause is ConflictCause.CHANGED


async def test_the_numbers_of_members_are_told_from_the_last_one_on(records: Opened) -> None:
    async with records() as kept:
        assert not kept.last_member_numbers("data/")
        for name in ("c", "a", "b/", "d"):
            await put(kept, f"data/{name}")
        await put(kept, "data/b/inner")
        found = [one.number for one in kept.members("data/")][::-1]
        assert kept.last_member_numbers("data/") == found
        assert kept.last_member_numbers("data/", limit=2) == found[:2]
        assert kept.last_member_numbers("data/", up_to=found[1]) == found[1:]
        assert kept.last_member_numbers("data/", up_to=found[1] - 1, limit=1) == [found[2]]
        assert not kept.last_member_numbers("data/", up_to=0)
        assert not kept.last_member_numbers("data/a")
        assert not kept.last_member_numbers("nowhere/")


async def test_the_roots_are_always_there(records: Opened) -> None:
    async with records() as kept:
        for root in ("data/", "queries/"):
            found = kept.get(root)
            assert found is not None
            assert found.model is BASIC
            assert (await refused(kept, Remove(root))).cause is ConflictCause.ROOT
        await put(kept, "data/", TRIPLE)
        assert (await refused(kept, Put("other/", BASIC))).cause is ConflictCause.CONTAINER
        assert (await refused(kept, Put("a", RDF))).cause is ConflictCause.CONTAINER


async def test_a_removed_path_is_remembered_until_it_is_made_again(records: Opened) -> None:
    async with records() as kept:
        await put(kept, "data/a")
        await kept.write(Remove("data/a"))
        assert kept.get("data/a") is None
        assert kept.is_tombstone("data/a")
        assert (await refused(kept, Put("data/a", RDF, unused=True))).cause is ConflictCause.GONE
        assert (await refused(kept, Put("data/a", RDF, expected=1))).cause is ConflictCause.GONE
        assert (await refused(kept, Remove("data/a"))).cause is ConflictCause.GONE
        again = await put(kept, "data/a", triples=b"<urn:a> <urn:b> <urn:c> .\n")
        assert kept.get("data/a") == again
        assert [one.path for one in kept.members("data/")] == ["data/a"]
        told = [one for one in kept.changes_since(0) if one.path == "data/a"]
        assert [one.is_removed for one in told] == [True, False]
        await kept.write(Remove("data/a"))
        assert kept.get("data/a") is None
        assert (await refused(kept, Put("data/a", RDF, unused=True))).cause is ConflictCause.GONE


async def test_conflicts_say_why(records: Opened) -> None:
    async with records() as kept:
        version = (await put(kept, "data/a")).version
        await put(kept, "data/c/")
        await put(kept, "data/c/d")
        for write, cause, words in (
            (Put("data/a", RDF, expected=0), ConflictCause.THERE, "it already exists"),
            (Put("data/a", RDF, expected=version + 9), ConflictCause.CHANGED, f"it is in version {version}"),
            (Remove("data/a", expected=version + 9), ConflictCause.CHANGED, f"it is in version {version}"),
            (Put("data/new", RDF, expected=3), ConflictCause.MISSING, "cannot be in version 3"),
            (Remove("data/new"), ConflictCause.MISSING, "it does not exist"),
            (Put("data/x/a", RDF), ConflictCause.CONTAINER, "its container data/x/ does not exist"),
            (Put("data/a/b", RDF), ConflictCause.CONTAINER, "its container data/a/ does not exist"),
            (Remove("data/c/"), ConflictCause.NOT_EMPTY, "delete its 1 members first"),
            (
                Put("data/c/", Model.DIRECT_CONTAINER, membership=Membership("http://a", "http://b")),
                ConflictCause.MODEL,
                "it is a BasicContainer and cannot become a DirectContainer",
            ),
        ):
            conflict = await refused(kept, write)
            assert (conflict.path, conflict.cause) == (write.path, cause)
            assert words in conflict.words
        await kept.write(Put("data/a", RDF, TRIPLE, expected=version), Put("data/b", RDF, expected=0))


NONSENSE = [
    *(Put(path, RDF) for path in ("", "/data/a", "data//a", "data/a/")),
    *(Put("data/a", model) for model in (BASIC, FILE)),
    Put("data/a/", Model.DIRECT_CONTAINER),
    Put("data/a", RDF, membership=Membership("http://a", "http://b")),
    Remove("data//"),
]


async def test_a_write_that_makes_no_sense_is_a_value_error(records: Opened) -> None:
    async with records() as kept:
        for write in NONSENSE:
            with pytest.raises(ValueError, match=r"path|cannot be|only"):
                await kept.write(write)


async def test_changes_are_told_once_a_path_in_the_order_of_versions(records: Opened) -> None:
    async with records() as kept:
        start = kept.version
        for name in ("a", "b", "c"):
            await put(kept, f"data/{name}")
        await put(kept, "data/a", TRIPLE)
        await kept.write(Remove("data/b"))
        changed = kept.changes_since(start)
        assert paths(changed) == ["data/c", "data/a", "data/b", "data/"]
        assert [one.is_removed for one in changed] == [False, False, True, False]
        assert [one.version for one in changed] == sorted({one.version for one in changed})
        assert kept.changes_since(start, limit=2) == changed[:2]
        assert kept.changes_since(changed[1].version) == changed[2:]
        assert kept.changes_since(kept.version) == []


async def test_watchers_are_told_what_each_write_changed_until_they_end_it(records: Opened) -> None:
    told: list[Sequence[RecordChange]] = []

    def fails(changed: Sequence[RecordChange]) -> None:
        raise RuntimeError("a watcher that fails")

    async with records() as kept:
        kept.watch(fails)
        end = kept.watch(told.append)
        before = kept.version
        await put(kept, "data/a")
        await refused(kept, Put("data/a", RDF, expected=0))
        await kept.write(Put("data/b", RDF), Remove("data/a"))
        assert [paths(one) for one in told] == [["data/a", "data/"], ["data/b", "data/a", "data/"]]
        assert list(told[1]) == kept.changes_since(told[0][-1].version)
        assert kept.changes_since(before) == told[1]
        end()
        end()
        await put(kept, "data/c")
        assert len(told) == 2


async def test_a_write_is_done_even_if_nobody_waits_any_more(kept: Opened) -> None:
    async with kept() as records:
        writing = asyncio.ensure_future(records.write(Put("data/a", RDF)))
        await asyncio.sleep(0)
        writing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writing
    async with kept() as records:
        assert records.get("data/a") is not None


async def test_closing_is_idempotent_and_nothing_is_written_afterwards(records: Opened) -> None:
    async with records() as kept:
        await kept.close()
        await kept.close()
        with pytest.raises(StorageError, match="closed"):
            await kept.write(Put("data/a", RDF))
        with pytest.raises(StorageError, match="closed"):
            kept.get("data/")
        with pytest.raises(StorageError, match="closed"):
            await kept.receive(chunks(b"x"), "text/plain", limit=10)


NAMES = st.sampled_from(["a", "b", "c/", "c/a", "c/d/", "c/d/b"])
STEPS = st.tuples(st.sampled_from(["put", "remove"]), NAMES, st.sampled_from([None, 0, "right", "wrong"]))


@given(st.lists(st.lists(STEPS, min_size=1, max_size=4), max_size=12))
def test_records_are_as_a_dictionary_would_tell(batches: list[list[tuple[str, str, object]]]) -> None:
    async def run() -> None:
        kept = open_records(None)
        there: dict[str, int] = {"data/": 0}
        gone: set[str] = set()
        for number, batch in enumerate(batches):
            writes, now, away = [], dict(there), set(gone)
            possible = True
            for kind, name, how in batch:
                path, mark = f"data/{name}", number + 1
                record = kept.get(path)
                expected = {"right": record.version if record else 0, "wrong": 10**9}.get(str(how), how)
                assert expected is None or isinstance(expected, int)
                same = path in there and now.get(path) == there[path]
                if kind == "put":
                    writes.append(Put(path, BASIC if name[-1] == "/" else RDF, b"%d" % mark, expected=expected))
                    above = path[: path.rstrip("/").rfind("/") + 1]
                    fits = expected is None or (same and record and expected == record.version)
                    fits = fits or (expected == 0 and path not in now)
                    possible = possible and bool(fits) and above in now
                    now[path] = mark
                    away.discard(path)
                else:
                    writes.append(Remove(path, expected=expected))
                    fits = expected is None or (same and record and expected == record.version)
                    alone = not any(other.startswith(path) for other in now if other != path and path[-1] == "/")
                    possible = possible and bool(fits) and path in now and alone
                    now.pop(path, None)
                    away.add(path)
            if any(isinstance(write, Put) and write.expected == 0 and write.path in there for write in writes):
                possible = False
            try:
                await kept.write(*writes)
            except Conflict:
                assert not possible or _twice(writes)
                continue
            assert possible or _twice(writes)
            there, gone = now, away
            for path, mark in there.items():
                found = kept.get(path)
                assert found is not None
                assert path == "data/" or found.triples == b"%d" % mark
                kept.clear_cache()
                assert kept.get(path) == found
                if path[-1] == "/":
                    inside = {one for one in there if one != path and one[: one.rstrip("/").rfind("/") + 1] == path}
                    assert {one.path for one in kept.members(path)} == inside
                    assert found.count == len(inside)
            for path in gone:
                assert kept.is_tombstone(path)
                assert kept.get(path) is None
        assert {one.path for one in kept.changes_since(0) if not one.is_removed} == set(there)
        assert {one.path for one in kept.changes_since(0)} == set(there) | gone
        await kept.close()

    asyncio.run(run())


def _twice(writes: Sequence[Write]) -> bool:
    """Whether a path is written twice, with expectations that the model above does not implement."""
    return len({write.path for write in writes}) < len(writes)
