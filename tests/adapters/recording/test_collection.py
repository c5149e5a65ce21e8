"""A collection as an adapter: what it says of a recording without opening it, and what it keeps open."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from rosld.adapters.base import Adapter, AdapterOptions, NullSink, Recording
from rosld.adapters.catalogue import Catalogue, Event
from rosld.adapters.model import NotFound, Unreachable
from rosld.adapters.recording import RecordingAdapter, adapter
from tests.adapters.recording import recorder


@asynccontextmanager
async def collection(folder: Path, *more: str) -> AsyncIterator[Adapter]:
    found = adapter("\n".join((str(folder), *more)), AdapterOptions())
    await found.open(NullSink(), deadline=asyncio.get_running_loop().time() + 20)
    await found.wait_for_recordings()
    try:
        yield found
    finally:
        await found.close()


def write(folder: Path, name: str, words: str = "") -> Path:
    """Write a recording of ROS 1, or of ROS 2 for a name without a suffix."""
    lines = [recorder.Line(10 + each / 10, "/chatter", f"{name} {words} {each}") for each in range(5)]
    write = recorder.write_rosbag1 if name.endswith(".bag") else recorder.write_rosbag2
    path: Path = write(folder / name, lines)
    return path


def test_summaries_say_what_opening_says(tmp_path: Path) -> None:
    lines = recorder.lines()
    paths = {
        "one": recorder.write_rosbag1(tmp_path / "one.bag", lines, compression="bz2", chunk=200),
        "two": recorder.write_rosbag2(tmp_path / "two", lines),
        "three": recorder.write_rosbag2(tmp_path / "three", lines, storage="sqlite3"),
        "four": recorder.write_rosbag2(tmp_path / "four", lines, compression="storage"),
        "cut": recorder.write_rosbag1(tmp_path / "cut.bag", recorder.lines(count=100), chunk=200),
    }
    data = paths["cut"].read_bytes()
    paths["cut"].write_bytes(data[: len(data) // 2])

    async def scenario() -> None:
        async with collection(tmp_path) as found:
            assert set(found.recordings) == set(paths)
            for name, recording in found.recordings.items():
                loop = asyncio.get_running_loop()
                assert await loop.run_in_executor(None, same, recording, paths[name]), name

    def same(recording: Recording, path: Path) -> bool:
        single = RecordingAdapter(path, AdapterOptions())
        asyncio.run(single.open(NullSink(), deadline=float("inf")))
        (bag,) = single.recordings.values()
        facts = [(each.count, each.start_ns, each.end_ns, each.format, each.encoding) for each in (recording, bag)]
        messages = [list(each.messages()) for each in (recording, bag)]
        is_same = facts[0] == facts[1] and dict(recording.topics) == dict(bag.topics) and messages[0] == messages[1]
        with pytest.raises(NotFound):
            recording.message(recording.count)
        asyncio.run(single.close())
        return is_same

    asyncio.run(scenario())


def test_no_more_than_eight_recordings_stay_open_and_none_is_closed_while_it_is_read(tmp_path: Path) -> None:
    for number in range(12):
        write(tmp_path, f"run{number}.bag")

    async def scenario() -> None:
        async with collection(tmp_path) as found:
            everything = list(found.recordings.values())
            readers = [each.messages() for each in everything]
            first = [next(each) for each in readers]  # all twelve are open now
            assert [each.index for each in first] == [0] * 12
            assert all(len(list(each)) == 4 for each in readers)
            with ThreadPoolExecutor(4) as threads:
                again = list(threads.map(lambda each: each.message(4).index, everything * 5))
            assert again == [4] * 60
            assert len(found._pool._open) <= 8  # type: ignore[attr-defined]

    asyncio.run(scenario())


def test_annotations_follow_the_content_of_files_that_are_rotated_and_copies_have_none(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    write(folder, "run.bag", "first")

    async def names() -> dict[str, tuple[str, tuple[str, ...]]]:
        async with collection(folder) as found:
            catalogue = found.catalogue
            assert isinstance(catalogue, Catalogue)
            rows = list(catalogue.rows())
            if len(rows) == 1:
                catalogue.annotate(rows[0].id, ["first"], [Event("x", 1)])
            return {row.path.name: (row.name, catalogue.tags(row.id)) for row in rows}

    assert asyncio.run(names()) == {"run.bag": ("run", ("first",))}
    (folder / "run.bag").rename(folder / "run.1.bag")
    write(folder, "run.bag", "second")
    shutil.copy(folder / "run.1.bag", folder / "same.bag")
    assert asyncio.run(names()) == {
        "run.1.bag": ("run", ("first",)),
        "run.bag": ("run.bag", ()),
        "same.bag": ("same", ()),
    }


def test_a_source_that_is_missing_or_a_part_of_a_folder_is_refused(tmp_path: Path) -> None:
    write(tmp_path, "run.bag")

    async def opens(*sources: str) -> None:
        async with collection(Path(sources[0]), *sources[1:]):
            pass

    for sources in ((str(tmp_path), str(tmp_path / "gone")), (f"{tmp_path}/*.mcap",)):
        with pytest.raises(NotFound, match="there is no recording"):
            asyncio.run(opens(*sources))
    with pytest.raises(ValueError, match="is a folder of recordings"):
        adapter(f"{tmp_path}?from=-1", AdapterOptions())
    (tmp_path / ".rosld.sqlite").write_text("my own notes, in no database at all, and long enough to be one" * 40)
    with pytest.raises(Unreachable, match="is no catalogue of recordings"):
        asyncio.run(opens(str(tmp_path)))
