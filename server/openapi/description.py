"""The description: an OpenAPI Object (OpenAPI 3.1.1, 4.8.1) of paths. Equal paths give equal bytes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from http import HTTPStatus
from itertools import chain, count

import orjson

from rosld.server.events.query_params import EVENT_STREAM
from rosld.server.hypermedia.json_schema import TEXT, Json, JsonSchema
from rosld.server.openapi.components import Components, body_content, content, headers, or_plan, parameter, reference
from rosld.server.openapi.description_parts import sections
from rosld.server.openapi.path_collector import DescribedPath
from rosld.server.rest.path_item import FIELD_READS, OF_EVERY_WRITE, QueryParameter

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
            read = (*path.item.reads, EVENT_STREAM) if path.item.streams else path.item.reads
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
