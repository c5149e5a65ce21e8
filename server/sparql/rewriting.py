"""Rewriting of queries for a dataset that stores some literals under private datatypes (`server/dataset/encoding.py`).

Constants in patterns, templates and inline data become the stored terms. In expressions each position takes either a
stored term that is only passed on (BIND, sameTerm, STR, a branch of IF) or a value that is computed with. Only in the
latter is a variable decoded, in SPARQL itself, which takes half the time of a Python function. ORDER BY, MIN and MAX
compare sort keys (`server/dataset/sort_keys.py`). SERVICE receives the original text.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from typing import NamedTuple

from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server.dataset.encoding import DOUBLE, INTEGER, NAMESPACE, NUMERIC, OTHER, PATTERN, encode_literal
from rosld.server.dataset.private_functions import GREATER, KEY, LESS, NOTHING, ORDER, PACK, PAIR, TYPED, UNPACK, VALUE
from rosld.server.sparql.message_order import FUNCTIONS
from rosld.server.sparql.syntax.token import Kind
from rosld.server.sparql.syntax.tree import (
    Call,
    Choices,
    Constant,
    EvaluatedExpression,
    Expression,
    ExpressionPurpose,
    Operand,
    Part,
    Reference,
    Value,
    strip_brackets,
)

_NAMES = (
    "STRLEN UCASE LCASE STRSTARTS STRENDS CONTAINS STRBEFORE STRAFTER ENCODE_FOR_URI CONCAT LANGMATCHES REGEX REPLACE "
    "MD5 SHA1 SHA256 SHA384 SHA512 LANG ISIRI ISURI ISBLANK ISLITERAL SAMETERM BOUND IRI URI BNODE STR STRLANG COUNT "
    "GROUP_CONCAT"
)
_AS_STORED = frozenset(_NAMES.split())
"""Functions that accept stored terms: they take text, which is never encoded, or ignore the value."""
_TOTAL = frozenset(
    ("STR", "LCASE", "UCASE", "CONCAT", "REPLACE", "STRBEFORE", "STRAFTER", "SUBSTR", "LANG", "STRLEN", "COUNT", "YEAR")
)
"""Functions whose results are totally ordered in the dataset."""
_PASSING = frozenset(("COALESCE", "SAMPLE"))
"""Functions that return one of their arguments."""
_KEEPING_UNITS = frozenset(
    ("MIN", "MAX", "AVG", "SUM", "SAMPLE", "ABS", *(each.value for each in (ros.at, ros.min, ros.max, ros.mean)))
)
"""Functions whose results are in the unit of their first argument."""
_NO_UNITS: Mapping[str, str] = {}
_MAX_INLINE = 32
"""Maximum number of variables decoded in SPARQL itself; a function decodes the others, to keep the text short."""


class _Use(Enum):
    """Purpose of an operand."""

    TERM = "a term as it is stored"
    VALUE = "a value to compute with"
    TEST = "whether it holds: an error is as good as false"


class _Edit(NamedTuple):
    """Replacement of the text between two positions."""

    start: int
    end: int
    text: str


def rewrite(
    text: str,
    literals: Iterable[Constant],
    expressions: Iterable[EvaluatedExpression],
    units: Mapping[str, str] = _NO_UNITS,
    paths: Iterable[tuple[int, int, str]] = (),
) -> str:
    """Return a query text for the dataset, with rewritten literals in patterns and data and rewritten expressions.

    `units` are the IRIs of the units of variables, which `ros:convert` of two arguments receives as its second.
    `paths` are places of paths, each with the IRI of the predicate that replaces it.
    """
    rewriter = _Rewriter(text, units)
    for literal in literals:
        rewriter.literal(literal)
    for place in expressions:
        rewriter.place(place)
    for start, end, predicate in paths:
        rewriter.path(start, end, predicate)
    return rewriter.rewritten()


class _Rewriter:
    """Collected edits of a text; they do not overlap."""

    def __init__(self, text: str, units: Mapping[str, str]) -> None:
        self._text = text
        self._units = units
        self._edits: list[_Edit] = []
        self._inline = 0

    def rewritten(self) -> str:
        """Return the text with its edits; edits at the same position apply in order."""
        if not self._edits:
            return self._text
        pieces: list[str] = []
        at = 0
        for start, end, text in sorted(self._edits, key=_position):
            pieces += (self._text[at:start], text)
            at = end
        return "".join((*pieces, self._text[at:]))

    def _replace(self, start: int, end: int, text: str) -> None:
        self._edits.append(_Edit(start, end, text))

    def _insert(self, at: int, text: str) -> None:
        self._edits.append(_Edit(at, at, text))

    def literal(self, constant: Constant) -> None:
        """Replace a literal by its stored term, if that differs."""
        if not isinstance(constant.term, Value):
            return
        literal = constant.term.literal
        stored = encode_literal(literal)
        if constant.kind is Kind.WORD:
            self._replace(constant.start, constant.end, literal.value)  # the store's parser rejects TRUE in capitals
        elif stored is not literal:
            self._replace(constant.start, constant.end, str(stored))

    def path(self, start: int, end: int, predicate: str) -> None:
        self._replace(start, end, f"<{predicate}>")

    def place(self, place: EvaluatedExpression) -> None:
        if place.purpose is ExpressionPurpose.ORDER:
            self._order(place)
        else:
            self._change(place.operand, _Use.TEST if place.purpose is ExpressionPurpose.TEST else _Use.TERM)

    def _order(self, place: EvaluatedExpression) -> None:
        """Rewrite a condition of ORDER BY to compare totally ordered keys."""
        operand, within = place.operand, strip_brackets(place.operand)
        if isinstance(within, Reference):
            conditions = (f" {place.direction}({each.replace('?', within.name)})" for each in _ORDERED)
            self._replace(place.start, operand.end, f"{''.join(conditions)} ")
        elif isinstance(within, Call) and within.name in _TOTAL:
            self._change(operand, _Use.TERM)
        else:
            self._replace(place.start, operand.start, f" {place.direction}(<{KEY}>(")
            self._change(operand, _Use.TERM)
            self._insert(operand.end, ")) ")

    def _change(self, operand: Operand, use: _Use) -> None:
        if isinstance(operand, Reference):
            if use is not _Use.TERM:
                self._replace(operand.start, operand.end, self._decode(operand.name))
        elif isinstance(operand, Constant):
            if use is _Use.TERM or operand.kind is Kind.WORD:
                self.literal(operand)
        elif isinstance(operand, Choices):
            for item in operand.items:
                self._change(item, _Use.VALUE)
        elif isinstance(operand, Expression):
            for part, of_part in _uses(operand.parts, use):
                self._change(part, of_part)
        elif isinstance(operand, Call):
            self._call(operand, use)

    def _decode(self, variable: str) -> str:
        """Return the expression of a variable's value."""
        self._inline += 1
        if self._inline > _MAX_INLINE:
            return f"<{VALUE}>({variable})"
        return _DECODED.replace("?", variable)

    def _call(self, call: Call, use: _Use) -> None:
        name, passed = call.name, _Use.TERM if use is _Use.TERM else _Use.VALUE
        uses: Sequence[_Use] = [_Use.VALUE] * len(call.arguments)
        if name in _AS_STORED:
            uses = [_Use.TERM] * len(call.arguments)
        elif name in _PASSING:
            uses = [passed] * len(call.arguments)
        elif name == "IF":
            uses = [_Use.VALUE, passed, passed]
        elif name == "SUBSTR":
            uses = [_Use.TERM, _Use.VALUE, _Use.VALUE]
        elif name == "DATATYPE":
            self._insert(call.start, "IRI(REPLACE(STR(")
            self._change(call.arguments[0], _Use.TERM)
            self._insert(call.end, f'),"^{PATTERN}","{xsd.iri}"))')
            return
        elif name in ("MIN", "MAX") and _passes(call.arguments[0]):
            self._extreme(call, use)
            return
        elif name == "STRDT" and use is _Use.TERM:
            self._replace(call.start, call.name_end, f"<{TYPED}>")
            uses = [_Use.TERM, _Use.TERM]
        for argument, of_argument in zip(call.arguments, uses, strict=False):
            self._change(argument, of_argument)
        if call.iri == ros.convert.value and len(call.arguments) == 2 and (unit := self._unit(call.arguments[0])):
            self._insert(call.arguments[1].start, f"<{unit}>,")
        elif call.iri in FUNCTIONS:  # a variable that may be unbound is no key of a join: 6 s instead of 0.02
            self._insert(call.start, "COALESCE(")
            self._insert(call.end, f",{rdf.nil})")
        elif call.iri == ros.percentile.value:
            self._insert(call.arguments[0].start, f"<{PAIR}>(")
            self._insert(call.arguments[1].end, ")")

    def _unit(self, operand: Operand) -> str | None:
        """Return the unit of a variable, or of the result of a function that keeps the unit of its first argument."""
        within = strip_brackets(operand)
        if isinstance(within, Call) and within.arguments and (within.iri or within.name) in _KEEPING_UNITS:
            return self._unit(within.arguments[0])
        return self._units.get(within.name[1:]) if isinstance(within, Reference) else None

    def _extreme(self, call: Call, use: _Use) -> None:
        """Rewrite MIN or MAX: the dataset compares numbers, and sort keys of other terms."""
        [argument] = call.arguments
        before, after = self._text[call.start : argument.start], self._text[argument.end : call.end]
        opened, closed = ("", "") if use is _Use.TERM else (f"<{VALUE}>(", ")")
        within = strip_brackets(argument)
        if isinstance(within, Reference):
            name, function = within.name, GREATER if call.name == "MAX" else LESS
            no_number, no_key = (f"<{NAMESPACE}>", '""') if call.name == "MAX" else (f'"{NOTHING}"',) * 2
            numbers = f"{before}IF(isNumeric({name}),{name},{no_number}){after}"
            keys = f"{before}IF(isNumeric({name}),{no_key},<{PACK}>({name})){after}"
            self._replace(call.start, call.end, f"{opened}<{function}>({numbers},{keys}){closed}")
            return
        self._insert(call.start, f"{opened}<{UNPACK}>(")
        self._insert(argument.start, f"<{PACK}>(")
        self._change(argument, _Use.TERM)
        self._insert(argument.end, ")")
        self._insert(call.end, f"){closed}")


def _position(edit: _Edit) -> tuple[int, int]:
    return edit.start, edit.end


_DECODED = (
    f"IF(isNumeric(?),?,COALESCE(IF(DATATYPE(?)={xsd.dateTime},?,"
    f'IF(STRSTARTS(STR(DATATYPE(?)),"{INTEGER}"),STRDT(STR(?),<{xsd.integer.value}>),'
    f'IF(STRSTARTS(STR(DATATYPE(?)),"{DOUBLE}"),STRDT(STR(?),<{xsd.double.value}>),'
    f'IF(STRSTARTS(STR(DATATYPE(?)),"{NAMESPACE}"),'
    f'STRDT(STR(?),IRI(CONCAT("{xsd.iri}",SUBSTR(STR(DATATYPE(?)),{len(OTHER) + 1})))),?)))),?))'
)
"""Expression of the value of the variable `?`."""


_TEXTUAL = f"DATATYPE(?) IN(<{xsd.string.value}>,<{rdf.langString.value}>)"
_IS_NUMERIC = f'STRSTARTS(STR(DATATYPE(?)),"{NUMERIC}")'
_MOMENT = xsd.dateTime.value
_ORDERED = (
    f"IF(isNumeric(?),2,IF(!isLiteral(?),IF(isIRI(?),1,0),IF({_TEXTUAL},3,IF({_IS_NUMERIC},2,"
    f"IF(DATATYPE(?)=<{OTHER}dateTime>||DATATYPE(?)=<{_MOMENT}>&&COALESCE(isNumeric(YEAR(?)),false),4,5)))))",
    f"IF(isNumeric(?),<{xsd.double.value}>(?),IF(!isLiteral(?),?,IF({_TEXTUAL},STR(?),"
    f"IF({_IS_NUMERIC},<{xsd.double.value}>(STR(?)),"
    f'IF(DATATYPE(?)=<{_MOMENT}>&&COALESCE(TZ(?)!="",false),?,<{ORDER}>(?))))))',
    f"IF(isNumeric(?)||{_IS_NUMERIC},IF(STRLEN(STR(?))>15&&DATATYPE(?)!=<{xsd.double.value}>"
    f'&&DATATYPE(?)!=<{DOUBLE}double>,<{KEY}>(?),""),LANG(?))',
)
"""Sort keys of the variable `?`: its kind, its value, and a key to tell values apart that round to one double."""


def _passes(operand: Operand) -> bool:
    """Whether the result may be a stored term and not only a computed one."""
    within = strip_brackets(operand)
    if isinstance(within, Call):
        return within.name in _PASSING or within.name in ("IF", "MIN", "MAX", "STRDT")
    return isinstance(within, Reference | Constant)


def _uses(parts: Sequence[Part], use: _Use) -> Iterator[tuple[Operand, _Use]]:
    if len(parts) == 1:
        [operand] = parts
        assert not isinstance(operand, str)
        yield operand, use
        return
    for comparison in _comparisons(parts):
        operands = [part for part in comparison if not isinstance(part, str)]
        if len(comparison) == 1:
            yield operands[0], _Use.TEST if use is _Use.TEST else _Use.VALUE
            continue
        plain = _is_plain(comparison, use)
        for operand in operands:
            yield operand, _Use.TERM if plain and isinstance(operand, Reference) else _Use.VALUE


def _comparisons(parts: Sequence[Part]) -> Iterator[Sequence[Part]]:
    """Yield the parts between the operators && and ||."""
    begin = 0
    for at, part in enumerate(parts):
        if part in ("&&", "||"):
            yield parts[begin:at]
            begin = at + 1
    yield parts[begin:]


def _is_plain(comparison: Sequence[Part], use: _Use) -> bool:
    """Whether a comparison gives the same result for a number or time and for its private literal.

    An IRI equals neither and is comparable with neither. Text equals neither; with the private literal it is an error.
    """
    if len(comparison) != 3:
        return False
    first, operator, second = comparison
    items = (
        [item.parts[0] if len(item.parts) == 1 else item for item in second.items]
        if isinstance(second, Choices)
        else []
    )
    kinds = {each.kind for each in (first, second, *items) if isinstance(each, Constant)}
    others = [each for each in items if not isinstance(each, Constant)]
    if not kinds or others:
        return False
    if kinds <= {Kind.IRI, Kind.NAME}:
        return True
    return use is _Use.TEST and operator not in ("!=", "NOT IN") and kinds <= {Kind.IRI, Kind.NAME, Kind.STRING}
