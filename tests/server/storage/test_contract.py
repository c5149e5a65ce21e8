"""The contract of records."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.storage.record import (
    Conflict,
    ConflictCause,
    Model,
    Put,
    RecordChange,
    Remove,
    Write,
)
from rosld.server.storage.sqlite import open_records
from tests.server.storage.conftest import Opened

RDF, BASIC = Model.RDF_SOURCE, Model.BASIC_CONTAINER


async def test_a_removed_path_is_remembered_until_it_is_made_again(records: Opened) -> None:
    async with records() as kept:
        await kept.write(Put("data/a", RDF))
        await kept.write(Remove("data/a"))
        for write in (Put("data/a", RDF, unused=True), Put("data/a", RDF, expected=1), Remove("data/a")):
            with pytest.raises(Conflict) as caught:
                await kept.write(write)
            assert caught.value.cause is ConflictCause.GONE
        await kept.write(Put("data/a", RDF))
        assert [one.path for one in kept.members("data/")] == ["data/a"]


async def test_watchers_are_told_what_each_write_changed_until_they_end_it(records: Opened) -> None:
    told: list[Sequence[RecordChange]] = []

    def fails(changed: Sequence[RecordChange]) -> None:
        raise RuntimeError("a watcher that fails")

    async with records() as kept:
        kept.watch(fails)
        end = kept.watch(told.append)
        before = kept.version
        await kept.write(Put("data/a", RDF))
        with pytest.raises(Conflict):
            await kept.write(Put("data/a", RDF, expected=0))
        await kept.write(Put("data/b", RDF), Remove("data/a"))
        paths = [[each.path for each in changed] for changed in told]
        assert paths == [["data/a", "data/"], ["data/b", "data/a", "data/"]]
        assert list(told[1]) == kept.changes_since(told[0][-1].version)
        assert kept.changes_since(before) == told[1]
        end()
        end()
        await kept.write(Put("data/c", RDF))
        assert len(told) == 2


async def test_a_write_is_done_even_if_nobody_waits_any_more(records: Opened) -> None:
    async with records() as kept:
        writing = asyncio.ensure_future(kept.write(Put("data/a", RDF)))
        await asyncio.sleep(0)
        writing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writing
    async with records() as kept:
        assert kept.get("data/a") is not None


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
