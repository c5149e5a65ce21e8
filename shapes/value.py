"""What a value must be: the one description from which a SHACL shape, a form and a data schema are drawn.

Beside the ROS type stand the bounds that limits (`--shapes`) give it, and what a mapping says of its unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import MessageSchema, Primitive


@dataclass(frozen=True, slots=True)
class Bounds:
    """What is demanded of one scalar beyond its type (SHACL 4.3 to 4.8); None and () where nothing is.

    `choices`: it is one of these. `step`: it is a multiple of these above `minimum`, or it is `maximum`. Lengths are in
    characters.
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
        """Whether anything is demanded."""
        return self != UNBOUNDED

    @property
    def range(self) -> Bounds:
        """The range alone."""
        return Bounds(self.minimum, self.maximum, self.exclusive_minimum, self.exclusive_maximum)


UNBOUNDED = Bounds()


@dataclass(frozen=True, slots=True)
class Measure:
    """What a number measures: its unit and its kind of quantity, as QUDT's terms."""

    unit: NamedNode | None = None
    quantity_kind: NamedNode | None = None


NO_MEASURE = Measure()


@dataclass(frozen=True, slots=True)
class ScalarShape:
    """A value that is one scalar of a ROS primitive.

    `is_parameter`: it is a parameter's, whose integers are xsd:integer, and numbers in JSON however large.
    """

    kind: Primitive
    bounds: Bounds = UNBOUNDED
    measure: Measure = NO_MEASURE
    is_parameter: bool = False


@dataclass(frozen=True, slots=True)
class MessageShape:
    """A value that is a message.

    `fields` are the names of those that belong to the value (all of the type's, as a rule), `bounds` those of single
    scalars by their dotted path (`linear.x`).
    """

    schema: MessageSchema
    fields: tuple[str, ...]
    bounds: Mapping[str, Bounds] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True)
class OpenShape:
    """A value of any kind: a parameter's, for which ROS declares no type."""

    bounds: Bounds = UNBOUNDED
    measure: Measure = NO_MEASURE


ValueShape: TypeAlias = ScalarShape | MessageShape | OpenShape
