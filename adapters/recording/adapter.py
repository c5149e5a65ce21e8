"""A recording as a ROS system: its topics play as recorded, and nothing can be written.

The format of a file is determined by its first bytes, not by its name.
"""

from __future__ import annotations

import asyncio
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType

from msgspec.structs import replace

from rosld.adapters.base import Adapter, AdapterOptions, Capabilities, Recording, Sink, Subscription
from rosld.adapters.model import (
    Encoding,
    Endpoint,
    Graph,
    Kind,
    Node,
    NotFound,
    Operation,
    Ref,
    Sample,
    Schema,
    Topic,
    TypeRef,
    UnknownType,
    Unreachable,
    Unreadable,
    freeze,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.mcap import MAGIC
from rosld.adapters.recording import mcap, rosbag1
from rosld.adapters.recording.bag import Bag, log
from rosld.adapters.recording.byte_source import STEP, ZSTD_MAGIC, inflate_file
from rosld.adapters.recording.part import WHOLE, Part
from rosld.adapters.recording.player import Playback, Position, TopicPlayer
from rosld.adapters.recording.rosbag2 import SQLITE_MAGIC, Rosbag2, Sqlite
from rosld.adapters.recording.storage import Damaged, OpenBudget, OpeningRefused, Storage


def open_storage(path: Path, budget: OpenBudget | None = None, *, only_totals: bool = False) -> Storage:
    """Return the recording at `path`, perhaps for its totals only.

    Raises NotFound, or Unreadable with a sentence about the defect.
    """
    opener = partial(open_file, only_totals=only_totals)
    budget = OpenBudget() if budget is None else budget
    if not path.exists():
        raise NotFound(f"there is no recording {str(path)!r}; rosld --help names the sources")
    try:
        return Rosbag2(path, opener, budget, only_totals=only_totals) if path.is_dir() else opener(path, budget)
    except (Damaged, OpeningRefused) as damage:
        raise Unreadable(f"{str(path)!r} cannot be read as a recording: {damage}") from damage
    except OSError as error:
        raise Unreadable(f"{str(path)!r} cannot be opened: {error.strerror or error}") from error


def open_file(path: Path, budget: OpenBudget, *, only_totals: bool = False, is_inflated: bool = False) -> Storage:
    """Return the recording in one file, perhaps compressed. Raises Damaged, OpeningRefused and OSError."""
    budget.allow(path.stat().st_size)
    with path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise Damaged("the file is empty")
    if head.startswith(rosbag1.MAGIC):
        return rosbag1.Rosbag1(path, budget, only_totals=only_totals)
    if head.startswith(MAGIC):
        return mcap.Mcap(path, budget, only_totals=only_totals)
    if head.startswith(SQLITE_MAGIC):
        return Sqlite(path, budget, only_totals=only_totals)
    if head.startswith(ZSTD_MAGIC) and not is_inflated:
        with tempfile.TemporaryDirectory(prefix="rosld-") as folder:  # an open file outlives its name
            plain = Path(folder) / "plain"
            inflate_file(path, plain, lambda _: _require_room(plain.parent, budget))
            return open_file(plain, budget, only_totals=only_totals, is_inflated=True)
    raise Damaged("it is not a ROS 1 bag, an MCAP file or a ROS 2 database")


def _require_room(folder: Path, budget: OpenBudget) -> None:
    """Raise Damaged if decompression would fill the disk with the temporary files."""
    budget.work(STEP)
    if shutil.disk_usage(folder).free < _RESERVE:
        raise Damaged(
            f"decompressed, it does not fit in {tempfile.gettempdir()}: set the environment variable TMPDIR to a "
            "folder on a larger disk"
        )


def recording_name(path: Path) -> str:
    """Return the name of a recording: that of its folder, or of its file without suffixes (`x` for `x.bag.active`)."""
    resolved = path.resolve()
    name = resolved.name if resolved.is_dir() else resolved.name.removesuffix(".active")
    stem = name if resolved.is_dir() else Path(name.removesuffix(".zst").removesuffix(".zstd")).stem
    return stem or "recording"


_RESERVE = 256 << 20
"""Free bytes reserved on the disk with temporary files."""
UNFORESEEN = (ArithmeticError, AssertionError, LookupError, MemoryError, RecursionError, TypeError, ValueError)
"""Errors that reading a file may raise: it is untrusted, and may be malformed in unforeseen ways."""


def open_bag(
    path: Path, folders: Sequence[Path], budget: OpenBudget, part: Part = WHOLE, name: str | None = None
) -> Bag:
    """Return part of the recording at a path. Raises NotFound, and Unreadable with the defect."""
    try:
        storage = open_storage(path, budget)
        library = TypeLibrary(ros_version=storage.ros_version, folders=folders)
        try:
            return Bag(name or recording_name(path), path, storage, library, part, budget)
        except BaseException as error:
            storage.close()
            if not isinstance(error, Damaged | OpeningRefused):
                raise
            raise Unreadable(f"{str(path)!r} cannot be played: {error}") from error
    except UNFORESEEN as error:
        words = " ".join(str(error).split()) or type(error).__name__
        raise Unreadable(f"{str(path)!r} cannot be read as a recording: {words}") from error


class RecordingAdapter(Adapter):
    """A recording as an `Adapter`. Starts playing when opened, by `clock` (monotonic ns)."""

    def __init__(
        self, path: Path, options: AdapterOptions, *, clock: Callable[[], int] = time.monotonic_ns, part: Part = WHOLE
    ) -> None:
        """Serve `part` of the recording at a path. Raises ValueError for an invalid rate."""
        options = options if part.rate is None else replace(options, rate=part.rate)
        Playback(0, 0, options.rate)  # raises ValueError for an invalid rate before any file is read
        self._part = part
        self._path = path
        self._options = options
        self._clock = clock
        self._began = 0
        self._bag: Bag | None = None
        self._players: dict[str, TopicPlayer] = {}
        self._graph = Graph(1)

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities for reading only; names that ROS 2 hides are hidden in its recordings, too."""
        return recording_capabilities(Encoding.CDR if self._bag is None else self._bag.encoding)

    @property
    def graph(self) -> Graph:
        """Topics of the recording and, if it names them, the nodes that published them."""
        return self._graph

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """The recording by its name, once open."""
        return MappingProxyType({} if self._bag is None else {self._bag.name: self._bag})

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Read the index in a thread, then play. Raises NotFound, and Unreadable with the defect.

        Something must be read before the deadline, and again in each such time span: the total time depends on the
        size.
        """
        if self._bag is not None:
            return
        span = max(deadline - asyncio.get_running_loop().time(), 0)
        budget = OpenBudget(self._options.recording_index_limit)
        opened = partial(open_bag, self._path, self._options.types, budget, self._part, self._options.recording_name)
        reading = asyncio.ensure_future(_on_a_thread(opened))
        try:
            previous = -1
            while not (await asyncio.wait({reading}, timeout=span))[0]:
                if budget.work_done <= previous:
                    raise Unreachable(f"nothing was read of {str(self._path)!r} in {span:.0f} s")
                previous = budget.work_done
            bag = reading.result()
        finally:
            reading.cancel()
            budget.cancel()  # nobody waits for the result
        for note in bag.notes:
            log.warning("the recording %s: %s", bag.name, note)
        self._bag = bag
        self._began = self._clock()
        self._graph = recorded_graph(bag, self._graph.revision + 1)

    async def close(self) -> None:
        """Stop playing and close the file. Idempotent."""
        for player in self._players.values():
            player.close()
        if self._bag is not None:
            self._bag.close()

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return `subscribe` for recorded topics, and nothing else."""
        is_recorded = ref.kind is Kind.TOPIC and ref.name in self._graph.topics
        return frozenset({Operation.SUBSCRIBE}) if is_recorded else frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type as recorded, else as shipped. Raises UnknownType."""
        if self._bag is None:
            raise UnknownType(f"the type {ref.name} is not known: the recording is not open")
        return self._bag.schema(ref)

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types of the recorded topics."""
        return [] if self._bag is None else self._bag.types()

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic, whether or not it is recorded."""
        return self._player(topic).subscribe(depth)

    def age_ns(self, sample: Sample) -> int:
        """Return the recorded time since a message; a latched one of the previous loop is older by a loop."""
        if self._bag is None:
            return 0
        playback = self._playback(self._bag)
        return playback.since(Position(sample.epoch, sample.received_ns - self._bag.start_ns), self._elapsed_ns())

    def _player(self, topic: str) -> TopicPlayer:
        if self._bag is None:
            raise Unreachable("the recording is not open")
        player = self._players.get(topic)
        if player is None:
            streams = self._bag.streams_by_topic.get(topic, [])
            player = TopicPlayer(self._bag, streams, self._playback(self._bag), self._elapsed_ns)
            if streams:  # players of names that are not recorded are not stored
                self._players[topic] = player
        return player

    def _playback(self, bag: Bag) -> Playback:
        return Playback(bag.end_ns - bag.start_ns, bag.count, self._options.rate, self._options.once)

    def _elapsed_ns(self) -> int:
        return self._clock() - self._began


def recording_capabilities(encoding: Encoding) -> Capabilities:
    """Return the capabilities of recordings: nothing can be written, and what ROS 2 hides is hidden."""
    return Capabilities(
        "recording",
        encoding,
        writes=False,
        creates_topics=False,
        parameter_trees=False,
        hidden_names=encoding is Encoding.CDR,
    )


def recorded_graph(bag: Bag, revision: int) -> Graph:
    """Return the computation graph of a recording. A recorded `/clock` means that time was simulated."""
    publishers = dict.fromkeys(stream.publisher for stream in bag.streams if stream.publisher)
    return Graph(
        revision,
        simulated_time="/clock" in bag.topics,
        nodes=freeze({name: Node(name) for name in sorted(publishers)}),
        topics=freeze({name: _topic(bag, name) for name in sorted(bag.topics)}),
        services=freeze({}),
        parameters=freeze({}),
    )


def _topic(bag: Bag, name: str) -> Topic:
    streams = bag.streams_by_topic[name]
    endpoints = [
        Endpoint(stream.publisher, stream.types[0] if len(stream.types) == 1 else None, stream.latched)
        for stream in streams
        if stream.publisher
    ]
    types = dict.fromkeys(ref for stream in streams for ref in stream.types)
    return Topic(name, tuple(types), tuple(endpoints), unreadable=bag.topics[name].unreadable)


async def _on_a_thread(work: Callable[[], Bag]) -> Bag:
    """Run `work` in a daemon thread; if the wait is cancelled, close the bag that it returns."""
    done: Future[Bag] = Future()

    def run() -> None:
        bag = None
        try:
            bag = work()
            done.set_result(bag)
        except InvalidStateError:  # nobody waits any more
            if bag is not None:
                bag.close()
        except BaseException as error:
            with suppress(InvalidStateError):
                done.set_exception(error)

    threading.Thread(target=run, name="rosld-recording", daemon=True).start()
    return await asyncio.wrap_future(done)
