"""The SPARQL functions under `ros:`. Invalid arguments give SPARQL's type error, never an exception."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import TypeAlias

import orjson
from pyoxigraph import Literal, NamedNode, Store

from rosld.ontology import units
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server.dataset import Function
from rosld.server.dataset.base import Term
from rosld.server.space.transforms import FrameBuffer, FrameRow
from rosld.server.sparql import geo_functions, math_functions
from rosld.server.sparql.message_order import FUNCTIONS, MessageOrder, MessageTimes

AGE = ros.age.value
TRANSFORM = ros.transform.value
Number: TypeAlias = int | float
_SPECIAL: Mapping[str, float] = {"NaN": math.nan, "INF": math.inf, "-INF": -math.inf, "-0.0": -0.0}
_EXACT = 2**53
_LONGEST_CACHED = 64 * 1024


class _NoAnswer(Exception):
    """Arguments outside of the domain of a function."""


def functions(
    seconds_since: Callable[[str], float | None],
    base: str = "",
    rows: Iterable[FrameRow] = (),
    times: Iterable[MessageTimes] = (),
) -> Mapping[str, Function]:
    """Return the functions of one query, by IRI; a topic has one age per query, like NOW() (SPARQL 1.1, 17.4.5.1).

    `seconds_since` (thread-safe) returns the seconds since the newest message of the topic at a URL was received, None
    if there was none. `rows` are the transforms of the robot at `base`, `times` those of the recorded messages.
    """
    ages: dict[str, float | None] = {}

    def age(topic: Term) -> Term:
        if not isinstance(topic, NamedNode):
            raise _NoAnswer
        seconds = ages[topic.value] if topic.value in ages else ages.setdefault(topic.value, seconds_since(topic.value))
        if seconds is None:
            raise _NoAnswer
        return Literal(seconds)

    placed = partial(geo_functions.transform, FrameBuffer.of(rows), f"{base}frames")
    ordered = {iri: _guard(function) for iri, function in MessageOrder(times).functions().items()}
    return {**_LASTING, **ordered, AGE: _guard(age), TRANSFORM: _guard(placed)}


def unknown_functions(iris: Iterable[str]) -> Mapping[str, Function]:
    """Return functions that raise SPARQL's error (17.2) for those that neither the store nor `functions` implements."""
    return {iri: _error for iri in iris if not _is_known(iri)}


def _error(*arguments: Term) -> None:
    """Return no term, which is an error in SPARQL."""


@lru_cache(maxsize=1024)
def _is_known(iri: str) -> bool:
    """Whether a function is ours or the store's, which only reports unknown functions when it evaluates a call."""
    if iri in OWN:
        return True
    try:
        Store().query(f"SELECT ({NamedNode(iri)}(1) AS ?x) {{}}")
    except RuntimeError:
        return False
    return True


def element_at(array: Term, index: Term) -> Term:
    """`ros:at(?array, ?index)`: the element at an index from 0."""
    elements, position = _array(array), _index(index)
    if not 0 <= position < len(elements):
        raise _NoAnswer
    return _term(elements[position], numeric=_is_numeric(elements))


def index_of(array: Term, value: Term) -> Term:
    """`ros:indexOf(?array, ?value)`: the index from 0 of the first element that is this term."""
    elements = _array(array)
    numeric = _is_numeric(elements)
    for index, element in enumerate(elements):
        if _term(element, numeric=numeric) == value:
            return Literal(index)
    raise _NoAnswer


def length(array: Term) -> Term:
    """`ros:length(?array)`: the number of elements."""
    return Literal(len(_array(array)))


def minimum(array: Term) -> Term:
    """`ros:min(?array)`: the least number, ignoring NaN (NaN if there is no other)."""
    return _number(min(_numbers(array), default=math.nan))


def maximum(array: Term) -> Term:
    """`ros:max(?array)`: the greatest number, ignoring NaN (NaN if there is no other)."""
    return _number(max(_numbers(array), default=math.nan))


def mean(array: Term) -> Term:
    """`ros:mean(?array)`: the mean as xsd:double, ignoring NaN (NaN if there is no number)."""
    numbers = _numbers(array)
    try:
        return Literal(math.fsum(numbers) / len(numbers) if numbers else math.nan)
    except (OverflowError, ValueError):  # infinities of both signs, or integers beyond the range of doubles
        return Literal(math.nan)


def convert(value: Term, source: Term, target: Term) -> Term:
    """`ros:convert(?value, ?from, ?to)`: the number in another unit of QUDT as xsd:double."""
    if not isinstance(value, Literal) or value.datatype == xsd.string or not value.datatype.value.startswith(xsd.iri):
        raise _NoAnswer
    if not isinstance(source, NamedNode) or not isinstance(target, NamedNode):
        raise _NoAnswer
    found = units.convert(float(value.value), source.value, target.value)
    if found is None:
        raise _NoAnswer
    return Literal(found)


def _guard(function: Callable[..., Term]) -> Function:
    def guarded(*terms: Term) -> Term | None:
        try:
            return function(*terms)
        except (_NoAnswer, ArithmeticError, LookupError, TypeError, ValueError):  # TypeError: wrong number of arguments
            return None

    return guarded


def _array(term: Term) -> Sequence[object]:
    if not isinstance(term, Literal) or term.datatype != rdf.JSON:
        raise _NoAnswer
    text = term.value
    return _parsed(text) if len(text) <= _LONGEST_CACHED else _parse(text)


def _parse(text: str) -> tuple[object, ...]:
    found = orjson.loads(text)
    if not isinstance(found, list):
        raise _NoAnswer
    return tuple(found)


_parsed = lru_cache(maxsize=64)(_parse)


def _index(term: Term) -> int:
    if not isinstance(term, Literal) or not term.datatype.value.startswith(xsd.iri):
        raise _NoAnswer
    return int(term.value)


def _numbers(term: Term) -> list[Number]:
    """Return the numbers of a purely numeric array, without NaN."""
    elements = _array(term)
    if not _is_numeric(elements):
        raise _NoAnswer
    numbers = [_read(element) for element in elements]
    return [number for number in numbers if not math.isnan(number)]


def _is_numeric(elements: Sequence[object]) -> bool:
    return all(
        (isinstance(element, int | float) and not isinstance(element, bool))
        or (isinstance(element, str) and _is_special(element))
        for element in elements
    )


def _is_special(text: str) -> bool:
    """Whether a string stands for a number that JSON cannot represent exactly."""
    if text in _SPECIAL:
        return True
    digits = text.removeprefix("-")
    return digits.isascii() and digits.isdigit() and len(digits) <= 20 and int(digits) > _EXACT


def _read(element: object) -> Number:
    if isinstance(element, str):
        return _SPECIAL[element] if element in _SPECIAL else int(element)
    assert isinstance(element, int | float)
    return element


def _number(number: Number) -> Term:
    return Literal(number) if isinstance(number, float) else Literal(str(number), datatype=xsd.integer)


def _term(element: object, *, numeric: bool) -> Term:
    if isinstance(element, bool):
        return Literal(element)
    if isinstance(element, int | float) or (numeric and isinstance(element, str)):
        return _number(_read(element))
    if isinstance(element, str):
        return Literal(element)
    if isinstance(element, dict) and isinstance(element.get("@value"), str) and isinstance(element.get("@type"), str):
        return Literal(element["@value"], datatype=NamedNode(element["@type"]))
    raise _NoAnswer


_LASTING: Mapping[str, Function] = {
    iri.value: _guard(function)
    for iri, function in (
        (ros.at, element_at),
        (ros.indexOf, index_of),
        (ros.length, length),
        (ros.min, minimum),
        (ros.max, maximum),
        (ros.mean, mean),
        (ros.convert, convert),
    )
} | {iri: _guard(function) for iri, function in {**geo_functions.FUNCTIONS, **math_functions.FUNCTIONS}.items()}
OWN = frozenset({*_LASTING, AGE, TRANSFORM, *FUNCTIONS, *math_functions.AGGREGATES})
"""IRIs of all functions and aggregates that the store does not implement."""
