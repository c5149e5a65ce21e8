"""The description: an OpenAPI Object (OpenAPI 3.1.1, 4.8.1) of paths, and parts of it. Equal paths give equal bytes."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from http import HTTPStatus
from itertools import chain, count
from typing import TypeAlias

import orjson
from msgspec.structs import replace

from rosld.server.events.query_params import EVENT_STREAM
from rosld.server.hypermedia.json_schema import TEXT, Json, JsonSchema
from rosld.server.openapi.components import Components, body_content, content, headers, or_plan, parameter, reference
from rosld.server.openapi.path_collector import DescribedPath
from rosld.server.rest.formats import OFFER_TYPE
from rosld.server.rest.path_item import (
    FIELD_READS,
    MAX_PART,
    OF_EVERY_WRITE,
    PUNCTUATION,
    QueryParameter,
    cut_parts,
    part_url,
)

ComponentTable: TypeAlias = "Mapping[str, Mapping[str, object]]"
"""ComponentTable by their kinds and names."""
Key: TypeAlias = "tuple[str, str]"
_PREFIX = "#/components/"


def references(part: object, components: ComponentTable) -> set[Key]:
    """Return the kinds and names of the components that an object references, directly or indirectly."""
    found: set[Key] = set()
    wanted = [part]
    while wanted:
        for kind, name in _direct(wanted.pop()):
            if (kind, name) not in found and name in components.get(kind, {}):
                found.add((kind, name))
                wanted.append(components[kind][name])
    return found


def chosen(components: ComponentTable, keys: Set[Key]) -> dict[str, object]:
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
    components: ComponentTable = said.pop("components")
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
SECURITY_SCHEMES: _Json = {
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
    said["components"]["securitySchemes"] = SECURITY_SCHEMES
    said["security"] = _DEMANDED
    if not whole:
        said["components"] = _referred_to(said)
    return orjson.dumps(said)


def _referred_to(said: _Json) -> _Json:
    """Return the components that an object references, directly or indirectly."""
    components = said["components"]
    assert isinstance(components, dict)
    found = references({name: part for name, part in said.items() if name != "components"}, components)
    return chosen(components, found | {("securitySchemes", name) for name in SECURITY_SCHEMES})


VERSION = "3.1.1"
_ORDER = ("GET", "PUT", "POST", "PATCH", "DELETE")
_TEMPLATE = re.compile(r"\{([^{}]+)\}")
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9]+")
_VERBS = {
    "GET": "Read", "PUT": "Write", "POST": "Post to", "PATCH": "Change", "DELETE": "Delete",
}  # fmt: skip


def description(
    title: str,
    base: str,
    version: str,
    about: str,
    described: Iterable[DescribedPath],
    schemas: Mapping[str, JsonSchema],
    *,
    query: str = "",
) -> bytes:
    """Return the description of a server at `base` as JSON; `schemas` are the components that paths reference by name.

    `query` is the query of its URL, which the URLs of its parts have as well.
    """
    ordered = sorted({path.template: path for path in described}.values(), key=lambda path: path.template)
    components = Components(schemas)
    writer = _Writer(components)
    paths = {path.template: writer.path_item(path) for path in ordered}
    return orjson.dumps(
        {
            "openapi": VERSION,
            "info": {
                "title": title,
                "version": version,
                "description": about,
                "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
            },
            "servers": [{"url": base.rstrip("/")}],
            "tags": [{"name": tag} for tag in dict.fromkeys(path.tag for path in ordered)],
            "x-parts": sections(f"{base}openapi.json{query}", paths),
            "paths": paths,
            "components": components.objects,
        }
    )


class _Writer:
    """Writer of Path Items, which stores shared objects in `components`."""

    def __init__(self, components: Components) -> None:
        self._components = components
        self._names: set[str] = set()

    def path_item(self, path: DescribedPath) -> dict[str, Json]:
        """Return the Path Item Object (4.8.9): an operation for each method."""
        segments: list[Json] = [
            parameter(name, path.segments[name], {**TEXT, "minLength": 1}, place="path", required=True)
            for name in _TEMPLATE.findall(path.template)
        ]
        item: dict[str, Json] = {"parameters": segments} if segments else {}
        for method in _ORDER:
            if method in path.methods:
                item[method.lower()] = self._operation(path, method)
        return item

    def _operation(self, path: DescribedPath, method: str) -> dict[str, Json]:
        """Return the Operation Object (4.8.10)."""
        operation: dict[str, Json] = {
            "tags": [path.tag],
            "operationId": self._name(method, path.template),
            "summary": f"{_VERBS[method]}: {path.item.summary}",
        }
        if (about := path.write(method).note) is not None:
            operation["description"] = about
        if parameters := [*self._parameters(path, method)]:
            operation["parameters"] = parameters
        if accepted := path.accepts.get(method):
            sent = self._shared(path, path.write(method).sends)
            body: dict[str, Json] = {"content": body_content(accepted, sent)}
            if path.write(method).is_body_required:
                body["required"] = True
            operation["requestBody"] = self._components.share("requestBodies", _referred(sent), body)
        operation["responses"] = {**dict(self._answers(path, method)), "default": reference("responses", "otherwise")}
        return operation

    def _name(self, method: str, path: str) -> str:
        """Return a unique name of an operation (`operationId`), such as `put_topics_cockpit_display`."""
        wanted = f"{method.lower()}_{_NOT_IN_A_NAME.sub('_', path).strip('_') or 'entry'}"
        numbered = (f"{wanted}_{number}" for number in count(2))
        name = next(each for each in chain([wanted], numbered) if each not in self._names)
        self._names.add(name)
        return name

    def _parameters(self, path: DescribedPath, method: str) -> Iterator[Json]:
        if method == "GET":
            query, shared = path.item.query, path.item.shared_query
            shared += ("Prefer.container",) if path.item.is_paged else ()
        else:
            query, own = path.write(method).query, {one.name for one in path.write(method).query}
            shared = ("If-Match", *(("If-None-Match",) if method == "PUT" else ()), "Prefer")
            shared += tuple(one.name for one in OF_EVERY_WRITE if one.name not in own)
        yield from (self._components.share("parameters", one.name, _query(one)) for one in query)
        yield from (reference("parameters", name) for name in shared)

    def _shared(self, path: DescribedPath, schema: JsonSchema | None) -> JsonSchema | None:
        """Return a schema of a path, or a reference to it if it is large and several operations share it."""
        name = _NOT_IN_A_NAME.sub(".", path.template).strip(".") or "entry"
        return None if schema is None else self._components.schema(name, schema)

    def _answers(self, path: DescribedPath, method: str) -> Iterator[tuple[str, Json]]:
        """Yield the successful responses by status (4.8.16)."""
        if method == "GET":
            plain = self._shared(path, path.item.plain)
            read = (*path.item.reads, OFFER_TYPE, EVENT_STREAM) if path.item.streams else path.item.reads
            answer: dict[str, Json] = {
                "description": "OK.",
                "headers": headers("ETag", "Link", "Allow"),
                "content": content(read, plain),
            }
            yield "200", self._components.share("responses", _referred(plain), answer)
            if path.item.has_value:
                yield "204", reference("responses", "unmet")
            return
        statuses = path.write(method).statuses(method)
        if 200 not in statuses:
            yield "200", reference("responses", "dry-run")
        shown = path.write(method).shows
        is_usual = shown is None and {*path.item.reads} <= {*FIELD_READS}
        for status in statuses:
            if status not in (200, 201) or (shown is None and (is_usual or status == 201)):
                yield str(status), reference("responses", str(status))
                continue
            told = content(path.item.reads, self._shared(path, path.item.plain if shown is None else shown))
            answer = {
                "description": f"{HTTPStatus(status).phrase}.",
                "headers": headers(*(("Location",) if status == 201 else ()), "Link"),
                "content": or_plan(told) if status == 200 else told,
            }
            yield str(status), self._components.share("responses", f"{_referred(shown)}.{status}", answer)


def _query(one: QueryParameter) -> dict[str, Json]:
    found = parameter(one.name, one.about, one.schema)
    return {**found, "required": True} if one.required else found


def _referred(schema: JsonSchema | None) -> str:
    """Return the name of the component that a schema, or the first of its alternatives, references."""
    found: Json = schema
    while isinstance(found, dict) and isinstance(alternatives := found.get("anyOf"), list):
        found = alternatives[0]
    referred = found.get("$ref") if isinstance(found, dict) else None
    return referred.rpartition("/")[2] if isinstance(referred, str) else "any"
