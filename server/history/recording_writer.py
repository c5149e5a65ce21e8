"""Writer of one recording as an MCAP file, which is renamed once it is complete."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.server.history.channel import channel_of
from rosld.server.history.mcap_writer import McapWriter, TopicChunk, recover
from rosld.server.history.segment_file import DiskFile, PipedFile

log = logging.getLogger("rosld.history")
ACTIVE = ".active"
"""File suffix while a recording is written, as for rosbag."""


class RecordingWriter:
    """Sink for one file. The recorder's thread writes; any thread reads `count`, `size` and `problem`.

    A full disk ends the recording, and completes the file.
    """

    def __init__(
        self,
        path: Path,
        encoding: Encoding,
        definition_of: Callable[[TypeRef], str],
        require_room: Callable[[Path], None],
        since_ns: int | None = None,
        stream: BinaryIO | None = None,
    ) -> None:
        """Begin the file of a recording that starts at a time (None: now), or write it to a stream. Raises OSError."""
        self.path = path
        self.since_ns = time.time_ns() if since_ns is None else since_ns
        self.count = 0
        self.counts: Counter[str] = Counter()
        self.types: dict[str, TypeRef] = {}
        self.start_ns = 0
        self.end_ns = 0
        self.problem: str | None = None
        self.silent: Sequence[str] = ()
        """Selected topics and globs without a message, as written to the file."""
        self._require_room = require_room
        self._active = None if stream is not None else path.with_name(path.name + ACTIVE)
        require_room(path.parent)
        file = PipedFile(stream) if stream is not None else DiskFile(path.with_name(path.name + ACTIVE))
        self._writer: McapWriter | None = McapWriter(file, encoding, definition_of, 0)
        self._open: dict[str, TopicChunk] = {}

    @property
    def size(self) -> int:
        """Number of bytes written."""
        writer = self._writer
        return 0 if writer is None else writer.file.size

    def add(self, topic: str, sample: Sample) -> None:
        """Add a message. A full disk ends the recording.

        Of earlier messages, only latched ones are added, with the start of the recording as their time.
        """
        time_ns = max(sample.received_ns, self.since_ns)
        is_opening = sample.received_ns < self.since_ns
        if self._writer is None or self.problem is not None or (is_opening and not sample.latched):
            return
        if not self._writer.has_room():
            self._end("it has more channels than MCAP allows")
            return
        chunk = self._open.get(topic)
        if chunk is None:
            chunk = self._open[topic] = TopicChunk(topic, time.monotonic())
        channel = self._writer.channel(channel_of(topic, sample, is_opening=is_opening))
        chunk.add(channel, self.count, time_ns, sample.data, sample.received_ns)
        self.count += 1
        self.counts[topic] += 1
        self.types[topic] = sample.schema
        self.start_ns = min(self.start_ns or time_ns, time_ns)
        self.end_ns = max(self.end_ns, time_ns)
        if chunk.is_due(chunk.opened):
            self._write([chunk])

    def write_due(self, now: float) -> None:
        self._write([chunk for chunk in self._open.values() if chunk.is_due(now)])

    def close(self) -> None:
        """Write all chunks, complete the file, and rename it. Idempotent."""
        if self._writer is None:
            return
        self._write(list(self._open.values()))
        self.silent = [topic for topic in self.silent if topic not in self.counts]
        writer, self._writer = self._writer, None
        try:
            writer.finish(self.silent)
            if self._active is not None:
                self._active.replace(self.path)
        except OSError as error:  # without a summary the file is readable, and it is completed at the next start
            self._end(error.strerror or str(error))

    def _write(self, chunks: list[TopicChunk]) -> None:
        if not chunks or self._writer is None or self.problem is not None:
            return
        try:
            self._require_room(self.path.parent)
            for chunk in chunks:
                del self._open[chunk.topic]
                self._writer.write(chunk)
        except OSError as error:
            self._end(error.strerror or str(error))

    def _end(self, why: str) -> None:
        self.problem = f"The recording {self.path.stem} ended early: {why}."
        self._open.clear()
        log.error("%s", self.problem)


def active_recordings(folder: Path) -> list[str]:
    """Return the names of the recordings in a folder that were being written when rosld was killed."""
    return [path.name.removesuffix(ACTIVE).removesuffix(".mcap") for path in folder.glob(f"*{ACTIVE}")]


def complete_active(folder: Path) -> None:
    """Complete the recordings in a folder that were being written when rosld was killed."""
    for path in folder.glob(f"*{ACTIVE}"):
        try:
            recover(DiskFile(path))
            path.replace(path.with_name(path.name.removesuffix(ACTIVE)))
        except (OSError, ValueError, KeyError) as error:
            log.warning("the recording %s cannot be completed: %s", path.name, error)
