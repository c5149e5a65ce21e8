"""References to components (OpenAPI 3.1.1, 4.8.23): which of them some part of a description needs. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set
from typing import TypeAlias

Components: TypeAlias = "Mapping[str, Mapping[str, object]]"
"""Components by their kinds and names."""
Key: TypeAlias = "tuple[str, str]"
_PREFIX = "#/components/"


def references(part: object, components: Components) -> set[Key]:
    """The kinds and names of the components that something refers to, and that these refer to."""
    found: set[Key] = set()
    wanted = [part]
    while wanted:
        for kind, name in _direct(wanted.pop()):
            if (kind, name) not in found and name in components.get(kind, {}):
                found.add((kind, name))
                wanted.append(components[kind][name])
    return found


def chosen(components: Components, keys: Set[Key]) -> dict[str, object]:
    """The components of these kinds and names, in their order."""
    kinds = {
        kind: {name: each for name, each in named.items() if (kind, name) in keys} for kind, named in components.items()
    }
    return {kind: named for kind, named in kinds.items() if named}


def _direct(part: object) -> Iterator[Key]:
    if isinstance(part, dict):
        reference = part.get("$ref")
        if isinstance(reference, str) and reference.startswith(_PREFIX):
            kind, _, name = reference.removeprefix(_PREFIX).partition("/")
            yield kind, name
        for inner in part.values():
            yield from _direct(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from _direct(inner)
