"""Parts of recordings. The package does not import this module: its rover also runs in a rospy without msgspec."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from rosld.adapters.model.schema import Sample, TypeRef


class RecordedTopic(Struct, frozen=True):
    """A topic of a recording: its type, its number of messages, and the reason they cannot be decoded, if any."""

    name: str
    type: TypeRef
    count: int
    unreadable: str | None = None


class RecordedMessage(Struct, frozen=True):
    """Message `index` (from 0, in recorded order) of a recording.

    `is_opening`: a latched message sent before the recording began, repeated at its start.
    """

    index: int
    topic: str
    sample: Sample
    is_opening: bool = False


class Event(NamedTuple):
    """Something that happened in a recording, at a time or during a span (ns)."""

    name: str
    start_ns: int
    end_ns: int | None = None
