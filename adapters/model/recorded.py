"""Parts of recordings, and orders of new ones.

The package does not import this module: its rover also runs in a rospy without msgspec.
"""

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


class Trigger(Struct, frozen=True):
    """Trigger of a recording: `condition` becomes true for the value at the URL `resource`.

    Without a resource, `condition` is the IRI of a condition of a mapping. `limit` is the maximum number of recordings.
    """

    condition: str
    resource: str | None = None
    limit: int = 1


class RecordingOrder(Struct, frozen=True):
    """Order of a recording: topics by name or glob, from `before` seconds ago, for `duration` (None: until ended).

    With a trigger it starts when the trigger fires, and `before` counts from then.
    """

    topics: tuple[str, ...]
    name: str | None = None
    before: float = 0.0
    duration: float | None = None
    trigger: Trigger | None = None
