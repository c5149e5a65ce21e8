"""What is said of recordings that can be read, that are being made, and that wait for their trigger."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from rosld.adapters.base import RecordedTopic, Recording
from rosld.ontology.describe_bags import bag_document
from rosld.ontology.document import Document
from rosld.ontology.urls import Space
from rosld.server.history.history import History
from rosld.server.history.recordings import ArmedRecording, Recordings, RunningRecording


class ArmedView:
    """A recording that waits for its trigger, as it is described."""

    format = "MCAP"
    first = count = start_ns = end_ns = 0
    topics: Mapping[str, RecordedTopic] = {}

    def __init__(self, name: str) -> None:
        self.name = name


class RunningView:
    """A recording that is being made, as it is described."""

    format = "MCAP"
    first = 0

    def __init__(self, one: RunningRecording) -> None:
        self.name = one.name
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


def describe_bag(space: Space, history: History, recording: Recording) -> Document:
    """The document of a recording that can be read."""
    if recording is history.recording:
        return bag_document(recording, space, dropped=history.dropped(), problem=history.problem)
    size: int | None = None
    with contextlib.suppress(OSError):
        size = recording.path.stat().st_size if recording.path.is_file() else None
    return bag_document(recording, space, history.digests.known(recording.path), size=size)


def describe_running(space: Space, recordings: Recordings, one: RunningRecording) -> Document:
    """The document of a recording that is being made."""
    writer, dropped = one.writer, recordings.dropped(one)
    view = RunningView(one)
    return bag_document(view, space, dropped=dropped, problem=writer.problem, size=writer.size, order=one.order)


def describe_armed(space: Space, one: ArmedRecording) -> Document:
    """The document of a recording that waits for its trigger."""
    view = ArmedView(one.name)
    return bag_document(view, space, problem=one.problem, order=one.order, triggered=one.count)
