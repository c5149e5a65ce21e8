"""SHA-256 digests of recordings, which do not change: each is computed once, in a thread of its own."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import threading
from collections.abc import Callable
from pathlib import Path

from rosld.adapters.base import Watch
from rosld.server.runtime.tasks import Signal

_CHUNK = 1024 * 1024
_DATA = frozenset({".bag", ".db3", ".mcap"})
_log = logging.getLogger("rosld")


class FileDigests:
    """The digests of recordings, to be used on the server's loop."""

    def __init__(self) -> None:
        self.revision = 0
        """Another one whenever another digest is known."""
        self._known: dict[Path, str | None] = {}
        self._changes = Signal()

    def known(self, path: Path) -> str | None:
        """The digest of a recording's file in hexadecimal, if it is known."""
        return self._known.get(path)

    def get(self, path: Path) -> str | None:
        """The same; who asks first has it computed. It stays None where there are several files."""
        if path not in self._known:
            self._known[path] = None
            loop = asyncio.get_running_loop()
            # A daemon: a server that ends waits for no file, however large.
            threading.Thread(target=self._compute, args=(path, loop), name="digest", daemon=True).start()
        return self._known[path]

    def forget(self, path: Path) -> None:
        """Forget the digest of a file that is gone: another one may have its name."""
        self._known.pop(path, None)

    def watch(self, path: Path, wake: Callable[[], None]) -> Watch:
        """Call `wake` once the digest of a recording is known."""
        return self._changes.watch(wake, lambda about: about == str(path))

    def _compute(self, path: Path, loop: asyncio.AbstractEventLoop) -> None:
        try:
            found = _digest(path)
        except OSError as error:
            _log.warning("The checksum of %s cannot be computed: %s", path, error)
            return
        if found is not None:
            with contextlib.suppress(RuntimeError):  # the loop has been closed
                loop.call_soon_threadsafe(self._found, path, found)

    def _found(self, path: Path, digest: str) -> None:
        self._known[path] = digest
        self.revision += 1
        self._changes.emit(str(path))


def _digest(path: Path) -> str | None:
    """The digest of the one file that has the messages; None where there are several. Raises OSError."""
    files = [path] if path.is_file() else [each for each in path.iterdir() if each.suffix in _DATA]
    if len(files) != 1:
        return None
    digest = hashlib.sha256()
    with files[0].open("rb") as file:
        while chunk := file.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()
