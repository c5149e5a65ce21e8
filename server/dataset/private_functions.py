"""Private functions called by rewritten queries (`server/sparql/rewriting.py`). No client can name them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from pyoxigraph import Literal, NamedNode, RdfFormat, parse

from rosld.ontology.vocab import rdf, xsd
from rosld.server.dataset.base import Function, Term
from rosld.server.dataset.encoding import NAMESPACE, decode_term, encode_literal, is_numeric
from rosld.server.dataset.sort_keys import sort_key

KEY = f"{NAMESPACE}f:key"
"""IRI of the function that returns the sort key of a term."""
ORDER = f"{NAMESPACE}f:order"
"""IRI of a function like `KEY`, which returns dateTimes with a time zone: pyoxigraph's order of these is total."""
GREATER = f"{NAMESPACE}f:greater"
"""IRI of the function that returns the greater of a number (an IRI for none) and a term in `PACK` form ("" for none).
"""
LESS = f"{NAMESPACE}f:less"
"""IRI of the function that returns the lesser of the two, with `NOTHING` for none."""
NOTHING = "~"
"""String that pyoxigraph considers greater than every number and every key."""
PAIR = f"{NAMESPACE}f:pair"
"""IRI of the function that returns two numbers as one string: the store's aggregates take one argument."""
PACK = f"{NAMESPACE}f:pack"
"""IRI of the function that returns a sort key from which `UNPACK` restores the term: MIN and MAX compare these."""
UNPACK = f"{NAMESPACE}f:unpack"
"""IRI of the function that returns the term of a key, as stored."""
VALUE = f"{NAMESPACE}f:value"
"""IRI of the function that returns the original of a stored term, whose value pyoxigraph knows."""
TYPED = f"{NAMESPACE}f:typed"
"""IRI of STRDT with a stored term as its result."""
_LENGTH = 8
"""Number of digits of the term's length at the end of its key."""


def _key(term: Term) -> Term:
    return Literal(sort_key(term))


def _order(term: Term) -> Term:
    decoded = decode_term(term)
    if not isinstance(decoded, Literal) or decoded.datatype != xsd.dateTime:
        return Literal(sort_key(term))
    return decoded if _ZONE.search(decoded.value) else Literal(f"{decoded.value}Z", datatype=xsd.dateTime)


_ZONE = re.compile(r"(?:Z|[+-][0-9]{2}:[0-9]{2})$")


def _pack(term: Term) -> Term:
    text = str(term)
    return Literal(f"{sort_key(term)}\x00{text}{len(text):0{_LENGTH}}")


def _unpack(key: Term) -> Term | None:
    if not isinstance(key, Literal):
        return None
    end = len(key.value) - _LENGTH
    text = key.value[end - int(key.value[end:]) : end]
    [quad] = parse(f"{rdf.first} {rdf.first} {text} .", RdfFormat.N_TRIPLES)
    object: Term = quad.object
    return object


def _greater(number: Term, packed: Term) -> Term | None:
    return _first(number, packed, lambda key, other: key > other)


def _less(number: Term, packed: Term) -> Term | None:
    return _first(number, packed, lambda key, other: key < other)


def _first(number: Term, packed: Term, precedes: Callable[[str, str], bool]) -> Term | None:
    if not isinstance(packed, Literal) or packed.value in ("", NOTHING):
        return number
    if not isinstance(number, Literal) or number.value == NOTHING:
        return _unpack(packed)
    return number if precedes(sort_key(number), packed.value) else _unpack(packed)


def _pair(value: Term, other: Term) -> Term:
    if isinstance(value, Literal) and isinstance(other, Literal) and is_numeric(value) and is_numeric(other):
        return Literal(f"{other.value} {value.value}")
    return Literal("")


def _typed_literal(text: Term, datatype: Term) -> Term | None:
    if not isinstance(text, Literal) or text.datatype != xsd.string or not isinstance(datatype, NamedNode):
        return None
    if datatype == rdf.langString:
        return None
    return encode_literal(Literal(text.value, datatype=datatype))


FUNCTIONS: Mapping[str, Function] = {
    KEY: _key,
    ORDER: _order,
    PACK: _pack,
    PAIR: _pair,
    UNPACK: _unpack,
    GREATER: _greater,
    LESS: _less,
    VALUE: decode_term,
    TYPED: _typed_literal,
}
"""The functions by IRI."""
