"""Recorded messages for SPARQL queries: their selection and their N-Triples."""

from __future__ import annotations

import asyncio
import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from itertools import starmap
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from rosld.adapters.base import FOR_EVER, MessageFilter, RecordedMessage, RecordedTopic, Recording
from rosld.adapters.model import MessageSchema, RosError, Sample, TypeRef
from rosld.ontology.column_lift import ColumnLifter, column_lifter, shorten_paths
from rosld.ontology.describe_topics import MESSAGE
from rosld.ontology.document import Envelope
from rosld.ontology.geometry import TERMS, geometry_ntriples, geometry_of, has_place
from rosld.ontology.lift import Lifter, partial_lifter
from rosld.ontology.literals import date_time, quote
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ldp, rdf, rdfs, ros, xsd
from rosld.server.auth.permissions import Permissions
from rosld.server.dataset.encoding import private_datatype
from rosld.server.history.history import HistoryRecording
from rosld.server.history.message_block import MessageBlock, columns_of, number_paths
from rosld.server.history.recordings import Recordings
from rosld.server.history.statistics import Statistics, pages
from rosld.server.http.problem import Problem
from rosld.server.resources.past_summaries import SummaryText, field_path
from rosld.server.robot.session import Session
from rosld.server.space.transforms import KEPT_NS, STATIC_TOPIC, TOPICS, TYPES, FrameBuffer, FrameRow
from rosld.server.sparql.intervals import Bounds, Interval
from rosld.server.sparql.message_order import MessageTimes
from rosld.server.sparql.past import MAX_TEXT, PastDataset, PastQuery, PastSelection, PastText
from rosld.server.sparql.query_limits import MAX_PAST, out_of_time, too_much_past
from rosld.server.sparql.summaries import SummaryQuery

_MAX_NAMED = 3
"""Maximum number of recordings that a problem names."""
_PAGE = 2000
"""Number of messages read from a file at a time."""


class PastRange(NamedTuple):
    """Messages of one topic between two times in ns (inclusive), whose numbers at some paths are within bounds."""

    topic: str
    from_ns: int
    until_ns: int
    numbers: tuple[tuple[tuple[str, ...], Bounds], ...] = ()


def count_past(recording: Recording, ranges: Sequence[PastRange]) -> int:
    """Return an upper bound of the number of messages, as far as it is known without reading."""
    found = 0
    for each in ranges:
        if isinstance(recording, HistoryRecording):
            found += recording.count_between(*each[:3])
        elif each.from_ns <= recording.start_ns and recording.end_ns <= each.until_ns:
            found += recording.topics[each.topic].count
    return found


def read_past(
    recording: Recording, ranges: Sequence[PastRange], statistics: Statistics | None = None
) -> Iterator[MessageBlock]:
    """Yield each message once, in any order, without unreadable ones.

    Ranges of one topic must not overlap. Blocks whose `statistics` show that no message can be wanted are not read.
    """
    for each in ranges:
        if isinstance(recording, HistoryRecording):
            yield from recording.blocks_between(*each[:3])
            continue
        for first, beyond in _parts(recording, each, statistics):
            criteria = MessageFilter(frozenset({each.topic}), each.from_ns, each.until_ns, first, beyond)
            for messages in pages(recording, criteria, _PAGE):
                yield from MessageBlock.grouped(messages)


def _parts(recording: Recording, span: PastRange, statistics: Statistics | None) -> Iterator[tuple[int, int]]:
    """Yield the ranges of indexes, from a first one up to and excluding another, of messages that may be wanted."""
    key = recording.content if span.numbers and statistics is not None else None
    found = None
    if key is not None and statistics is not None:
        found = statistics.find(key, span.topic, [".".join(path) for path, _ in span.numbers])
    if found is None:
        yield recording.first, FOR_EVER
        return
    chosen: list[tuple[int, int]] = []
    for each in found.values():
        is_wanted = (each.blocks[:, 3] >= span.from_ns) & (each.blocks[:, 2] <= span.until_ns)
        for path, bounds in span.numbers:
            numbers = each.fields.get(".".join(path))
            if numbers is not None:
                is_wanted &= (numbers[:, 0] <= bounds.high) & (numbers[:, 1] >= bounds.low)
        chosen += each.blocks[is_wanted, :2].tolist()
    end = -1
    for first, last in sorted(chosen):  # blocks of several types may overlap
        if last > end:
            yield max(first, end + 1), last + 1
            end = last


def merge_ranges(ranges: Sequence[PastRange]) -> list[PastRange]:
    """Return ranges for the same messages that do not overlap."""
    merged: list[PastRange] = []
    for each in sorted(ranges):
        last = merged[-1] if merged else None
        if last is not None and last.topic == each.topic and each.from_ns <= last.until_ns:
            numbers = last.numbers if last.numbers == each.numbers else ()
            merged[-1] = last._replace(until_ns=max(last.until_ns, each.until_ns), numbers=numbers)
        elif each.from_ns <= each.until_ns:
            merged.append(each)
    return merged


_PIECES = 1000
"""Number of equal parts of a recording without an index, over which its messages are assumed to be spread evenly."""


def time_of_end(plans: Sequence[tuple[Recording, Sequence[PastRange]]], most: int, *, is_newest: bool) -> int | None:
    """Return a time after (or before) which there are about `most` messages; None if there are fewer.

    With an index the result is exact, except for chunks that extend beyond the ranges; otherwise it is an estimate.
    """
    spans = [
        span
        for recording, ranges in plans
        for each in ranges
        for span in _spans(recording, each, most, is_newest=is_newest)
    ]
    count = 0
    for start, end, messages in sorted(spans, key=lambda span: -span[0] if is_newest else span[1]):
        count += messages
        if count >= most:
            return start if is_newest else end
    return None


def clip_ranges(ranges: Sequence[PastRange], bound: int, *, is_newest: bool) -> list[PastRange]:
    """Return the parts of ranges at or after (`is_newest`) or at or before a time."""
    if is_newest:
        clipped = (each._replace(from_ns=max(each.from_ns, bound)) for each in ranges)
    else:
        clipped = (each._replace(until_ns=min(each.until_ns, bound)) for each in ranges)
    return [each for each in clipped if each.from_ns <= each.until_ns]


def _spans(recording: Recording, span: PastRange, most: int, *, is_newest: bool) -> Iterator[tuple[int, int, int]]:
    """Yield start, end and number of messages of time ranges; altogether more than `most` messages, or all."""
    if isinstance(recording, HistoryRecording):
        yield from recording.spans_at_end(
            *span[:3], most + 1, is_newest=is_newest
        )  # each span has at least one message
        return
    count = recording.topics[span.topic].count
    start, end = recording.start_ns, recording.end_ns
    if count <= most or end <= start:
        yield start, end, count
        return
    pieces = min(count, _PIECES)
    for piece in range(pieces):
        begins, ends = (start + (end - start) * (piece + side) // pieces for side in (0, 1))
        if ends >= span.from_ns and begins <= span.until_ns:
            yield begins, ends, max(1, count // pieces)


def may_read_recording(space: Space, permissions: Permissions, recording: Recording) -> bool:
    """Whether an agent may read a recording and its messages; topics are checked separately."""
    messages = f"{space.bag_messages(recording.name)}{{index}}"
    return permissions.may_read(space.bag(recording.name)) and permissions.may_template("GET", messages)


_SLICE = 0.004
"""Seconds of lifting between pauses that let the loop run."""


Text = TypeVar("Text")
_Read: TypeAlias = "Callable[[_Reading, Sequence[Recording], Sequence[PastSelection]], Text]"


class NoRecordings(Problem):
    """There is no recording that a query could be about."""


class RecordedPast:
    """Recorded messages of one robot for its SPARQL endpoint."""

    def __init__(self, session: Session, recordings: Recordings) -> None:
        self._session = session
        self._recordings = recordings

    async def read(
        self, query: PastQuery, dataset: PastDataset, now: Interval, until: float, most: int | None = None
    ) -> PastText:
        """Return the text of the messages that a query selects, or of about `most` at one end. Raises Problems."""
        return await self._run(query, dataset, now, until, lambda one, bags, found: one.read(bags, found, most))

    async def summarize(
        self, query: PastQuery, summary: SummaryQuery, dataset: PastDataset, until: float
    ) -> PastText | None:
        """Return the text of summaries of the selected messages, or None if they are not known. Raises Problems."""
        return await self._run(
            query, dataset, summary.time, until, lambda one, bags, found: one.summarize(bags, found, summary)
        )

    async def _run(
        self, query: PastQuery, dataset: PastDataset, now: Interval, until: float, read: _Read[Text]
    ) -> Text:
        """Read from the readable recordings of a query, in a thread. Raises Problems."""
        recordings = self._find(query, dataset.graphs)
        selections = query.selections(now)
        readable = [one for one in recordings if may_read_recording(self._session.space, dataset.permissions, one)]
        for selection in selections:
            self._require_recorded(selection, readable, dataset.permissions)
        reading = _Reading(self._session, query, dataset, until, self._recordings.indexer.statistics)
        try:
            return await asyncio.to_thread(read, reading, readable, selections)
        finally:
            for ref, schema in reading.learned.items():
                self._session.schemas.add(ref, schema)

    def _find(self, query: PastQuery, graphs: tuple[str, ...]) -> Sequence[Recording]:
        """Return the recordings of a query. Raises a 400 Problem if there are none."""
        space, readable = self._session.space, self._recordings.readable
        if query.asks_all and not graphs and (found := list(readable.values())):
            return found
        by_url = {space.bag(name): name for name in readable}
        asked = frozenset(by_url) if query.asks_all else query.recordings
        named = asked & set(graphs) if graphs else asked
        if graphs and not named:
            raise NoRecordings(400, "ros:past needs a recording in the dataset: name one, as in FROM </bags/history/>.")
        unknown = sorted(named - by_url.keys())
        if unknown:
            words = f"There is no recording <{unknown[0]}> that can be read: {space.container('bags')} lists them."
            raise Problem(400, words)
        if named:
            return [readable[by_url[url]] for url in sorted(named)]
        if self._recordings.history.is_enabled:
            return [self._recordings.history.recording]
        if self._session.adapter.recordings:
            return list(self._session.adapter.recordings.values())
        raise NoRecordings(
            400,
            "There are no recordings to query: start rosld with --history GLOB (--history '*' for all "
            f"topics), or name a recording by ?message ros:recordedIn <{space.container('bags')}NAME/>.",
        )

    def _require_recorded(
        self, selection: PastSelection, recordings: Sequence[Recording], permissions: Permissions
    ) -> None:
        """Raise a 400 Problem for a named topic that is not recorded: empty results would be misleading."""
        space = self._session.space
        for url in sorted(selection.urls or ()):
            location = space.location(url)
            if location is None or location.kind != "topics" or not permissions.may_read(url):
                continue
            name = location.name
            if any(name in one.topics or self._will_record(one, name) for one in recordings):
                continue
            if recordings and name in self._session.graph.topics:
                urls = ", ".join(f"<{space.bag(one.name)}>" for one in recordings[:_MAX_NAMED])
                if len(recordings) > _MAX_NAMED:
                    urls += f" and {len(recordings) - _MAX_NAMED} more recordings"
                is_history = any(one is self._recordings.history.recording for one in recordings)
                next_step = f"--history {name} records it" if is_history else "its page lists its topics"
                raise Problem(400, f"{name} is not recorded in {urls}: {next_step}.")

    def _will_record(self, recording: Recording, topic: str) -> bool:
        history = self._recordings.history
        return recording is history.recording and history.will_record(topic)


class _Reading:
    """One read operation on a thread. `learned` are newly loaded types."""

    def __init__(
        self, session: Session, query: PastQuery, dataset: PastDataset, until: float, statistics: Statistics
    ) -> None:
        self.learned: dict[TypeRef, MessageSchema] = {}
        self._session = session
        self._query = query
        self._dataset = dataset
        self._statistics = statistics
        self._until = until
        self._placed_ns: list[int] = []
        self._variables: dict[str, set[str]] = {}
        self._needs: dict[str, tuple[frozenset[str] | None, Mapping[str, Sequence[str]], frozenset[str] | None]] = {}
        self._times: dict[tuple[str, str], list[tuple[int, int]]] = {}
        self._urls: dict[str, str | None] = {}
        self._read = Counter[tuple[str, str]]()
        """Numbers of messages read, by topic and recording."""
        self._pause = time.monotonic() + _SLICE
        self._lifters: dict[tuple[TypeRef, str], ColumnLifter | None] = {}

    def read(self, recordings: Sequence[Recording], selections: Sequence[PastSelection], most: int | None) -> PastText:
        """Return the text of all messages, or of about `most` at the relevant end. Raises Problems."""
        plans = [(one, self._ranges(one, selections)) for one in recordings]
        is_whole = True
        if most is not None and self._query.end is not None:
            bound = time_of_end(plans, most, is_newest=self._query.end.is_newest)
            is_whole = bound is None
            if bound is not None:
                plans = [
                    (one, clip_ranges(ranges, bound, is_newest=self._query.end.is_newest)) for one, ranges in plans
                ]
        self._require_few(plans)
        texts: tuple[list[str], list[str]] = [], []
        count = size = 0
        for recording, ranges in plans:
            record_text = _RecordText(
                self._session.space, recording, self._query.predicates, is_linked=self._query.is_linked
            )
            for each in ranges:
                for block in read_past(recording, [each], self._statistics):
                    for text, messages, is_stored in self._lift_block(
                        recording, self._narrow(recording, block, each), record_text
                    ):
                        texts[is_stored].append(text)
                        size += len(text)
                        self._read[each.topic, recording.name] += messages
                        count += messages
                        if count > MAX_PAST:
                            raise self._too_much(self._read, "may match this query")
                        if size > MAX_TEXT:
                            raise self._too_much(self._read, f"would exceed {MAX_TEXT >> 20} MiB")
                        self._yield_to_others()
                    self._yield_to_others()
        transforms = self._transforms(recordings) if self._query.asks_transforms else ()
        times = [*starmap(_message_times, self._times.items())]
        plain, stored = ("".join(each).encode() for each in texts)
        return PastText(plain, stored, is_whole, transforms, times, _by_topic(self._read))

    def summarize(
        self, recordings: Sequence[Recording], selections: Sequence[PastSelection], query: SummaryQuery
    ) -> PastText | None:
        """Return the text of summaries of all messages, None if some statistics are not known. Raises Problems."""
        plans = [(one, self._ranges(one, selections)) for one in recordings]
        summaries = SummaryText(self._session.space, query, self._query.predicates or frozenset(), self._statistics)
        text = summaries.of(plans, self._schema, lambda _: self._yield_to_others())
        return None if text is None else PastText(b"", text.encode())

    def _require_few(self, plans: Sequence[tuple[Recording, Sequence[PastRange]]]) -> None:
        """Raise a 503 Problem if far too many messages are known to take part; bounded numbers may exclude any."""
        known = Counter[tuple[str, str]]()
        for recording, ranges in plans:
            for each in ranges:
                if not each.numbers:
                    known[each.topic, recording.name] += count_past(recording, [each])
        if sum(known.values()) > MAX_PAST + 1000 * len(known):  # chunks at the edges are counted in full
            raise self._too_much(known, "may match this query")

    def _yield_to_others(self) -> None:
        """Let the loop run, now and then. Raises a 503 Problem after the deadline."""
        if time.monotonic() <= self._pause:
            return
        if time.monotonic() > self._until:
            raise out_of_time(self._session.settings.query_time_limit, _by_topic(self._read))
        time.sleep(_SLICE / 20)
        self._pause = time.monotonic() + _SLICE

    def _narrow(self, recording: Recording, block: MessageBlock, span: PastRange) -> MessageBlock:
        """Return a block without messages whose numbers are out of bounds, as far as its layout permits."""
        if not span.numbers or block.rows is None or not len(block.rows.times):
            return block
        schema = self._schema(recording, block.channel.type)
        paths = [] if schema is None else [path for path, _ in span.numbers if path in set(number_paths(schema))]
        columns = (
            columns_of(block.rows, schema, block.channel.encoding, paths) if schema is not None and paths else None
        )
        if columns is None:
            return block
        is_wanted = np.ones(len(block.rows.times), bool)
        bounds = dict(span.numbers)
        for path, column in zip(paths, columns, strict=True):
            is_wanted &= (column >= bounds[path].low) & (column <= bounds[path].high)
        return block if is_wanted.all() else block.where(is_wanted)

    def _transforms(self, recordings: Sequence[Recording]) -> Sequence[FrameRow]:
        """Return the transforms around the times of the lifted places. Raises Problems."""
        buffer = FrameBuffer(is_exact=True)
        if not self._placed_ns:
            return ()
        low, high = min(self._placed_ns) - KEPT_NS, max(self._placed_ns) + KEPT_NS
        for recording in recordings:
            for topic in TOPICS:
                if topic not in recording.topics or not self._dataset.permissions.may_read(
                    self._session.space.topic(topic)
                ):
                    continue
                is_static = topic == STATIC_TOPIC
                span = PastRange(topic, 0 if is_static else max(low, 0), high)
                if (count := count_past(recording, [span])) > MAX_PAST:
                    raise self._too_much({(topic, recording.name): count}, "may match this query")
                for block in read_past(recording, [span]):
                    for message in block.messages():
                        self._add_transforms(recording, message.sample, buffer, is_static=is_static)
                    if time.monotonic() > self._until:
                        raise out_of_time(self._session.settings.query_time_limit, _by_topic(self._read))
                    time.sleep(_SLICE / 20)
        return buffer.rows()

    def _add_transforms(self, recording: Recording, sample: Sample, buffer: FrameBuffer, *, is_static: bool) -> None:
        schema = self._schema(recording, sample.schema)
        if schema is not None and schema.ref.name in TYPES:
            with suppress(ValueError):  # undecodable messages contain no frames
                buffer.add(schema.codec.decode(sample.data, sample.encoding), sample, is_static=is_static)

    def _too_much(self, counts: Mapping[tuple[str, str], int], why: str) -> Problem:
        """Return the problem of too many messages, whose numbers are by topic and recording."""
        (largest, recording), _ = Counter(counts).most_common(1)[0]
        more = "" if len(counts) == 1 else f", most of {largest} in <{self._session.space.bag(recording)}>"
        named = _list([topic for topic, _ in _by_topic(counts).most_common()])
        return too_much_past(
            f"{sum(counts.values())} recorded messages of {named} {why}{more}; the limit is {MAX_PAST}."
        )

    def _url(self, topic: str) -> str | None:
        """Return the URL of a topic, None if it may not be read."""
        if topic not in self._urls:
            url = self._session.space.topic(topic)
            self._urls[topic] = url if self._dataset.permissions.may_read(url) else None
        return self._urls[topic]

    def _ranges(self, recording: Recording, selections: Sequence[PastSelection]) -> list[PastRange]:
        found: list[PastRange] = []
        bag = self._session.space.bag(recording.name)
        selections = [each for each in selections if self._dataset.includes(each, bag)]
        if not selections:
            return found
        for name, topic in recording.topics.items():
            url = self._url(name)
            if url is None:
                continue
            for each in selections:
                if self._is_of(each, url, recording, topic):
                    self._variables.setdefault(name, set()).add(each.variable)
                    low = _earlier(recording, name, max(each.time.low, 0), each.before)
                    numbers = tuple((field_path(path), bounds) for path, bounds in each.numbers)
                    found.append(PastRange(name, low, min(each.time.high, FOR_EVER), numbers))
        return merge_ranges(found)

    def _is_of(self, selection: PastSelection, url: str, recording: Recording, topic: RecordedTopic) -> bool:
        """Whether messages of a topic may be selected."""
        if selection.urls is not None and url not in selection.urls:
            return False
        if selection.names is not None and topic.name not in selection.names:
            return False
        live = self._session.graph.topics.get(topic.name)
        if live is not None and not selection.topic_types <= {ref.name for ref in live.types}:
            return False
        if not selection.types:
            return True
        if isinstance(recording, HistoryRecording):
            refs = recording.types_of(topic.name)
        elif live is not None and len(live.types) > 1:
            return True
        else:
            refs = frozenset({topic.type})
        schemas = [self._schema(recording, ref) for ref in refs]
        return any(schema is not None and selection.types <= schema.types.keys() for schema in schemas)

    def _schema(self, recording: Recording, ref: TypeRef) -> MessageSchema | None:
        found = self.learned.get(ref) or self._session.schemas.find_cached(ref)
        if found is None:
            try:
                found = recording.schema(ref)
            except RosError:
                return None
            if isinstance(found, MessageSchema):
                self.learned[ref] = found
        return found if isinstance(found, MessageSchema) else None

    def _lift_block(
        self, recording: Recording, block: MessageBlock, record_text: _RecordText
    ) -> Iterator[tuple[str, int, bool]]:
        """Yield texts, each with its number of messages, and whether it is in its stored form.

        That is what is read by columns, if only numeric fields are needed: 3 times as fast as encoding the text.
        """
        if block.rows is not None and not len(block.rows.times):
            return
        if block.rows is not None and self._query.predicates is not None and not record_text.is_of_records:
            channel = block.channel
            schema = self._schema(recording, channel.type)
            lifter = (
                None
                if schema is None or self._is_placed(schema)
                else self._column_lifter(schema, channel.topic, record_text.topic(channel.topic))
            )
            if schema is not None and lifter is not None:
                columns = columns_of(block.rows, schema, channel.encoding, lifter.paths)
                if columns is not None:
                    numbers = block.numbers()
                    documents = [f"{record_text.messages}{number}" for number in numbers]
                    times = block.rows.times.tolist()
                    text = lifter.ntriples(documents, times, block.sequences(), columns)
                    if text is not None:
                        self._note(record_text, channel.topic, times, numbers)
                        yield text + record_text.recorded_in(documents), len(numbers), True
                        return
        for message in block.messages():
            yield self._lift(recording, message, record_text), 1, False

    def _is_placed(self, schema: MessageSchema) -> bool:
        """Whether the query needs geometries, and messages of this type have one."""
        return (self._query.predicates is None or not self._query.predicates.isdisjoint(TERMS)) and has_place(schema)

    def _needed(self, topic: str) -> tuple[frozenset[str] | None, Mapping[str, Sequence[str]], frozenset[str] | None]:
        """Return the predicates that are lifted, None for all, the paths, and the predicates that remain."""
        if topic not in self._needs:
            kept = self._query.predicates_of(self._variables.get(topic, ("",)))
            paths = {name: steps for name, steps in self._query.paths.items() if kept is not None and name in kept}
            self._needs[topic] = None if kept is None else kept.union(*paths.values()), paths, kept
        return self._needs[topic]

    def _lifter(self, schema: MessageSchema, topic: str) -> Lifter:
        only, _, _ = self._needed(topic)
        return partial_lifter(schema, self._session.lifting, only, is_linked=self._query.is_linked)

    def _column_lifter(self, schema: MessageSchema, topic: str, url: str) -> ColumnLifter | None:
        key = schema.ref, topic
        if key not in self._lifters:
            only, _, _ = self._needed(topic)
            lifter, is_simulated = self._lifter(schema, topic), self._session.graph.simulated_time
            assert only is not None
            self._lifters[key] = column_lifter(
                lifter,
                only,
                url,
                MESSAGE,
                partial(self._shorten, topic),
                datatype=_datatype,
                simulated_time=is_simulated,
            )
        return self._lifters[key]

    def _shorten(self, topic: str, text: str, message: str) -> str:
        """Return the text of a message with a statement for each path that is needed of it."""
        _, paths, kept = self._needed(topic)
        return shorten_paths(text, message, paths, kept) if paths and kept is not None else text

    def _note(self, record_text: _RecordText, topic: str, times: Sequence[int], numbers: Sequence[int]) -> None:
        """Note the times and numbers if the query asks for their order."""
        if self._query.is_ordered:
            place = record_text.topic(topic), record_text.messages
            self._times.setdefault(place, []).extend(zip(times, numbers, strict=True))

    def _lift(self, recording: Recording, message: RecordedMessage, record_text: _RecordText) -> str:
        """Return the text of a message and its record."""
        sample = message.sample
        schema = self._schema(recording, sample.schema)
        url = f"{record_text.messages}{message.index}"
        if schema is None:
            return record_text.of_record(url, message, f"the type {sample.schema.name} is not known")
        try:
            decoded = schema.codec.decode(sample.data, sample.encoding)
        except ValueError as error:
            return record_text.of_record(url, message, str(error))
        publisher = self._session.space.node(sample.publisher) if sample.publisher else None
        if publisher is not None and not self._dataset.permissions.may_read(publisher):
            publisher = None
        envelope = Envelope(sample.received_ns, sample.sequence, publisher)
        lifted = self._lifter(schema, message.topic).ntriples(
            decoded, url, MESSAGE, envelope=envelope, simulated_time=self._session.graph.simulated_time
        )
        lifted = self._shorten(message.topic, lifted, url + MESSAGE)
        self._note(record_text, message.topic, [sample.received_ns], [message.index])
        if self._is_placed(schema) and (place := geometry_of(schema, decoded)) is not None:
            self._placed_ns.append(sample.received_ns)
            lifted += geometry_ntriples(url + MESSAGE, place, self._session.space.frames, only=self._query.predicates)
        return f"{record_text.of_record(url, message)}{lifted}"


def _datatype(name: str) -> str:
    return private_datatype(name).value


def _by_topic(counts: Mapping[tuple[str, str], int]) -> Counter[str]:
    found = Counter[str]()
    for (topic, _), count in counts.items():
        found[topic] += count
    return found


def _message_times(place: tuple[str, str], messages: list[tuple[int, int]]) -> MessageTimes:
    messages.sort()
    times, numbers = (array("q", each) for each in zip(*messages, strict=True))
    return MessageTimes(*place, times, numbers)


def _earlier(recording: Recording, topic: str, time_ns: int, count: int) -> int:
    """Return the time of the message that is `count` messages before a time, or of the first."""
    for _ in range(count):
        with suppress(RosError):
            found = recording.latest_at(topic, time_ns - 1) if time_ns else None
            time_ns = time_ns if found is None else found.sample.received_ns
    return time_ns


class _RecordText:
    """N-Triples about the messages of a recording, without their content."""

    def __init__(self, space: Space, recording: Recording, only: frozenset[str] | None, *, is_linked: bool) -> None:
        self.messages = space.bag_messages(recording.name)
        self._bag = space.bag(recording.name)
        self._name = recording.name
        self.topic = lru_cache(maxsize=1024)(space.topic)
        self._only = only
        self.is_more = only is None or not only.isdisjoint(_OF_RECORDS)
        self.is_of_records = self.is_more
        """Whether more is needed of records than that a message is recorded in the recording."""
        if only is not None and is_linked and only & _OF_RECORDS == {ros.recordedIn.value}:
            self.is_of_records = False

    def recorded_in(self, documents: Sequence[str]) -> str:
        """Return the statements that the messages of these records are in this recording, if they are needed."""
        if not self.is_more:
            return ""
        return "".join(f"<{each}{MESSAGE}> <{ros.recordedIn.value}> <{self._bag}> .\n" for each in documents)

    def of_record(self, url: str, message: RecordedMessage, reason: str | None = None) -> str:
        """Return the text about one message; `reason` says why it is unreadable, if it is."""
        topic = self.topic(message.topic)
        link = f"<{topic}> <{ros.past.value}> <{url}{MESSAGE}> .\n" if reason is None else ""
        if not self.is_more:
            return link
        return link + "".join(self._more(url, topic, message, reason))

    def _more(self, url: str, topic: str, message: RecordedMessage, reason: str | None) -> Iterator[str]:
        received = f'"{date_time(0, message.sample.received_ns)}"^^<{xsd.dateTime.value}>'
        record_text = [
            *((rdf.type, f"<{each.value}>") for each in (ros.Record, ldp.Resource, ldp.RDFSource)),
            (rdfs.label, quote(f"Message {message.index} of {self._name}")),
            (ros.recordedIn, f"<{self._bag}>"),
            (ros.index, f'"{message.index}"^^<{xsd.integer.value}>'),
            (ros.onTopic, f"<{topic}>"),
            (ros.recordedAt, received),
            *([(ros.opensRecording, f'"true"^^<{xsd.boolean.value}>')] if message.is_opening else []),
            (ros.recordedMessage, f"<{url}{MESSAGE}>") if reason is None else (ros.unreadable, quote(reason or "")),
        ]
        for predicate, value in record_text if self.is_of_records else ():
            if self._only is None or predicate.value in self._only:
                yield f"<{url}> <{predicate.value}> {value} .\n"
        if reason is None and (self._only is None or ros.recordedIn.value in self._only):
            yield f"<{url}{MESSAGE}> <{ros.recordedIn.value}> <{self._bag}> .\n"


_OF_RECORDS = frozenset(
    each.value
    for each in (
        rdf.type, ros.recordedIn, ros.index, ros.onTopic, ros.recordedAt, ros.opensRecording, ros.recordedMessage,
        ros.unreadable,
    )
)  # fmt: skip


def _list(topics: Sequence[str]) -> str:
    """Return a readable list of at most three topics."""
    shown = ", ".join(topics[:3])
    return f"{shown} and {len(topics) - 3} more topics" if len(topics) > 3 else shown or "no topic"
