"""Recordings that wait for triggers, in isolation: failures lose no order, stored ones are restored."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncGenerator
from pathlib import Path

import pytest

from rosld.server.auth.rules import Agent
from rosld.server.history.armed_recordings import MAX_ARMED, ArmedRecording, ArmedRecordings, MayRecord
from rosld.server.history.recording_orders import ARMED, RecordingNotes, RecordingOrder, RecordingRefused, Trigger

ANNA = Agent("anna", "http://example.org/anna")
ONCE = RecordingOrder(("/odom", "/camera/*"), "x", 10.0, 5.0, Trigger("x > 1", "/topics/odom"))


class Begun:
    """Recordings that were started, after this number of failures."""

    def __init__(self, *failures: Exception) -> None:
        self.names: list[str] = []
        self.failures = list(failures)

    def begin(self, order: RecordingOrder, may_record: MayRecord) -> None:
        if self.failures:
            raise self.failures.pop(0)
        assert order.name is not None
        self.names.append(order.name)

    def is_free(self, name: str) -> bool:
        return name not in self.names


async def never(one: ArmedRecording) -> AsyncGenerator[MayRecord, None]:
    await asyncio.Event().wait()
    yield lambda topic: True


def notes(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


async def finished(one: ArmedRecording) -> None:
    """Wait until a recording waits no more."""
    assert one.task is not None
    await one.task


def armed(folder: Path | None, begun: Begun) -> ArmedRecordings:
    return ArmedRecordings(RecordingNotes(folder), begun.begin, begun.is_free, retry_seconds=0.0)


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), RecordingRefused("16 are made already")])
async def test_an_order_whose_last_recording_could_not_be_begun_says_so_waits_on_and_begins_it(
    tmp_path: Path, failure: Exception
) -> None:
    begun, seen = Begun(failure), []

    async def looked_at(one: ArmedRecording) -> AsyncGenerator[MayRecord, None]:
        seen.append((one.count, one.problem, notes(tmp_path), "x" in recordings.all))
        yield lambda topic: True

    recordings = armed(tmp_path, begun)
    await finished(await recordings.arm("x", ONCE, ANNA, looked_at))
    assert begun.names == ["x"]
    assert not notes(tmp_path)
    kept, words = [f"x{ARMED}"], failure.strerror if isinstance(failure, OSError) else str(failure)
    assert seen == [(0, None, kept, True), (0, f"The recording could not be started: {words}.", kept, True)]
    assert not recordings.all
    await recordings.stop()


async def test_an_exception_where_a_trigger_is_followed_is_logged_and_the_order_waits_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    begun, failures = Begun(), [KeyError("odom"), KeyError("odom")]
    problems: list[str | None] = []

    async def failing(one: ArmedRecording) -> AsyncGenerator[MayRecord, None]:
        problems.append(one.problem)
        if failures:
            raise failures.pop()
        yield lambda topic: True

    recordings = armed(tmp_path, begun)
    await finished(await recordings.arm("x", ONCE, ANNA, failing))
    assert begun.names == ["x"]
    assert problems == [None, *["The trigger could not be watched: KeyError."] * 2]
    assert sum("could not be watched" in each.message for each in caplog.records) == 1, "the same is logged once"
    await recordings.stop()


async def test_an_order_that_began_its_recording_as_the_server_died_does_not_begin_it_again(tmp_path: Path) -> None:
    recordings = armed(tmp_path, Begun())
    await recordings.arm("x", ONCE, ANNA, never)
    await recordings.stop()
    begun = Begun()
    begun.names.append("x")
    again = armed(tmp_path, begun)
    again.load()
    assert not again.all
    assert not notes(tmp_path)


async def test_a_note_that_is_damaged_is_left_where_it_is_and_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for number, text in enumerate(("{", "[]", "{}", '{"order": {"topics": 3}, "agent": {"name": "a"}, "count": 0}')):
        (tmp_path / f"odd{number}{ARMED}").write_text(text)
    recordings = armed(tmp_path, Begun())
    recordings.load()
    assert not recordings.all
    assert len(notes(tmp_path)) == len([each for each in caplog.records if each.levelname == "WARNING"]) == 4


async def test_what_was_kept_beyond_the_limit_says_so_and_waits_once_there_is_room(tmp_path: Path) -> None:
    begun = Begun()
    recordings = armed(tmp_path, begun)
    for number in range(MAX_ARMED):
        await recordings.arm(f"a{number:02}", ONCE, ANNA, never)
    with pytest.raises(RecordingRefused, match="already"):
        await recordings.arm("b", ONCE, ANNA, never)
    await recordings.stop()
    shutil.copy(tmp_path / f"a00{ARMED}", tmp_path / f"b{ARMED}")
    again = armed(tmp_path, begun)
    again.load()
    last = again.all["b"]

    async def only_the_last(one: ArmedRecording) -> AsyncGenerator[MayRecord, None]:
        if one is not last:
            await asyncio.Event().wait()
        yield lambda topic: True

    again.resume(only_the_last)
    for _ in range(3):
        await asyncio.sleep(0)  # an iteration of the loop, in which it waits for its turn
    assert "16 recordings are already waiting" in str(last.suspended)
    assert begun.names == []
    await again.disarm("a00")
    await finished(last)
    assert begun.names == ["b"]
    await again.stop()
