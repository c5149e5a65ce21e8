"""Cuts of recordings: the messages of some topics between two times, in a file of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import BinaryIO, NamedTuple

from rosld.adapters.base import MessageFilter, Recording
from rosld.adapters.model import Encoding, TypeRef, UnknownType
from rosld.server.history.history_writer import require_room
from rosld.server.history.recording_writer import ACTIVE, RecordingWriter

_PAGE = 2000
"""Number of messages read at a time."""
MAX_CUTS = 100
"""Maximum number of cuts around the times of one query."""


class CutRefused(ValueError):
    """Why there is no such cut: a sentence without its full stop."""


class Span(NamedTuple):
    """The times between which messages are cut out, in ns, inclusive."""

    from_ns: int
    to_ns: int


def spans_around(times: Sequence[int], before: float, after: float) -> Sequence[Span]:
    """Return the spans from `before` seconds before to `after` seconds after these times; overlapping ones are joined.

    Raises CutRefused if there are none or too many.
    """
    spans: list[Span] = []
    for time in sorted(times):
        found = Span(time - round(before * 1e9), time + round(after * 1e9))
        if spans and found.from_ns <= spans[-1].to_ns:
            spans[-1] = Span(spans[-1].from_ns, found.to_ns)
        else:
            spans.append(found)
    if not spans:
        raise CutRefused("nothing was found to cut around")
    if len(spans) > MAX_CUTS:
        raise CutRefused(f"{len(spans)} places were found to cut around, more than {MAX_CUTS}: ask for fewer")
    return spans


def selected(topics: Sequence[str]) -> Callable[[str], bool]:
    """Return whether a topic matches one of these names and globs, any topic if there are none."""
    return lambda topic: not topics or any(fnmatchcase(topic, glob) for glob in topics)


def write_cut(
    recording: Recording,
    path: Path,
    encoding: Encoding,
    selects: Callable[[str], bool],
    span: Span,
    stream: BinaryIO | None = None,
) -> RecordingWriter:
    """Write a cut as MCAP to a path or a stream; return its closed writer.

    The latched messages in force at its start open it. Raises CutRefused if it has no message, OSError, and RosError if
    the recording cannot be read.
    """

    def definition_of(ref: TypeRef) -> str:
        try:
            return recording.schema(ref).definition
        except UnknownType:
            return ""

    writer = RecordingWriter(path, encoding, definition_of, require_room, span.from_ns, stream)
    try:
        for topic, sample in recording.latched_before(span.from_ns, selects):
            writer.add(topic, sample)
        opening, topics = writer.count, frozenset(filter(selects, recording.topics))
        start: int | None = recording.first
        while start is not None and writer.problem is None:
            page = recording.select(MessageFilter(topics, span.from_ns, span.to_ns, start), _PAGE)
            for message in page.messages:
                writer.add(message.topic, message.sample)
            start = page.next
        if writer.count == opening and writer.problem is None:
            raise CutRefused(f"{recording.name} has no messages of these topics in that period")
        writer.close()
    except BaseException:
        path.with_name(path.name + ACTIVE).unlink(missing_ok=True)
        raise
    if writer.problem is not None:
        path.unlink(missing_ok=True)
        raise OSError(writer.problem)
    return writer
