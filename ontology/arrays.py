"""Arrays: numbers, bools and strings as minimal JSON, the lexical form of rdf:JSON.

JSON has no NaN, INF or -INF, its readers often lose the sign of -0.0 and digits beyond 2^53: those are strings. The
whole array is formatted at once (orjson writes `null` for what it cannot) and only what needs it is spliced in.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from rosld.ontology.literals import SAFE_INTEGER, json_string, special_float

_NUMPY = orjson.OPT_SERIALIZE_NUMPY


def json_numbers(values: npt.NDArray[Any], quote: str = '"') -> str:
    """An array of numbers or bools as JSON; `quote` is how a quotation mark is written (`\\"` within a literal)."""
    text = _dump(values)
    if values.dtype.kind == "f":
        if "n" in text:  # only `null` has one, and one character is found much faster than four
            text = _with_specials(text, values, quote)
        if "-" in text and ("-0.0," in text or text.endswith("-0.0]")):
            text = _with_negative_zeros(text, quote)
    elif values.dtype.itemsize == 8 and values.size and _beyond_doubles(values):
        text = _with_wide_integers(values, quote)
    return text


def json_strings(values: Sequence[str]) -> str:
    """An array of strings as JSON; those that are not UTF-8 are value objects of their base64."""
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
