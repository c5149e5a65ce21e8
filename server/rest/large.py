"""Large documents: representations rendered in worker processes, and sent from files.

A file is created once for all concurrent requests, and the last few are cached. A page shows only the first triples.
"""

from __future__ import annotations

import asyncio
import itertools
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import partial
from io import FileIO
from pathlib import Path
from typing import TypeVar

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import RdfFormat, Triple, parse
from pyoxigraph import serialize as pyoxigraph_serialize

from rosld.ontology.document import Document
from rosld.ontology.serialize import serialize
from rosld.server.rest.state import State, require_memory
from rosld.server.runtime.offload import Work, WorkerPool

_T = TypeVar("_T")

EXCERPT = 250
"""Number of triples of a large document that a page shows."""
MAX_BYTES = 512 * 1024 * 1024
"""Maximum number of bytes of cached files, in addition to the newest."""
MAX_FILES = 16


class Excerpt(Struct, frozen=True):
    """The first triples of a document, and the total number."""

    document: Document
    total: int


class LargeDocuments:
    """Files with representations of large documents. Belongs to one loop."""

    def __init__(self, workers: WorkerPool) -> None:
        self._workers = workers
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._numbers = itertools.count()
        self._files: OrderedDict[Hashable, tuple[Path, int]] = OrderedDict()
        self._pending: dict[Hashable, asyncio.Future[tuple[Path, int]]] = {}

    async def file(self, name: Hashable, state: State, media_type: str) -> tuple[FileIO, int]:
        """Return the opened representation of a state in a media type, and its size; `name` is the cache key.

        Raises CannotCarry, and the Problems of `WorkerPool.run`.
        """
        while True:
            path, size = await self._cached_file(name, state, media_type)
            try:
                return await asyncio.to_thread(FileIO, path), size
            except FileNotFoundError:  # removed in favour of others meanwhile
                continue

    async def _cached_file(self, name: Hashable, state: State, media_type: str) -> tuple[Path, int]:
        found = self._files.get(name)
        if found is not None:
            self._files.move_to_end(name)
            return found
        pending = self._pending.get(name)
        if pending is None:
            pending = self._pending[name] = asyncio.ensure_future(self._make(name, state, media_type))
            pending.add_done_callback(lambda _: self._pending.pop(name, None))
        return await asyncio.shield(pending)

    async def _make(self, name: Hashable, state: State, media_type: str) -> tuple[Path, int]:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="rosld-large-", ignore_cleanup_errors=True)
        path = Path(self._folder.name) / f"{next(self._numbers)}"
        try:
            size = await self._run(state, partial(write_document, state.describe, media_type, path))
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        self._files[name] = (path, size)
        self._evict()
        return path, size

    def _evict(self) -> None:
        """Remove the least recently used files beyond the limits; readers of open files are not affected."""
        files = self._files
        while len(files) > 1 and (len(files) > MAX_FILES or sum(size for _, size in files.values()) > MAX_BYTES):
            _, (path, _) = files.popitem(last=False)
            path.unlink(missing_ok=True)

    async def excerpt(self, state: State, limit: int = EXCERPT) -> Excerpt:
        """Return the first triples of a large state's document, preferring those about the document's own subject."""
        url, ntriples, total = await self._run(state, partial(first_triples, state.describe, limit))
        triples = tuple(quad.triple for quad in parse(ntriples, RdfFormat.N_TRIPLES))
        return Excerpt(Document(url, triples), total)

    async def _run(self, state: State, work: Work[_T]) -> _T:
        """Process a state's document in a worker, or in a thread if it cannot be pickled."""
        require_memory(state)
        return await (self._workers.run(work) if isinstance(state.describe, partial) else asyncio.to_thread(work))

    async def close(self) -> None:
        """Remove all files. Idempotent."""
        folder, self._folder = self._folder, None
        self._files.clear()
        if folder is not None:
            await asyncio.to_thread(folder.cleanup)


def excerpt_state(state: State, excerpt: Excerpt) -> State:
    """Return a state that contains only the excerpt."""
    return replace(state, describe=lambda: excerpt.document, weight=0, renderings={}, redactions={}, token=state.tag)


# --- in a worker process


def write_document(describe: Callable[[], Document], media_type: str, path: Path) -> int:
    """Write a document in the syntax of a media type to a file; return its size. Raises CannotCarry."""
    return path.write_bytes(serialize(describe(), media_type))


def first_triples(describe: Callable[[], Document], limit: int) -> tuple[str, bytes, int]:
    """Return the URL of a document, its first triples as N-Triples, and the total number of triples."""
    document = describe()
    triples: list[Triple] = list(itertools.islice(document.triples, limit))
    return document.url, pyoxigraph_serialize(triples, format=RdfFormat.N_TRIPLES) or b"", len(document.triples)
