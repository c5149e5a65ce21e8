"""Playback of a recording: its clock, a pure function of the elapsed time, and the players of its topics.

The newest message is computed on demand, without a task per message. Only a watch has a timer, set to the time of the
topic's next message. `latest` reads the disk in the caller's thread if the playback has passed a message of the topic
since the last call: microseconds for an uncompressed file or a cached chunk, otherwise one decompression (a few ms for
a typical chunk of 1 MB, up to 50 ms for bz2).
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from rosld.adapters.model import Sample, Unreachable
from rosld.adapters.recording.bag import Bag, Stream, log
from rosld.adapters.slots import Feed, LoopWatch


class Position(NamedTuple):
    """A position in a playback: the number of its loop (from 0) and the recorded time since the first message in ns."""

    epoch: int
    offset_ns: int


class Playback(Struct, frozen=True):
    """Playback of a recording of `duration_ns` at `rate` times its speed, in a loop with a short pause, or once.

    The pause shows the last message for the mean time between messages, at least a millisecond and at most a second.
    Raises ValueError for a rate that is not a positive number.
    """

    duration_ns: int
    count: int
    rate: float = 1.0
    once: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"the rate must be a number above 0, not {self.rate}")

    @property
    def period_ns(self) -> int:
        """Recorded time of one loop, including the pause."""
        mean = self.duration_ns // (self.count - 1) if self.count > 1 else 10**9
        return self.duration_ns + min(max(mean, 10**6), 10**9)

    def position(self, elapsed_ns: int) -> Position:
        """Return the position `elapsed_ns` after the start; a single playback rests at the end."""
        played = int(max(elapsed_ns, 0) * self.rate)
        if self.once:
            return Position(0, min(played, self.duration_ns))
        return Position(*divmod(played, self.period_ns))

    def since(self, position: Position, elapsed_ns: int) -> int:
        """Return the recorded time in ns between a position and the current one; 0 for a future position."""
        now = self.position(elapsed_ns)
        return max(0, (now.epoch - position.epoch) * self.period_ns + now.offset_ns - position.offset_ns)

    def elapsed_at(self, position: Position) -> int:
        """Return the time from the start to a position: never too early, and at most a few ns late."""
        return math.ceil((position.epoch * self.period_ns + position.offset_ns) / self.rate)


_CALM = 0.005
"""Minimum seconds between wake-ups: faster topics are coalesced."""


class _Due(NamedTuple):
    """A message to show: its index in the recording, and its number within its stream."""

    epoch: int
    at: int
    sequence: int


class _View(NamedTuple):
    """The messages that are due, with their samples."""

    due: tuple[_Due, ...]
    samples: tuple[Sample, ...]


class TopicPlayer(Feed):
    """Player of a topic; `elapsed` returns the time since the start, in ns."""

    def __init__(self, bag: Bag, streams: Sequence[Stream], playback: Playback, elapsed: Callable[[], int]) -> None:
        super().__init__()
        self._bag = bag
        self._streams = streams
        self._positions = np.sort(np.concatenate([np.empty(0, np.int64), *(each.positions for each in streams)]))
        self._playback = playback
        self._elapsed = elapsed
        self._until = 0
        self._views: dict[int, _View] = {}
        self._timer: asyncio.TimerHandle | None = None

    def latest(self, depth: int = 1) -> Sequence[Sample]:
        """Return the newest `depth` messages of each publisher at or before the current position, in order of play."""
        now = self._elapsed()
        if now >= self._until:
            self._until = self._next_change(now)
            self._views = {each: self._renew(each, view, now) for each, view in self._views.items()}
        if depth not in self._views:
            self._views[depth] = self._renew(depth, _View((), ()), now)
        return self._views[depth].samples

    def watch(self, wake: Callable[[], None]) -> LoopWatch:
        """Wake when the topic's next message is due."""
        watch = super().watch(wake)
        if self._timer is None:
            self._set_timer(self._next_change(self._elapsed()))
        return watch

    def _renew(self, depth: int, view: _View, now: int) -> _View:
        """Return the view at `now`: the same object if nothing has changed."""
        due = self._due(self._playback.position(now), depth)
        if due == view.due:
            return view
        previous = dict(zip(view.due, view.samples, strict=False)) if len(view.due) == len(view.samples) else {}
        samples = ((each, previous.get(each) or self._sample(each)) for each in due)
        entries = [(each, sample) for each, sample in samples if sample is not None]
        return _View(due, tuple(sample for _, sample in entries))

    def _sample(self, due: _Due) -> Sample | None:
        try:
            return self._bag.sample(due.at, due.sequence, due.epoch)
        except Unreachable as error:  # skip damaged messages: their neighbours still play
            log.warning("%s", error)
            return None

    def _due(self, position: Position, depth: int) -> tuple[_Due, ...]:
        passed = self._count_passed(position)
        due = [each for stream in self._streams for each in _of_stream(stream, position.epoch, passed, depth)]
        return tuple(sorted(due))

    def _count_passed(self, position: Position) -> int:
        """Return the number of messages of the recording at or before a position."""
        now = min(self._bag.start_ns + position.offset_ns, self._bag.end_ns)
        return int(np.searchsorted(self._bag.times, now, "right"))

    def _next_change(self, now: int) -> int:
        """Return the elapsed time in ns, after `now`, of the topic's next message or of the next loop."""
        position = self._playback.position(now)
        following = int(np.searchsorted(self._positions, self._count_passed(position)))
        if following < len(self._positions):
            offset = int(self._bag.times[self._positions[following]]) - self._bag.start_ns
            return max(self._playback.elapsed_at(Position(position.epoch, offset)), now + 1)
        if self._playback.once or not len(self._positions):
            return _NEVER
        return max(self._playback.elapsed_at(Position(position.epoch + 1, 0)), now + 1)

    def _set_timer(self, due: int) -> None:
        if due < _NEVER:
            delay = max((due - self._elapsed()) / 1e9, _CALM)
            self._timer = asyncio.get_running_loop().call_later(delay, self._ring, due)

    def _ring(self, due: int) -> None:
        self._timer = None
        if not self.watches:
            return
        now = self._elapsed()
        if now >= due:
            self.notify()
            due = self._next_change(now)
        self._set_timer(due)

    def close(self) -> None:
        """Stop waking watches."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


_NEVER = 1 << 63


def _of_stream(stream: Stream, epoch: int, passed: int, depth: int) -> list[_Due]:
    """Return the latest messages of a publisher after `passed` messages of the recording in this loop.

    The latched messages of the previous loop are shown until the publisher's first message in this loop.
    """
    count = int(np.searchsorted(stream.positions, passed))
    if not count and stream.latched and epoch:
        epoch, count = epoch - 1, len(stream.positions)
    first = max(count - depth, 0)
    return [_Due(epoch, int(stream.positions[each]), each + 1) for each in range(first, count)]
