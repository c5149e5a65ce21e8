"""The description: an OpenAPI Object (OpenAPI 3.1.1, 4.8.1) of paths. The same paths give the same bytes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from http import HTTPStatus

import orjson

from rosld.server.events.query_params import EVENT_STREAM
from rosld.server.hypermedia.data_schema import Json
from rosld.server.hypermedia.json_schema import ANYTHING, JSON_LD, JsonSchema
from rosld.server.openapi.components import (
    READING,
    WRITING,
    components,
    content,
    document,
    headers,
    or_plan,
    reference,
    refusals,
    representation,
    schema_of,
)
from rosld.server.openapi.description_parts import sections
from rosld.server.openapi.path_collector import DescribedPath
from rosld.server.rest.path_item import OF_EVERY_WRITE, QueryParameter

VERSION = "3.1.1"
_ORDER = ("GET", "HEAD", "OPTIONS", "PUT", "POST", "PATCH", "DELETE")
_SHORT = frozenset({"HEAD", "OPTIONS"})
_TEMPLATE = re.compile(r"\{([^{}]+)\}")
_BY_SCHEMA = frozenset({"application/json", "application/merge-patch+json", "application/x-www-form-urlencoded"})
"""Media types of bodies that have the schema of their path."""
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
    """The description of a server at `base`, as JSON; `schemas` are those that places refer to by name.

    `query` is that of its URL, which the URLs of its parts have too.
    """
    ordered = sorted({path.template: path for path in described}.values(), key=lambda path: path.template)
    names, shared = _Names(), _Shared()
    paths = {
        path.template: _path_item(path, names) if path.item.alike is None else shared.item(path) for path in ordered
    }
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
            "components": {**components(schemas), "pathItems": shared.items},
        }
    )


class _Names:
    """Names of operations: made from method and path, no two alike."""

    def __init__(self) -> None:
        self._given: set[str] = set()

    def of(self, method: str, path: str) -> str:
        """The name of an operation (`operationId`), such as `put_topics_cockpit_display`."""
        name = wanted = f"{method.lower()}_{_NOT_IN_A_NAME.sub('_', path).strip('_') or 'entry'}"
        number = 2
        while name in self._given:
            name = f"{wanted}_{number}"
            number += 1
        self._given.add(name)
        return name


class _Shared:
    """Path Items of paths that are alike: one for each way in which they answer, referred to by its name."""

    def __init__(self) -> None:
        self.items: dict[str, Json] = {}
        self._names: dict[bytes, str] = {}

    def item(self, path: DescribedPath) -> dict[str, Json]:
        """A reference to the Path Item of a path."""
        item = _path_item(replace(path, item=replace(path.item, summary=f"A {path.item.alike}")), None)
        key = orjson.dumps(item)
        name = self._names.get(key)
        if name is None:
            name = self._names[key] = f"{path.item.alike}.{len(self._names) + 1}"
            self.items[name] = item
        return reference("pathItems", name)


def _path_item(path: DescribedPath, names: _Names | None) -> dict[str, Json]:
    """The Path Item Object (4.8.9): an operation for each method, without names where they would occur twice."""
    segments: list[Json] = [_segment(name, path.segments[name]) for name in _TEMPLATE.findall(path.template)]
    item: dict[str, Json] = {"summary": path.item.summary}
    if segments:
        item["parameters"] = segments
    for method in _ORDER:
        if method in path.methods:
            item[method.lower()] = _operation(path, method, names)
    return item


def _segment(name: str, about: str) -> Json:
    return {
        "name": name,
        "in": "path",
        "required": True,
        "description": about,
        "schema": {"type": "string", "minLength": 1},
    }


def _operation(path: DescribedPath, method: str, names: _Names | None) -> dict[str, Json]:
    """The Operation Object (4.8.10). Those that tell only of the others are told in short."""
    operation: dict[str, Json] = {"tags": [path.tag]}
    if names is not None:
        operation["operationId"] = names.of(method, path.template)
    about = path.write(method).note
    if about is not None:
        operation["description"] = about
    if method not in _SHORT:
        operation["summary"] = f"{_VERBS[method]}: {path.item.summary}"
        operation["parameters"] = [*_parameters(path, method)]
    elif method == "HEAD" and (required := [_query(one) for one in path.item.query if one.required]):
        operation["parameters"] = [*required]
    body = _body(path, method)
    if body is not None:
        operation["requestBody"] = body
    operation["responses"] = _answers(path, method)
    return operation


def _parameters(path: DescribedPath, method: str) -> Iterator[Json]:
    if method == "GET":
        yield from (_query(one) for one in path.item.query)
        container = ("Prefer.container",) if path.item.is_paged else ()
        names = (*path.item.shared_query, *container, "If-None-Match")
        yield from (reference("parameters", name) for name in names)
    else:
        yield from (reference("parameters", name) for name in ("If-Match", "If-None-Match", "Prefer"))
        query = path.write(method).query
        yield from map(_query, query)
        own = {one.name for one in query}
        yield from (reference("parameters", one.name) for one in OF_EVERY_WRITE if one.name not in own)


def _query(one: QueryParameter) -> Json:
    found: dict[str, Json] = {"name": one.name, "in": "query", "description": one.about, "schema": one.schema}
    return {**found, "required": True} if one.required else found


def _body(path: DescribedPath, method: str) -> Json:
    accepted = path.accepts.get(method, ())
    if not accepted:
        return None
    sent = path.write(method).sends
    told: dict[str, Json] = {"content": {kind: {"schema": _body_schema(kind, sent)} for kind in accepted}}
    return {"required": True, **told} if path.write(method).is_body_required else told


def _body_schema(media_type: str, sent: JsonSchema | None) -> JsonSchema:
    if media_type in _BY_SCHEMA:
        return ANYTHING if sent is None else sent
    return schema_of(media_type)


def _answers(path: DescribedPath, method: str) -> dict[str, Json]:
    """The Responses Object (4.8.16)."""
    if method == "OPTIONS":
        return {"204": reference("responses", "options"), **refusals((308, 400, 404, 503, *path.item.also))}
    if method == "HEAD":
        return {"200": reference("responses", "head"), **refusals((*READING, *_ways(path)), body=False)}
    if method == "GET":
        unmet = {"204": reference("responses", "unmet")} if path.item.has_value else {}
        return {"200": _read(path), **unmet, **refusals((*READING, *_ways(path)))}
    done = {str(status): _success_response(path, method, status) for status in path.write(method).statuses(method)}
    return {"200": reference("responses", "dry-run"), **done, **refusals((*WRITING, *path.item.also))}


def _ways(path: DescribedPath) -> tuple[int, ...]:
    """What reading a path may come to besides."""
    return (303, *path.item.also) if path.item.is_paged else path.item.also


def _read(path: DescribedPath) -> dict[str, Json]:
    if path.item.is_document:
        return document()
    plain = path.item.plain
    if path.item.has_shape and plain is not None:
        plain = {"anyOf": [plain, JSON_LD]}
    return representation((*path.item.reads, EVENT_STREAM) if path.item.streams else path.item.reads, plain)


def _success_response(path: DescribedPath, method: str, status: int) -> dict[str, Json]:
    """The answer to a write that was done."""
    if status in (202, 204):
        return reference("responses", str(status))
    shown = path.write(method).shows
    answer: dict[str, Json] = {"description": f"{HTTPStatus(status).phrase}."}
    if status == 201:
        answer["headers"] = headers("Location", "ETag", "Link", "Content-Location", certain=["Location"])
    else:
        answer["headers"] = headers("ETag", "Link", "Content-Location", "Preference-Applied")
    told = content(path.item.reads, path.item.plain if shown is None else shown)
    answer["content"] = or_plan(told) if status == 200 else told
    return answer
