"""Codec of a schema: rosbags' compiled serializers, with a slow and exact reader for the strings they reject.

Default values of fields (`float64 w 1`) are read like rosidl_adapter does. ROS 1 has none: every field of a new message
is zero or empty.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TypeAlias, cast

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError, normalize_fieldname
from rosbags.typesys.store import Typestore

from rosld.adapters.model.definition import may_be_empty
from rosld.adapters.model.schema import (
    DUMMY,
    Array,
    Constant,
    Default,
    Encoding,
    Field,
    FieldType,
    Message,
    MessageType,
    Nested,
    Primitive,
    Scalar,
)

Build: TypeAlias = Callable[[str, Mapping[str, object]], Message]

_FORMATS = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
DTYPES = {"bool": "?", "byte": "i1", "char": "u1", "int8": "i1", "uint8": "u1", "float32": "f4", "float64": "f8"} | {
    f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (16, 32, 64)
}


class Reader:
    """Reads one message from bytes. Methods raise ValueError if the bytes are truncated."""

    def __init__(self, data: bytes, encoding: Encoding, types: Mapping[str, MessageType], build: Build) -> None:
        self._cdr = encoding is Encoding.CDR
        self._order = ">" if self._cdr and data[1:2] == b"\x00" else "<"
        self._data = memoryview(data)[4:] if self._cdr else memoryview(data)
        self._position = 0
        self._types = types
        self._build = build

    def message(self, name: str) -> Message:
        """Return the message of type `name` at the current position."""
        fields = self._types[name].fields
        if not fields and self._cdr:
            self._take(1)
        return self._build(name, {field.attribute: self._value(field.type) for field in fields})

    def end(self) -> None:
        """Raise ValueError unless everything (except CDR's padding) was read."""
        left = len(self._data) - self._position
        if left > (3 if self._cdr else 0):
            raise ValueError(f"{left} bytes are left over after the message")

    def rest(self) -> bytes:
        """Return the bytes that were not read."""
        return bytes(self._data[self._position :])

    def _align(self, size: int) -> None:
        if self._cdr:
            self._position += -self._position % size

    def _take(self, size: int) -> memoryview:
        start, end = self._position, self._position + size
        if end > len(self._data):
            raise ValueError(f"the message ends at byte {len(self._data)}, where byte {end} was needed")
        self._position = end
        return self._data[start:end]

    def _length(self) -> int:
        self._align(4)
        return cast(int, struct.unpack(self._order + "I", self._take(4))[0])

    def _value(self, kind: FieldType) -> object:
        if isinstance(kind, Nested):
            return self.message(kind.name)
        if isinstance(kind, Array):
            return self._array(kind)
        return self._primitive(kind)

    def _primitive(self, kind: Primitive) -> object:
        if kind.name in ("string", "wstring"):
            return self._string()
        code = _FORMATS[kind.name]
        size = struct.calcsize(code)
        self._align(size)
        return struct.unpack(self._order + code, self._take(size))[0]

    def _string(self) -> str:
        octets = bytes(self._take(self._length()))
        return octets[: -1 if self._cdr else None].decode("utf-8", "surrogateescape")

    def _array(self, kind: Array) -> object:
        length = self._length() if kind.length is None else kind.length
        if isinstance(kind.element, Primitive) and kind.element.name in _FORMATS:
            dtype = np.dtype(self._order + DTYPES[kind.element.name])
            if length:
                self._align(dtype.itemsize)
            values = np.frombuffer(self._take(length * dtype.itemsize), dtype)
            return values.astype(DTYPES[kind.element.name])
        if length > len(self._data):
            raise ValueError(f"an array of {length} elements cannot be in {len(self._data)} bytes")
        return [self._value(kind.element) for _ in range(length)]


class Writer:
    """Writes one message to bytes. Raises ValueError naming a field that does not fit."""

    def __init__(self, encoding: Encoding, types: Mapping[str, MessageType]) -> None:
        self._cdr = encoding is Encoding.CDR
        self._parts = bytearray()
        self._types = types

    def octets(self) -> bytes:
        """Return the written bytes, with CDR's header if needed."""
        return (b"\x00\x01\x00\x00" if self._cdr else b"") + bytes(self._parts)

    def message(self, name: str, message: object) -> None:
        """Append a message of type `name`."""
        fields = self._types[name].fields
        if not fields and self._cdr:
            self._parts += b"\x00"
        for field in fields:
            try:
                self._value(field.type, getattr(message, field.attribute))
            except (struct.error, TypeError, AttributeError) as error:
                raise ValueError(f"{name} field {field.name}: {error}") from error

    def _align(self, size: int) -> None:
        if self._cdr:
            self._parts += bytes(-len(self._parts) % size)

    def _pack(self, code: str, value: object) -> None:
        self._align(struct.calcsize(code))
        self._parts += struct.pack("<" + code, value)

    def _value(self, kind: FieldType, value: object) -> None:
        if isinstance(kind, Nested):
            self.message(kind.name, value)
        elif isinstance(kind, Array):
            self._array(kind, cast("Iterable[object]", value))
        elif kind.name in ("string", "wstring"):
            self._string(cast(str, value))
        else:
            self._pack(_FORMATS[kind.name], value)

    def _string(self, value: str) -> None:
        octets = value.encode("utf-8", "surrogateescape") + (b"\x00" if self._cdr else b"")
        self._pack("I", len(octets))
        self._parts += octets

    def _array(self, kind: Array, values: Iterable[object]) -> None:
        if isinstance(values, np.ndarray):
            values = values.tolist()
        items = list(values)
        if kind.length is None:
            self._pack("I", len(items))
        elif len(items) != kind.length:
            raise ValueError(f"an array must have exactly {kind.length} elements, not {len(items)}")
        for item in items:
            self._value(kind.element, item)


_STATED_ELSEWHERE: Mapping[tuple[str, str], str] = {("geometry_msgs/msg/Quaternion", "w"): "1"}
"""Default values that ROS 2's definitions have and ROS 1's cannot: a quaternion of zeros is not a rotation."""
_STRINGS = frozenset({"string", "wstring"})
_ELEMENT = re.compile(r""" *(?:"((?:\\.|[^"\\])*)"|'((?:\\.|[^'\\])*)'|([^,"' ][^,]*)) *(?:,|$)""")
_TRUE, _FALSE = frozenset({"true", "1"}), frozenset({"false", "0"})
_OCTET = (0, 255)
_MAX_DIGITS = 100


def default_texts(name: str, text: str) -> Mapping[str, str]:
    """Return the texts of the default values in the definition `text` of a message type, by field name."""
    texts = {field: value for (kind, field), value in _STATED_ELSEWHERE.items() if kind == name}
    for line in text.splitlines():
        words = line.replace("\t", " ").partition("#")[0].split(None, 2)
        if len(words) == 3 and "=" not in words[1] + words[2]:
            texts[words[1]] = words[2].rstrip()
    return texts


def with_default(field: Field, texts: Mapping[str, str]) -> Field:
    """Return the field with its default value if that fits its type: ROS does not build a package with another."""
    text = texts.get(field.name)
    if text is None:
        return field
    try:
        return Field(field.name, field.type, field.attribute, read_default(field.type, text))
    except ValueError:
        return field


def read_default(kind: FieldType, text: str) -> Default:
    """Return the default value that a text stands for. Raises ValueError if it does not fit the type."""
    if isinstance(kind, Primitive):
        return _scalar(kind, _unquoted(text) if kind.name in _STRINGS else text)
    if not isinstance(kind, Array) or not isinstance(kind.element, Primitive):
        raise ValueError("a field that is a message cannot have a default value")
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError(f"{text} is not an array: write it in brackets")
    element = kind.element
    values = tuple(_scalar(element, each) for each in _elements(text[1:-1], element))
    if (kind.most is not None and len(values) > kind.most) or (kind.length is not None and len(values) < kind.length):
        raise ValueError(f"an array cannot have {len(values)} elements here")
    return values


def _elements(text: str, element: Primitive) -> Sequence[str]:
    """Return the texts between the commas of an array, without quotes."""
    if not text.strip():
        return ()
    if element.name not in _STRINGS:
        return [each.strip() for each in text.split(",")]
    found, place = [], 0
    while place < len(text):
        match = _ELEMENT.match(text, place)
        if match is None:
            raise ValueError(f"{text} is not a list of strings")
        double, single, bare = match.groups()
        quoted = _unescaped(double, '"') if double is not None else _unescaped(single or "", "'")
        found.append(quoted if bare is None else bare.rstrip())
        place = match.end()
    return found


def _scalar(kind: Primitive, text: str) -> Scalar:
    name = kind.name
    if name in _STRINGS:
        if kind.bound is not None and len(text) > kind.bound:
            raise ValueError(f"{text!r} is longer than {kind.bound}")
        return text
    if name == "bool":
        if text.lower() not in _TRUE | _FALSE:
            raise ValueError(f"{text} is neither true nor false")
        return text.lower() in _TRUE
    return float(text) if name.startswith("float") else _integer(name, text)


def _integer(name: str, text: str) -> int:
    """Return the integer in a text: decimal, or with the prefix of another base. Raises ValueError."""
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"{len(text)} characters do not fit {name}")
    try:
        value = int(text)
    except ValueError:
        value = int(text, 0)
    least, greatest = _range(name)
    if not least <= value <= greatest:
        raise ValueError(f"{text} is no {name}")
    return value


def _range(name: str) -> tuple[int, int]:
    if name in ("byte", "char"):
        return _OCTET
    bits = int(name.lstrip("uint"))
    return (0, 2**bits - 1) if name.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def _unquoted(text: str) -> str:
    """Return a string without its optional quotes. Raises ValueError for an unescaped quote within."""
    for quote in ('"', "'"):
        if len(text) > 1 and text.startswith(quote) and text.endswith(quote):
            if re.search(rf"(?<!\\){quote}", text[1:-1]):
                raise ValueError(f"{text} has a {quote} within")
            return _unescaped(text[1:-1], quote)
    return text


def _unescaped(text: str, quote: str) -> str:
    return text.replace(f"\\{quote}", quote)


_NESTED_PARTS = re.compile(r"^([ \t]*\w+)/(?:srv|action)/", re.MULTILINE | re.ASCII)
"""A field whose type is part of a service or an action, at the start of its line."""


def store_name(name: str) -> str:
    """Return the name under which rosbags stores a type: it knows only messages, including the parts of services."""
    return name.replace("/srv/", "/msg/").replace("/action/", "/msg/")


def typestore_of(texts: Mapping[str, str]) -> Typestore:
    """Return a type store with only these texts. Raises ValueError if one cannot be parsed."""
    store = get_typestore(Stores.EMPTY)
    for name, text in texts.items():
        try:
            store.register(get_types_from_msg(_NESTED_PARTS.sub(r"\1/msg/", text) + "\n", store_name(name)))
        except (TypesysError, SyntaxError, ValueError, AssertionError) as error:
            raise ValueError(f"the definition of {name} cannot be read: {error}") from error
    return store


class RosbagsCodec:
    """A `Codec` for a closed set of types, with its own type store."""

    def __init__(self, root: str, store: Typestore, types: Mapping[str, MessageType]) -> None:
        self._root = root
        self._stored = store_name(root)
        self._store = store
        self._types = types
        self._classes = {name: store.types[store_name(name)] for name in types}
        self._empty = frozenset(name for name, kind in types.items() if not kind.fields)
        self._may_be_empty = may_be_empty(types)

    def decode(self, data: bytes, encoding: Encoding) -> Message:
        """Return the message in `data`. Raises ValueError with the name of the type if it cannot be decoded."""
        if self._may_be_empty:  # the compiled code creates as many elements as the message claims
            return self._decode_slowly(data, encoding)
        try:
            if encoding is Encoding.ROS1:
                return cast(Message, self._store.deserialize_ros1(data, self._stored))
            return cast(Message, self._store.deserialize_cdr(data, self._stored))
        except (SerdeError, ValueError, struct.error, IndexError):
            return self._decode_slowly(data, encoding)

    def _decode_slowly(self, data: bytes, encoding: Encoding) -> Message:
        reader = Reader(data, encoding, self._types, self.build)
        try:
            message = reader.message(self._root)
            reader.end()
        except (ValueError, struct.error, OverflowError) as error:
            raise ValueError(f"cannot decode {len(data)} bytes as {self._root}: {error}") from error
        return message

    def encode(self, message: Message, encoding: Encoding) -> bytes:
        """Return the bytes of a message. Raises ValueError with the name of a field that does not fit."""
        try:
            if encoding is Encoding.ROS1:
                return bytes(self._store.serialize_ros1(message, self._stored))
            return bytes(self._store.serialize_cdr(message, self._stored, little_endian=True))
        except (SerdeError, AttributeError, ValueError, TypeError, AssertionError, struct.error):
            writer = Writer(encoding, self._types)
            writer.message(self._root, message)
            return writer.octets()

    def build(self, type_name: str, values: Mapping[str, object]) -> Message:
        """Return a message with these attributes, which must be complete and valid."""
        if type_name in self._empty:
            values = {DUMMY: 0}
        return cast(Message, self._classes[type_name](**values))  # type: ignore[arg-type]


def message_types(store: Typestore, texts: Mapping[str, str]) -> Mapping[str, MessageType]:
    """Return the layouts of the types in `store`, with the default values of their definitions."""
    external = {store_name(name): name for name in texts}
    return MappingProxyType({name: _message_type(name, texts[name], store, external) for name in texts})


def _message_type(name: str, text: str, store: Typestore, external: Mapping[str, str]) -> MessageType:
    constants, fields = store.fielddefs[store_name(name)]
    defaults = default_texts(name, text)
    return MessageType(
        name,
        tuple(
            with_default(Field(field, _field_type(description, external), normalize_fieldname(field)), defaults)
            for field, description in fields
            if field != DUMMY
        ),
        tuple(
            Constant(constant, kind, value) for constant, kind, value in cast("list[tuple[str, str, str]]", constants)
        ),
    )


def _field_type(description: object, external: Mapping[str, str]) -> FieldType:
    """Translate rosbags' nested tuples: (BASE, (name, bound)), (NAME, type), (ARRAY|SEQUENCE, (element, size))."""
    kind, detail = cast("tuple[Nodetype, tuple[object, int]]", description)
    if kind == Nodetype.BASE:
        name, bound = cast("tuple[str, int]", detail)
        return Primitive(name, bound or None)
    if kind == Nodetype.NAME:
        return Nested(external[cast(str, detail)])
    inner, size = detail
    element = cast("Primitive | Nested", _field_type(inner, external))
    if kind == Nodetype.ARRAY:
        return Array(element, length=size)
    return Array(element, bound=size or None)
