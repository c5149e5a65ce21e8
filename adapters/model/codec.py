"""The codec of a schema: rosbags' compiled serialisers, with `wire.py` for the strings they refuse."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import cast

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError, normalize_fieldname
from rosbags.typesys.store import Typestore

from rosld.adapters.model.defaults import default_texts, with_default
from rosld.adapters.model.definition_limits import may_be_empty
from rosld.adapters.model.sample import Encoding
from rosld.adapters.model.schema import Array, Constant, Field, FieldType, Message, MessageType, Nested, Primitive
from rosld.adapters.model.wire import Reader, Writer

DUMMY = "structure_needs_at_least_one_member"
_NESTED_PARTS = re.compile(r"^([ \t]*\w+)/(?:srv|action)/", re.MULTILINE | re.ASCII)
"""A field whose type is a part of a service or an action, at the beginning of its line."""


def store_name(name: str) -> str:
    """The name under which rosbags keeps a type: it knows only messages, the halves of services included."""
    return name.replace("/srv/", "/msg/").replace("/action/", "/msg/")


def typestore_of(texts: Mapping[str, str]) -> Typestore:
    """A type store holding just these texts. Raises ValueError where one cannot be parsed."""
    store = get_typestore(Stores.EMPTY)
    for name, text in texts.items():
        try:
            store.register(get_types_from_msg(_NESTED_PARTS.sub(r"\1/msg/", text) + "\n", store_name(name)))
        except (TypesysError, SyntaxError, ValueError, AssertionError) as error:
            raise ValueError(f"the definition of {name} cannot be read: {error}") from error
    return store


class RosbagsCodec:
    """A `Codec` for one closed set of types, in a type store of its own."""

    def __init__(self, root: str, store: Typestore, types: Mapping[str, MessageType]) -> None:
        self._root = root
        self._stored = store_name(root)
        self._store = store
        self._types = types
        self._classes = {name: store.types[store_name(name)] for name in types}
        self._empty = frozenset(name for name, kind in types.items() if not kind.fields)
        self._may_be_empty = may_be_empty(types)

    def decode(self, data: bytes, encoding: Encoding) -> Message:
        """The message in `data`; raises ValueError naming the type when it holds none."""
        if self._may_be_empty:  # the compiled code makes as many elements as the message claims
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
            raise ValueError(f"{len(data)} bytes are no {self._root}: {error}") from error
        return message

    def encode(self, message: Message, encoding: Encoding) -> bytes:
        """The bytes of a message; raises ValueError naming the field that does not fit."""
        try:
            if encoding is Encoding.ROS1:
                return bytes(self._store.serialize_ros1(message, self._stored))
            return bytes(self._store.serialize_cdr(message, self._stored, little_endian=True))
        except (SerdeError, AttributeError, ValueError, TypeError, AssertionError, struct.error):
            writer = Writer(encoding, self._types)
            writer.message(self._root, message)
            return writer.octets()

    def build(self, type_name: str, values: Mapping[str, object]) -> Message:
        """A message from its attributes' values, which must be complete and right."""
        if type_name in self._empty:
            values = {DUMMY: 0}
        return cast(Message, self._classes[type_name](**values))  # type: ignore[arg-type]


def message_types(store: Typestore, texts: Mapping[str, str]) -> Mapping[str, MessageType]:
    """The layouts of the types that `store` was made of, with the default values that their definitions have."""
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
