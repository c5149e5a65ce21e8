"""A recording that is readable message by message in any format: its types, and messages latched before it."""

from __future__ import annotations

import hashlib
import logging
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_idl, get_typestore
from rosbags.typesys.base import TypesysError

from rosld.adapters.base import PAGE_BYTES, MessageFilter, MessagePage, RecordedMessage, RecordedTopic
from rosld.adapters.model import Encoding, MessageSchema, NotFound, Sample, Schema, TypeRef, UnknownType, Unreachable
from rosld.adapters.model.codec import store_name
from rosld.adapters.model.definition import derived_from, require_short, split_action, split_service, written_form
from rosld.adapters.model.library import SEPARATOR, TypeLibrary
from rosld.adapters.model.names import global_name
from rosld.adapters.model.schema import latched_depth
from rosld.adapters.recording.part import WHOLE, Part
from rosld.adapters.recording.storage import Damaged, MessageTable, OpenBudget, RecordedConnection, RosVersion, Storage

_IDL_SEPARATOR = "=" * 80 + "\n"
_PART = "---"


def type_name(recorded: str) -> str:
    """Return rosbags' name of a type: ROS 1 records `pkg/Name` for `pkg/msg/Name`."""
    parts = recorded.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else recorded


def learn(library: TypeLibrary, connection: RecordedConnection, ros_version: RosVersion) -> tuple[TypeRef, str | None]:
    """Return the type of a connection, and the reason why its messages cannot be decoded, or None."""
    name = type_name(connection.type)
    named = TypeRef(name, connection.hash)
    if connection.odd is not None:
        return named, connection.odd
    try:
        if not connection.definition.strip() and ros_version == 2:
            schema = library.find(named)
            if not isinstance(schema, MessageSchema):
                raise ValueError("it is not a message type")
            return schema.ref, None
        # RIHS01 also covers facts that the text lacks, so only an MD5 can prove the text
        proof = connection.hash if ros_version == 1 else None
        return library.learn_message(name, _text(name, connection), proof).ref, None
    except (ValueError, UnknownType) as error:
        return named, f"its type {name or '(none)'} cannot be used: {error}"


def _text(name: str, connection: RecordedConnection) -> str:
    if connection.syntax == "idl":
        return _text_of_idl(name, connection.definition)
    if connection.syntax != "msg":
        raise ValueError(f"its definition is in {connection.syntax!r}")
    derived = derived_from(name)
    if derived is None or _PART not in connection.definition.splitlines():
        return connection.definition
    return _text_of_derived(*derived, connection.definition)


def _text_of_derived(of: str, text: str, definition: str) -> str:
    """Return the text of a message of a hidden topic, recorded with the definition of its service or action."""
    head, separator, nested = definition.partition("\n===")
    own = [f"MSG: {name}\n{part}" for name, part in _parts(of, head).items()]
    return f"\n{SEPARATOR}\n".join([text, *own]) + "\n" + separator.lstrip("\n") + nested


def _parts(of: str, definition: str) -> Mapping[str, str]:
    """Return the texts of the messages of a service or an action, or of a service of an action."""
    derived = derived_from(of)
    if derived is not None:
        action, text = derived
        return {**_parts(action, definition), **_parts_named(of, ("_Request", "_Response"), split_service(text))}
    if written_form(of) == "action":
        return _parts_named(of, ("_Goal", "_Result", "_Feedback"), split_action(definition))
    return _parts_named(of, ("_Request", "_Response"), split_service(definition))


def _parts_named(of: str, ends: Sequence[str], texts: Sequence[str]) -> Mapping[str, str]:
    return {f"{of}{end}": text for end, text in zip(ends, texts, strict=True)}


def _text_of_idl(name: str, definition: str) -> str:
    """Return the definition in .msg syntax of a type defined in OMG IDL, with its dependencies appended."""
    require_short(name, definition)
    marked = definition.startswith(f"{_IDL_SEPARATOR}IDL: ")
    parts = [part.partition("\n")[2] for part in definition.split(_IDL_SEPARATOR)[1:]] if marked else [definition]
    store = get_typestore(Stores.EMPTY)
    try:
        for part in parts:
            store.register(get_types_from_idl(part))
        return store.generate_msgdef(store_name(name), ros_version=2)[0]
    except (TypesysError, SerdeError, KeyError, ValueError, AssertionError, SyntaxError) as error:
        raise ValueError(f"its IDL cannot be read: {error}") from error


def without_repeats(table: MessageTable, connections: Sequence[RecordedConnection]) -> MessageTable:
    """Remove the opening messages of files that are not their publisher's first: they repeat earlier messages."""
    is_opening = np.asarray([each.is_opening for each in connections], bool)
    if not is_opening.any():
        return table
    order = np.arange(len(table.times))[::-1]
    first = np.full(len(connections), -1)
    first[table.connections[order]] = order  # assignment of repeated indexes: the last one wins
    earliest: dict[tuple[str, str], int] = {}
    for connection, row in zip(connections, first.tolist(), strict=True):
        if row >= 0:
            key, time = (connection.topic, connection.publisher), int(table.times[row])
            earliest[key] = min(earliest.get(key, time), time)
    first_times = np.asarray(
        [earliest.get((connection.topic, connection.publisher), 0) for connection in connections], np.int64
    )
    is_repeat = is_opening[table.connections] & (table.times > first_times[table.connections])
    return table.rows(~is_repeat)


def latched_rows(
    table: MessageTable, until: int, connections: Sequence[RecordedConnection], types: Sequence[TypeRef]
) -> NDArray[np.int64]:
    """Return the rows before row `until` with the latest latched messages of each publisher, ascending."""
    latched = [number for number, connection in enumerate(connections) if connection.latched]
    rows = np.flatnonzero(np.isin(table.connections[:until], latched))
    newest: dict[tuple[str, str], deque[int]] = {}
    for row, number in zip(rows.tolist(), table.connections[rows].tolist(), strict=True):
        connection = connections[number]
        newest.setdefault(
            (connection.topic, connection.publisher), deque(maxlen=latched_depth(types[number].name))
        ).append(row)
    return np.sort(np.asarray([row for each in newest.values() for row in each], np.int64))


@lru_cache(maxsize=10_000)
def _digest(path: Path, size: int, changed_ns: int) -> str:
    """Return a digest of the begin and end of a file, its size and the time of its last change."""
    with path.open("rb") as file:
        head = file.read(_EDGE)
        file.seek(max(0, size - _EDGE))
        return hashlib.sha256(b"%d %d " % (size, changed_ns) + head + file.read(_EDGE)).hexdigest()


_EDGE = 4096
_Key = TypeVar("_Key")
_Value = TypeVar("_Value")
log = logging.getLogger("rosld.recording")
_STATIC_TOPIC = "/tf_static"


class Stream(Struct, frozen=True, eq=False):
    """Messages of a publisher on a topic: `positions` are their indexes in the recording, ascending."""

    topic: str
    publisher: str
    types: tuple[TypeRef, ...]
    latched: bool
    positions: NDArray[np.int64]


class Bag:
    """An open recording: implements `Recording` and supports playback. Any thread may read from it.

    Uses 40 bytes of memory per message, and at most 64 MB for recent chunks; the messages stay on the disk.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        storage: Storage,
        library: TypeLibrary,
        part: Part = WHOLE,
        budget: OpenBudget | None = None,
    ) -> None:
        """Index `part` of a stored recording. Raises Damaged if the part is empty, and OpeningRefused."""
        self.name = name
        self.path = path
        self.format = storage.format
        self.encoding = Encoding.ROS1 if storage.ros_version == 1 else Encoding.CDR
        self.notes = tuple(storage.notes)
        self.first = 0
        self._storage = storage
        self._library = library
        self._connections = tuple(map(with_global_names, storage.connections))
        results = _learn_all(library, self._connections, storage.ros_version, budget or OpenBudget())
        self._types = [ref for ref, _ in results]
        self._unreadable = [words for _, words in results]
        table = without_repeats(storage.messages.in_recorded_order(), self._connections)
        self._table, self._openings = part.select(
            table, lambda table, until: latched_rows(table, until, self._connections, self._types)
        )
        self.times = self._table.times
        self.count = len(self.times)
        self.start_ns = int(self.times[0]) if self.count else 0
        self.end_ns = int(self.times[-1]) if self.count else 0
        self.streams, self._stream_of = self._as_streams()
        self.streams_by_topic = _grouped(self.streams, [stream.topic for stream in self.streams])
        members = _grouped(range(len(self._connections)), [each.topic for each in self._connections])
        self.topics: Mapping[str, RecordedTopic] = MappingProxyType(
            {name: self._topic(name, mine) for name, mine in members.items()}
        )
        self.silent = tuple(each for each in storage.silent if each not in self.topics)

    def message(self, index: int) -> RecordedMessage:
        """Return message `index` in recorded order. Raises NotFound if it is out of range, Unreachable if damaged."""
        if not 0 <= index < self.count:
            last = f"its messages are 0 to {self.count - 1}" if self.count else "it holds none"
            raise NotFound(f"the recording {self.name} has no message {index}: {last}")
        stream = self._stream(index)
        sequence = int(np.searchsorted(stream.positions, index)) + 1
        return RecordedMessage(index, stream.topic, self.sample(index, sequence), self._is_opening(index))

    def topic_of(self, index: int) -> str | None:
        return self._stream(index).topic if 0 <= index < self.count else None

    def messages(self) -> Iterator[RecordedMessage]:
        """Yield all messages in recorded order; unreadable ones are skipped with a warning."""
        sequences: Counter[int] = Counter()
        for index, connection in enumerate(self._table.connections.tolist()):
            stream = self._stream_of[connection]
            sequences[stream] += 1
            try:
                sample = self.sample(index, sequences[stream])
            except Unreachable as error:
                log.warning("%s", error)
            else:
                yield RecordedMessage(index, self.streams[stream].topic, sample, self._is_opening(index))

    @property
    def settled(self) -> int:
        """Number below which all messages are available: their count."""
        return self.count

    @property
    def identity(self) -> str:
        """Identity from the first and last times and the number of messages."""
        return f"{zlib.crc32(f'{self.start_ns} {self.end_ns} {self.count}'.encode()):08x}"

    @property
    def content(self) -> str | None:
        """Key of the content of this part of its files; None if they cannot be read."""
        try:
            paths = [self.path] if self.path.is_file() else sorted(self.path.iterdir())
            digests = [_digest(each, each.stat().st_size, each.stat().st_mtime_ns) for each in paths if each.is_file()]
        except OSError:
            return None
        part = f"{self.start_ns} {self.end_ns} {self.count}"
        return hashlib.sha256(" ".join([*digests, part]).encode()).hexdigest()[:32]

    def times_between(self, start: int, end: int) -> tuple[int, int] | None:
        found = self.times[start:end]
        return (int(found[0]), int(found[-1])) if len(found) else None

    def select(self, criteria: MessageFilter, limit: int) -> MessagePage:
        """Return at most `limit` messages; only these are read from the disk."""
        indexes = self._indexes(criteria, limit + 1)
        columns = (self._table.connections, self._table.places, self._table.offsets, self.times, self._sequences)
        rows = zip(indexes, *(each[indexes].tolist() for each in columns), strict=True)
        messages: list[RecordedMessage] = []
        size = 0
        for count, (index, connection, place, offset, received, sequence) in enumerate(rows):
            if count == limit or size >= PAGE_BYTES:
                return MessagePage(messages, index)
            try:
                data = self._data(index, place, offset)
            except Unreachable as error:
                log.warning("%s", error)
                continue
            source = self._connections[connection]
            sample = self._as_sample(connection, data, received, sequence)
            is_opening = index < self._openings or source.is_opening
            messages.append(RecordedMessage(index, source.topic, sample, is_opening))
            size += len(data)
        return MessagePage(messages, None)

    @cached_property
    def _sequences(self) -> NDArray[np.uint32]:
        """The number of each message among those of its stream, from 1."""
        found = np.zeros(self.count, np.uint32)
        for stream in self.streams:
            found[stream.positions] = np.arange(1, len(stream.positions) + 1)
        return found

    def _indexes(self, criteria: MessageFilter, limit: int) -> list[int]:
        """Return the indexes of the first `limit` messages that match a filter."""
        first = max(criteria.start, int(np.searchsorted(self.times, criteria.from_ns, "left")))
        beyond = min(criteria.end, int(np.searchsorted(self.times, criteria.to_ns, "right")))
        if criteria.topics is None:
            return list(range(first, min(beyond, first + limit)))
        indexes: list[int] = []
        for topic in criteria.topics:
            for stream in self.streams_by_topic.get(topic, ()):
                begin = int(np.searchsorted(stream.positions, first))
                indexes += (each for each in stream.positions[begin : begin + limit].tolist() if each < beyond)
        return sorted(indexes)[:limit]

    def latest_at(self, topic: str, time_ns: int) -> RecordedMessage | None:
        passed = int(np.searchsorted(self.times, time_ns, "right"))
        found = [
            int(stream.positions[count - 1])
            for stream in self.streams_by_topic.get(topic, ())
            if (count := int(np.searchsorted(stream.positions, passed)))
        ]
        return self.message(max(found)) if found else None

    def latched_before(self, time_ns: int, selects: Callable[[str], bool]) -> Iterable[tuple[str, Sample]]:
        until = int(np.searchsorted(self.times, time_ns, "left"))
        for row in latched_rows(self._table, until, self._connections, self._types).tolist():
            if selects(self._stream(row).topic):
                yield self._stream(row).topic, self.message(row).sample

    def sample(self, index: int, sequence: int, epoch: int = 0) -> Sample:
        """Return message `index` as a sample with this sequence and epoch. Raises Unreachable."""
        connection = int(self._table.connections[index])
        data = self._data(index, int(self._table.places[index]), int(self._table.offsets[index]))
        return self._as_sample(connection, data, int(self.times[index]), sequence, epoch)

    def _as_sample(self, connection: int, data: bytes, received: int, sequence: int, epoch: int = 0) -> Sample:
        source, kind = self._connections[connection], self._types[connection]
        return Sample(data, source.encoding, kind, source.publisher, received, sequence, epoch, source.latched)

    def _data(self, index: int, place: int, offset: int) -> bytes:
        try:
            return self._storage.read(place, offset)
        except Damaged as damage:
            raise Unreachable(f"message {index} of the recording {self.name} cannot be read: {damage}") from damage

    def density(self, parts: int) -> Mapping[str, Sequence[int]]:
        places = (self.times - self.start_ns) * (parts / max(self.end_ns - self.start_ns, 1))
        numbers = np.clip(places.astype(np.int64), 0, parts - 1)
        counts = {name: np.zeros(parts, np.int64) for name in self.topics}
        for stream in self.streams:
            counts[stream.topic] += np.bincount(numbers[stream.positions], minlength=parts)
        return {name: each.tolist() for name, each in counts.items()}

    def schema(self, ref: TypeRef) -> Schema:
        return self._library.find(ref)

    def types(self) -> Sequence[TypeRef]:
        """Return the types of the recorded topics."""
        return list(dict.fromkeys(ref for ref in self._types if ref.name))

    def types_of(self, topic: str) -> frozenset[TypeRef]:
        """Return all types that messages of a topic have."""
        return frozenset(ref for stream in self.streams_by_topic.get(topic, ()) for ref in stream.types)

    def limit_cache(self, max_bytes: int) -> None:
        """Limit the memory for recent chunks."""
        self._storage.limit_cache(max_bytes)

    def close(self) -> None:
        """Close the files. Idempotent."""
        self._storage.close()

    def _is_opening(self, index: int) -> bool:
        return index < self._openings or self._connections[int(self._table.connections[index])].is_opening

    def _stream(self, index: int) -> Stream:
        return self.streams[self._stream_of[int(self._table.connections[index])]]

    def _as_streams(self) -> tuple[tuple[Stream, ...], list[int]]:
        """Return the streams, and the index of each connection's stream among them."""
        keys = [(each.topic, each.publisher) for each in self._connections]
        numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
        stream_of = [numbers[key] for key in keys]
        order = np.argsort(np.asarray(stream_of, np.int64)[self._table.connections], kind="stable")
        counts = np.bincount(np.asarray(stream_of, np.int64)[self._table.connections], minlength=len(numbers))
        parts = np.split(order, np.cumsum(counts)[:-1]) if len(numbers) else []
        members = _grouped(range(len(keys)), stream_of)
        streams: list[Stream] = []
        for (key, number), positions in zip(numbers.items(), parts, strict=True):
            types = dict.fromkeys(ref for each in members[number] if (ref := self._types[each]).name)
            is_latched = any(self._connections[each].latched for each in members[number])
            streams.append(Stream(*key, tuple(types), is_latched, positions))
        return tuple(streams), stream_of

    def _topic(self, name: str, connections: Sequence[int]) -> RecordedTopic:
        """Return a topic, which is unreadable if none of its connections can be decoded."""
        readable = [number for number in connections if self._unreadable[number] is None]
        number = (readable or connections)[0]
        count = sum(len(stream.positions) for stream in self.streams_by_topic[name])
        return RecordedTopic(name, self._types[number], count, None if readable else self._unreadable[number])


def _grouped(values: Iterable[_Value], keys: Iterable[_Key]) -> dict[_Key, list[_Value]]:
    """Group values by key, in the order of first appearance."""
    groups: dict[_Key, list[_Value]] = {}
    for value, key in zip(values, keys, strict=True):
        groups.setdefault(key, []).append(value)
    return groups


def _learn_all(
    library: TypeLibrary, connections: Iterable[RecordedConnection], ros_version: RosVersion, budget: OpenBudget
) -> list[tuple[TypeRef, str | None]]:
    """Return the result of `learn` per connection, computed once if only topic or publisher differ."""
    keys = [each._replace(topic="", publisher="", latched=False) for each in connections]
    types = dict.fromkeys(keys)
    budget.learn(len(types), sum(len(each.definition) for each in types))
    results = {}
    for key in types:
        budget.work(0)
        results[key] = learn(library, key, ros_version)
    return [results[key] for key in keys]


def with_global_names(connection: RecordedConnection) -> RecordedConnection:
    """Return the connection with global names, as on a master: old recordings omit the leading slash."""
    topic, publisher = global_name(connection.topic or "unnamed"), connection.publisher
    latched = connection.latched or topic == _STATIC_TOPIC  # tf2 relies on it; some recorders omit the QoS
    return connection._replace(topic=topic, publisher=global_name(publisher) if publisher else "", latched=latched)
