"""Parts of the description: some of its paths, with the components that these refer to. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import orjson

from rosld.server.openapi.references import Components, Key, chosen, references
from rosld.server.rest.path_item import MAX_PART, part_url


def sections(url: str, paths: Collection[str]) -> list[dict[str, object]]:
    """The parts of the description at `url`, by the first segments of its paths, each with the number of its paths."""
    firsts = dict.fromkeys("/" + "".join(path[1:].partition("/")[:2]) for path in paths)
    return [{"url": part_url(url, first), "paths": sum(path.startswith(first) for path in paths)} for first in firsts]


def description_parts(data: bytes, url: str, below: str) -> tuple[bytes, ...]:
    """The parts of the description at `url` that tell of paths that begin with `below`; none where there are none."""
    said = orjson.loads(data)
    components: Components = said.pop("components")
    paths: Mapping[str, object] = said.pop("paths")
    tags = said.pop("tags")
    said.pop("x-parts")
    always = {("securitySchemes", name) for name in components.get("securitySchemes", ())}
    weights = _Weights(components)
    room = MAX_PART - len(orjson.dumps({**said, "tags": tags})) - len(part_url(url, below)) - _FRAME
    found: list[_Part] = []
    for path, item in paths.items():
        if not path.startswith(below):
            continue
        needed = references(item, components) | always
        own = len(orjson.dumps(item)) + len(path) + _PUNCTUATION
        if not found or found[-1].size + own + weights.of(needed - found[-1].keys) > room:
            found.append(_Part())
        found[-1].add(path, item, needed, own + weights.of(needed - found[-1].keys))
    return tuple(
        orjson.dumps(
            {
                **said,
                **({"x-next": part_url(url, below, number)} if number < len(found) else {}),
                "tags": [tag for tag in tags if tag["name"] in part.tags(components)],
                "paths": part.paths,
                "components": chosen(components, part.keys),
            }
        )
        for number, part in enumerate(found, 1)
    )


_PUNCTUATION = 6
"""Bytes between the members of an object."""
_FRAME = 300
"""Bytes of what holds paths and components together."""


@dataclass
class _Part:
    """Paths, what they need, and how large that is."""

    paths: dict[str, object] = field(default_factory=dict)
    keys: set[Key] = field(default_factory=set)
    size: int = 0

    def add(self, path: str, item: object, needed: set[Key], size: int) -> None:
        """Add a path, whose item and whatever else it needs have this size."""
        self.paths[path] = item
        self.keys |= needed
        self.size += size

    def tags(self, components: Components) -> set[object]:
        """The tags of the operations of its paths."""
        items = [*self.paths.values(), *(components[kind][name] for kind, name in self.keys if kind == "pathItems")]
        operations = [one for item in items if isinstance(item, dict) for one in item.values() if isinstance(one, dict)]
        return {tag for one in operations for tag in one.get("tags", ())}


class _Weights:
    """The sizes of components, each written once to be measured."""

    def __init__(self, components: Components) -> None:
        self._components = components
        self._known: dict[Key, int] = {}

    def of(self, keys: set[Key]) -> int:
        """The size of all of these."""
        return sum(map(self._one, keys))

    def _one(self, key: Key) -> int:
        found = self._known.get(key)
        if found is None:
            kind, name = key
            found = self._known[key] = len(orjson.dumps(self._components[kind][name])) + len(name) + _PUNCTUATION
        return found
