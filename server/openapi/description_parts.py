"""Parts of the description: permitted operations, paths below one, and the components they reference. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from typing import TypeAlias

import orjson
from msgspec.structs import replace

from rosld.server.hypermedia.json_schema import JsonSchema
from rosld.server.openapi.path_collector import DescribedPath
from rosld.server.rest.path_item import MAX_PART, PUNCTUATION, cut_parts, part_url

Components: TypeAlias = "Mapping[str, Mapping[str, object]]"
"""Components by their kinds and names."""
Key: TypeAlias = "tuple[str, str]"
_PREFIX = "#/components/"


def references(part: object, components: Components) -> set[Key]:
    """Return the kinds and names of the components that an object references, directly or indirectly."""
    found: set[Key] = set()
    wanted = [part]
    while wanted:
        for kind, name in _direct(wanted.pop()):
            if (kind, name) not in found and name in components.get(kind, {}):
                found.add((kind, name))
                wanted.append(components[kind][name])
    return found


def chosen(components: Components, keys: Set[Key]) -> dict[str, object]:
    """Return the components of these kinds and names, in order."""
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


def sections(url: str, paths: Collection[str]) -> list[dict[str, object]]:
    """Return the parts of the description at `url`, by first path segment, each with the number of its paths."""
    firsts = dict.fromkeys("/" + "".join(path[1:].partition("/")[:2]) for path in paths)
    return [{"url": part_url(url, first), "paths": sum(path.startswith(first) for path in paths)} for first in firsts]


def description_parts(data: bytes, url: str, below: str) -> tuple[bytes, ...]:
    """Return the parts of the description at `url` for paths that begin with `below`; empty if there are none."""
    said = orjson.loads(data)
    components: Components = said.pop("components")
    paths: Mapping[str, object] = said.pop("paths")
    tags = said.pop("tags")
    said.pop("x-parts")
    always = {("securitySchemes", name) for name in components.get("securitySchemes", ())}
    weights = {
        (kind, name): len(orjson.dumps(each)) + len(name) + PUNCTUATION
        for kind, named in components.items()
        for name, each in named.items()
    }
    room = MAX_PART - len(orjson.dumps({**said, "tags": tags})) - len(part_url(url, below)) - _FRAME
    members = []
    for path in (path for path in paths if path.startswith(below)):
        needed = references(paths[path], components) | always
        size = len(orjson.dumps(paths[path])) + len(path) + PUNCTUATION
        members.append(((path, needed), size, {key: weights[key] for key in needed}))
    parts = tuple(cut_parts(members, room))
    return tuple(
        orjson.dumps(
            {
                **said,
                **({"x-next": part_url(url, below, number)} if number < len(parts) else {}),
                "tags": [tag for tag in tags if tag["name"] in used],
                "paths": {path: paths[path] for path, _ in part},
                "components": chosen(components, {key for _, needed in part for key in needed}),
            }
        )
        for number, part in enumerate(parts, 1)
        for used in [_tags(paths[path] for path, _ in part)]
    )


_FRAME = 300
"""Bytes of the frame around paths and components."""


def _tags(items: Iterable[object]) -> set[object]:
    operations = (one for item in items if isinstance(item, dict) for one in item.values() if isinstance(one, dict))
    return {tag for one in operations for tag in one.get("tags", ())}


_Json: TypeAlias = "dict[str, object]"
May: TypeAlias = Callable[[str, str], bool]
"""Permission for a method at a path."""
_METHODS = frozenset({"get", "put", "post", "patch", "delete"})
_SCHEMES: _Json = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "A token from the operator of this server."},
    "basic": {"type": "http", "scheme": "basic", "description": "The same token as the password, with any user name."},
}
_DEMANDED: list[_Json] = [{"bearer": []}, {"basic": []}]


def permitted_paths(
    paths: Iterable[DescribedPath], may: May, may_read: Callable[[str], bool]
) -> Iterator[DescribedPath]:
    """Yield the paths that an agent may use, with the permitted methods and the readable members of their JSON."""
    for path in paths:
        methods = frozenset(method for method in path.methods if may(method, path.template))
        if methods - {"OPTIONS"}:
            found = replace(path, methods=methods)
            yield _without_members(found, may_read) if path.item.members else found


def _without_members(path: DescribedPath, may_read: Callable[[str], bool]) -> DescribedPath:
    """Return the path without the JSON members that contain values the agent may not read."""
    item = path.item
    hidden = {name for name, url in item.members.items() if not may_read(url)}
    if not hidden:
        return path
    writes = {
        name: replace(each, sends=None if each.sends is None else _left(each.sends, hidden))
        for name, each in item.writes.items()
    }
    plain = None if item.plain is None else _left(item.plain, hidden)
    return replace(path, item=replace(item, plain=plain, writes=writes))


def _left(schema: JsonSchema, hidden: Set[str]) -> JsonSchema:
    """Return the schema of an object without these members."""
    members = schema.get("properties")
    if not isinstance(members, dict):
        return schema
    return {**schema, "properties": {name: each for name, each in members.items() if name not in hidden}}


def add_security(data: bytes, public: May, *, whole: bool) -> bytes:
    """Return the description with its security schemes; operations permitted to the `public` need no token."""
    said = orjson.loads(data)
    for path, item in said["paths"].items():
        for method in _METHODS & item.keys():
            if public(method.upper(), path):
                item[method]["security"] = [{}, *_DEMANDED]
    said["components"]["securitySchemes"] = _SCHEMES
    said["security"] = _DEMANDED
    if not whole:
        said["components"] = _referred_to(said)
    return orjson.dumps(said)


def _referred_to(said: _Json) -> _Json:
    """Return the components that an object references, directly or indirectly."""
    components = said["components"]
    assert isinstance(components, dict)
    found = references({name: part for name, part in said.items() if name != "components"}, components)
    return chosen(components, found | {("securitySchemes", name) for name in _SCHEMES})
