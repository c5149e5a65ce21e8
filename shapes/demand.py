"""What limits demand of what is written, as far as a shape of it can say that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rosld.shapes.limit_parts import LimitPart
from rosld.shapes.value import Bounds


@dataclass(frozen=True, slots=True)
class Demand:
    """What limits demand of a message or a value, beyond its type.

    `bounds` are those of single scalars, by dotted path ("" is the value itself). `value_parts` are limits that say
    more, by the same paths, and `type_parts` those on all messages of a type, by its name. `is_all` is False where
    limits hold that none of these can say. `largest` is the largest absolute value of all floats, which are finite;
    None where they may be any.
    """

    bounds: Sequence[tuple[str, Bounds]] = ()
    is_all: bool = True
    value_parts: Sequence[tuple[str, LimitPart]] = ()
    type_parts: Sequence[tuple[str, LimitPart]] = ()
    largest: float | None = None

    def __and__(self, other: Demand) -> Demand:
        """What demands both."""
        return Demand(
            (*self.bounds, *other.bounds),
            self.is_all and other.is_all,
            (*self.value_parts, *other.value_parts),
            (*self.type_parts, *other.type_parts),
            min((each for each in (self.largest, other.largest) if each is not None), default=None),
        )

    def of_bounds(self) -> Demand:
        """What bounds can say of it."""
        is_all = self.is_all and not self.value_parts and not self.type_parts
        return Demand(self.bounds, is_all, largest=self.largest)

    def of_ranges(self) -> Demand:
        """What ranges of numbers can say of it."""
        ranges = [(path, each) for path, each in self.bounds if each == each.range]
        is_all = self.of_bounds().is_all and len(ranges) == len(self.bounds)
        return Demand(ranges, is_all, largest=self.largest)

    def at(self, path: str) -> Demand:
        """What is demanded of the value at a path, where that is written alone; `is_all` is False where more is."""
        bounds = [("", each) for where, each in self.bounds if where == path]
        parts = [("", each) for where, each in self.value_parts if where == path]
        is_all = self.is_all and len(parts) == len(self.value_parts) and not self.type_parts
        return Demand(bounds, is_all, parts, largest=self.largest)


NO_DEMAND = Demand()
