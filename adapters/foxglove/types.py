"""Types of channels and services: from ROS definitions or JSON schemas; and JSON messages as ROS messages. No I/O.

A JSON schema becomes a message type of the package `foxglove_json`, so that everything that works for ROS messages
works for those of programs without ROS. JSON without a schema becomes the text of a `std_msgs/msg/String`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import orjson

from rosld.adapters.model import (
    Encoding,
    Message,
    MessageSchema,
    Schema,
    ServiceSchema,
    TypeRef,
    UnknownType,
)
from rosld.adapters.model.definition import split_sections
from rosld.adapters.model.foxglove_protocol import Json
from rosld.adapters.model.library import SEPARATOR, TypeLibrary
from rosld.adapters.model.names import global_name
from rosld.adapters.model.plain import message_of, plain_of

_PACKAGE = "foxglove_json"
_ROS_SCHEMAS = frozenset({"ros1msg", "ros2msg"})
_DEFAULT_SCHEMAS = {"cdr": "ros2msg", "ros1": "ros1msg", "json": "jsonschema"}
_ROS_NAME = re.compile(r"([A-Za-z]\w*)/(?:(?:msg|srv)/)?([A-Za-z]\w*)\Z", re.ASCII)
_FIELD = re.compile(r"[A-Za-z]\w*\Z", re.ASCII)
_PRIMITIVES = {"integer": "int64", "number": "float64", "boolean": "bool", "string": "string"}
_MAX_DEPTH = 32


class Channel(NamedTuple):
    """A channel of the server: its topic as a ROS name and as the server writes it, and how to read its messages."""

    id: int
    topic: str
    written: str
    schema: MessageSchema | None = None
    is_json: bool = False
    unreadable: str | None = None


class ServiceOffer(NamedTuple):
    """A service of the server; `encodings` are those of its request and response."""

    id: int
    name: str
    type: TypeRef | None = None
    schema: ServiceSchema | None = None
    encodings: tuple[str, str] = ("", "")
    uncallable: str | None = None


def type_name(name: str, kind: str = "msg") -> str:
    """Return the name of a type as rosld writes it; that of a type of other systems is made one of `foxglove_json`."""
    match = _ROS_NAME.match(name)
    short = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    return f"{match[1]}/{kind}/{match[2]}" if match else f"{_PACKAGE}/{kind}/{short if _FIELD.match(short) else 'Json'}"


def read_channel(library: TypeLibrary, encoding: Encoding, entry: Json) -> Channel:
    """Return a channel from its advertisement, learning its type. Raises KeyError, TypeError."""
    channel = Channel(entry["id"], global_name(entry["topic"]), entry["topic"])
    try:
        schema = _message_schema(library, encoding, entry)
    except (ValueError, UnknownType) as error:
        return channel._replace(unreadable=str(error))
    return channel._replace(schema=schema, is_json=entry["encoding"] == "json")


def read_service(library: TypeLibrary, encoding: Encoding, entry: Json) -> ServiceOffer:
    """Return a service from its advertisement, learning its type. Raises KeyError, TypeError."""
    halves: list[Json] = [entry.get("request") or {}, entry.get("response") or {}]
    texts = [half.get("schema") or entry.get(f"{side}Schema") or "" for half, side in zip(halves, _SIDES, strict=True)]
    encodings = (halves[0].get("encoding", ""), halves[1].get("encoding", ""))
    name = type_name(entry["type"], "srv")
    offer = ServiceOffer(entry["id"], global_name(entry["name"]), TypeRef(name), None, encodings)
    try:
        if bad := set(encodings) - {"", "json", encoding.value}:
            raise ValueError(f"its messages are encoded as {min(bad)}, which rosld does not read")
        schema: Schema
        if any(halves) or any(texts):
            sections = [
                _sections(f"{name}_{side}", half.get("schemaEncoding") or "ros2msg", text)
                for side, half, text in zip(("Request", "Response"), halves, texts, strict=True)
            ]
            own = [sections[0].pop(f"{name}_Request"), sections[1].pop(f"{name}_Response")]
            schema = library.learn_service(name, _joined("\n---\n".join(own), {**sections[0], **sections[1]}))
        else:
            schema = library.find(TypeRef(name))
    except (ValueError, UnknownType) as error:
        return offer._replace(uncallable=str(error))
    if not isinstance(schema, ServiceSchema):
        return offer._replace(uncallable=f"{name} is not a service type")
    return offer._replace(type=schema.ref, schema=schema)


_SIDES = ("request", "response")


def _message_schema(library: TypeLibrary, encoding: Encoding, entry: Json) -> MessageSchema:
    """Return the schema of a channel. Raises ValueError, UnknownType."""
    coded, name, text = entry["encoding"], type_name(entry["schemaName"]), entry.get("schema") or ""
    if coded not in ("json", encoding.value):
        raise ValueError(f"its messages are encoded as {coded}, which rosld does not read")
    written = entry.get("schemaEncoding") or _DEFAULT_SCHEMAS[coded]
    if coded == "json" and not text.strip():
        found = library.find(TypeRef("std_msgs/msg/String"))
    elif written in _ROS_SCHEMAS and (text.strip() or name.startswith("std_msgs/msg/Empty")):
        return library.learn_message(name, text)
    elif written == "jsonschema":
        sections = _sections(name, written, text)
        return library.learn_message(name, _joined(sections.pop(name), sections))
    else:
        try:
            found = library.find(TypeRef(name))
        except UnknownType as error:
            words = f"its definition is written in {written}, which rosld does not read"
            raise ValueError(f"{words}, and {error}") from error
    if not isinstance(found, MessageSchema):
        raise ValueError(f"{name} is not a message type")
    return found


def _joined(own: str, sections: Mapping[str, str]) -> str:
    return "\n".join([own, *(f"{SEPARATOR}\nMSG: {name}\n{text}" for name, text in sections.items())]) + "\n"


def _sections(name: str, written: str, text: str) -> dict[str, str]:
    """Return the ROS definitions in a schema, those of nested types included. Raises ValueError."""
    if written in _ROS_SCHEMAS:
        return split_sections(name, text)
    if written != "jsonschema":
        raise ValueError(f"its definition is written in {written}, which rosld does not read")
    whole = orjson.loads(text)
    if not isinstance(whole, dict):
        raise ValueError("its JSON schema is not an object")
    found: dict[str, str] = {}
    _describe(whole, whole, name, found, 0)
    return found


def _describe(whole: Json, schema: Json, name: str, found: dict[str, str], depth: int) -> None:
    """Add the definition of an object in a JSON schema, and those of the objects in it."""
    lines = []
    found[name] = ""  # keeps the whole type first
    for field, each in schema.get("properties", {}).items():
        if not _FIELD.match(field):
            raise ValueError(f"its field {field[:50]!r} has a name that ROS does not permit")
        short = name.rpartition("/")[2]
        lines.append(f"{_type_of(whole, each, f'{_PACKAGE}/msg/{short}_{field}', found, depth + 1)} {field}")
    found[name] = "\n".join(lines)


def _type_of(whole: Json, schema: Any, name: str, found: dict[str, str], depth: int) -> str:
    """Return the ROS type of a value; what has none is a string with JSON."""
    if depth > _MAX_DEPTH:
        raise ValueError("its JSON schema is nested too deeply")
    if not isinstance(schema, dict):
        return "string"
    if isinstance(reference := schema.get("$ref"), str) and reference.startswith("#/"):
        target: Any = whole
        for step in reference[2:].split("/"):
            target = target.get(step) if isinstance(target, dict) else None
        return _type_of(whole, target, name, found, depth + 1)
    kinds = schema.get("type")
    kind = next((each for each in kinds if each != "null"), None) if isinstance(kinds, list) else kinds
    if kind == "string" and schema.get("contentEncoding") == "base64":
        return "uint8[]"
    if kind == "array" and isinstance(schema.get("items"), dict):
        element = _type_of(whole, schema["items"], name, found, depth + 1)
        return "string" if element.endswith("]") else f"{element}[]"
    if kind == "object" and schema.get("properties"):
        _describe(whole, schema, name, found, depth)
        return name.replace("/msg/", "/")
    return _PRIMITIVES.get(str(kind), "string")


def message_of_json(schema: MessageSchema, data: bytes) -> Message:
    """Return the message in JSON, without the members that are not in its schema. Raises ValueError."""
    if schema.ref.name == "std_msgs/msg/String":
        return schema.codec.build(schema.ref.name, {"data": data.decode("utf-8", "surrogateescape")})
    return message_of(schema, orjson.loads(data), is_open=True)


def json_of_message(schema: MessageSchema, message: Message) -> bytes:
    """Return a message as JSON; octets are base64 in types that were made from a JSON schema."""
    return orjson.dumps(plain_of(schema, message, base64_octets=schema.ref.name.startswith(f"{_PACKAGE}/")))
