"""Orders of clients to record topics, and their form in JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass


class RecordingRefused(Exception):
    """A recording is refused: its name is in use (`taken`), it is too large (`is_too_large`), else it is invalid."""

    def __init__(self, words: str, *, taken: bool = False, is_too_large: bool = False) -> None:
        super().__init__(words)
        self.taken = taken
        self.is_too_large = is_too_large


@dataclass(frozen=True, slots=True)
class Trigger:
    """When a recording begins: as `condition` comes to hold of the value at the URL `resource`.

    Without a resource the condition is the IRI of one of a mapping. `limit` is how often that begins a recording.
    """

    condition: str
    resource: str | None = None
    limit: int = 1


@dataclass(frozen=True, slots=True)
class RecordingOrder:
    """What is to be recorded: topics by name or glob, from `before` seconds ago, for `duration` (None: until ended).

    With a trigger it begins when that says so, and `before` counts from then.
    """

    topics: tuple[str, ...]
    name: str | None = None
    before: float = 0.0
    duration: float | None = None
    trigger: Trigger | None = None


def order_to_json(order: RecordingOrder) -> dict[str, object]:
    """An order as clients send it in JSON."""
    return {**asdict(order), "topics": list(order.topics)}


def order_from_json(members: Mapping[str, object]) -> RecordingOrder:
    """The order that was kept as these members. Raises KeyError, TypeError, ValueError for what is none."""
    topics, trigger, name = members["topics"], members.get("trigger"), members.get("name")
    before, duration = members.get("before", 0.0), members.get("duration")
    if not isinstance(topics, list) or not all(isinstance(each, str) for each in topics):
        raise TypeError("its topics are no list of names")
    if not isinstance(name, str | None) or not isinstance(trigger, dict | None):
        raise TypeError("its name or its trigger is none")
    if not isinstance(before, float | int) or not isinstance(duration, float | int | None):
        raise TypeError("its seconds are no numbers")
    return RecordingOrder(tuple(topics), name, before, duration, None if trigger is None else _trigger(trigger))


def _trigger(members: Mapping[str, object]) -> Trigger:
    condition, resource, limit = members["condition"], members.get("resource"), members.get("limit", 1)
    if not isinstance(condition, str) or not isinstance(resource, str | None) or not isinstance(limit, int):
        raise TypeError("its trigger is none")
    return Trigger(condition, resource, limit)
