"""Descriptions of recordings: of those that can be read, are being made, or wait for their trigger."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence

from rosld.adapters.base import RecordedTopic, Recording
from rosld.ontology.describe_bags import bag_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.history.armed_recordings import ArmedRecording
from rosld.server.history.recordings import Recordings, RunningRecording


class ArmedView:
    """A recording that waits for its trigger, as it is described."""

    format = "MCAP"
    first = count = start_ns = end_ns = 0
    topics: Mapping[str, RecordedTopic] = {}
    silent: Sequence[str] = ()

    def __init__(self, name: str) -> None:
        self.name = name


class RunningView:
    """A recording that is being made, as it is described."""

    format = "MCAP"
    first = 0

    def __init__(self, one: RunningRecording, silent: Sequence[str]) -> None:
        self.name = one.name
        self.silent = silent
        self.count = one.writer.count
        self.start_ns = one.writer.start_ns
        self.end_ns = one.writer.end_ns
        types = one.writer.types
        counts = dict(one.writer.counts)
        self.topics = {topic: RecordedTopic(topic, types[topic], n) for topic, n in counts.items() if topic in types}


def bag_urls(space: Space, recordings: Recordings) -> tuple[str, ...]:
    """The URLs of all recordings, those that are being made, and those that wait to be, included."""
    names = (*recordings.readable, *recordings.running, *recordings.armed)
    return tuple(map(space.bag, dict.fromkeys(names)))


def describe_bag(space: Space, recordings: Recordings, recording: Recording) -> Document:
    """The document of a recording that can be read."""
    history = recordings.history
    if recording is history.recording:
        return bag_document(recording, space, dropped=history.dropped(), problem=history.problem)
    size: int | None = None
    with contextlib.suppress(OSError):
        size = recording.path.stat().st_size if recording.path.is_file() else None
    why = recordings.interruption(recording.name)
    digest, status = history.digests.known(recording.path), None if why is None else "interrupted"
    return bag_document(recording, space, digest, size=size, problem=why, status=status)


def describe_running(space: Space, recordings: Recordings, one: RunningRecording) -> Document:
    """The document of a recording that is being made."""
    writer = one.writer
    return bag_document(
        RunningView(one, recordings.silent(one)),
        space,
        dropped=recordings.dropped(one),
        problem=writer.problem,
        size=writer.size,
        status="recording",
        order=one.order,
    )


def describe_armed(space: Space, one: ArmedRecording) -> Document:
    """The document of a recording that waits for its trigger."""
    status, problem = ("armed", one.problem) if one.suspended is None else ("suspended", one.suspended)
    view = ArmedView(one.name)
    return bag_document(view, space, problem=problem, status=status, order=one.order, triggered=one.count)
