"""Bytes of a segment, in a file or in memory, and its chunks."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from rosld.server.history import mcap_records as mcap


class SegmentFile(Protocol):
    """Bytes that are appended by one thread and read by any."""

    @property
    def size(self) -> int:
        """Number of bytes."""
        ...

    def append(self, data: bytes) -> None:
        """Append all of the data, or nothing. Raises OSError."""
        ...

    def read(self, at: int, size: int) -> bytes:
        """Return up to `size` bytes from `at`. Raises OSError if the file was removed."""
        ...

    def close(self) -> None:
        """End appending; reading stays possible. Raises OSError if the file cannot be made durable."""
        ...

    def remove(self) -> None:
        """Free the storage. Idempotent."""
        ...


class PipedFile:
    """A stream, such as stdout, that is only appended to."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = 0

    def append(self, data: bytes) -> None:
        """Write all of the data. Raises OSError."""
        self._stream.write(data)
        self.size += len(data)

    def read(self, at: int, size: int) -> bytes:
        raise OSError("a stream cannot be read")

    def close(self) -> None:
        self._stream.flush()

    def remove(self) -> None:
        """Do nothing: nothing is stored."""


class DiskFile:
    """A file in a folder. Opened for each read, since there are many segments and few file descriptors."""

    def __init__(self, path: Path) -> None:
        """Open the file to append to it. Raises OSError."""
        self.path = path
        self._file: int | None = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._size = os.lseek(self._file, 0, os.SEEK_END)

    @property
    def size(self) -> int:
        return self._size

    def append(self, data: bytes) -> None:
        """Append all of the data. If the disk takes only a part, that is removed again."""
        assert self._file is not None, "cannot write to a closed segment"
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except OSError:
            self.truncate(self._size)
            raise
        self._size += len(data)

    def truncate(self, size: int) -> None:
        """Truncate the file to `size` bytes."""
        assert self._file is not None, "cannot write to a closed segment"
        with contextlib.suppress(OSError):
            os.ftruncate(self._file, size)
            os.lseek(self._file, size, os.SEEK_SET)
        self._size = size

    def read(self, at: int, size: int) -> bytes:
        with self.path.open("rb", buffering=0) as file:
            file.seek(at)
            parts: list[bytes] = []
            while size > 0 and (data := file.read(size)):
                parts.append(data)
                size -= len(data)
        return b"".join(parts)

    def close(self) -> None:
        if self._file is not None:
            file, self._file = self._file, None
            try:
                os.fsync(file)
            finally:
                os.close(file)

    def remove(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None
        with contextlib.suppress(OSError):
            self.path.unlink()


class MemoryFile:
    def __init__(self) -> None:
        self._data = bytearray()

    @property
    def size(self) -> int:
        """Number of bytes."""
        return len(self._data)

    def append(self, data: bytes) -> None:
        self._data += data

    def read(self, at: int, size: int) -> bytes:
        return bytes(self._data[at : at + size])

    def close(self) -> None:
        pass

    def remove(self) -> None:
        self._data = bytearray()


class ChunkMessage(NamedTuple):
    """A message of a chunk; `sequence` are the lower 32 bits of its number."""

    channel: int
    sequence: int
    time_ns: int
    data: bytes


def read_records(file: SegmentFile, at: int, length: int) -> bytes:
    """Return the records of the chunk record at `at`. Raises OSError, and ValueError if it is damaged."""
    data = file.read(at, length)
    if len(data) != length or data[0] != mcap.CHUNK:
        raise ValueError(f"no chunk found at {at}")
    head = mcap.chunk_head(data, mcap.RECORD_HEAD.size)
    return mcap.decompress(data[head.records_at :], head.size)


def read_chunk(file: SegmentFile, at: int, length: int) -> Iterator[ChunkMessage]:
    """Yield the messages of the chunk record at `at`. Raises OSError, and ValueError if it is damaged."""
    yield from messages_in(read_records(file, at, length))


def messages_in(inner: bytes) -> Iterator[ChunkMessage]:
    """Yield the messages among the records of a chunk."""
    for record in mcap.records_in(inner):
        if record.op == mcap.MESSAGE:
            start = record.at - mcap.RECORD_HEAD.size
            _, _, channel, sequence, time_ns, _ = mcap.MESSAGE_HEAD.unpack_from(inner, start)
            yield ChunkMessage(channel, sequence, time_ns, inner[start + mcap.MESSAGE_HEAD.size : record.end])
