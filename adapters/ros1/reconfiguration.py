"""Wire format of dynamic_reconfigure: descriptions of a node's parameters, and requests to set them. No I/O.

A server in a namespace (`/camera`, or `/camera/driver`) has a service `set_parameters` and two latched topics:
`parameter_descriptions` describes each parameter and its limits, `parameter_updates` has the values of all. The
messages are the same everywhere, so they are read and written without their definitions.
"""

from __future__ import annotations

import ast
import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple, TypeAlias

from rosld.adapters.model import Choice, Descriptor, ParameterType, Range, TypeRef, coerce
from rosld.adapters.ros1.wire_reader import WireReader

Scalar: TypeAlias = "bool | int | float | str"

DESCRIPTIONS, UPDATES, SET = "parameter_descriptions", "parameter_updates", "set_parameters"
SERVICE = TypeRef("dynamic_reconfigure/srv/Reconfigure")
_DESCRIPTION = "dynamic_reconfigure/ConfigDescription"
_MAX_PARAMETERS = 10_000
_MAX_CHOICES = 1_000
_MAX_TEXT = 4096
"""Maximum number of characters of a text."""
_MAX_METHOD = 100_000
_MAX_NESTED = 8
_TYPES: Mapping[str, ParameterType] = {
    "bool": ParameterType.BOOLEAN,
    "int": ParameterType.INTEGER,
    "double": ParameterType.DOUBLE,
    "str": ParameterType.STRING,
}
_TOKEN = re.compile(
    r"\s+|[\[{(]|[\]}),:]|True|False|None"
    r"|[uU]?'(?:[^'\\\n]|\\.)*'|[uU]?\"(?:[^\"\\\n]|\\.)*\""
    r"|[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
)
"""Tokens of Python values of dicts, lists, strings and numbers."""


class Server(NamedTuple):
    """A dynamic_reconfigure server: the namespace of its parameters, and its node."""

    namespace: str
    node: str


class Description(NamedTuple):
    """A parameter in a server's description, without its values."""

    name: str
    type: str
    words: str
    edit_method: str


def servers_of(
    publishers: Mapping[str, tuple[str, ...]], services: Mapping[str, tuple[str, ...]], types: Mapping[str, str]
) -> Iterator[Server]:
    """Yield the servers in a system, given the nodes by topic and by service, and ROS 1's types of topics."""
    for topic, type in types.items():
        namespace, _, last = topic.rpartition("/")
        if type != _DESCRIPTION or last != DESCRIPTIONS or not publishers.get(topic):
            continue
        if providers := services.get(f"{namespace}/{SET}"):
            yield Server(namespace, providers[0])


# Reading


def read_config(data: bytes) -> Mapping[str, Scalar]:
    """Return the values in a dynamic_reconfigure/Config. Raises ValueError."""
    return _config(WireReader(data))


def read_descriptors(data: bytes) -> Mapping[str, Descriptor]:
    """Return the declarations in a dynamic_reconfigure/ConfigDescription, by local name. Raises ValueError."""
    reader = WireReader(data)
    groups = reader.array(lambda: _group(reader), _MAX_PARAMETERS)
    greatest, least = _config(reader), _config(reader)
    return {
        one.name: _descriptor(one, _TYPES[one.type], least.get(one.name), greatest.get(one.name))
        for group in groups
        for one in group
        if one.type in _TYPES
    }


def _group(reader: WireReader) -> list[Description]:
    reader.text(), reader.text()
    descriptions = reader.array(lambda: _description(reader), _MAX_PARAMETERS)
    reader.int32(), reader.int32()
    return descriptions


def _description(reader: WireReader) -> Description:
    name, type = reader.text(), reader.text()
    reader.length()
    return Description(name, type, reader.text(), reader.text())


def _config(reader: WireReader) -> Mapping[str, Scalar]:
    values: dict[str, Scalar] = {}
    for read in _values(reader):
        values.update(reader.array(lambda read=read: (reader.text(), read()), _MAX_PARAMETERS))  # type: ignore[misc]
    reader.array(lambda: (reader.text(), reader.bool(), reader.int32(), reader.int32()), _MAX_PARAMETERS)
    return values


def _values(reader: WireReader) -> tuple[Callable[[], Scalar], ...]:
    """Return the readers of the values in a Config, in the order of its fields."""
    return reader.bool, reader.int32, reader.text, reader.float64


def _descriptor(
    description: Description, type: ParameterType, least: Scalar | None, greatest: Scalar | None
) -> Descriptor:
    return Descriptor(
        type,
        _shortened(description.words),
        range=_range(type, least, greatest),
        choices=tuple(_choices(type, description.edit_method)),
    )


def _range(type: ParameterType, least: Scalar | None, greatest: Scalar | None) -> Range | None:
    """Return the range of a number; None without one, or if its ends are invalid."""
    if type not in (ParameterType.INTEGER, ParameterType.DOUBLE):
        return None
    if isinstance(least, bool | str | None) or isinstance(greatest, bool | str | None):
        return None
    return Range(least, greatest) if least <= greatest and not (least == -math.inf and greatest == math.inf) else None


def _choices(type: ParameterType, edit_method: str) -> Iterator[Choice]:
    """Yield the values of an enumeration (`{'enum': [{'name': 'Small', 'value': 0, ...}, ...]}`) that have the type."""
    method = _python_value(edit_method)
    listed = method.get("enum") if isinstance(method, dict) else None
    for each in listed[:_MAX_CHOICES] if isinstance(listed, list) else ():
        if not isinstance(each, dict):
            continue
        value = each.get("value")
        fit = coerce(value, type) if isinstance(value, bool | int | float | str) else None
        if isinstance(fit, bool | int | float | str):
            yield Choice(fit, _words(each.get("name")), _words(each.get("description")))


def _python_value(text: str) -> object:
    """Return the value of a Python literal of dicts, lists, strings and numbers, or None for anything else.

    The text is checked first, because deep nesting would crash Python's parser.
    """
    if not text or len(text) > _MAX_METHOD:
        return None
    place = depth = 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            return None
        depth += (token[0] in "[{(") - (token[0] in "]})")
        if not 0 <= depth <= _MAX_NESTED:
            return None
        place = token.end()
    try:
        return ast.literal_eval(text.strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        return None


def _words(value: object) -> str:
    return _shortened(value) if isinstance(value, str) else ""


def _shortened(text: str) -> str:
    short = text if len(text) <= _MAX_TEXT else text[: _MAX_TEXT - 1] + "…"
    return short.encode("utf-8", "replace").decode()


# Writing


def request_of(values: Mapping[str, Scalar]) -> bytes:
    """Return a dynamic_reconfigure/Reconfigure request that sets only these parameters, by local name."""
    kinds: dict[type, list[bytes]] = {bool: [], int: [], str: [], float: []}
    for name, value in values.items():
        kinds[type(value)].append(_text(name) + _ENCODERS[type(value)](value))
    return b"".join(map(_array, kinds.values())) + _array(())


def _array(elements: Iterable[bytes]) -> bytes:
    encoded = list(elements)
    return struct.pack("<I", len(encoded)) + b"".join(encoded)


def _text(value: object) -> bytes:
    data = str(value).encode("utf-8", "surrogateescape")
    return struct.pack("<I", len(data)) + data


_ENCODERS: Mapping[type, Callable[[object], bytes]] = {
    bool: lambda value: struct.pack("<?", value),
    int: lambda value: struct.pack("<i", value),
    str: _text,
    float: lambda value: struct.pack("<d", value),
}
