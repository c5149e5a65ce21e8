"""Coercion: fitting values to ROS primitives, exactly or, for floats, rounded to the nearest.

Values are already parsed: an int, a float or, if its digits matter, a Decimal. A value that does not fit raises a
`Misfit` with a description of the expected value.
"""

from __future__ import annotations

from base64 import b64decode
from binascii import Error as Base64Error
from collections.abc import Callable, Sized
from decimal import Decimal
from fractions import Fraction
from math import inf, isfinite, isinf
from struct import Struct
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from rosld.adapters.model import OCTETS, Array, FieldType, Nested, Primitive
from rosld.ontology.literals import DTYPES, wire_length

Number: TypeAlias = "int | float | Decimal"
Numbers: TypeAlias = npt.NDArray[Any]

_Sized = TypeVar("_Sized", bound=Sized)

RANGES = {
    name: (int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)) for name, dtype in DTYPES.items() if dtype.kind in "iu"
}
"""Minimum and maximum of each integer primitive."""

SPECIALS = {"NaN": float("nan"), "INF": float("inf"), "+INF": float("inf"), "-INF": float("-inf")}
"""XSD's names of NaN and the infinities."""

_FLOAT32, _FLOAT64, _INT64 = Struct("<f"), Struct("<d"), Struct("<Q")
_BEYOND_ANY = 24


class Misfit(ValueError):
    """A value that does not fit: the expected and the actual value, and the path below the field (`3.x`, or empty)."""

    def __init__(self, words: str, value: object = None, path: str = "") -> None:
        super().__init__(words)
        self.words = words
        self.value = value
        self.path = path


def describe_kind(kind: FieldType) -> str:
    """Return a description of the kind of value that a field expects."""
    if isinstance(kind, Nested):
        return f"a {kind.name}"
    if isinstance(kind, Array):
        return f"an array of {_count(kind)}{describe_kind(kind.element).partition(' ')[2]}"
    if kind.name in RANGES:
        least, greatest = RANGES[kind.name]
        article = "a" if kind.name[0] in "ubc" else "an"
        return f"{article} {kind.name} (an integer from {least} to {greatest})"
    return f"a {kind.name}" + (f" of at most {kind.bound} bytes" if kind.bound is not None else "")


def _count(kind: Array) -> str:
    if kind.length is not None:
        return f"exactly {kind.length} "
    return "" if kind.bound is None else f"at most {kind.bound} "


def integer_fit(kind: Primitive) -> Callable[[Number], int]:
    """Return the function that converts a number to an integer of this primitive. It raises Misfit."""
    least, greatest = RANGES[kind.name]

    def fit(value: Number) -> int:
        whole = value if type(value) is int else _whole(value)
        if whole is None or not least <= whole <= greatest:
            raise Misfit(f"expected {describe_kind(kind)}", value)
        return whole

    return fit


def _whole(value: Number) -> int | None:
    """Return the integer equal to a number; None if there is none, or none within the range of any ROS type."""
    if isinstance(value, float):
        return int(value) if value.is_integer() else None
    if isinstance(value, Decimal) and value.is_finite() and value.adjusted() <= _BEYOND_ANY:
        whole = int(value)
        return whole if whole == value else None
    return None


def float_fit(kind: Primitive) -> Callable[[Number], float]:
    """Return the function that rounds a number to the nearest float of this primitive. It raises Misfit.

    A finite number that rounds to infinity does not fit.
    """
    rounded = to_float32 if kind.name == "float32" else float

    def fit(value: Number) -> float:
        try:
            result = rounded(value)
        except OverflowError:
            raise Misfit(f"expected a {kind.name}, but this is out of its range", value) from None
        if isinf(result) and not (isinstance(value, float) and isinf(value)):
            raise Misfit(f"expected a {kind.name}, but this is out of its range", value)
        return result

    return fit


def to_float32(value: Number) -> float:
    """Return the float32 nearest to `value`, as a double. Raises OverflowError beyond the range of float32."""
    double = float(value)
    nearest: float = _FLOAT32.unpack(_FLOAT32.pack(double))[0]
    if nearest == double or isinstance(value, float) or not may_tie(double):
        return nearest
    other = float(np.nextafter(np.float32(nearest), np.float32(inf if double > nearest else -inf)))
    exact = Fraction(value)
    return other if isfinite(other) and abs(exact - Fraction(other)) < abs(exact - Fraction(nearest)) else nearest


def may_tie(double: float) -> bool:
    """Whether a double may lie halfway between two float32s, so that the unrounded value decides."""
    bits: int = _INT64.unpack(_FLOAT64.pack(double))[0]
    return not bits & 0x0FFFFFFF


def string_fit(kind: Primitive) -> Callable[[str], str]:
    """Return the function that checks a string against its maximum length in bytes of UTF-8. It raises Misfit."""
    bound = kind.bound

    def fit(value: str) -> str:
        if bound is not None and wire_length(value) > bound:
            raise Misfit(f"expected {describe_kind(kind)}, but this has {wire_length(value)}", value)
        return value

    return fit


def base64_octets(text: str) -> bytes:
    """Return the octets of xsd:base64Binary, which may contain white space. Raises Misfit."""
    try:
        return b64decode("".join(text.split()), validate=True)
    except (Base64Error, ValueError) as error:
        raise Misfit(f"expected base64 as in xsd:base64Binary ({error})", text) from error


def octet_array(kind: Array, octets: bytes) -> Numbers:
    """Return octets as the array of a field. Raises Misfit for a wrong length."""
    return check_length(kind, np.frombuffer(octets, DTYPES[kind.element.name]))


def check_length(kind: Array, values: _Sized) -> _Sized:
    """Return the values unchanged, if the field may have as many. Raises Misfit."""
    count = len(values)
    if kind.length is not None and count != kind.length:
        raise Misfit(f"expected {describe_kind(kind)}, but this has {count}")
    if kind.bound is not None and count > kind.bound:
        raise Misfit(f"expected {describe_kind(kind)}, but this has {count}")
    return values


def is_octets(kind: Array) -> bool:
    """Whether an array consists of octets."""
    return kind.element.name in OCTETS
