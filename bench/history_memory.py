"""Memory while 200 topics of 50 Hz are recorded to disk, minute by minute.

Run: python bench/history_memory.py [minutes]. The history has the limits that a server has by default, a day in 1 GiB:
a segment is begun each minute, and the oldest is removed once it is full. The robot is made up in the same process; its
messages come round again, so that they take no more memory than in the first minute.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
from pathlib import Path

from history import IMU, RATE, TOPICS, Messages, Source, learn, resident

from rosld.server.history.history_writer import HistoryWriter
from rosld.server.history.live_recorder import LiveRecorder
from rosld.server.history.segments import HistoryLimits, Segments

MINUTE = 60.0
DAY, GIBIBYTE = 86400.0, 1 << 30


class Round(Messages):
    """Messages that come round again."""

    def next(self, now: int) -> bytes:
        """The next message."""
        if self._at == len(self._noise):
            self._at = 0
        return super().next(now)


async def record(minutes: int, folder: Path) -> None:
    """Record so long, and print what the process has after each minute."""
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
