"""Blobs that were received and that no write refers to yet."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import AsyncIterator, Iterable
from pathlib import Path

from rosld.server.storage.blobs import Blobs
from rosld.server.storage.record import Blob, StorageError


class ReceivedBlobs:
    """Receives blobs and discards those that no write has referred to after `keep_seconds`. Belongs to one loop.

    They are in the folder that `use` was given, or in a private one, made when it is first needed.
    """

    def __init__(self, keep_seconds: float) -> None:
        self._keep_seconds = keep_seconds
        self._blobs: Blobs | None = None
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._closed = False

    def use(self, blobs: Blobs) -> None:
        """Keep the blobs in this folder."""
        self._blobs = blobs

    def folder(self) -> Blobs:
        """The folder of blobs. Raises StorageError after `close`."""
        if self._closed:
            raise StorageError("The records are closed.")
        if self._blobs is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="rosld-", ignore_cleanup_errors=True)
            self._blobs = Blobs(Path(self._temporary.name) / "blobs", durable=False)
        return self._blobs

    async def receive(self, chunks: AsyncIterator[bytes], media_type: str, limit: int) -> Blob:
        """Keep what comes as a blob for a while. Raises ValueError beyond `limit` bytes, StorageError."""
        id, size = await self.folder().receive(chunks, limit)
        self.keep((id,))
        return Blob(id, size, media_type)

    def keep(self, ids: Iterable[str]) -> None:
        """Keep blobs for a while, until a write refers to them."""
        loop = asyncio.get_running_loop()
        self._timers.update({id: loop.call_later(self._keep_seconds, self.discard, id) for id in ids})

    def claim(self, ids: Iterable[str]) -> list[str]:
        """Discard these no more, for a write refers to them; which of them were waiting for that."""
        taken = []
        for id in ids:
            timer = self._timers.pop(id, None)
            if timer is not None:
                timer.cancel()
                taken.append(id)
        return taken

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
        """Let go of the folder."""
        self._closed = True
        if self._blobs is not None:
            self._blobs.close()
        if self._temporary is not None:
            self._temporary.cleanup()
