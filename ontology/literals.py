"""Literals: values of ROS primitives in RDF and in JSON.

Numbers have the shortest digits that read back the same; numbers that JSON lacks (NaN, INF, -INF) have XSD's names. The
functions here run inside the generated lifters, so they take many values at a time and format with orjson, whose
escapes in strings are exactly those that Turtle and N-Triples define too.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterable, Sequence
from datetime import datetime, timezone
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from rosld.ontology.vocab import xsd

BASE64 = xsd.base64Binary.value

DATATYPES = {
    "bool": "boolean",
    "byte": "byte",
    "char": "unsignedByte",
    "int8": "byte",
    "uint8": "unsignedByte",
    "int16": "short",
    "uint16": "unsignedShort",
    "int32": "int",
    "uint32": "unsignedInt",
    "int64": "long",
    "uint64": "unsignedLong",
    "float32": "float",
    "float64": "double",
    "string": "string",
    "wstring": "string",
}
"""Local name, in XSD, of the datatype of each primitive (a byte is signed and a char is not, as on the wire)."""

DTYPES: dict[str, np.dtype[Any]] = {
    "bool": np.dtype("?"),
    "byte": np.dtype("i1"),
    "char": np.dtype("u1"),
    **{name: np.dtype(name) for name in DATATYPES if name[-1].isdigit()},
}
"""The numpy type of arrays of each primitive, except strings."""

SAFE_INTEGER = 2**53
"""Maximum absolute value of JSON integers; larger ones are strings, as many readers convert numbers to doubles."""


def special_float(value: float) -> str:
    """Return XSD's name of a float that is not finite."""
    if value != value:
        return "NaN"
    return "INF" if value > 0 else "-INF"


def scalar_texts(values: Iterable[bool | int | float]) -> list[str]:
    """Return the lexical forms of numbers and bools in a tuple or a numpy array (for float32's own digits)."""
    text = orjson.dumps(values, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].decode()
    if "null" not in text:
        return text.split(",")
    return [
        special_float(value) if form == "null" else form for form, value in zip(text.split(","), values, strict=True)
    ]


def json_scalars(values: Iterable[bool | int | float | str]) -> list[str]:
    """Return numbers and bools as JSON: values that are not JSON numbers are strings."""
    text = orjson.dumps(values, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].decode()
    if "null" not in text:
        return text.split(",")
    pairs = zip(text.split(","), values, strict=True)
    return [f'"{special_float(float(value))}"' if form == "null" else form for form, value in pairs]


def wide_integer_json(value: int) -> int | str:
    """Return a 64-bit integer as JSON: as a string of digits if a double might lose some."""
    return value if -SAFE_INTEGER <= value <= SAFE_INTEGER else str(value)


def unpack_float32(packed: bytes) -> npt.NDArray[np.float32]:
    """Return the float32s in `packed` (little endian)."""
    return np.frombuffer(packed, "<f4")


def wire_bytes(value: str) -> bytes:
    """Return the bytes of a string as they are on the wire."""
    return value.encode("utf-8", "surrogateescape")


def wire_length(value: str) -> int:
    """Return the number of bytes of a string on the wire."""
    return len(value) if value.isascii() else len(wire_bytes(value))


def base64_length(octets: int | None) -> int | None:
    """Return the number of characters of the base64 of octets: four per started group of three; None stays None."""
    return None if octets is None else (octets + 2) // 3 * 4


def base64_text(value: bytes) -> str:
    """Return the base64 of octets (of any object with a buffer)."""
    return b64encode(value).decode("ascii")


def quote(value: str) -> str:
    """Return a string in quotes, valid in JSON, Turtle and N-Triples. Raises TypeError if it is not UTF-8."""
    return orjson.dumps(value).decode()


def json_string(value: str) -> str:
    """Return a string as JSON and JSON-LD: invalid UTF-8 becomes JSON-LD's value object with its base64."""
    try:
        return orjson.dumps(value).decode()
    except TypeError:
        return f'{{"@value":"{base64_text(wire_bytes(value))}","@type":"{BASE64}"}}'


@lru_cache(maxsize=4096)
def _second(seconds: int) -> str:
    return str(np.datetime64(seconds, "s"))


def date_time(seconds: int, nanoseconds: int) -> str:
    """Return the canonical xsd:dateTime (UTC, no trailing zeros) of a time after the epoch, of any sign and size."""
    if not 0 <= nanoseconds < 1_000_000_000:
        carry, nanoseconds = divmod(nanoseconds, 1_000_000_000)
        seconds += carry
    if nanoseconds == 0:
        return _second(seconds) + "Z"
    return f"{_second(seconds)}.{nanoseconds:09d}".rstrip("0") + "Z"


_DATE_TIME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,30}))?(?:Z|([+-]\d\d:\d\d))", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def date_time_nanoseconds(date_time: str) -> int | None:
    """Return the nanoseconds from the epoch to an xsd:dateTime with a time zone; None for any other text."""
    found = _DATE_TIME.fullmatch(date_time)
    if found is None:
        return None
    try:
        seconds = int((datetime.fromisoformat(found[1] + (found[3] or "+00:00")) - _EPOCH).total_seconds())
    except (ValueError, OverflowError):
        return None
    return seconds * 1_000_000_000 + int((found[2] or "0").ljust(9, "0")[:9])


_NUMPY = orjson.OPT_SERIALIZE_NUMPY


def json_numbers(values: npt.NDArray[Any], quote: str = '"') -> str:
    """Return an array of numbers or bools as JSON; `quote` is the quotation mark (`\\"` within a literal)."""
    text = _dump(values)
    if values.dtype.kind == "f":
        if "n" in text:  # only `null` contains one, and one character is found much faster than four
            text = _with_specials(text, values, quote)
        if "-" in text and ("-0.0," in text or text.endswith("-0.0]")):
            text = _with_negative_zeros(text, quote)
    elif values.dtype.itemsize == 8 and values.size and _beyond_doubles(values):
        text = _with_wide_integers(values, quote)
    return text


def json_strings(values: Sequence[str]) -> str:
    """Return an array of strings as JSON; those that are not UTF-8 are value objects with their base64."""
    try:
        return orjson.dumps(values).decode()
    except TypeError:
        return f"[{','.join(map(json_string, values))}]"


def _dump(values: npt.NDArray[Any]) -> str:
    try:
        return orjson.dumps(values, option=_NUMPY).decode()
    except TypeError:  # not contiguous, or of foreign byte order
        return orjson.dumps(np.array(values, values.dtype.newbyteorder("=")), option=_NUMPY).decode()


def _with_specials(text: str, values: npt.NDArray[Any], quote: str) -> str:
    odd = values[~np.isfinite(values)]
    if (odd == odd[0]).all():
        return text.replace("null", f"{quote}{special_float(odd[0])}{quote}")
    names = iter([f"{quote}{special_float(value)}{quote}" for value in odd.tolist()])
    first, *pieces = text.split("null")
    return first + "".join([next(names) + piece for piece in pieces])


def _with_negative_zeros(text: str, quote: str) -> str:
    zero = f"{quote}-0.0{quote}"
    text = text.replace("-0.0,", zero + ",")
    return text.removesuffix("-0.0]") + zero + "]" if text.endswith("-0.0]") else text


def _beyond_doubles(values: npt.NDArray[Any]) -> bool:
    return bool(values.max() > SAFE_INTEGER or values.min() < -SAFE_INTEGER)


def _with_wide_integers(values: npt.NDArray[Any], quote: str) -> str:
    def written(value: int) -> str:
        return str(value) if -SAFE_INTEGER <= value <= SAFE_INTEGER else f"{quote}{value}{quote}"

    return f"[{','.join(map(written, values.tolist()))}]"
