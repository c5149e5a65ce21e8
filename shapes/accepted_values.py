"""Shapes of field values in RDF from clients: more lexical forms than this server itself writes.

People write `1` or `0.5` in Turtle where ROS has a double, and programs write the numbers of their language. Therefore
any XSD number that the field can represent is accepted: for an integer all integers, and decimals without a fraction;
for a float all numbers, rounded to the nearest, and INF, -INF and NaN unless it is a command. These shapes define
exactly what is accepted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, cast

from pyoxigraph import Literal, NamedNode

from rosld.adapters.model import OCTETS, STRINGS, Array, ParameterType, Primitive
from rosld.ontology.coercion import RANGES, SPECIALS
from rosld.ontology.lexical import NUMBERS
from rosld.ontology.literals import BASE64, DATATYPES
from rosld.ontology.triples import Statement, Value, double, integer, text
from rosld.ontology.vocab import rdf, sh, xsd
from rosld.shapes.command_numbers import LARGEST_NUMBER
from rosld.shapes.terms import number
from rosld.shapes.value import Bounds
from rosld.shapes.writer import ShapesWriter, list_of

LONGEST_COUNT = 1000
"""Maximum number of elements that a pattern counts."""
WHOLE_DECIMAL = r"^\s*[+-]?[0-9]*(\.0*)?\s*$"
"""An xsd:decimal that is an integer."""

_SPACE = r"[ \t\n\r]*"
_SEXTET = r"[A-Za-z0-9+/]\s*"
_DIGITS = "(0|[1-9][0-9]*)"
_INTEGER_DIGITS = "-?(0|[1-9][0-9]{0,23})"
_FLOAT_DIGITS = {
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
    number = f"-?({'|'.join(_FLOAT_DIGITS['float32'])})"
    return rf'{start}("{_CHARACTER}*"|{number}[\s,\]}}]|[^"0-9-])*$'


def _parameter_element(kind: Primitive, *, is_finite: bool) -> str:
    if kind.name in RANGES:
        number = integer_pattern(*RANGES[kind.name])
        return f"{number}|{_typed_object(number, 'integer')}"
    if kind.name in _FLOAT_DIGITS:
        finite = f"-?({'|'.join(_FLOAT_DIGITS['float32' if is_finite else kind.name])})"
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
    numbers = "|".join(_FLOAT_DIGITS["float32" if is_finite else kind.name])
    return f'(-?({numbers})|"({"" if is_finite else "[+-]?INF|NaN|"}-0[.]0|{_INTEGER_DIGITS})")'


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


PARAMETERS: Mapping[ParameterType, Primitive] = {
    ParameterType.BOOLEAN: Primitive("bool"),
    ParameterType.INTEGER: Primitive("int64"),
    ParameterType.DOUBLE: Primitive("float64"),
    ParameterType.STRING: Primitive("string"),
}
"""Primitives of scalar parameters by declared type."""
PARAMETER_ARRAYS = {ParameterType(f"{type.value} array"): element for type, element in PARAMETERS.items()}
"""Primitives of the elements of declared arrays; octets are written as octets."""


class OpenParameter(NamedTuple):
    """A parameter without a declaration: integers have `bits`, and XML must be able to represent it (ROS 1) or not."""

    bits: int = 64
    is_in_xml: bool = False


_FLOATS = (xsd.double, xsd.float)
_XML_TEXT = r"^[^\x00-\x08\x0B\x0C\x0E-\x1F]*$"
"""Characters that XML can represent, of those in use."""
_GREATEST = Literal("1.7976931348623157E308", datatype=xsd.double)
_LEAST = Literal("-1.7976931348623157E308", datatype=xsd.double)
_BEYOND = Literal("3.4028235677973366E38", datatype=xsd.double)
"""Midpoint between the greatest float32 and the next value, from which numbers round to infinity."""
_BELOW = Literal("-3.4028235677973366E38", datatype=xsd.double)
_RANGES: dict[str, tuple[Statement, ...]] = {
    "float64": ((sh.minInclusive, _LEAST), (sh.maxInclusive, _GREATEST)),
    "float32": ((sh.minExclusive, _BELOW), (sh.maxExclusive, _BEYOND)),
}
_INTEGERS = tuple(datatype for datatype in NUMBERS if datatype not in (*_FLOATS, xsd.decimal))
_UNBOUNDED = (
    xsd.integer,
    *(NamedNode(f"{xsd.iri}{name}Integer") for name in ("nonNegative", "positive", "nonPositive", "negative")),
)
_WIDE = {xsd.long: RANGES["int64"], xsd.unsignedLong: RANGES["uint64"]}


class AcceptedValues:
    """Shapes of values in one shapes graph, each written on first use.

    `largest` is the largest absolute value of all floats, which are finite; None if floats are unrestricted.
    """

    def __init__(self, writer: ShapesWriter, largest: float | None = None) -> None:
        self._writer = writer
        self._largest = largest

    def scalar(self, kind: Primitive) -> NamedNode:
        """Return the shape of a scalar."""
        bound = "" if kind.bound is None else f"-{kind.bound}"
        return self._writer.shared(f"{kind.name}{bound}", lambda: self._scalar(kind))

    def array(self, kind: Array) -> NamedNode:
        """Return the shape of an array of primitives: one literal, or a list of literals."""
        element = cast(Primitive, kind.element)
        parts = [element.name, "array"]
        parts += [] if element.bound is None else [f"of-{element.bound}"]
        parts += [] if kind.length is None else [f"{kind.length}"]
        parts += [] if kind.bound is None else [f"at-most-{kind.bound}"]
        return self._writer.shared("-".join(parts), lambda: self._array(kind, element))

    def parameter(self, type: ParameterType) -> NamedNode:
        """Return the shape of a parameter's value: a string is text, never octets, and an array is one literal."""
        shared = self._writer.shared
        if type is ParameterType.STRING:
            return shared("text", lambda: [(sh.datatype, xsd.string)])
        if type is ParameterType.BYTE_ARRAY:
            return shared("octets", lambda: [(sh.datatype, xsd.base64Binary), (sh.pattern, text(base64_pattern()))])
        if type in PARAMETERS:
            return self.scalar(PARAMETERS[type])
        element = PARAMETER_ARRAYS[type]
        pattern = parameter_array_pattern(element, is_finite=self._largest is not None)
        return shared(f"{element.name}-array", lambda: [(sh.datatype, rdf.JSON), (sh.pattern, text(pattern))])

    def open_parameter(self, kind: OpenParameter) -> NamedNode:
        """Return the shape of an undeclared parameter's value, by datatype."""
        return self._writer.shared("parameter", lambda: [self._open(kind)])

    def bounds(
        self, kind: Primitive, bounds: Bounds, datatype: NamedNode | None = None
    ) -> Iterator[Sequence[Statement]]:
        """Yield the constraints of bounds on a scalar in addition to its type, one by one.

        `datatype` is its datatype in RDF if that is not the field's. Numbers are compared by value, whatever their
        datatypes, texts by their characters.
        """
        if bounds.range:
            # NaN is within no range, but not every validator knows that.
            is_float = kind.name not in RANGES
            yield [*bounds.range_statements, *([(sh.not_, self._not_a_number())] if is_float else [])]
        if bounds.choices:
            yield [self._choices(datatype or NamedNode(xsd.iri + DATATYPES[kind.name]), bounds.choices)]
        if any(value is not None for _, value in bounds.text_statements):
            is_text = [(sh.datatype, xsd.string)] if kind.name in STRINGS else []
            yield [*is_text, *bounds.text_statements]

    def _choices(self, own: NamedNode, choices: Sequence[Literal]) -> Statement:
        """Return the constraint to these choices: by value for numbers with the datatype `own`, else as terms."""
        writer = self._writer
        found = [choice for choice in choices if choice.datatype == own]
        if own == xsd.boolean:
            found += [Literal("1" if each.value == "true" else "0", datatype=own) for each in found]
        if own in (xsd.string, xsd.boolean):
            return sh.in_, writer.list_of(found)
        equal = [
            writer.blank((sh.minInclusive, choice), (sh.maxInclusive, choice), (sh.not_, self._not_a_number()))
            for choice in found
            if (value := number(choice)) is not None and value == value
        ]
        nan = [self._not_a_number()] if len(equal) < len(found) else []
        return writer.either([*equal, *nan]) if found else (sh.in_, rdf.nil)

    def _not_a_number(self) -> NamedNode:
        values = [Literal("NaN", datatype=datatype) for datatype in _FLOATS]
        return self._writer.shared("not-a-number", lambda: [(sh.in_, self._writer.list_of(values))])

    def _either(self, *alternatives: Sequence[Statement]) -> Statement:
        return self._writer.either([self._writer.blank(*statements) for statements in alternatives])

    def _scalar(self, kind: Primitive) -> Sequence[Statement]:
        if kind.name == "bool":
            # XSD collapses white space, but not every validator does.
            return [(sh.datatype, xsd.boolean), (sh.pattern, text("^(true|false|1|0)$"))]
        if kind.name in STRINGS:
            return [self._string(kind)]
        if kind.name in RANGES:
            least, greatest = RANGES[kind.name]
            whole = [(sh.datatype, xsd.decimal), (sh.pattern, text(WHOLE_DECIMAL))]
            return [
                (sh.minInclusive, integer(least)),
                (sh.maxInclusive, integer(greatest)),
                self._either(*_integers(), whole),
            ]
        return [self._either(*self._floats(kind.name), *_integers(self._range(kind.name)), *self._specials())]

    def _string(self, kind: Primitive) -> Statement:
        """Return the constraints on a string, by characters: SHACL cannot count bytes, which are at least as many."""
        return self._either(
            [(sh.datatype, xsd.string), (sh.maxLength, integer(kind.bound))],
            [(sh.datatype, xsd.base64Binary), (sh.pattern, text(base64_pattern(bound=kind.bound)))],
            [(sh.datatype, xsd.hexBinary), (sh.pattern, text(hex_pattern(bound=kind.bound)))],
        )

    def _floats(self, name: str) -> Iterator[Sequence[Statement]]:
        """Yield an alternative for each datatype of numbers with a fraction, within the range of a float."""
        # NaN is within no range, and an ill-typed xsd:float is no number, but not every validator knows that.
        finite = [] if self._largest is None else [(sh.not_, self._not_a_number())]
        yield [(sh.datatype, xsd.double), *self._range(name), *finite]
        yield [(sh.datatype, xsd.float), *self._range("float32"), *finite]
        yield [(sh.datatype, xsd.decimal), *self._range(name)]

    def _range(self, name: str) -> Sequence[Statement]:
        if self._largest is None:
            return _RANGES[name]
        if self._largest == LARGEST_NUMBER:
            return _RANGES["float32"]
        return (sh.minInclusive, double(-self._largest)), (sh.maxInclusive, double(self._largest))

    def _specials(self) -> Iterator[Sequence[Statement]]:
        """Yield an alternative for NaN and the infinities if they are accepted."""
        if self._largest is None:
            names = [Literal(name, datatype=datatype) for datatype in _FLOATS for name in SPECIALS]
            yield [(sh.in_, self._writer.list_of(names))]

    def _open(self, kind: OpenParameter) -> Statement:
        integers = self._scalar(Primitive(f"int{kind.bits}"))
        specials = () if kind.is_in_xml else self._specials()
        zone = "" if kind.is_in_xml else r"([.][0-9]{1,6}0*)?(Z|[+-][0-9]{2}:[0-9]{2})?"
        moment = rf"^\s*[0-9]{{4}}-[0-9]{{2}}-[0-9]{{2}}T[0-9]{{2}}:[0-9]{{2}}:[0-9]{{2}}{zone}\s*$"
        return self._either(
            [(sh.datatype, xsd.string), (sh.pattern, text(_XML_TEXT if kind.is_in_xml else None))],
            self._scalar(Primitive("bool")),
            integers,
            *self._floats("float64"),
            *specials,
            [(sh.datatype, xsd.base64Binary), (sh.pattern, text(base64_pattern()))],
            [(sh.datatype, xsd.dateTime), (sh.pattern, text(moment))],
            [(sh.datatype, rdf.JSON), (sh.pattern, text(open_array_pattern(is_finite=self._largest is not None)))],
        )

    def _array(self, kind: Array, element: Primitive) -> Sequence[Statement]:
        writer = self._writer
        pattern = json_array_pattern(kind, element, is_finite=self._largest is not None)
        literals: list[Value] = [writer.blank((sh.datatype, rdf.JSON), (sh.pattern, text(pattern)))]
        if element.name in OCTETS:
            octets = {xsd.base64Binary: base64_pattern, xsd.hexBinary: hex_pattern}
            literals += [
                writer.blank((sh.datatype, datatype), (sh.pattern, text(pattern(kind.length, kind.bound))))
                for datatype, pattern in octets.items()
            ]
        elements = list_of(writer, [(sh.node, self.scalar(element))], kind)
        return [writer.either([*literals, elements])]


def _integers(within: Sequence[Statement] = ()) -> Iterator[Sequence[Statement]]:
    """Yield an alternative for each datatype of integers; unbounded datatypes get the range `within`.

    Not every validator checks the range of 64-bit datatypes.
    """
    for datatype in _INTEGERS:
        if datatype in _UNBOUNDED:
            yield [(sh.datatype, datatype), *within]
            continue
        least, greatest = _WIDE.get(datatype, (None, None))
        yield [(sh.datatype, datatype), (sh.minInclusive, integer(least)), (sh.maxInclusive, integer(greatest))]
