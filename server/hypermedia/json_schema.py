"""From data schemas (WoT Thing Description 1.1) to JSON Schema 2020-12, which OpenAPI 3.1 speaks. Pure."""

from __future__ import annotations

from typing import TypeAlias, cast

from rosld.server.hypermedia.data_schema import DataSchema, Json

Schema: TypeAlias = DataSchema

ANYTHING: Schema = {}
TEXT: Schema = {"type": "string"}
BOOLEAN: Schema = {"type": "boolean"}
URI: Schema = {"type": "string", "format": "uri"}
OBJECT: Schema = {"type": "object"}
NOTHING: Schema = {"type": "null"}
JSON_LD: Schema = {"type": ["object", "array"]}
_OF_THINGS = {"unit": "x-unit"}
"""What only Thing Descriptions have words for, and the extensions that stand for it."""


def read_schema(schema: DataSchema) -> Schema:
    """The schema of a value that the server writes."""
    return cast(Schema, _rename(schema))


def write_schema(schema: DataSchema) -> Schema:
    """The schema of a value that a client writes: without what only the server says (`readOnly`)."""
    return cast(Schema, _rename(_without_read_only(schema)))


def patch_schema(schema: DataSchema) -> Schema:
    """The schema of a JSON merge patch of a value (RFC 7396): of an object any of its members, else the whole value."""
    return _part(write_schema(schema))


def _part(schema: Schema) -> Schema:
    members = schema.get("properties")
    if not isinstance(members, dict):
        return {name: each for name, each in schema.items() if name != "default"}  # what is left out stays as it is
    return {"type": "object", "properties": {name: _part(cast(Schema, each)) for name, each in members.items()}}


def nullable(schema: Schema) -> Schema:
    """The schema of a value that may not be there."""
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
