"""Playback of a recording: its clock, and the selected part."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.base import AdapterOptions, NullSink
from rosld.adapters.model import Unreachable
from rosld.adapters.model.moment import Moment
from rosld.adapters.recording import adapter
from rosld.adapters.recording.part import Part, parse_part
from rosld.adapters.recording.player import Playback
from tests.adapters.recording.recorder import lines, write_rosbag1

SECOND = 10**9
playbacks = st.builds(
    Playback,
    duration_ns=st.integers(0, 3600 * SECOND),
    count=st.integers(0, 10**6),
    rate=st.floats(0.01, 100),
)
moments = st.integers(0, 7 * 24 * 3600 * SECOND)


def test_recordings_of_no_duration_play_too_and_a_rate_that_is_none_is_refused_naming_it() -> None:
    for count in (0, 1, 5):
        playback = Playback(0, count)
        assert 10**6 <= playback.period_ns <= SECOND
        assert playback.position(10 * SECOND).epoch >= 10
    for rate in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=str(rate)):
            Playback(1, 1, rate=rate)


@given(playbacks, moments, moments)
def test_it_never_goes_back(playback: Playback, one: int, other: int) -> None:
    earlier, later = sorted((one, other))
    assert playback.position(earlier) <= playback.position(later)


@given(playbacks, moments)
def test_a_position_is_reached_when_it_says_and_not_before(playback: Playback, elapsed: int) -> None:
    position = playback.position(elapsed)
    due = playback.elapsed_at(position)
    assert due <= elapsed + 1000
    assert playback.position(due + 1000) >= position


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return ten lines, one every 0.1 s from 2023-11-14T22:13:20Z on."""
    return write_rosbag1(tmp_path_factory.mktemp("bags") / "talk.bag", lines())


def texts(source: str) -> list[str]:
    """Return the texts of the messages of a source."""

    async def read() -> list[str]:
        found = adapter(source, AdapterOptions())
        await found.open(NullSink(), deadline=asyncio.get_running_loop().time() + 60)
        (recording,) = found.recordings.values()
        said = [each.sample.data[4:].decode() for each in recording.messages()]
        assert recording.count == len(said)
        await found.close()
        return said

    return asyncio.run(read())


def test_a_part_has_the_messages_of_its_time_both_ends_included(bag: Path) -> None:
    for query, expected in {
        "from=0.5": "56789",
        "from=-0.25": "789",
        "to=0.2": "012",
        "to=-0.7": "012",
        "from=0.2&to=-0.5": "234",
        "from=2023-11-14T22:13:20.3Z&to=2023-11-14T22:13:20.5Z": "345",
        "from=2023-11-14T23:13:20.3+01:00&to=0.5&rate=2": "345",
        "rate=2": "0123456789",
    }.items():
        assert texts(f"{bag}?{query}") == list(expected), query
    with pytest.raises(Unreachable, match="2023-11-14T22:13:20Z"):
        texts(f"{bag}?from=2030-01-01T00:00:00Z")


def test_a_part_that_makes_no_sense_is_refused_before_any_file_is_read() -> None:
    times = ("from=soon", "until=5", "from=3&to=2", "from=1&from=2", "from", "from=-1&to=-2")
    for query in (*times, "rate=fast", "rate=0"):
        with pytest.raises(ValueError, match=r".{10}"):
            adapter(f"/nowhere/run.bag?{query}", AdapterOptions())


def test_a_file_with_a_question_mark_in_its_name_is_that_file(tmp_path: Path) -> None:
    path = write_rosbag1(tmp_path / "why?from=5", lines(count=3))
    assert texts(str(path)) == ["0", "1", "2"]
    assert texts(f"recording:{path}") == ["0", "1", "2"]


def test_the_rate_of_a_part_goes_before_that_of_the_settings() -> None:
    assert parse_part("rate=0.5") == Part(rate=0.5)
    assert parse_part("from=-60") == Part(Moment(-60_000_000_000, is_absolute=False))
