"""What limits demand of what is written, as far as bounds can say it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rosld.shapes.value import Bounds


@dataclass(frozen=True, slots=True)
class Demand:
    """What limits demand of a message or a value, beyond its type.

    `bounds` are those of single scalars, by dotted path ("" is the value itself); `is_all` is False where limits hold
    that bounds cannot say.
    """

    bounds: Sequence[tuple[str, Bounds]] = ()
    is_all: bool = True

    def __and__(self, other: Demand) -> Demand:
        """What demands both."""
        return Demand((*self.bounds, *other.bounds), self.is_all and other.is_all)


NO_DEMAND = Demand()
