"""Type inference: the use of a service or topic as a property or action, by its type. Pure.

A name only proposes a getter or a setter; these functions decide. A GET must be safe (RFC 9110 9.2.1), so a service
that could be a command is no getter: a response with only a status is that of a command.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from math import inf

from rosld.adapters.model import STRINGS, Array, Field, MessageSchema, Nested, Primitive, ServiceSchema
from rosld.shapes.value import MessageShape, OpenShape, ScalarShape, ValueShape

_OCTETS = frozenset({"byte", "char", "octet", "int8", "uint8", "int16", "uint16"})
"""Types of numbers whose unbounded arrays are pictures, clouds, maps or sounds."""
_MAX_NUMBERS = 1000
"""Maximum number of numbers in an array of a light message."""
_HEAVY = frozenset({"LaserScan", "MultiEchoLaserScan", "LaserEcho", "PointCloud", "PolygonMesh", "Mesh", "Marker"})
"""Messages with large unbounded arrays of other numbers; a battery's cells and a robot's joints are few."""

_BULKY = frozenset({"PointCloud", "PolygonMesh", "Mesh"})


@lru_cache(maxsize=1024)
def is_light(schema: MessageSchema) -> bool:
    """Whether messages of a type are usually small, including nested messages."""
    kinds = schema.types.values()
    if any(kind.name.rpartition("/")[2] in _HEAVY for kind in kinds):
        return False
    return not any(_is_many(field.type) for kind in kinds for field in kind.fields)


@lru_cache(maxsize=1024)
def is_bulky(schema: MessageSchema) -> bool:
    """Whether messages of a type are pictures, clouds, maps or sounds, which are too large to receive incidentally."""
    kinds = schema.types.values()
    if any(kind.name.rpartition("/")[2] in _BULKY for kind in kinds):
        return True
    arrays = (field.type for kind in kinds for field in kind.fields if isinstance(field.type, Array))
    return any(
        isinstance(one.element, Primitive) and one.element.name in _OCTETS and (one.length or one.bound) is None
        for one in arrays
    )


def _is_many(kind: object) -> bool:
    if not isinstance(kind, Array) or not isinstance(kind.element, Primitive):
        return False
    return kind.element.name in _OCTETS if kind.most is None else kind.most > _MAX_NUMBERS


MAX_ELEMENTS = 64
"""Maximum number of elements of an array in a light response, with nested arrays multiplied."""

_WORDS = frozenset({"message", "status_message"})


def value_fields(schema: ServiceSchema) -> tuple[Field, ...]:
    """Return the fields of the response that form the value; empty if the type is not that of a getter.

    A getter's request is empty and its response is light and more than a status. The status is `bool success` and, with
    it, the string `message` or `status_message`.
    """
    if schema.request.type.fields or not is_small(schema.response):
        return ()
    fields = schema.response.type.fields
    answered = tuple(field for field in fields if not _is_success(field))
    if len(answered) == len(fields):
        return fields
    return tuple(field for field in answered if not _is_words(field))


def _is_success(field: Field) -> bool:
    return field.name == "success" and field.type == Primitive("bool")


def _is_words(field: Field) -> bool:
    return field.name in _WORDS and isinstance(field.type, Primitive) and field.type.name in STRINGS


def is_small(schema: MessageSchema) -> bool:
    """Whether messages of this type are always small: every array in it is short and bounded."""
    return _widest(schema, schema.ref.name, {}) <= MAX_ELEMENTS


def _widest(schema: MessageSchema, name: str, known: dict[str, float]) -> float:
    """Return the maximum number of repetitions of one field of a type; each type is visited once."""
    if name not in known:
        known[name] = inf  # the result for a type that contains itself
        known[name] = max((_repeated(schema, field, known) for field in schema.types[name].fields), default=1)
    return known[name]


def _repeated(schema: MessageSchema, field: Field, known: dict[str, float]) -> float:
    kind, times = field.type, 1.0
    if isinstance(kind, Array):
        times, kind = inf if kind.most is None else max(kind.most, 1), kind.element
    return times * _widest(schema, kind.name, known) if isinstance(kind, Nested) else times


def is_convertible(value: ValueShape, into: ValueShape) -> bool:
    """Whether a value of one shape can be sent as another: the same fields, or one scalar each of one family.

    An integer can be sent as a float, but not a float as an integer. Ranges and lengths are checked per value. An open
    shape is convertible to any other.
    """
    if isinstance(value, OpenShape) or isinstance(into, OpenShape):
        return True
    if isinstance(value, ScalarShape) and isinstance(into, ScalarShape):
        families = _family(value.kind), _family(into.kind)
        return families[0] == families[1] or families == ("integer", "float")
    if isinstance(value, MessageShape) and isinstance(into, MessageShape):
        return _tree(value.fields) == _tree(into.fields) and all(
            _tree(value.schema.types[name].fields) == _tree(into.schema.types[name].fields)
            for name in _nested_types(value)
        )
    return False


def _family(primitive: Primitive) -> str:
    if primitive.name in STRINGS:
        return "string"
    if primitive.name == "bool":
        return "bool"
    return "float" if primitive.name.startswith("float") else "integer"


def _tree(fields: tuple[Field, ...]) -> dict[str, object]:
    """Return fields by name, because their order is irrelevant."""
    return {field.name: field.type for field in fields}


def _nested_types(shape: MessageShape) -> Iterator[str]:
    """Yield the types within a value, outermost first, without duplicates."""
    seen: set[str] = set()
    waiting = list(shape.fields)
    while waiting:
        found = waiting.pop().type
        element = found.element if isinstance(found, Array) else found
        if isinstance(element, Nested) and element.name not in seen:
            seen.add(element.name)
            yield element.name
            waiting.extend(shape.schema.types[element.name].fields)
