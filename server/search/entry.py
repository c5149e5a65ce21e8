"""Entries: what can be found, each with what it is found by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum


class EntryKind(Enum):
    """What an entry is of; of several that fit equally well the first kind here comes first."""

    ACTION = "action"
    TOPIC = "topic"
    SERVICE = "service"
    RESOURCE = "resource"
    PARAMETER = "parameter"
    NODE = "node"
    QUERY = "query"
    MAPPING = "mapping"
    DOCUMENT = "document"


@dataclass(frozen=True, slots=True)
class Entry:
    """Something with a URL.

    `name` is a ROS name, or the path of what clients keep. `types` are the names of its ROS types, as a rule one.
    `texts` are titles, descriptions and units. `resource` is the URL below `/resources/` that stands for the same.
    """

    kind: EntryKind
    name: str
    url: str
    types: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    resource: str | None = None


@dataclass(frozen=True, slots=True)
class Catalog:
    """All entries, and the fields of their types by the names of these (`pose.position.x`)."""

    entries: Sequence[Entry]
    fields: Mapping[str, Sequence[str]] = field(default_factory=dict)
