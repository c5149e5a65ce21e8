"""Memory while 200 topics at 50 Hz are recorded to disk, minute by minute.

Run: python bench/history_memory.py [minutes]. The history has the default limits of a server, a day in 1 GiB: it starts
a segment each minute, and removes the oldest once it is full. The robot is simulated in the same process; its messages
repeat, so that they take no more memory than in the first minute.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
from pathlib import Path

from history import IMU, RATE, TOPICS, Messages, Source, learn, resident

from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.segments import HistoryLimits, Segments
from rosld.server.history.topic_feed import LiveRecorder

MINUTE = 60.0
DAY, GIBIBYTE = 86400.0, 1 << 30


class Round(Messages):
    """Messages that repeat."""

    def next(self, now: int) -> bytes:
        """Return the next message."""
        if self._at == len(self._noise):
            self._at = 0
        return super().next(now)


async def record(minutes: int, folder: Path) -> None:
    """Record for some minutes, and print the memory of the process after each."""
    source = Source(TOPICS, 0.0)
    source._messages = Round(TOPICS * RATE * 10)
    live = LiveRecorder(source, learn)  # type: ignore[arg-type]
    writer = HistoryWriter(Segments(folder, HistoryLimits(DAY, GIBIBYTE)), lambda ref: IMU.definition)
    writer.open()
    live.add(writer, lambda topic: True)
    sent = 0
    for minute in range(1, minutes + 1):
        sent += await source.speak(MINUTE)
        size, segments, dropped = writer.segments.size, len(writer.segments.rows), live.dropped().total()
        print(
            f"{minute:3} min: {resident():6.1f} MB; {sent} sent, {writer.next} recorded, {dropped} dropped; "
            f"{size / 1e6:.0f} MB in {segments} segments",
            flush=True,
        )
    await live.stop()


def main() -> None:
    """Print memory by minutes."""
    minutes = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    with tempfile.TemporaryDirectory() as name:
        asyncio.run(record(minutes, Path(name)))


if __name__ == "__main__":
    main()
