"""Bounds together: what several shapes demand of one scalar, as one demand."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import TypeVar

from pyoxigraph import Literal

from rosld.shapes.terms import number
from rosld.shapes.value import UNBOUNDED, Bounds

_K = TypeVar("_K", bound=Hashable)


def narrow(one: Bounds, other: Bounds) -> Bounds:
    """What fulfils both, as far as bounds can say it: of two patterns the first is kept."""
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
    """The bounds of several mappings in one, narrowed where they meet."""
    found: dict[_K, Bounds] = {}
    for mapping in mappings:
        for key, bounds in mapping.items():
            found[key] = narrow(found.get(key, UNBOUNDED), bounds)
    return {key: bounds for key, bounds in found.items() if bounds}


def is_exact(*mappings: Mapping[_K, Bounds]) -> bool:
    """Whether `merge_bounds` loses nothing of these: of two patterns it keeps the first."""
    found: dict[_K, Bounds] = {}
    for mapping in mappings:
        for key, bounds in mapping.items():
            other = found.get(key, UNBOUNDED)
            if (other.pattern is not None and bounds.pattern is not None) or (other.choices and bounds.choices):
                return False
            found[key] = narrow(other, bounds)
    return True


def _further(one: Literal | None, other: Literal | None, sign: int) -> Literal | None:
    """The bound that lies further up (`sign` 1) or down (-1); the first where they are no numbers."""
    if one is None or other is None:
        return one if other is None else other
    left, right = number(one), number(other)
    return other if left is not None and right is not None and (right > left if sign > 0 else right < left) else one


def _both(one: tuple[Literal, ...], other: tuple[Literal, ...]) -> tuple[Literal, ...]:
    """What is in both; where nothing is, the first, since no choice at all would mean that nothing is demanded."""
    if not one or not other:
        return one or other
    return tuple(each for each in one if each in other) or one
