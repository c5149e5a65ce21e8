"""Blobs: a folder of files, each named by a random id, written once and never changed.

A file is complete and durable before a record refers to it. It is removed only when no record refers to it that a crash
could restore. Readers of a snapshot of the records prevent the removal of files meanwhile.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from rosld.server.storage.files import FileLock, sync_folder
from rosld.server.storage.record import Blob, StorageError

ID = re.compile(r"[0-9a-f]{32}")
_PART = ".part"
_AT_ONCE = 256 * 1024
"""Maximum size in bytes of a file that is written without another thread."""


class Blobs:
    """The files in a folder. With `durable`, the files that `receive` returns survive a crash of the machine."""

    def __init__(self, folder: Path, *, durable: bool) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._durable = durable
        self._lock = FileLock(folder.parent / f"{folder.name}.lock") if durable else None

    def path(self, id: str) -> Path:
        """Return the path of the file of a blob."""
        return self._folder / id

    async def receive(self, chunks: AsyncIterator[bytes], limit: int) -> tuple[str, int]:
        """Write a new file from chunks; return its id and size. Raises ValueError beyond `limit` bytes, StorageError.

        On failure or cancellation the file is removed.
        """
        id = secrets.token_hex(16)
        part = self._folder / (id + _PART)
        try:
            with _disk_errors():
                file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            try:
                size = await _fill(file, chunks, limit)
                await self._settle(file, part, self.path(id))
            finally:
                os.close(file)
        except BaseException:
            _unlink(part)
            _unlink(self.path(id))
            raise
        return id, size

    async def _settle(self, file: int, part: Path, path: Path) -> None:
        def settle() -> None:
            os.fsync(file)
            part.rename(path)
            sync_folder(self._folder)

        with _disk_errors():
            if self._durable:
                await _finish(settle)
            else:
                os.rename(part, path)  # noqa: PTH104 - as fast as starting the thread

    def add(self, file: IO[bytes], size: int) -> str:
        """Copy a file of known size; return the id of the copy, whose name is durable after `sync`.

        Raises ValueError for another size, and OSError; then no copy is left.
        """
        id = secrets.token_hex(16)
        path = self.path(id)
        try:
            with path.open("xb") as copy:
                shutil.copyfileobj(file, copy, _AT_ONCE)
                copy.flush()
                os.fsync(copy.fileno())
                written = copy.tell()
            if written != size:
                raise ValueError(f"a file has {written} bytes, expected {size}")
        except BaseException:
            _unlink(path)
            raise
        return id

    def sync(self) -> None:
        """Make the names of all files durable."""
        sync_folder(self._folder)

    def remove(self, ids: Collection[str]) -> bool:
        """Remove files unless a process holds them (`hold_files`); return whether they were removed."""
        with self.try_removal_lock() as free:
            if free:
                for id in ids:
                    _unlink(self.path(id))
        return free

    def discard(self, id: str) -> None:
        """Remove a file that no record has ever referred to."""
        _unlink(self.path(id))

    def sweep(self, used: Callable[[], Collection[str]]) -> None:
        """Remove files left by an earlier process: all but those in `used`."""
        with self.try_removal_lock() as free:
            if free:
                keep = used()
                for path in self._folder.iterdir():
                    if path.name not in keep and ID.fullmatch(path.name.removesuffix(_PART)):
                        _unlink(path)

    @contextmanager
    def try_removal_lock(self) -> Iterator[bool]:
        """Prevent other processes from reading or replacing all records; yield False if one does so already."""
        if self._lock is None:
            yield True
            return
        free = self._lock.acquire()
        try:
            yield free
        finally:
            if free:
                self._lock.release()

    @contextmanager
    def hold_files(self) -> Iterator[None]:
        """Prevent all processes from removing files; wait for a removal in progress."""
        if self._lock is None:
            yield
            return
        self._lock.acquire(shared=True, wait=True)
        try:
            yield
        finally:
            self._lock.release()

    def close(self) -> None:
        """Release the folder."""
        if self._lock is not None:
            self._lock.close()


def storage_error(error: OSError) -> StorageError:
    """Return the StorageError for a failed write of a file."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    words = error.strerror or str(error)
    return StorageError(f"The file could not be stored: {words}.", full=full)


@contextmanager
def _disk_errors() -> Iterator[None]:
    """Raise the StorageError for an error of the disk."""
    try:
        yield
    except OSError as error:
        raise storage_error(error) from error


async def _fill(file: int, chunks: AsyncIterator[bytes], limit: int) -> int:
    """Write the chunks; return the size in bytes. Exceptions of `chunks` are propagated."""
    size, buffered, buffer = 0, 0, list[bytes]()
    async for chunk in chunks:
        size += len(chunk)
        if size > limit:
            raise ValueError(f"more than {limit} bytes were sent")
        buffer.append(chunk)
        buffered += len(chunk)
        if buffered > _AT_ONCE:
            with _disk_errors():
                await _finish(_write, file, buffer)
            buffered, buffer = 0, []
    with _disk_errors():
        _write(file, buffer)
    return size


async def _finish(work: Callable[..., None], *arguments: object) -> None:
    """Run in another thread, to the end even if the wait is cancelled: it uses a file that is closed next."""
    future = asyncio.get_running_loop().run_in_executor(None, work, *arguments)
    cancelled: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.shield(future)
        except asyncio.CancelledError as error:
            cancelled = error
        except OSError:
            break
    if cancelled is not None:
        future.exception()  # retrieved, so that asyncio does not report it as lost
        raise cancelled
    future.result()


def _write(file: int, chunks: Iterable[bytes]) -> None:
    data = memoryview(b"".join(chunks))
    while data:
        data = data[os.write(file, data) :]


def _unlink(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


class ReceivedBlobs:
    """Receives blobs, and discards those that no write refers to within `keep_seconds`. Belongs to one event loop.

    Files are in the folder given to `use`, or else in a temporary folder, created when it is needed.
    """

    def __init__(self, keep_seconds: float) -> None:
        self._keep_seconds = keep_seconds
        self._blobs: Blobs | None = None
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._closed = False

    def use(self, blobs: Blobs) -> None:
        """Store the blobs in this folder."""
        self._blobs = blobs

    def folder(self) -> Blobs:
        """Return the folder of blobs. Raises StorageError after `close`."""
        if self._closed:
            raise StorageError("The records are closed.")
        if self._blobs is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="rosld-", ignore_cleanup_errors=True)
            self._blobs = Blobs(Path(self._temporary.name) / "blobs", durable=False)
        return self._blobs

    async def receive(self, chunks: AsyncIterator[bytes], media_type: str, limit: int) -> Blob:
        """Store the chunks as a blob, for `keep_seconds`. Raises StorageError, and ValueError beyond `limit` bytes."""
        id, size = await self.folder().receive(chunks, limit)
        self.keep((id,))
        return Blob(id, size, media_type)

    def keep(self, ids: Iterable[str]) -> None:
        """Discard blobs after `keep_seconds` unless a write refers to them."""
        loop = asyncio.get_running_loop()
        self._timers.update({id: loop.call_later(self._keep_seconds, self.discard, id) for id in ids})

    def claim(self, ids: Iterable[str]) -> list[str]:
        """Stop the timers of blobs, because a write refers to them; return those that had one."""
        claimed = []
        for id in ids:
            timer = self._timers.pop(id, None)
            if timer is not None:
                timer.cancel()
                claimed.append(id)
        return claimed

    def discard(self, id: str) -> None:
        """Remove a blob that no write refers to."""
        timer = self._timers.pop(id, None)
        if timer is not None:
            timer.cancel()
            self.folder().discard(id)

    def discard_all(self) -> None:
        """Remove all blobs that no write refers to."""
        for id in tuple(self._timers):
            self.discard(id)

    def close(self) -> None:
        """Release the folder."""
        self._closed = True
        if self._blobs is not None:
            self._blobs.close()
        if self._temporary is not None:
            self._temporary.cleanup()
