"""JSON Schema 2020-12 (as in OpenAPI 3.1) from data schemas (WoT Thing Description 1.1) and message types. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias, cast

from rosld.adapters.model import ActionSchema, MessageSchema, Schema, ServiceSchema, TypeRef
from rosld.ontology.lift import LiftSettings
from rosld.server.hypermedia.data_schema import DataSchema, Json, message_schema

JsonSchema: TypeAlias = DataSchema

ANYTHING: JsonSchema = {}
TEXT: JsonSchema = {"type": "string"}
BOOLEAN: JsonSchema = {"type": "boolean"}
URI: JsonSchema = {"type": "string", "format": "uri"}
OBJECT: JsonSchema = {"type": "object"}
NOTHING: JsonSchema = {"type": "null"}
JSON_LD: JsonSchema = {"anyOf": [{"type": "object"}, {"type": "array", "items": {}}]}
_OF_THINGS = {"unit": "x-unit"}
"""What only Thing Descriptions have words for, and the extensions that stand for it."""


def read_schema(schema: DataSchema) -> JsonSchema:
    """Return the schema of a value that the server writes."""
    return cast(JsonSchema, _rename(schema))


def write_schema(schema: DataSchema) -> JsonSchema:
    """Return the schema of a value that a client writes: without what only the server says (`readOnly`)."""
    return cast(JsonSchema, _rename(_without_read_only(schema)))


def patch_schema(schema: DataSchema) -> JsonSchema:
    """Return the schema of a JSON merge patch of a value (RFC 7396): any members of an object, else the whole value."""
    return _part(write_schema(schema))


def _part(schema: JsonSchema) -> JsonSchema:
    members = schema.get("properties")
    if not isinstance(members, dict):
        return {name: each for name, each in schema.items() if name != "default"}  # what is left out stays as it is
    return {"type": "object", "properties": {name: _part(cast(JsonSchema, each)) for name, each in members.items()}}


def nullable(schema: JsonSchema) -> JsonSchema:
    """Return the schema of a value that may not be there."""
    return {"anyOf": [schema, NOTHING]} if schema else schema


def _rename(value: Json) -> Json:
    if isinstance(value, list):
        return [_rename(each) for each in value]
    if not isinstance(value, dict):
        return value
    # The names of properties are the robot's: no keyword is among them.
    return {
        _OF_THINGS.get(key, key): {name: _rename(one) for name, one in each.items()}
        if key == "properties" and isinstance(each, dict)
        else _rename(each)
        for key, each in value.items()
    }


def _without_read_only(value: Json) -> Json:
    if isinstance(value, list):
        return [_without_read_only(each) for each in value]
    if not isinstance(value, dict):
        return value
    choices = value.get("oneOf")
    if isinstance(choices, list):
        left = [one for one in choices if not (isinstance(one, dict) and one.get("readOnly") is True)]
        if len(left) == 1 and len(left) < len(choices):
            rest = {key: each for key, each in value.items() if key != "oneOf"}
            return _without_read_only({**rest, **cast("dict[str, Json]", left[0])})
    return {key: _without_read_only(each) for key, each in value.items()}


_NOT_IN_A_KEY = re.compile(r"[^A-Za-z0-9._-]")


class MessageSchemas:
    """Collector of the schemas that were referred to. `find` returns a type, or None if it is not known.

    Messages of an unknown type are objects without further constraints.
    """

    def __init__(self, find: Callable[[TypeRef], Schema | None], lifting: LiftSettings) -> None:
        self.lifting = lifting
        self.by_key: dict[str, DataSchema] = {}
        """The schemas that `#/components/schemas/KEY` refers to."""
        self._find = find
        self._keys: dict[TypeRef, str] = {}

    def message(self, ref: TypeRef | None) -> MessageSchema | None:
        """Return a message type."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, MessageSchema) else None

    def service(self, ref: TypeRef | None) -> ServiceSchema | None:
        """Return a service type."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, ServiceSchema) else None

    def action(self, ref: TypeRef | None) -> ActionSchema | None:
        """Return an action type."""
        found = None if ref is None else self._find(ref)
        return found if isinstance(found, ActionSchema) else None

    def read(self, schema: MessageSchema | None) -> DataSchema:
        """Return a reference to the schema of a message when read."""
        if schema is None:
            return OBJECT
        key = self._key(schema.ref)
        return self._shared(key, lambda: read_schema(message_schema(schema, self.lifting)))

    def write(self, schema: MessageSchema | None) -> DataSchema:
        """Return a reference to the schema of a message when sent, in which members with defaults are optional."""
        if schema is None:
            return OBJECT
        key = f"{self._key(schema.ref)}.sent"
        return self._shared(key, lambda: write_schema(message_schema(schema, self.lifting, sent=True)))

    def _shared(self, key: str, make: Callable[[], DataSchema]) -> DataSchema:
        if key not in self.by_key:
            self.by_key[key] = make()
        return {"$ref": f"#/components/schemas/{key}"}

    def _key(self, ref: TypeRef) -> str:
        """Return the name of the schema of a type; variants of one type have their hash in it."""
        key = self._keys.get(ref)
        if key is None:
            key = _NOT_IN_A_KEY.sub(".", ref.name)
            if key in self._keys.values():
                key = f"{key}.{_NOT_IN_A_KEY.sub('.', ref.hash or '')}.{len(self._keys)}"
            self._keys[ref] = key
        return key
