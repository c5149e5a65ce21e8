"""Reading bytes at offsets in files and decompressed chunks, and the base class of formats that consist of chunks."""

from __future__ import annotations

import bz2
import sys
import threading
import zlib
from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, cast

import numpy as np
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from numpy.typing import NDArray

from rosld.adapters.model import Encoding
from rosld.adapters.recording.storage import (
    Damaged,
    MessageTable,
    OpenBudget,
    RecordedConnection,
    Storage,
    Totals,
    concatenate,
)

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAX_PIECE = 256 << 20
"""Maximum bytes of a chunk or a message, which is the maximum size of a robot's messages (`MESSAGE_LIMIT`).

Recorders close a chunk after a few megabytes, or after a single longer message.
"""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
STEP = 1 << 20
"""Bytes decompressed at a time, so that memory use depends on the data, not on the size claimed in a header."""


class ByteSource(Protocol):
    """Bytes that can be read at any offset."""

    @property
    def size(self) -> int:
        """Number of bytes."""

    def read_up_to(self, at: int, size: int) -> bytes:
        """Return up to `size` bytes from `at`; fewer at the end."""


def read_exactly(source: ByteSource, at: int, size: int) -> bytes:
    """Return `size` bytes from `at`. Raises Damaged if the source ends before."""
    if at < 0 or size < 0 or at + size > source.size:
        raise Damaged(f"{size} bytes are missing at {at}: it ends at {source.size}")
    if size > MAX_PIECE:
        raise Damaged(f"{size} bytes at {at} exceed the read limit of {MAX_PIECE}")
    data = source.read_up_to(at, size)
    if len(data) != size:
        raise Damaged(f"only {len(data)} of {size} bytes could be read at {at}")
    return data


class RandomFile:
    """A file that any thread can read at offsets; the lock is held while reading the disk, not while decompressing."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._lock = threading.Lock()
        self.size = path.stat().st_size

    def read_up_to(self, at: int, size: int) -> bytes:
        """Return up to `size` bytes from `at`. Raises Damaged after `close`."""
        try:
            with self._lock:
                self._file.seek(at)
                return self._file.read(size)
        except (ValueError, OSError) as error:
            raise Damaged(f"the file cannot be read: {error}") from error

    def close(self) -> None:
        """Close the file. Idempotent."""
        with self._lock:
            self._file.close()


class BytesSource:
    """Bytes in memory as a `ByteSource`."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.size = len(data)

    def read_up_to(self, at: int, size: int) -> bytes:
        """Return up to `size` bytes from `at`."""
        return self._data[at : at + size]


class _Decompressor(Protocol):
    """Common interface of the bz2, LZ4 and Zstandard decompressors."""

    @property
    def eof(self) -> bool: ...

    @property
    def needs_input(self) -> bool: ...

    def decompress(self, data: bytes, max_length: int = ...) -> bytes: ...


_DECOMPRESSORS: dict[str, Callable[[], _Decompressor]] = {
    "bz2": lambda: cast(_Decompressor, bz2.BZ2Decompressor()),
    "lz4": lambda: cast(_Decompressor, LZ4FrameDecompressor()),
    "zstd": lambda: cast(_Decompressor, zstd.ZstdDecompressor()),
}
_ERRORS = (OSError, EOFError, ValueError, RuntimeError, zstd.ZstdError)


def decompress(compression: str, data: bytes, size: int) -> bytes:
    """Return the `size` bytes of compressed data; never produces more. Raises Damaged."""
    if compression in ("", "none"):
        return data
    if compression not in _DECOMPRESSORS:
        raise Damaged(f"the compression {compression!r} is not one of {', '.join(_DECOMPRESSORS)}")
    if size > MAX_PIECE:
        raise Damaged(f"a chunk states a size of {size} bytes, more than the read limit of {MAX_PIECE}")
    try:
        inflated = b"".join(_inflate(_DECOMPRESSORS[compression](), data, size + 1))
    except _ERRORS as error:
        raise Damaged(f"a {compression} chunk cannot be decompressed: {error}") from error
    if len(inflated) != size:
        raise Damaged(f"a {compression} chunk does not contain the stated {size} bytes")
    return inflated


def decompress_zstd(data: bytes) -> bytes:
    """Return the contents of a zstd frame of unknown size. Raises Damaged."""
    decompressor = zstd.ZstdDecompressor()
    try:
        inflated = b"".join(_inflate(cast(_Decompressor, decompressor), data, MAX_PIECE + 1))
    except zstd.ZstdError as error:
        raise Damaged(f"it cannot be decompressed: {error}") from error
    if len(inflated) > MAX_PIECE:
        raise Damaged(f"it exceeds the read limit of {MAX_PIECE} bytes")
    if not decompressor.eof:
        raise Damaged("it is cut off")
    return inflated


def inflate_file(path: Path, target: Path, check: Callable[[int], None]) -> None:
    """Decompress a zstd file to another file; call `check` with the size so far before each write.

    Raises Damaged, OSError, and what `check` raises.
    """
    size = 0
    try:
        with zstd.ZstdFile(path) as packed, target.open("wb") as out:
            while block := packed.read(STEP):
                size += len(block)
                check(size)
                out.write(block)
    except (zstd.ZstdError, EOFError) as error:
        raise Damaged(f"it cannot be decompressed: {error}") from error


def _inflate(decompressor: _Decompressor, data: bytes, most: int) -> Iterator[bytes]:
    """Yield at most the first `most` bytes of a compressed stream, in pieces.

    Input and output are processed in steps: lz4's decompressor allocates its whole allowed output, and copies its
    unused input at each step.
    """
    at = 0
    while most and not decompressor.eof:
        piece = data[at : at + STEP] if decompressor.needs_input else b""
        at += len(piece)
        output = decompressor.decompress(piece, max_length=min(STEP, most))
        if not output and not piece:
            return
        most -= len(output)
        yield output


class ChunkCache:
    """Cache of recent decompressed chunks, so that neighbouring messages share one decompression.

    Unreadable chunks are cached as such. Thread-safe; two threads may load the same chunk at the same time.
    """

    def __init__(self, load: Callable[[int], bytes], max_bytes: int = 64 << 20) -> None:
        self._load = load
        self.limit = max_bytes
        self._size = 0
        self._chunks: OrderedDict[int, BytesSource | Damaged] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, chunk: int) -> BytesSource:
        """Return the chunk. Raises Damaged."""
        with self._lock:
            found = self._chunks.get(chunk)
            if found is not None:
                self._chunks.move_to_end(chunk)
        if found is None:
            found = self._keep(chunk, self._load_chunk(chunk))
        if isinstance(found, Damaged):
            raise Damaged(str(found))
        return found

    def _load_chunk(self, chunk: int) -> BytesSource | Damaged:
        try:
            return BytesSource(self._load(chunk))
        except Damaged as damage:
            return damage

    def _keep(self, chunk: int, source: BytesSource | Damaged) -> BytesSource | Damaged:
        with self._lock:
            if chunk not in self._chunks:
                self._chunks[chunk] = source
                self._size += _weight(source)
            while self._size > self.limit and len(self._chunks) > 1:
                _, dropped = self._chunks.popitem(last=False)
                self._size -= _weight(dropped)
        return source


def _weight(source: BytesSource | Damaged) -> int:
    return source.size if isinstance(source, BytesSource) else 0


class Chunk(NamedTuple):
    """A chunk: start, size and compression of its bytes, and size and CRC (0 if unknown) of the uncompressed ones."""

    at: int
    size: int
    compression: str
    inflated: int
    crc: int = 0


class Scan:
    """Results of scanning so far: connections by their number in the file, chunks, and tables of messages.

    `only_totals`: the totals in a summary suffice, without the tables.
    """

    def __init__(self, budget: OpenBudget, encoding: Encoding, kind: str, *, only_totals: bool = False) -> None:
        self.budget = budget
        self.only_totals = only_totals
        self.totals: Totals | None = None
        self.numbers: dict[int, int] = {}
        self.connections: list[RecordedConnection] = []
        self.chunks: list[Chunk] = []
        self.tables: list[MessageTable] = []
        self.notes: list[str] = []
        self.silent: tuple[str, ...] = ()
        self._encoding = encoding
        self._kind = kind

    def add(self, number: int, connection: RecordedConnection) -> None:
        """Add a connection, unless there is one of this number."""
        if number not in self.numbers:
            self.budget.spend(parts=1)
            self.numbers[number] = len(self.connections)
            self.connections.append(connection)

    def connection(self, number: int) -> int:
        """Return the index of connection `number`; an undescribed connection is added as an odd one."""
        if number not in self.numbers:
            odd = f"the recording does not describe its {self._kind} {number}"
            self.add(number, RecordedConnection(f"/{self._kind}_{number}", "", self._encoding, odd=odd))
        return self.numbers[number]

    def set_totals(self, counts: Mapping[int, int], start_ns: int, end_ns: int) -> bool:
        """Use the totals of a summary; return whether they can be right, and count no message twice."""
        known = counts.keys() <= self.numbers.keys() and 0 <= start_ns <= end_ns < 1 << 63
        if known and not any(each.is_opening for each in self.connections):
            self.totals = Totals([counts.get(number, 0) for number in self.numbers], start_ns, end_ns)
        return self.totals is not None

    def table(self, number: int, place: int, times: NDArray[Any], offsets: NDArray[Any]) -> MessageTable:
        """Return the table of a connection's messages in one place."""
        connection = np.full(len(times), self.connection(number), np.int32)
        places = np.full(len(times), place, np.int32)
        return MessageTable(times.astype(np.int64), connection, places, offsets.astype(np.int64))


def inflate(source: ByteSource, chunk: Chunk, budget: OpenBudget) -> bytes:
    """Return the uncompressed bytes of a chunk. Raises Damaged."""
    budget.work(min(chunk.inflated, MAX_PIECE))
    data = decompress(chunk.compression, read_exactly(source, chunk.at, chunk.size), chunk.inflated)
    if chunk.crc and zlib.crc32(data) != chunk.crc:
        raise Damaged(f"the checksum of the chunk at {chunk.at} is wrong")
    return data


class ChunkedFile(Storage):
    """An open file with an index and compressed chunks, numbered from place 1; it is read through without its index."""

    encoding: ClassVar[Encoding]
    kind: ClassVar[str]
    """Name of a connection in the format."""

    def __init__(self, path: Path, budget: OpenBudget, *, only_totals: bool = False) -> None:
        self._file = RandomFile(path)
        try:
            begin = self._read_header(self._file)
            scan = Scan(budget, self.encoding, self.kind, only_totals=only_totals)
            try:
                self._read_index(self._file, scan)
            except Damaged as damage:
                scan = Scan(budget, self.encoding, self.kind)
                self._read_through(self._file, begin, scan)
                scan.notes.append(f"its index cannot be used ({damage}), so the whole file was read")
                if not scan.connections:
                    raise Damaged(f"{damage}, and no complete {self.kind} was found in it either") from damage
        except BaseException:
            self._file.close()
            raise
        chunks = scan.chunks
        self._cache = ChunkCache(lambda number: inflate(self._file, chunks[number], OpenBudget()))
        self.connections, self.messages = scan.connections, concatenate(scan.tables)
        self.places, self.notes, self.silent = 1 + len(chunks), tuple(scan.notes), scan.silent
        self.totals = scan.totals

    @abstractmethod
    def _read_header(self, file: RandomFile) -> int:
        """Check the header, and return its end. Raises Damaged."""

    @abstractmethod
    def _read_index(self, file: RandomFile, scan: Scan) -> None:
        """Scan the index. Raises Damaged."""

    @abstractmethod
    def _read_through(self, file: RandomFile, at: int, scan: Scan) -> None:
        """Scan everything from `at` on."""

    def _source(self, place: int) -> ByteSource:
        return self._cache.get(place - 1) if place else self._file

    def limit_cache(self, max_bytes: int) -> None:
        self._cache.limit = max_bytes

    def close(self) -> None:
        self._file.close()
