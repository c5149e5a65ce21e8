"""The description as it is for one agent: operations it may use, what these refer to, what they demand. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias

import orjson

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


def for_agent(data: bytes, may: May, public: May, *, whole: bool) -> bytes:
    """The description for an agent, who `may` use methods at paths; what the `public` may do as well takes no token."""
    said = orjson.loads(data)
    shared: _Json = said["components"].get("pathItems", {})
    made: _Json = {}
    paths: _Json = {}
    for path, item in said["paths"].items():
        name = item.get("$ref", "").removeprefix(_ITEMS)
        every = _object(shared[name] if name else item)
        left = _item(every, path, may)
        if left is None:
            continue
        free = [method for method in _METHODS if method in left and public(method.upper(), path)]
        for method in free:
            left[method] = {**_object(left[method]), "security": [{}, *_DEMANDED]}
        if not name:
            paths[path] = left
            continue
        kind = ".".join((name, *(method for method in _METHODS if method in left), *(f"free-{each}" for each in free)))
        made[kind] = left
        paths[path] = {"$ref": _ITEMS + kind}
    said["paths"] = paths
    said["components"]["pathItems"] = made
    said["components"]["securitySchemes"] = _SCHEMES
    said["security"] = _DEMANDED
    if not whole:
        said["components"] = _referred_to(said)
        used = {tag for item in (*paths.values(), *made.values()) for tag in _tags(_object(item))}
        said["tags"] = [tag for tag in said["tags"] if tag["name"] in used]
    return orjson.dumps(said)


def _object(found: object) -> _Json:
    assert isinstance(found, dict)
    return found


def _item(item: _Json, path: str, may: May) -> _Json | None:
    """A Path Item with those operations that may be used, None where only OPTIONS is left."""
    left = {name: said for name, said in item.items() if name not in _METHODS or may(name.upper(), path)}
    return left if any(name in left for name in _METHODS if name != "options") else None


def _tags(item: _Json) -> Iterator[object]:
    for name in _METHODS:
        operation = item.get(name)
        if isinstance(operation, dict):
            yield from operation.get("tags", ())


def _referred_to(said: _Json) -> _Json:
    """The components that something refers to, and what these refer to."""
    components = _object(said["components"])
    wanted = list(_references({name: part for name, part in said.items() if name != "components"}))
    kept: dict[str, dict[str, object]] = {"securitySchemes": _object(components["securitySchemes"])}
    while wanted:
        _, _, kind, name = wanted.pop().split("/", 3)
        if name in kept.setdefault(kind, {}):
            continue
        part = _object(components[kind]).get(name)
        if part is None:
            continue
        kept[kind][name] = part
        wanted += _references(part)
    return dict(kept)


def _references(part: object) -> Iterable[str]:
    if isinstance(part, dict):
        reference = part.get("$ref")
        if isinstance(reference, str) and reference.startswith("#/components/"):
            yield reference
        for inner in part.values():
            yield from _references(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from _references(inner)
