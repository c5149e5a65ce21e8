"""Patterns of lexical forms: octets, and arrays in rdf:JSON (RFC 8259).

They use the common subset of XPath, Python and Java (XQuery Functions 7.6.1), and alternatives differ early, so that
matching takes linear time.
"""

from __future__ import annotations

from rosld.adapters.model import Array, Primitive
from rosld.ontology.coercion import RANGES
from rosld.ontology.literals import BASE64, STRINGS

LONGEST_COUNT = 1000
"""Maximum number of elements that a pattern counts."""
WHOLE_DECIMAL = r"^\s*[+-]?[0-9]*(\.0*)?\s*$"
"""An xsd:decimal that is an integer."""

_SPACE = r"[ \t\n\r]*"
_SEXTET = r"[A-Za-z0-9+/]\s*"
_DIGITS = "(0|[1-9][0-9]*)"
_WIDE = "-?(0|[1-9][0-9]{0,23})"
_FLOATS = {
    "float64": (
        r"(0|[1-9][0-9]{0,299})(\.[0-9]+)?([eE]-[0-9]+)?",
        r"(0|[1-9][0-9]{0,7})(\.[0-9]+)?[eE]\+?0*[12]?[0-9]{1,2}",
        r"[0-9](\.[0-9]+)?[eE]\+?30[0-7]",
        r"(0(\.[0-9]+)?|1(\.([0-6][0-9]*|7([0-8][0-9]*)?|79([0-6][0-9]*)?|7976931348623157))?)[eE]\+?308",
    ),
    "float32": (
        r"(0|[1-9][0-9]{0,37})(\.[0-9]+)?([eE]-[0-9]+)?",
        r"(0|[1-9][0-9]{0,7})(\.[0-9]+)?[eE]\+?0*[12]?[0-9]",
        r"[0-9](\.[0-9]+)?[eE]\+?3[0-7]",
        r"([0-2](\.[0-9]+)?|3(\.([0-3][0-9]*|40?|4028235|4028234663852886))?)[eE]\+?38",
    ),
}
"""JSON numbers within the range of a float, including its maximum."""
_HEX = "[0-9A-Fa-f]"
_PAIR = rf"[dD][89ABab]{_HEX}{{2}}\\u[dD][C-Fc-f]{_HEX}{{2}}"
_UNICODE = rf"u([0-9A-CEFa-cef]{_HEX}{{3}}|[dD][0-7]{_HEX}{{2}}|{_PAIR})"
"""Escapes of characters, without unpaired surrogates."""
_CHARACTER = rf'([^"\\\x00-\x1F]|\\(["\\/bfnrt]|{_UNICODE}))'


def base64_pattern(length: int | None = None, bound: int | None = None) -> str:
    """Return the pattern of base64 with white space anywhere, of exactly `length`, or at most `bound` octets."""
    most = length if length is not None else bound
    if most is None or most > LONGEST_COUNT:
        return rf"^\s*([A-Za-z0-9+/\s]*{_SEXTET}{_SEXTET}(=\s*){{0,2}})?$"
    if most == 0:
        return r"^\s*$"
    sextets = (4 * most + 2) // 3
    some = rf"({_SEXTET}){{{sextets if length is not None else f'2,{sextets}'}}}(=\s*){{0,2}}"
    return rf"^\s*{some}$" if length is not None else rf"^\s*({some})?$"


def hex_pattern(length: int | None = None, bound: int | None = None) -> str:
    """Return the pattern of hexadecimal octets, without white space, of exactly `length`, or at most `bound` octets."""
    most = length if length is not None else bound
    counts = "*" if most is None or most > LONGEST_COUNT else f"{{{most if length is not None else f'0,{most}'}}}"
    return rf"^([0-9A-Fa-f]{{2}}){counts}$"


def json_array_pattern(kind: Array, element: Primitive, *, is_finite: bool = False) -> str:
    """Return the pattern of an array of a primitive in JSON; a number of elements over 1000 is not checked.

    `is_finite`: its floats are finite, also as float32.
    """
    one = _json_element(element, is_finite=is_finite)
    least, most = (kind.length, kind.length) if kind.length is not None else (0, kind.bound)
    if most == 0:
        return rf"^{_SPACE}\[{_SPACE}\]{_SPACE}$"
    more = "*" if most is None or most > LONGEST_COUNT else f"{{{max(0, (least or 0) - 1)},{most - 1}}}"
    elements = rf"{one}({_SPACE},{_SPACE}{one}){more}{_SPACE}"
    return rf"^{_SPACE}\[{_SPACE}{elements if least else f'({elements})?'}\]{_SPACE}$"


def parameter_array_pattern(element: Primitive, *, is_finite: bool = False) -> str:
    """Return the pattern of an array in a parameter: values that JSON cannot represent are objects with a datatype.

    `is_finite`: its floats are finite, also as float32.
    """
    one = f"({_parameter_element(element, is_finite=is_finite)})"
    return rf"^{_SPACE}\[{_SPACE}({one}({_SPACE},{_SPACE}{one})*{_SPACE})?\]{_SPACE}$"


def open_array_pattern(*, is_finite: bool) -> str:
    """Return the pattern of any list in JSON, as far as SHACL can express it.

    `is_finite`: its numbers are finite, also as float32.
    """
    start = rf"^{_SPACE}\["
    if not is_finite:
        return start
    number = f"-?({'|'.join(_FLOATS['float32'])})"
    return rf'{start}("{_CHARACTER}*"|{number}[\s,\]}}]|[^"0-9-])*$'


def _parameter_element(kind: Primitive, *, is_finite: bool) -> str:
    if kind.name in RANGES:
        number = integer_pattern(*RANGES[kind.name])
        return f"{number}|{_typed_object(number, 'integer')}"
    if kind.name in _FLOATS:
        finite = f"-?({'|'.join(_FLOATS['float32' if is_finite else kind.name])})"
        return finite if is_finite else f"{finite}|{_typed_object('(NaN|-?INF)', 'double')}"
    return _json_element(kind) if kind.name == "bool" else rf'"{_CHARACTER}*"'


def _typed_object(value: str, datatype: str) -> str:
    """Return the pattern of an object with a value, as text, and its datatype."""
    members = rf'"@value"{_SPACE}:{_SPACE}"{value}"', rf'"@type"{_SPACE}:{_SPACE}"xsd:{datatype}"'
    comma = f"{_SPACE},{_SPACE}"
    return rf"\{{{_SPACE}({comma.join(members)}|{comma.join(reversed(members))}){_SPACE}\}}"


def _json_element(kind: Primitive, *, is_finite: bool = False) -> str:
    if kind.name == "bool":
        return "(true|false)"
    if kind.name in STRINGS:
        octets = rf'"@value"{_SPACE}:{_SPACE}"[A-Za-z0-9+/]*={{0,2}}"'
        datatype = rf'"@type"{_SPACE}:{_SPACE}"{BASE64.replace(".", "[.]")}"'
        comma = f"{_SPACE},{_SPACE}"
        most = "*" if kind.bound is None or kind.bound > LONGEST_COUNT else f"{{0,{kind.bound}}}"
        return rf"(\"{_CHARACTER}{most}\"|\{{{_SPACE}({octets}{comma}{datatype}|{datatype}{comma}{octets}){_SPACE}\}})"
    if kind.name in RANGES:
        number = integer_pattern(*RANGES[kind.name])
        return f'({number}|"{number}")' if kind.name.endswith("64") else number
    numbers = "|".join(_FLOATS["float32" if is_finite else kind.name])
    return f'(-?({numbers})|"({"" if is_finite else "[+-]?INF|NaN|"}-0[.]0|{_WIDE})")'


def integer_pattern(least: int, greatest: int) -> str:
    """Return the pattern of JSON integers from `least` (0 or less) to `greatest` (0 or more), without leading zeros."""
    positive = "|".join(_up_to(str(greatest)))
    if least == 0:
        return f"(-?0|{positive})"
    return f"(-?0|{positive}|-({'|'.join(_up_to(str(-least)))}))"


def _up_to(most: str) -> list[str]:
    """Return alternatives for the integers from 1 to `most`."""
    shorter = f"[1-9][0-9]{{0,{len(most) - 2}}}" if len(most) > 1 else ""
    found = [shorter] if shorter else []
    for place, digit in enumerate(most):
        least, rest = (1 if place == 0 else 0), len(most) - place - 1
        if int(digit) > least:
            found.append(f"{most[:place]}[{least}-{int(digit) - 1}]" + (f"[0-9]{{{rest}}}" if rest else ""))
    return [*found, most]
