"""The indexer, which makes the statistics of recordings while a server has nothing else to do."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable
from functools import partial

from rosld.adapters.base import Adapter, AdapterOptions, Recording
from rosld.adapters.catalogue import Catalogue
from rosld.adapters.model import RosError
from rosld.server.history.statistics import Statistics, index_file
from rosld.server.http.problem import Problem
from rosld.server.runtime.offload import WorkerPool
from rosld.server.runtime.tasks import Background
from rosld.server.settings import Settings

log = logging.getLogger("rosld.history")
_PAUSE = 10.0
"""Seconds before the first look, and between looks for recordings without statistics."""
_SECONDS = 3600.0
_BYTES = 3 * 1024 * 1024 * 1024
"""Address space of the process in bytes."""


class Indexer(Background):
    """Maker of statistics in another process, for a lasting catalogue. Belongs to the loop."""

    def __init__(
        self, adapter: Adapter, catalogue: Catalogue, finished: Callable[[], Iterable[Recording]], settings: Settings
    ) -> None:
        """`finished` returns the recordings besides those of a source of many."""
        self.statistics = Statistics(catalogue.path)
        self._adapter = adapter
        self._catalogue = catalogue
        self._finished = finished
        self._options = AdapterOptions(types=settings.types)
        self._failed: set[str] = set()

    def start(self) -> None:
        """Begin, unless statistics would be lost at the end."""
        if self._catalogue.path is not None:
            super().start()

    async def stop(self) -> None:
        """Stop, and close the database."""
        await super().stop()
        self.statistics.close()

    async def _run(self) -> None:
        pool = WorkerPool(1, memory=_BYTES, subject="recording")
        revision = -1
        try:
            while True:
                await asyncio.sleep(_PAUSE)
                await self._adapter.wait_for_recordings()
                if revision != self._catalogue.revision:
                    revision = self._catalogue.revision
                    of_source = () if self._adapter.catalogue is None else self._adapter.recordings.values()
                    for recording in (*self._finished(), *of_source):
                        await self._index(recording, pool)
        finally:
            await pool.close()

    async def _index(self, recording: Recording, pool: WorkerPool) -> None:
        key = await asyncio.to_thread(lambda: recording.content)
        missing = [] if key is None else self.statistics.missing(key, recording.topics)
        if key is None or key in self._failed or not missing:
            return
        try:
            found = await pool.run(partial(index_file, recording.path, self._options, missing), _SECONDS)
        except (RosError, Problem, OSError, ValueError) as error:
            log.info("%s has no statistics: %s", recording.name, error)
            self._failed.add(key)
            return
        for topic, each in found.items():
            await asyncio.to_thread(self.statistics.keep, key, topic, each)
