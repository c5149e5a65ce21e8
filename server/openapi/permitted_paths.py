"""The description as it is for one agent: operations it may use, what these refer to, what they demand. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import replace
from typing import TypeAlias

import orjson

from rosld.server.hypermedia.json_schema import JsonSchema
from rosld.server.openapi.described_path import DescribedPath
from rosld.server.openapi.references import chosen, references

_Json: TypeAlias = "dict[str, object]"
May: TypeAlias = Callable[[str, str], bool]
"""Whether a method may be used at a path."""
_METHODS = ("get", "head", "options", "put", "post", "patch", "delete")
_ITEMS = "#/components/pathItems/"
_SCHEMES: _Json = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "A token, as whoever runs this server gives it."},
    "basic": {"type": "http", "scheme": "basic", "description": "The same token as the password; the name is free."},
}
_DEMANDED: list[_Json] = [{"bearer": []}, {"basic": []}]


def permitted_paths(
    paths: Iterable[DescribedPath], may: May, may_read: Callable[[str], bool]
) -> Iterator[DescribedPath]:
    """The paths that an agent may use, with those methods and those members of their JSON that it may know of."""
    for path in paths:
        methods = frozenset(method for method in path.methods if may(method, path.template))
        if methods - {"OPTIONS"}:
            found = replace(path, methods=methods)
            yield _without_members(found, may_read) if path.item.members else found


def _without_members(path: DescribedPath, may_read: Callable[[str], bool]) -> DescribedPath:
    """The path without the members of its JSON that are values of what may not be read."""
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
    """The schema of an object without these members."""
    members = schema.get("properties")
    if not isinstance(members, dict):
        return schema
    return {**schema, "properties": {name: each for name, each in members.items() if name not in hidden}}


def add_security(data: bytes, public: May, *, whole: bool) -> bytes:
    """The description of what an agent may use, with how it says who it is: what the `public` may do takes no token."""
    said = orjson.loads(data)
    shared: _Json = said["components"].get("pathItems", {})
    made: _Json = {}
    paths: _Json = {}
    for path, item in said["paths"].items():
        name = item.get("$ref", "").removeprefix(_ITEMS)
        left = dict(_object(shared[name] if name else item))
        free = [method for method in _METHODS if method in left and public(method.upper(), path)]
        for method in free:
            left[method] = {**_object(left[method]), "security": [{}, *_DEMANDED]}
        if not name:
            paths[path] = left
            continue
        kind = ".".join((name, *(f"free-{each}" for each in free)))
        made[kind] = left
        paths[path] = {"$ref": _ITEMS + kind}
    said["paths"] = paths
    said["components"]["pathItems"] = made
    said["components"]["securitySchemes"] = _SCHEMES
    said["security"] = _DEMANDED
    if not whole:
        said["components"] = _referred_to(said)
    return orjson.dumps(said)


def _object(found: object) -> _Json:
    assert isinstance(found, dict)
    return found


def _referred_to(said: _Json) -> _Json:
    """The components that something refers to, and what these refer to."""
    components = said["components"]
    assert isinstance(components, dict)
    found = references({name: part for name, part in said.items() if name != "components"}, components)
    return chosen(components, found | {("securitySchemes", name) for name in _SCHEMES})
