"""The shape of a value: ROS type, bounds from limits (`--shapes`), unit by its type or from a mapping.

SHACL shapes, forms and data schemas are derived from it.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, TypeAlias, TypeVar

from msgspec import Struct
from pyoxigraph import Literal

from rosld.adapters.model import Field, MessageSchema, Primitive
from rosld.ontology.triples import Statement, integer, text
from rosld.ontology.units import UNKNOWN, Quantity, field_quantity
from rosld.ontology.vocab import sh
from rosld.shapes.terms import number


class Bounds(Struct, frozen=True):
    """Constraints on one scalar beyond its type (SHACL 4.3 to 4.8); None and () for none.

    `choices`: the allowed values. `step`: the value is a multiple of this above `minimum`, or it is `maximum`. Lengths
    are in characters.
    """

    minimum: Literal | None = None
    maximum: Literal | None = None
    exclusive_minimum: Literal | None = None
    exclusive_maximum: Literal | None = None
    choices: tuple[Literal, ...] = ()
    pattern: str | None = None
    min_length: int | None = None
    max_length: int | None = None
    step: Literal | None = None

    def __bool__(self) -> bool:
        """Whether there are constraints."""
        return self != UNBOUNDED

    @property
    def range(self) -> Bounds:
        """The bounds with only the range."""
        return Bounds(self.minimum, self.maximum, self.exclusive_minimum, self.exclusive_maximum)

    @property
    def range_statements(self) -> list[Statement]:
        """Return the range as SHACL."""
        return [
            (sh.minInclusive, self.minimum),
            (sh.maxInclusive, self.maximum),
            (sh.minExclusive, self.exclusive_minimum),
            (sh.maxExclusive, self.exclusive_maximum),
        ]

    @property
    def text_statements(self) -> list[Statement]:
        """Return the pattern and the lengths as SHACL."""
        return [
            (sh.pattern, text(self.pattern)),
            (sh.minLength, integer(self.min_length)),
            (sh.maxLength, integer(self.max_length)),
        ]


UNBOUNDED = Bounds()


class ScalarShape(Struct, frozen=True):
    """A value that is one scalar of a ROS primitive.

    `is_parameter`: it is the value of a parameter; its integers are xsd:integer in RDF and numbers of any size in JSON.
    """

    kind: Primitive
    bounds: Bounds = UNBOUNDED
    quantity: Quantity = UNKNOWN
    is_parameter: bool = False


@dataclass(frozen=True, slots=True)
class MessageShape:
    """A value that is a message.

    `fields` are those that belong to the value (usually all fields of the type), `bounds` those of single scalars by
    dotted path (`linear.x`).
    """

    schema: MessageSchema
    fields: tuple[Field, ...]
    bounds: Mapping[str, Bounds] = field(default_factory=dict, hash=False)
    quantity: ClassVar[Quantity] = UNKNOWN


class OpenShape(Struct, frozen=True):
    """A value of any kind: of a parameter without a declared type, or of a topic with an unknown type."""

    kind: ClassVar[None] = None
    bounds: Bounds = UNBOUNDED
    quantity: Quantity = UNKNOWN
    is_parameter: ClassVar[bool] = False


ValueShape: TypeAlias = ScalarShape | MessageShape | OpenShape


def value_shape(schema: MessageSchema, fields: tuple[Field, ...]) -> ScalarShape | MessageShape:
    """Return the shape of a value that consists of these fields of a message: a scalar if it is one primitive."""
    if len(fields) == 1 and isinstance(fields[0].type, Primitive):
        quantity = field_quantity(schema.ref.name, fields[0])
        return ScalarShape(fields[0].type, quantity=quantity or UNKNOWN)
    return MessageShape(schema, fields)


_K = TypeVar("_K", bound=Hashable)


def narrow(one: Bounds, other: Bounds) -> Bounds:
    """Return the conjunction as far as bounds can express it: of two patterns, the first is used."""
    if not one or not other:
        return one or other
    return Bounds(
        minimum=_further(one.minimum, other.minimum, 1),
        maximum=_further(one.maximum, other.maximum, -1),
        exclusive_minimum=_further(one.exclusive_minimum, other.exclusive_minimum, 1),
        exclusive_maximum=_further(one.exclusive_maximum, other.exclusive_maximum, -1),
        choices=_both(one.choices, other.choices),
        pattern=one.pattern if one.pattern is not None else other.pattern,
        min_length=max((each for each in (one.min_length, other.min_length) if each is not None), default=None),
        max_length=min((each for each in (one.max_length, other.max_length) if each is not None), default=None),
        step=one.step or other.step,
    )


def merge_bounds(*mappings: Mapping[_K, Bounds]) -> dict[_K, Bounds]:
    """Return the merged bounds of several mappings, narrowed where they overlap."""
    found: dict[_K, Bounds] = {}
    for mapping in mappings:
        for key, bounds in mapping.items():
            found[key] = narrow(found.get(key, UNBOUNDED), bounds)
    return {key: bounds for key, bounds in found.items() if bounds}


def is_exact(*mappings: Mapping[_K, Bounds]) -> bool:
    """Whether `merge_bounds` loses nothing of these: of two patterns, it uses the first."""
    found: dict[_K, Bounds] = {}
    for mapping in mappings:
        for key, bounds in mapping.items():
            other = found.get(key, UNBOUNDED)
            if (other.pattern is not None and bounds.pattern is not None) or (other.choices and bounds.choices):
                return False
            found[key] = narrow(other, bounds)
    return True


def _further(one: Literal | None, other: Literal | None, sign: int) -> Literal | None:
    """Return the higher bound (`sign` 1) or the lower one (-1); the first if they are no numbers."""
    if one is None or other is None:
        return one if other is None else other
    left, right = number(one), number(other)
    return other if left is not None and right is not None and (right > left if sign > 0 else right < left) else one


def _both(one: tuple[Literal, ...], other: tuple[Literal, ...]) -> tuple[Literal, ...]:
    """Return the intersection or, if it is empty, the first, because no choices would mean no constraint."""
    if not one or not other:
        return one or other
    return tuple(each for each in one if each in other) or one
