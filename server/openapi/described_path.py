"""A URL, or a template of URLs, with what it answers: a member of the Paths Object (OpenAPI 3.1.1, 4.8.8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rosld.server.rest.path_item import PathItem, WriteMethod


@dataclass(frozen=True, slots=True)
class DescribedPath:
    """What `template` answers. It lies below the base and begins with a slash, encoded as in the URL.

    Names in braces stand for segments, each told of in `segments`. `accepts` are the media types that each of the
    `methods` takes.
    """

    template: str
    tag: str
    item: PathItem
    methods: frozenset[str]
    accepts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    segments: Mapping[str, str] = field(default_factory=dict)

    def write(self, method: str) -> WriteMethod:
        """What is told of a method that writes."""
        return self.item.write(method)
