"""Tables of readers of a schema's messages: what lowering from JSON and from RDF have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from typing import Generic, Protocol, TypeAlias, TypeVar, cast

from rosld.adapters.model import Array, FieldType, Message, MessageSchema, Nested, Primitive
from rosld.ontology.coercion import Misfit, check_length
from rosld.ontology.violations import Findings, LoweringError, Path


class Reading(Protocol):
    """State of one lowering."""

    @property
    def findings(self) -> Findings: ...


_Value = TypeVar("_Value")
_Reading = TypeVar("_Reading", bound=Reading)
Reader: TypeAlias = Callable[[_Value, Path, _Reading], object]


class MessageReaders(ABC, Generic[_Value, _Reading]):
    """The readers of one schema's messages, created once for each type."""

    def __init__(self, schema: MessageSchema) -> None:
        self._schema = schema
        self.message: Callable[[str], Reader[_Value, _Reading]] = cache(self._message)

    def reader(self, kind: FieldType) -> Reader[_Value, _Reading]:
        """Return the reader of a value of this type."""
        if isinstance(kind, Nested):
            return self.message(kind.name)
        if isinstance(kind, Primitive) or isinstance(kind.element, Primitive):
            return self._leaf(kind)
        array, one = kind, self.message(kind.element.name)

        def read(value: _Value, path: Path, reading: _Reading) -> object:
            items = enumerate(check_length(array, self._items(array, value, reading)))
            return [guarded(one, item, (path, str(index)), reading) for index, item in items]

        return read

    @abstractmethod
    def _message(self, name: str) -> Reader[_Value, _Reading]:
        """Return a new reader of messages of a type of this schema."""

    @abstractmethod
    def _leaf(self, kind: Primitive | Array) -> Reader[_Value, _Reading]:
        """Return the reader of a primitive or an array of them."""

    @abstractmethod
    def _items(self, kind: Array, value: _Value, reading: _Reading) -> Sequence[_Value]:
        """Return the elements of an array of messages. Raises Misfit."""


def guarded(read: Reader[_Value, _Reading], value: _Value, path: Path, reading: _Reading) -> object:
    """Return what `read` returns; a misfit becomes a violation."""
    try:
        return read(value, path, reading)
    except Misfit as misfit:
        reading.findings.misfit(path, misfit)
        return None


def read_message(read: Reader[_Value, _Reading], value: _Value, reading: _Reading) -> Message:
    """Return the message in a value. Raises LoweringError with the violations (at most the first twenty)."""
    message = guarded(read, value, None, reading)
    if violations := reading.findings.violations:
        raise LoweringError(*violations)
    return cast(Message, message)
