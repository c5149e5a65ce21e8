"""Limits of message definitions, whose texts come from recordings and from other nodes. Pure.

A definition of 2 kB whose types each nest the next one twice has more fields than there is memory, and a message of
4 bytes can hold four thousand million elements of a type without fields.
"""

from __future__ import annotations

from collections.abc import Mapping

from rosld.adapters.model.schema import Array, FieldType, MessageType, Nested

MAX_CHARACTERS = 1024 * 1024
"""Characters of a definition with its dependencies, comments included."""
MAX_DECLARED = 128 * 1024
"""Characters of its fields and constants: parsing them takes 2 s."""
MAX_FIELDS = 20_000
"""Fields of a message, those of the messages in it counted wherever they are nested."""
MAX_FIXED = 16 * 1024 * 1024
"""Values in the arrays of fixed length of a message, a nested message counting as a hundred."""
_NESTED_WEIGHT = 100


def require_short(name: str, definition: str) -> None:
    """Raise ValueError for the text of a definition, with its dependencies, that takes too long to parse."""
    if len(definition) > MAX_CHARACTERS:
        raise ValueError(f"the definition of {name} has more than {MAX_CHARACTERS} characters")
    declared = sum(len(line.partition("#")[0].strip()) + 1 for line in definition.split("\n") if line.strip())
    if declared > MAX_DECLARED:
        raise ValueError(f"the fields and constants of {name} take more than {MAX_DECLARED} characters")


def require_bounded(name: str, types: Mapping[str, MessageType]) -> None:
    """Raise ValueError for a message type that comes to too many fields; RecursionError where it nests itself."""
    fields, fixed = _Extent(types).of(name)
    if fields > MAX_FIELDS:
        raise ValueError(f"{name} comes to more than {MAX_FIELDS} fields, with those of the messages in it")
    if fixed > MAX_FIXED:
        raise ValueError(f"the arrays of fixed length of {name} come to more than {MAX_FIXED} values")


def may_be_empty(types: Mapping[str, MessageType]) -> bool:
    """Whether an element of an array of these types may take no bytes in ROS 1."""
    elements = {field.type.element for kind in types.values() for field in kind.fields if isinstance(field.type, Array)}
    return any(isinstance(each, Nested) and _takes_nothing(each, types) for each in elements)


def _takes_nothing(kind: FieldType, types: Mapping[str, MessageType]) -> bool:
    if isinstance(kind, Array):
        return kind.length == 0 or (kind.length is not None and _takes_nothing(kind.element, types))
    return isinstance(kind, Nested) and all(_takes_nothing(each.type, types) for each in types[kind.name].fields)


class _Extent:
    """Counts the fields and the values of fixed arrays of each type once, however often it is nested."""

    def __init__(self, types: Mapping[str, MessageType]) -> None:
        self._types = types
        self._known: dict[str, tuple[int, int]] = {}
        self._above: set[str] = set()

    def of(self, name: str) -> tuple[int, int]:
        if name in self._above:
            raise RecursionError(f"{name} is nested in itself")
        if name not in self._known:
            self._above.add(name)
            counts = [self._of_field(field.type) for field in self._types[name].fields]
            self._above.remove(name)
            self._known[name] = sum(fields for fields, _ in counts), sum(fixed for _, fixed in counts)
        return self._known[name]

    def _of_field(self, kind: FieldType) -> tuple[int, int]:
        if isinstance(kind, Array):
            fields, each = self._of_field(kind.element)
            return fields, each if kind.length is None else max(each, 1) * kind.length
        if isinstance(kind, Nested):
            fields, fixed = self.of(kind.name)
            return fields + 1, fixed + _NESTED_WEIGHT
        return 1, 0
