"""Recordings that clients make or upload: files in a folder, each opened by the adapter for recordings."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import tempfile
import time
from collections import Counter
from collections.abc import (
    AsyncIterator,
    Awaitable,
    Callable,
    Hashable,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
    ValuesView,
)
from fnmatch import fnmatchcase
from functools import cached_property, partial
from io import FileIO
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from rosld.adapters.base import Adapter, AdapterOptions, NullSink, Recording
from rosld.adapters.catalogue import NAME as CATALOGUE
from rosld.adapters.catalogue import Catalogue, Entry, Event, Row
from rosld.adapters.model import Encoding, RosError, TypeRef
from rosld.adapters.registry import adapter_for
from rosld.server.auth.rules import Agent
from rosld.server.history.armed_recordings import ArmedRecording, ArmedRecordings, MayRecord, Occurrences
from rosld.server.history.bag_export import ExportFormat
from rosld.server.history.cut import Span, write_cut
from rosld.server.history.history import NAME as HISTORY
from rosld.server.history.history import History
from rosld.server.history.history_writer import require_room
from rosld.server.history.indexer import Indexer
from rosld.server.history.recording_orders import (
    KILLED,
    STOPPED,
    Interruptions,
    RecordingNotes,
    RecordingOrder,
    RecordingRefused,
)
from rosld.server.history.recording_writer import RecordingWriter, active_recordings, complete_active
from rosld.server.history.topic_feed import LiveRecorder
from rosld.server.history.uploads import (
    DRAFT,
    SUFFIXES,
    UploadRefused,
    check_recording,
    check_seconds,
    receive_file,
    remove_drafts,
)
from rosld.server.history.uploads import NAME as FILE_NAME
from rosld.server.receipts.audit import record_step
from rosld.server.runtime.dry_run import end_dry_run
from rosld.server.runtime.offload import WorkerPool
from rosld.server.runtime.tasks import loop_time
from rosld.server.settings import Settings

log = logging.getLogger("rosld.history")
FOLDER = "bags"
SUFFIX = ".mcap"
_OPEN_SECONDS = 60.0
_REVISION_SECONDS = 5.0
"""Maximum age in seconds of query results about a recording in progress."""
_LONGEST_STEP = 500
"""Maximum length of the step of a receipt that describes a recording."""
_MAX_RUNNING = 16
"""Maximum number of recordings in progress."""
_MAX_CHECKED = 4
"""Maximum number of concurrent checks: a slow one must not block the others."""
_CHECK_BYTES = 3 * 1024 * 1024 * 1024
"""Address space of a checking process in bytes; the libraries use a third of it."""


class _Readable(Mapping[str, Recording]):
    """Recordings of several owners by name; an earlier owner of a name wins."""

    def __init__(self, *owners: Mapping[str, Recording]) -> None:
        self._owners = owners

    def __getitem__(self, name: str) -> Recording:
        for owner in self._owners:
            found = owner.get(name)
            if found is not None:
                return found
        raise KeyError(name)

    def values(self) -> ValuesView[Recording]:
        """Return all recordings, faster than one by one."""
        return {each.name: each for owner in reversed(self._owners) for each in owner.values()}.values()

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys(chain.from_iterable(reversed(self._owners))))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class UnreadableFile(NamedTuple):
    """A recording's file that cannot be opened, and the reason."""

    path: Path
    problem: str


class RunningRecording:
    """A recording in progress. `dropped_before` counts the messages dropped before its start, by topic."""

    def __init__(
        self, name: str, order: RecordingOrder, writer: RecordingWriter, dropped_before: Mapping[str, int]
    ) -> None:
        self.name = name
        self.order = order
        self.writer = writer
        self.dropped_before = dropped_before
        self.timer: asyncio.Handle | None = None
        self.ends_at: float | None = None
        """Time of its end on the loop's clock, or None.

        Stored because uvloop's handle for a delay of 0 lacks `when`.
        """
        self.ending: asyncio.Task[None] | None = None


class Recordings:
    """The recordings of a server, except those of its source, by name.

    Without a data folder they are in a temporary one, which is deleted at the end.
    """

    def __init__(
        self,
        adapter: Adapter,
        settings: Settings,
        learn: Callable[[TypeRef], Awaitable[object]],
        definition_of: Callable[[TypeRef], str],
    ) -> None:
        """Create the recordings. `learn` loads a type, `definition_of` returns its text, if it is known.

        Raises ValueError if a history is enabled for a source that has none.
        """
        self._changes = 0
        self._adapter = adapter
        self.live = LiveRecorder(adapter, learn)
        self.history = History(adapter, self.live, settings, definition_of)
        self._definition_of = definition_of
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.running: dict[str, RunningRecording] = {}
        """The recordings in progress, by name."""
        notes = RecordingNotes(None if settings.data is None else settings.data / FOLDER)
        self._armed = ArmedRecordings(notes, self.begin, self.can_be_named)
        self.interruptions = Interruptions(notes)
        self._opened: dict[str, tuple[Adapter, Recording]] = {}
        self.unreadable: dict[str, UnreadableFile] = {}
        """The files that cannot be opened, by recording name."""
        self._receiving: set[str] = set()
        self._checkers = WorkerPool(_MAX_CHECKED, memory=_CHECK_BYTES, subject="recording")
        self._settings = settings

    @cached_property
    def indexer(self) -> Indexer:
        """The statistics of the messages of recordings, in the database of the catalogue."""
        return Indexer(self._adapter, self.catalogue, lambda: self.finished.values(), self._settings)

    @property
    def _folder(self) -> Path | None:
        """Folder of recordings, or None before the first recording."""
        if self._settings.data is not None:
            return self._settings.data / FOLDER
        return None if self._temporary is None else Path(self._temporary.name)

    @property
    def revision(self) -> Hashable:
        """Value that changes with the set of recordings, and every few seconds while something is recorded."""
        is_recording = self.history.is_enabled or bool(self.running)
        moment = int(time.monotonic() / _REVISION_SECONDS) if is_recording else 0
        return self._changes, self._armed.revision, moment, self.catalogue.revision

    @property
    def finished(self) -> Mapping[str, Recording]:
        """The finished recordings by name."""
        return {name: recording for name, (_, recording) in self._opened.items()}

    @property
    def readable(self) -> Mapping[str, Recording]:
        """All readable recordings by name: the history, those of clients, those of the source."""
        own = {HISTORY: self.history.recording} if self.history.is_enabled else {}
        return _Readable(self._adapter.recordings, self.finished, own)

    @property
    def few(self) -> Mapping[str, Recording]:
        """The readable recordings without those of a source of many."""
        own = {HISTORY: self.history.recording} if self.history.is_enabled else {}
        return {**own, **self.finished, **(self._adapter.recordings if self._adapter.catalogue is None else {})}

    @cached_property
    def catalogue(self) -> Catalogue:
        """The catalogue of finished recordings: that of the source, if it has one, with those of the server."""
        data = self._settings.data
        return self._adapter.catalogue or Catalogue(None if data is None else data / CATALOGUE)

    def find(self, name: str) -> Recording | None:
        """Return the readable recording of a name, or None (thread-safe)."""
        return self.readable.get(name)

    @property
    def armed(self) -> Mapping[str, ArmedRecording]:
        """The recordings that wait for triggers, by name."""
        return self._armed.all

    async def start(self) -> None:
        """Start the history, and open the stored recordings. Unreadable ones are logged and reserve their names."""
        await self.history.start()
        if self._adapter.catalogue is None:
            self.catalogue.leave_out_source()
            for recording in self._adapter.recordings.values():
                self._add_to_catalogue(recording)
        if self._folder is not None and self._folder.is_dir():
            await self._open_stored(self._folder)
        self.catalogue.keep_only([each.path.absolute() for each in self.few.values()], own=True)
        self._armed.load()
        self.indexer.start()

    async def _open_stored(self, folder: Path) -> None:
        await asyncio.to_thread(remove_drafts, folder)
        for name in active_recordings(folder):
            await self.interruptions.add(name, KILLED)
        await asyncio.to_thread(complete_active, folder)
        for path in await asyncio.to_thread(lambda: sorted(folder.iterdir())):
            if path.suffix in SUFFIXES.values():
                await self._open_or_keep(path.stem, path)
        self.interruptions.load({*self._opened, *self.unreadable})

    def resume(self, occurrences: Occurrences) -> None:
        """Wait for the triggers of the orders stored before the restart."""
        self._armed.resume(occurrences)

    def begin(self, order: RecordingOrder, may_record: MayRecord) -> RunningRecording:
        """Start a recording of the topics that may be recorded. Raises RecordingRefused, and OSError for the disk."""
        if len(self.running) >= _MAX_RUNNING:
            raise RecordingRefused(f"{_MAX_RUNNING} recordings are already running: end one first", is_conflict=True)
        name = self._free_name(order.name)
        record_step(f"record {', '.join(order.topics)} as {name}"[:_LONGEST_STEP])
        end_dry_run()
        encoding = self._adapter.capabilities.encoding
        since = self._since(order.before)
        writer = RecordingWriter(self._path(name, SUFFIX), encoding, self._definition_of, require_room, since)
        self.running[name] = recording = RunningRecording(name, order, writer, self.live.dropped())

        def selects(topic: str) -> bool:
            return any(fnmatchcase(topic, glob) for glob in order.topics) and may_record(topic)

        copy = (lambda: self.history.copy_to(writer, selects, since)) if order.before > 0 else None
        self.live.add(writer, selects, copy)
        if order.duration is not None:
            recording.ends_at = loop_time() + order.duration
            recording.timer = asyncio.get_running_loop().call_later(order.duration, self._end_soon, recording)
        self._changes += 1
        return recording

    async def arm(self, order: RecordingOrder, agent: Agent, occurrences: Occurrences) -> ArmedRecording:
        """Wait for the trigger of an order before recording. Raises RecordingRefused, OSError."""
        name, trigger = self._free_name(order.name), order.trigger
        if trigger is not None and trigger.limit > 1 and FILE_NAME.fullmatch(f"{name}-{trigger.limit}") is None:
            raise RecordingRefused(f"{name[:100]!r} is too long a name for repeated recordings: use at most 96 letters")
        return await self._armed.arm(name, order, agent, occurrences)

    async def disarm(self, name: str) -> bool:
        """Disarm a recording; return whether it existed. Recordings already started continue. Raises OSError."""
        return await self._armed.disarm(name)

    def can_be_named(self, name: str) -> bool:
        """Whether a name is valid and unused."""
        return FILE_NAME.fullmatch(name) is not None and not self._is_used(name)

    async def end(self, name: str) -> None:
        """End a recording, which can then be read. Does nothing if it does not exist."""
        recording = self.running.get(name)
        if recording is not None:
            record_step(f"end the recording {name}")
            end_dry_run()
            await asyncio.shield(self._end_soon(recording))

    async def receive(self, name: str, chunks: AsyncIterator[bytes]) -> None:
        """Store an uploaded file: a ROS 1 bag, MCAP, or a ROS 2 database. Raises RecordingRefused, OSError."""
        self._require_free(name)
        self._receiving.add(name)
        try:
            folder = self._path(name, SUFFIX).parent
            draft, suffix = await receive_file(folder, name, chunks, self._settings.upload_limit)
            try:
                # opened again under its name, without a limit
                await self._check(name, draft)
                record_step(f"keep the recording {name}")
                end_dry_run()
                path = draft.replace(self._path(name, suffix))
            finally:
                draft.unlink(missing_ok=True)
            await self._open(name, path)
        except UploadRefused as error:
            raise RecordingRefused(f"{name} was rejected: {error}", is_too_large=error.is_too_large) from error
        finally:
            self._receiving.discard(name)

    async def cut(
        self, recording: Recording, name: str | None, selects: Callable[[str], bool], spans: Sequence[Span]
    ) -> Sequence[str]:
        """Write each span as a recording of its own, and return their names: NAME-1, NAME-2 and so on for several.

        Raises RecordingRefused, CutRefused, OSError, and RosError if the recording cannot be read.
        """
        base = self._free_name(name)
        names = [base] if len(spans) == 1 else [f"{base}-{number}" for number in range(1, len(spans) + 1)]
        for each in names:
            self._require_free(each)
        if len(self._receiving) >= _MAX_RUNNING:
            raise RecordingRefused("Too many recordings are being stored: try again later", is_conflict=True)
        record_step(f"cut {recording.name} as {', '.join(names)}"[:_LONGEST_STEP])
        end_dry_run()
        encoding, stored = recording.encoding, list[str]()
        self._receiving.update(names)
        try:
            for each, span in zip(names, spans, strict=True):
                path = self._path(each, SUFFIX)
                await asyncio.to_thread(write_cut, recording, path, encoding, selects, span)
                await self._open(each, path)
                stored.append(each)
        except BaseException:
            for each in stored:
                await self.delete(each)
            raise
        finally:
            self._receiving.difference_update(names)
        return names

    async def delete(self, name: str) -> bool:
        """End and delete a recording, or disarm it; return whether it existed."""
        record_step(f"delete the recording {name}")
        end_dry_run()
        if await self.disarm(name):
            return True
        await self.end(name)
        file = self.unreadable.pop(name, None)
        if file is not None:
            self._changes += 1
            await asyncio.to_thread(file.path.unlink, True)
            await self.interruptions.remove(name)
            return True
        found = self._opened.pop(name, None)
        if found is None:
            return False
        self._changes += 1
        await found[0].close()
        self.history.digests.forget(found[1].path)
        self.catalogue.forget(found[1].path)
        await asyncio.to_thread(found[1].path.unlink, True)
        await self.interruptions.remove(name)
        return True

    async def annotate(self, row: Row, tags: Iterable[str], events: Iterable[Event]) -> None:
        """Replace the tags and the events of a recording. Raises sqlite3.Error."""
        record_step(f"annotate the recording {row.name}")
        end_dry_run()
        await asyncio.to_thread(self.catalogue.annotate, row.id, tags, events)

    async def forget(self, row: Row) -> None:
        """Remove a missing recording from the catalogue."""
        record_step(f"forget the recording {row.name}")
        end_dry_run()
        await asyncio.to_thread(self.catalogue.forget, row.path)

    async def export(self, recording: Recording, format: ExportFormat) -> FileIO:
        """Return an open file with a recording in a format. Raises CannotExport, OSError, RosError, and Problems."""
        return await self.history.exports.make(recording, format, self._path(f".{secrets.token_hex(8)}", DRAFT))

    def dropped(self, recording: RunningRecording) -> Mapping[str, int]:
        """Return the numbers of messages lost since a recording began, by topic."""
        return self.live.dropped() - Counter(recording.dropped_before)

    def silent(self, recording: RunningRecording) -> Sequence[str]:
        """Return the topics and globs that have no message yet in a recording in progress."""
        return self.live.silent(recording.writer, recording.order.topics, recording.writer.counts)

    async def stop(self) -> None:
        """End all recordings in progress, and close the files."""
        await self._armed.stop()
        await self._checkers.close()
        await self.history.exports.close()
        for name, recording in list(self.running.items()):
            if recording.ending is None:
                await self.interruptions.add(name, STOPPED)
            await self.end(name)
        await self.live.stop()
        self.history.close()
        if "indexer" in vars(self):
            await self.indexer.stop()
        for adapter, _ in self._opened.values():
            await adapter.close()
        if "catalogue" in vars(self) and self.catalogue is not self._adapter.catalogue:
            self.catalogue.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def _since(self, before: float) -> int:
        """Return the start of a recording that includes the last `before` seconds, limited to those in the history."""
        now = time.time_ns()
        oldest = self.history.recording.start_ns if self.history.is_enabled else 0
        return min(max(now - int(before * 1e9), oldest or now), now)

    def _end_soon(self, recording: RunningRecording) -> asyncio.Task[None]:
        """Start to end a recording, once; return the task."""
        if recording.timer is not None:
            recording.timer.cancel()
        if recording.ending is None:
            recording.ending = asyncio.get_running_loop().create_task(self._end(recording))
        return recording.ending

    async def _end(self, recording: RunningRecording) -> None:
        recording.writer.silent = self.silent(recording)
        await self.live.remove(recording.writer)
        if recording.writer.problem is not None:
            await self.interruptions.add(recording.name, recording.writer.problem)
        if recording.writer.path.exists():
            await self._open_or_keep(recording.name, recording.writer.path)
        del self.running[recording.name]
        self._changes += 1

    async def _open_or_keep(self, name: str, path: Path) -> None:
        """Open a file; if that fails, or another file has its name, add it to the unreadable files."""
        try:
            if name in self._opened:
                raise RecordingRefused(
                    f"{path.name} is not opened: its name is already used by {self._opened[name][1].path.name}"
                )
            await self._open(name, path)
        except RecordingRefused as error:
            log.warning("%s", error)
            if name not in self._opened:
                self.unreadable[name] = UnreadableFile(path, str(error))

    async def _open(self, name: str, path: Path) -> None:
        adapter, recording = await self._opened_adapter(name, path)
        self._opened[name] = adapter, recording
        self._add_to_catalogue(recording)
        self.unreadable.pop(name, None)
        self._changes += 1

    def _add_to_catalogue(self, recording: Recording) -> None:
        path = recording.path.absolute()
        status = path.stat()
        entry = Entry(
            *(f"{recording.identity}-{status.st_size}", path, status.st_size, status.st_mtime_ns),
            *(recording.format, 1 if recording.encoding is Encoding.ROS1 else 2, recording.start_ns, recording.end_ns),
            *(recording.count, tuple(recording.silent), tuple(recording.topics.values())),
            own=True,
        )
        self.catalogue.put([entry], {path: (recording.name,)})

    async def _check(self, name: str, path: Path) -> None:
        """Check in another process that a file can be opened. Raises RecordingRefused, and as `WorkerPool.run`."""
        work = partial(check_recording, path, self._settings.upload_index_limit)
        try:
            await self._checkers.run(work, check_seconds(path))
        except RosError as error:
            raise _not_opened(name, path, error) from error

    async def _opened_adapter(self, name: str, path: Path) -> tuple[Adapter, Recording]:
        adapter = adapter_for(f"recording:{path}", AdapterOptions())
        deadline = asyncio.get_running_loop().time() + _OPEN_SECONDS
        try:
            await adapter.open(NullSink(), deadline=deadline)
        except RosError as error:
            with contextlib.suppress(RosError):
                await adapter.close()
            raise _not_opened(name, path, error) from error
        (recording,) = adapter.recordings.values()
        return adapter, recording

    def _free_name(self, requested: str | None) -> str:
        if requested is not None:
            self._require_free(requested)
            return requested
        name = base = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        number = 1
        while self._is_used(name):
            number += 1
            name = f"{base}-{number}"
        return name

    def _require_free(self, name: str) -> None:
        if FILE_NAME.fullmatch(name) is None:
            raise RecordingRefused(
                f"{name[:100]!r} is not a valid recording name: use at most 100 letters, digits, dots, dashes and "
                "underscores"
            )
        if name in self.unreadable:
            file = self.unreadable[name]
            raise RecordingRefused(
                f"The file {file.path.name} already exists and cannot be opened: DELETE it, or choose another name",
                is_conflict=True,
            )
        if self._is_used(name):
            can_be_deleted = name != HISTORY and name not in self._adapter.recordings
            way = "DELETE it, or choose another name" if can_be_deleted else "choose another name"
            raise RecordingRefused(f"The recording {name} already exists: {way}", is_conflict=True)

    def _is_used(self, name: str) -> bool:
        owners = (
            *(self.running, self.armed, self._opened, self.unreadable, self._receiving),
            self._adapter.recordings,
        )
        return name == HISTORY or any(name in each for each in owners)

    def _path(self, name: str, suffix: str) -> Path:
        if self._folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="rosld-bags-", ignore_cleanup_errors=True)
        folder = self._folder
        assert folder is not None, "it exists now"
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{name}{suffix}"


def _not_opened(name: str, path: Path, error: RosError) -> RecordingRefused:
    words = error.sentence.replace(repr(str(path)), "it")
    return RecordingRefused(f"{name} is not opened: {words}")
