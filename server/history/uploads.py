"""Upload of recordings: a file is stored under a hidden name until it is known to be a recording."""

from __future__ import annotations

import asyncio
import re
import shutil
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.base import AdapterOptions, NullSink, Recording
from rosld.adapters.model.mcap import MAGIC
from rosld.adapters.registry import adapter_for
from rosld.server.history.history_writer import require_room

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

SUFFIXES = {b"#ROSBAG ": ".bag", MAGIC: ".mcap", b"SQLite f": ".db3"}
"""File suffixes by the first 8 bytes of a file."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_ZSTD = b"\x28\xb5\x2f\xfd"
_STEP = 1 << 20
_CHECK_SECONDS = 30.0
_BYTES_PER_SECOND = 1_000_000
"""A tenth of the speed of reading a recording of short messages without an index."""
DRAFT, _INFLATED = ".part", ".inflated"


class UploadRefused(Exception):
    """An uploaded file that is refused; `is_too_large`: it exceeds the limit."""

    def __init__(self, words: str, *, is_too_large: bool = False) -> None:
        super().__init__(words)
        self.is_too_large = is_too_large


async def receive_file(folder: Path, name: str, chunks: AsyncIterator[bytes], limit: int) -> tuple[Path, str]:
    """Write the chunks to a hidden file, decompressing zstd; return its path and the suffix for its format.

    Raises UploadRefused above `limit` bytes, OSError, and what `chunks` raises.
    """
    draft = folder / f".{name}{DRAFT}"
    try:
        with draft.open("wb") as file:
            async for chunk in chunks:
                await asyncio.to_thread(_write, file.write, folder, chunk)
        return await asyncio.to_thread(_recognize, draft, folder / f".{name}{_INFLATED}", limit)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


@contextmanager
def opened_recording(path: Path, options: AdapterOptions, seconds: float) -> Iterator[Recording]:
    """Open the recording at a path within these seconds, for work outside the event loop. Raises RosError."""
    adapter, loop = adapter_for(f"recording:{path}", options), asyncio.new_event_loop()
    try:
        loop.run_until_complete(adapter.open(NullSink(), deadline=loop.time() + seconds))
        (recording,) = adapter.recordings.values()
        yield recording
    finally:
        loop.run_until_complete(adapter.close())
        loop.close()


def check_recording(path: Path, index_limit: int) -> None:
    """Check that an untrusted file can be opened; run in a worker process. Raises RosError."""
    with opened_recording(path, AdapterOptions(recording_index_limit=index_limit), _CHECK_SECONDS):
        pass


def check_seconds(path: Path) -> float:
    """Return the seconds after which a worker that checks a file is killed, by the size of the file."""
    return _CHECK_SECONDS + path.stat().st_size / _BYTES_PER_SECOND


def remove_drafts(folder: Path) -> None:
    """Remove uploads and exports left by a killed rosld. No other process may use the folder."""
    for path in folder.glob(".*"):
        name = path.name[1:]
        for suffix in (DRAFT, _INFLATED, f"{DRAFT}.folder"):
            if name.endswith(suffix) and NAME.fullmatch(name.removesuffix(suffix)):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)


def _write(write: Callable[[bytes], object], folder: Path, data: bytes) -> None:
    require_room(folder)
    write(data)


def _recognize(draft: Path, inflated: Path, limit: int) -> tuple[Path, str]:
    """Return the path of the decompressed file, and the suffix for its format."""
    if _head(draft)[: len(_ZSTD)] != _ZSTD:
        return draft, _suffix(draft)

    try:
        _inflate(draft, inflated, limit)
        suffix = _suffix(inflated)
    except BaseException:
        inflated.unlink(missing_ok=True)
        raise
    draft.unlink()
    return inflated, suffix


def _inflate(packed: Path, target: Path, limit: int) -> None:
    size = 0
    try:
        with zstd.ZstdFile(packed) as source, target.open("wb") as out:
            while block := source.read(_STEP):
                size += len(block)
                if size > limit:
                    words = f"decompressed, it exceeds the {limit} bytes that the setting `upload_limit` allows"
                    raise UploadRefused(words, is_too_large=True)
                _write(out.write, target.parent, block)
    except (zstd.ZstdError, EOFError) as error:
        raise UploadRefused(f"it cannot be decompressed: {error}") from error


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(8)


def _suffix(path: Path) -> str:
    head = _head(path)
    if head not in SUFFIXES:
        raise UploadRefused(
            "this is not a ROS 1 bag, an MCAP file or a ROS 2 database (optionally compressed with zstd)"
        )
    return SUFFIXES[head]
