"""A collection: all recordings in folders and of globs, catalogued in the background and opened when they are read."""

from __future__ import annotations

import asyncio
import logging
import sqlite3
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, ValuesView
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Concatenate, ParamSpec, TypeVar

from rosld.adapters.base import (
    Adapter,
    AdapterOptions,
    Capabilities,
    RecordedMessage,
    RecordedTopic,
    Recording,
    Sink,
    Subscription,
)
from rosld.adapters.catalogue import CannotCatalogue, Catalogue, Entry, Row
from rosld.adapters.model import (
    Encoding,
    Graph,
    Kind,
    NotFound,
    Operation,
    Ref,
    RosError,
    Sample,
    Schema,
    Topic,
    TypeRef,
    UnknownType,
    Unreachable,
    freeze,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.recording.adapter import open_bag, recording_capabilities, recording_name
from rosld.adapters.recording.bag import Bag
from rosld.adapters.recording.rosbag2 import is_one_recording
from rosld.adapters.recording.storage import OpenBudget, OpeningRefused
from rosld.adapters.recording.summary import PatientBudget, SummaryReader
from rosld.adapters.slots import Slot

log = logging.getLogger("rosld.recording")
P = ParamSpec("P")
T = TypeVar("T")
FILE = ".rosld.sqlite"
"""Name of the catalogue in the first folder of a collection."""
SUFFIXES = (".bag", ".bag.active", ".mcap", ".db3")
_COMPRESSIONS = ("", ".zst", ".zstd")
_FILES = tuple(f"{suffix}{compression}" for suffix in SUFFIXES for compression in _COMPRESSIONS)
_RESCAN = 5.0
"""Seconds between looks at the folders."""
_SETTLED_NS = 10_000_000_000
"""Age in ns of the last change of a file before it is read again: it may be being written."""
_FIRST_SCAN = 1.5
"""Seconds that the start waits for the first scan, which continues in the background."""
_BATCH = 0.5
"""Seconds of reading after which the entries are stored."""
_MAX_OPEN = 8
_MOST_KEPT = 5000
"""Maximum number of recordings in memory, of 1 to 2 KB each."""
_IDLE = 60.0
"""Seconds after the last use after which a recording is closed."""
_CACHE = 8 << 20
"""Bytes of recent chunks of each open recording."""
_INDEX_LIMIT = 512 << 20
"""Bytes of the index of a recording, at most 13 million messages."""
_MAX_SCHEMAS = 2000


def is_glob(source: str) -> bool:
    """Whether a source is a pattern of paths, not a path. A question mark begins the part of a recording."""
    return any(letter in source for letter in "*[") and not Path(source).expanduser().exists()


class _Open:
    """A recording in the pool: open once `bag` is set. `users` read from it now."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.bag: Bag | None = None
        self.users = 0
        self.used_at = time.monotonic()


class OpenRecordings:
    """The open recordings: those used last, and all that are being read. Any thread may read."""

    def __init__(self, options: AdapterOptions) -> None:
        self._folders = options.types
        self._limit = options.recording_index_limit or _INDEX_LIMIT
        self._lock = threading.Lock()
        self._open: OrderedDict[tuple[Path, str], _Open] = OrderedDict()

    @contextmanager
    def use(self, row: Row) -> Iterator[Bag]:
        """Yield a recording, opened if needed, which stays open meanwhile. Raises NotFound, Unreachable."""
        key = row.path, row.identity
        with self._lock:
            one = self._open.setdefault(key, _Open())
            self._open.move_to_end(key)
            one.users += 1
        self.close_unused(_MAX_OPEN)
        try:
            with one.lock:
                if one.bag is None:
                    one.bag = open_bag(row.path, self._folders, OpenBudget(self._limit), name=row.name)
                    one.bag.limit_cache(_CACHE)
            yield one.bag
        finally:
            with self._lock:
                one.users -= 1
                one.used_at = time.monotonic()

    def close_unused(self, most: int = 0, idle: float = 0) -> None:
        """Close the recordings without readers that were not used for `idle` seconds, until `most` are left."""
        horizon = time.monotonic() - idle
        with self._lock:
            unused = [key for key, one in self._open.items() if not one.users and one.used_at <= horizon]
            closed = [self._open.pop(key) for key in unused[: max(len(self._open) - most, 0)]]
        for one in closed:
            if one.bag is not None:
                one.bag.close()


def _reading(method: Callable[Concatenate[Bag, P], T]) -> Callable[Concatenate[CataloguedRecording, P], T]:
    """Return a method of the recording, opened for it."""

    def read(self: CataloguedRecording, /, *args: P.args, **kwargs: P.kwargs) -> T:
        with self._pool.use(self._row) as bag:
            return method(bag, *args, **kwargs)

    return read


class CataloguedRecording:
    """A recording as the catalogue describes it, whose file is opened by the first read of a message."""

    first = 0

    def __init__(self, row: Row, catalogue: Catalogue, pool: OpenRecordings) -> None:
        self._row = row
        self._catalogue = catalogue
        self._pool = pool
        self.name = row.name
        self.path = row.path
        self.format = row.format
        self.count = self.settled = row.count
        self.start_ns = row.start_ns
        self.end_ns = row.end_ns
        self.silent = row.silent
        self.identity = row.identity
        self.content = f"{row.identity}-{row.mtime_ns}"
        """Key of what is known of its content, the same when its file is moved."""
        self.encoding = Encoding.ROS1 if row.ros_version == 1 else Encoding.CDR

    @cached_property
    def topics(self) -> Mapping[str, RecordedTopic]:
        """The topics by name."""
        return {topic.name: topic for topic in self._catalogue.topics(self._row.id)}

    message = _reading(Bag.message)
    topic_of = _reading(Bag.topic_of)
    times_between = _reading(Bag.times_between)
    latest_at = _reading(Bag.latest_at)
    select = _reading(Bag.select)
    types_of = _reading(Bag.types_of)
    density = _reading(Bag.density)
    schema = _reading(Bag.schema)

    def messages(self) -> Iterator[RecordedMessage]:
        with self._pool.use(self._row) as bag:
            yield from bag.messages()

    def latched_before(self, time_ns: int, selects: Callable[[str], bool]) -> Iterable[tuple[str, Sample]]:
        with self._pool.use(self._row) as bag:
            return list(bag.latched_before(time_ns, selects))


class CataloguedRecordings(Mapping[str, Recording]):
    """The readable recordings of a collection by name, read from the catalogue."""

    def __init__(self, catalogue: Catalogue, pool: OpenRecordings) -> None:
        self._catalogue = catalogue
        self._pool = pool
        self._all: tuple[int, dict[str, Recording]] = (-1, {})
        """Revision of the catalogue, and its recordings: to read the topics of 1,000 takes 40 ms, as a query does."""

    def values(self) -> ValuesView[Recording]:
        """Return all recordings, which are kept until the catalogue changes, if they are not too many."""
        revision, found = self._all
        if revision != self._catalogue.revision:
            revision = self._catalogue.revision
            rows = (row for row in self._catalogue.rows() if row.is_readable and not row.is_own)
            found = {row.name: CataloguedRecording(row, self._catalogue, self._pool) for row in rows}
            if len(found) <= _MOST_KEPT:
                self._all = (revision, found)
        return found.values()

    def __getitem__(self, name: str) -> Recording:
        row = self._catalogue.find(name)
        if row is None or row.is_own or not row.is_readable:
            raise KeyError(name)
        return CataloguedRecording(row, self._catalogue, self._pool)

    def __iter__(self) -> Iterator[str]:
        return iter(self._catalogue.readable_names())

    def __len__(self) -> int:
        return len(self._catalogue.readable_names())


class CollectionAdapter(Adapter):
    """Many recordings as an `Adapter`: their topics and types are known, and nothing is live."""

    def __init__(self, sources: Sequence[str], options: AdapterOptions) -> None:
        self._sources = sources
        self._options = options
        self._reader = SummaryReader(options.types)
        self._pool = OpenRecordings(options)
        self._catalogue: Catalogue | None = None
        self._recordings: CataloguedRecordings | None = None
        self._schemas: dict[TypeRef, Schema] = {}
        self._graph = Graph(1)
        self._budget: OpenBudget | None = None
        self._closing = threading.Event()
        self._scanned = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities for reading only."""
        return recording_capabilities(Encoding.CDR)

    @property
    def graph(self) -> Graph:
        """The topics of all recordings, without nodes."""
        return self._graph

    @property
    def catalogue(self) -> Catalogue | None:
        """The catalogue, once open."""
        return self._catalogue

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """The readable recordings by name, once catalogued."""
        return {} if self._recordings is None else self._recordings

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Find the files and begin to catalogue them. Raises NotFound for a missing one, Unreachable."""
        if self._catalogue is not None:
            return
        await asyncio.to_thread(self._require_sources)
        try:
            self._catalogue = await asyncio.to_thread(Catalogue, self._catalogue_path())
        except CannotCatalogue as error:
            raise Unreachable(str(error)) from error
        self._recordings = CataloguedRecordings(self._catalogue, self._pool)
        if not self._catalogue.is_lasting:
            log.warning("%s cannot be written: the catalogue, tags and events are temporary", self._catalogue_path())
        loop = asyncio.get_running_loop()

        def announce() -> None:
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(self._update_graph, sink)

        self._thread = threading.Thread(target=self._follow, args=(announce,), name="rosld-collection", daemon=True)
        self._thread.start()
        await asyncio.to_thread(self._scanned.wait, min(_FIRST_SCAN, max(deadline - loop.time(), 0)))
        self._update_graph(sink)

    async def wait_for_recordings(self) -> None:
        """Wait until the first scan is complete."""
        await asyncio.to_thread(self._scanned.wait)

    async def close(self) -> None:
        """Stop cataloguing, and close all files. Idempotent."""
        self._closing.set()
        self._scanned.set()
        if self._budget is not None:
            self._budget.cancel()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 2.0)
        self._pool.close_unused()
        if self._catalogue is not None:
            self._catalogue.close()

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return `subscribe` for recorded topics, and nothing else."""
        is_recorded = ref.kind is Kind.TOPIC and ref.name in self._graph.topics
        return frozenset({Operation.SUBSCRIBE}) if is_recorded else frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type as a recording defines it, else as shipped. Raises UnknownType."""
        if ref not in self._schemas:
            if len(self._schemas) >= _MAX_SCHEMAS:
                self._schemas.clear()
            self._schemas[ref] = await asyncio.to_thread(self._find_schema, ref)
        return self._schemas[ref]

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types of the recorded topics."""
        found = [] if self._catalogue is None else self._catalogue.all_topics()
        return list(dict.fromkeys(topic.type for topic, _ in found if topic.type.name))

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Return a subscription without messages."""
        return Slot().subscribe(depth)

    def _find_schema(self, ref: TypeRef) -> Schema:
        recordings = self.recordings
        for name in self._catalogue.with_type(ref) if self._catalogue is not None else ():
            with suppress(RosError, KeyError):
                return recordings[name].schema(ref)
        for library in (TypeLibrary(ros_version=2, folders=self._options.types), TypeLibrary(ros_version=1)):
            with suppress(UnknownType):
                return library.find(ref)
        raise UnknownType(f"the type {ref.name} is in none of the recordings")

    def _update_graph(self, sink: Sink) -> None:
        """Read the topics from the catalogue; announce the graph if it has changed."""
        assert self._catalogue is not None
        if self._closing.is_set():
            return
        refs: dict[str, dict[str, TypeRef]] = {}
        unreadable: dict[str, list[str | None]] = {}
        for topic, _ in self._catalogue.all_topics():
            # of types with one name (of ROS 1 and 2) the most frequent one
            refs.setdefault(topic.name, {}).setdefault(topic.type.name, topic.type)
            unreadable.setdefault(topic.name, []).append(topic.unreadable)
        topics = {
            name: Topic(
                name,
                tuple(each for each in types.values() if each.name),
                unreadable=unreadable[name][0] if all(unreadable[name]) else None,
            )
            for name, types in refs.items()
        }
        if topics != dict(self._graph.topics):
            self._graph = Graph(self._graph.revision + 1, topics=freeze(topics))
            sink.graph_changed(self._graph)

    def _catalogue_path(self) -> Path | None:
        if self._options.catalogue is not None:
            return self._options.catalogue
        folders = (path for source in self._sources for path in (Path(source).expanduser(),))
        first = next((path for path in folders if path.is_dir()), None)
        if first is None:
            first = next(iter(self._find()), Path("x")).parent
        return first / FILE

    def _follow(self, announce: Callable[[], None]) -> None:
        """Scan the folders again and again, in a thread of its own."""
        while not self._closing.is_set():
            try:
                self._scan(announce)
            except OpeningRefused:
                return
            except (OSError, sqlite3.Error) as error:
                if not self._closing.is_set():
                    log.warning("the collection cannot be scanned: %s", error)
            self._scanned.set()
            self._pool.close_unused(idle=_IDLE)
            self._closing.wait(_RESCAN)

    def _scan(self, announce: Callable[[], None]) -> None:
        """Catalogue what is new or changed, and mark what has vanished."""
        assert self._catalogue is not None
        catalogue, found = self._catalogue, self._find()
        seen, young = catalogue.seen(), time.time_ns() - _SETTLED_NS
        before = catalogue.revision
        catalogue.keep_only(found.keys())
        has_new = not found.keys() <= seen.keys()  # perhaps a changed file of before, under another name
        changed = [
            path for path, (size, at) in found.items() if seen.get(path) != (size, at) and (has_new or at < young)
        ]
        names = self._names(found) if changed else {}
        batch: list[Entry] = []
        stored_at = time.monotonic()
        for number, path in enumerate(changed, 1):
            self._budget = PatientBudget(self._options.recording_index_limit or _INDEX_LIMIT)
            if self._closing.is_set():
                return
            try:
                entry = self._reader.read(path, *found[path], self._budget)
            except OSError:  # it has vanished meanwhile
                continue
            if entry.problem is not None:
                log.warning("%s: %s", path, entry.problem)
            batch.append(entry)
            if number == len(changed) or time.monotonic() > stored_at + _BATCH:
                catalogue.put(batch, names)
                batch, stored_at = [], time.monotonic()
                announce()
        catalogue.put(batch, names)
        if catalogue.revision != before:
            announce()

    def _names(self, found: Mapping[Path, object]) -> dict[Path, tuple[str, ...]]:
        """Return the names to choose from: that of the file if it is the only one, else that of its relative path."""
        stems = {path: recording_name(path) for path in found}
        counts = Counter(stems.values())
        roots = [Path(source).expanduser().absolute() for source in self._sources]
        names: dict[Path, tuple[str, ...]] = {}
        for path, stem in stems.items():
            root = next((each for each in roots if each in path.parents), path.parent)
            folder = "-".join(path.relative_to(root).parts[:-1])
            longer = [f"{folder}-{each}" if folder else each for each in (stem, path.name)]
            names[path] = (*((stem,) if counts[stem] == 1 else ()), *longer)
        return names

    def _find(self) -> dict[Path, tuple[int, int]]:
        """Return size and time of the last change (ns) of each recording."""
        found: dict[Path, tuple[int, int]] = {}
        visited: set[tuple[int, int]] = set()
        for source in self._sources:
            for path in _paths(source):
                found.update(_below(path, visited, is_named=not is_glob(source)))
        return found

    def _require_sources(self) -> None:
        """Raise NotFound for a source that does not exist."""
        for source in self._sources:
            if not any(path.exists() for path in _paths(source)):
                raise NotFound(f"there is no recording {source!r}")


def _paths(source: str) -> list[Path]:
    """Return the path of a source, or those that match a glob."""
    path = Path(source).expanduser()
    if not is_glob(source):
        return [path.absolute()]
    found = Path(path.anchor).glob(str(path.relative_to(path.anchor)))
    return sorted(each.absolute() for each in found if not each.name.startswith("."))


def _below(
    path: Path, visited: set[tuple[int, int]], *, is_named: bool = False
) -> Iterator[tuple[Path, tuple[int, int]]]:
    """Yield the recordings at and below a path. Hidden files are left out, and any file that is not named one."""
    try:
        status = path.stat()
        str(path).encode()
        if not path.is_dir():
            if is_named or path.name.endswith(_FILES):
                yield path, (status.st_size, status.st_mtime_ns)
            return
        if (status.st_dev, status.st_ino) in visited:  # links may lead in circles
            return
        visited.add((status.st_dev, status.st_ino))
        if is_one_recording(path):
            parts = [each.stat() for each in path.iterdir() if each.is_file()]
            yield path, (sum(each.st_size for each in parts), max(each.st_mtime_ns for each in parts))
            return
        inner = sorted(each for each in path.iterdir() if not each.name.startswith("."))
    except (OSError, UnicodeEncodeError) as error:
        log.warning("%s is left out: %s", str(path).encode("utf-8", "replace").decode(), error)
        return
    for each in inner:
        yield from _below(each, visited)
