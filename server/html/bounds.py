"""Bounds of inputs: the texts of attributes, options, and a sentence for people. Pure.

Bounds of inputs only help the user: the shape validates every submission, whatever the browser allowed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal, InvalidOperation

from pyoxigraph import Literal

from rosld.adapters.model import Primitive
from rosld.ontology.coercion import RANGES
from rosld.shapes.value import Bounds

_MAX_DIGITS = 40
_ONLY_IN_XPATH = re.compile(r"\\[A-Za-z]|\[[^\]]*\[|\(\?")
"""Constructs that XPath and browsers interpret differently: class escapes, subtraction, options."""


def parse_number(text: str) -> Decimal | None:
    """Return a text as a finite number, or None if it is not one or is too large."""
    try:
        found = Decimal(text.strip())
    except InvalidOperation:
        return None
    return found if found.is_finite() and abs(found.adjusted()) < _MAX_DIGITS else None


def same_value(one: str, other: str) -> bool:
    """Whether two texts are the same value: `1` and `1.0` are."""
    return one == other or (parse_number(one) is not None and parse_number(one) == parse_number(other))


def number_range(kind: Primitive, bounds: Bounds) -> tuple[str, str]:
    """Return the minimum and maximum of an input as texts; empty where there is none.

    Inputs have no exclusive bounds: for integers the next integer is used, for other numbers the bound itself.
    """
    least, greatest = RANGES.get(kind.name, (None, None))
    lower = _ends(least, bounds.minimum, bounds.exclusive_minimum, ROUND_CEILING, 1)
    upper = _ends(greatest, bounds.maximum, bounds.exclusive_maximum, ROUND_FLOOR, -1)
    return _text(max(lower, default=None)), _text(min(upper, default=None))


def _ends(
    own: int | None, inclusive: Literal | None, exclusive: Literal | None, rounding: str, inward: int
) -> Iterator[Decimal]:
    """Yield one end of a range by the type (`own`, of whole numbers) and by each bound."""
    if own is not None:
        yield Decimal(own)
    for bound, step in ((inclusive, 0), (exclusive, inward)):
        number = _bound(bound)
        if number is not None:
            whole = number.to_integral_value(rounding)
            yield number if own is None else whole + step if whole == number else whole


def number_step(kind: Primitive, bounds: Bounds) -> str:
    """Return the step of an input.

    Browsers count steps from the minimum. The step is omitted if it would exclude the maximum.
    """
    plain = "1" if kind.name in RANGES else "any"
    step, least, greatest = (_bound(each) for each in (bounds.step, bounds.minimum, bounds.maximum))
    if step is None:
        return plain
    even = least is not None and greatest is not None and (greatest - least) % step == 0
    return _text(step) if even else plain


def _bound(literal: Literal | None) -> Decimal | None:
    return None if literal is None else parse_number(literal.value)


def _text(value: Decimal | None) -> str:
    return "" if value is None else f"{value:f}"


def option_texts(kind: Primitive | None, bounds: Bounds) -> tuple[str, ...]:
    """Return the texts of the choices, in order; for integer types without a fraction."""
    return tuple(dict.fromkeys(_option(kind, choice) for choice in bounds.choices))


def _option(kind: Primitive | None, choice: Literal) -> str:
    found = parse_number(choice.value) if kind is not None and kind.name in RANGES else None
    return str(int(found)) if found is not None and found == found.to_integral_value() else choice.value


def browser_pattern(bounds: Bounds) -> str:
    """Return the `pattern` of an input, which browsers match against the whole text; empty if they may differ."""
    if bounds.pattern is None or _ONLY_IN_XPATH.search(bounds.pattern):
        return ""
    return f".*(?:{bounds.pattern}).*"


def describe_bounds(bounds: Bounds) -> str:
    """Return the constraints as a sentence; empty without any, or if the options show them."""
    if bounds.choices:
        return ""
    found = ", ".join(_phrases(bounds))
    return f"{found[:1].upper()}{found[1:]}." if found else ""


def _phrases(bounds: Bounds) -> Iterator[str]:
    if bounds.minimum is not None and bounds.maximum is not None:
        yield f"from {bounds.minimum.value} to {bounds.maximum.value}"
    elif bounds.minimum is not None:
        yield f"at least {bounds.minimum.value}"
    elif bounds.maximum is not None:
        yield f"at most {bounds.maximum.value}"
    if bounds.exclusive_minimum is not None:
        yield f"more than {bounds.exclusive_minimum.value}"
    if bounds.exclusive_maximum is not None:
        yield f"less than {bounds.exclusive_maximum.value}"
    if bounds.step is not None:
        yield f"in steps of {bounds.step.value}"
    if bounds.min_length is not None:
        yield f"at least {_characters(bounds.min_length)}"
    if bounds.max_length is not None:
        yield f"at most {_characters(bounds.max_length)}"
    if bounds.pattern is not None:
        yield f"must match {bounds.pattern}"


def _characters(count: int) -> str:
    return f"{count} character{'' if count == 1 else 's'}"
