"""RDF terms as pyshacl sees them: numbers by value, literals by their normal form, as rdflib reads both.

rdflib is used wherever its result is not obvious, so that compiled shapes and pyshacl never disagree, except about NaN:
rdflib orders it below everything, so that it conforms to every upper bound; here, as in SPARQL (17.3), it compares with
nothing and conforms to none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime, time
from decimal import Decimal, InvalidOperation
from math import isnan
from typing import TYPE_CHECKING, Protocol, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.coercion import RANGES
from rosld.ontology.literals import DATATYPES
from rosld.ontology.vocab import rdf, xsd

if TYPE_CHECKING:
    from rdflib.term import BNode, URIRef
    from rdflib.term import Literal as Normal


Number: TypeAlias = "int | float | Decimal"
Node: TypeAlias = "URIRef | BNode | Normal"
# rdflib is imported on first use: with its dependencies it takes a tenth of a server's start, and most
# servers never need it.

_NAN = float("nan")


def _integer(least: int | None = None, greatest: int | None = None) -> Callable[[str], Number | None]:
    def read(text: str) -> int | None:
        try:
            value = int(text)
        except ValueError:
            return None
        inside = (least is None or value >= least) and (greatest is None or value <= greatest)
        return value if inside else None

    return read


def _float(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _decimal(text: str) -> Number | None:
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    return _NAN if value.is_nan() else value


_ANY = _integer()
_READERS: dict[NamedNode, Callable[[str], Number | None]] = {
    xsd.double: _float,
    xsd.float: _float,
    xsd.decimal: _decimal,
    xsd.integer: _ANY,
    NamedNode(xsd.iri + "nonNegativeInteger"): _integer(0, None),
    NamedNode(xsd.iri + "positiveInteger"): _integer(1, None),
    NamedNode(xsd.iri + "nonPositiveInteger"): _integer(None, 0),
    NamedNode(xsd.iri + "negativeInteger"): _integer(None, -1),
    **{NamedNode(xsd.iri + DATATYPES[name]): _integer(*limits) for name, limits in RANGES.items()},
    # rdflib permits these two to be larger than they can be.
    xsd.long: _ANY,
    xsd.unsignedLong: _integer(0, None),
}


def number(literal: Literal) -> Number | None:
    """Return the value of a number as rdflib reads it; None for other literals and for ill-typed numbers."""
    read = _READERS.get(literal.datatype)
    return None if read is None else read(literal.value)


def is_numeric(datatype: NamedNode) -> bool:
    """Whether the literals of a datatype are numbers."""
    return datatype in _READERS


class _NotANumber(float):
    """A NaN that cannot be compared."""

    def __eq__(self, other: object) -> bool:
        raise TypeError("NaN compares with nothing")

    __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __eq__
    __hash__ = float.__hash__


def normalize(term: Term) -> Node:
    """Return a term as rdflib has it, in normal form.

    A triple term, which rdflib does not support, is a blank node.
    """
    from rdflib.term import BNode, URIRef

    if isinstance(term, NamedNode):
        return URIRef(term.value)
    if isinstance(term, Literal):
        return _normal(term)
    return BNode(term.value if isinstance(term, BlankNode) else f"triple{hash(term)}")


def _normal(literal: Literal) -> Normal:
    from rdflib.term import Literal as Normal

    text = literal.value
    if literal.language is not None:
        return Normal(text, lang=literal.language)
    if literal.datatype == xsd.string:
        return Normal(text)
    # A decimal with an exponent is invalid in XSD, and its normal form may have more digits than fit in memory.
    normalize = not (literal.datatype == xsd.decimal and "e" in text.lower())
    found = Normal(text, datatype=literal.datatype.value, normalize=normalize)
    value = number(literal)
    if value is not None and isnan(value):
        found._value = _NotANumber(_NAN)
    return found


def is_plain(term: Term) -> bool:
    """Whether a term is its own normal form: of literals, only strings are sure to be."""
    return not isinstance(term, Literal) or term.datatype in (xsd.string, rdf.langString)


def distinct(terms: Sequence[Term]) -> Sequence[Term]:
    """Return each term once; literals with equal normal forms are one."""
    if len(terms) < 2:
        return terms
    terms = list(dict.fromkeys(terms))
    if sum(not is_plain(term) for term in terms) < 2:
        return terms
    return list({_key(term): term for term in reversed(terms)}.values())[::-1]


def _key(term: Term) -> Term | Node:
    """Return a key that literals with the same normal form share."""
    return term if is_plain(term) else normalize(term)


def membership(terms: Iterable[Term]) -> Callable[[Term], bool]:
    """Return whether a term is one of these; literals of one normal form are one."""
    exact = frozenset(terms)
    others = [term for term in exact if isinstance(term, Literal) and not is_plain(term)]
    forms, datatypes = frozenset(map(normalize, others)), frozenset(term.datatype for term in others)

    def contains(value: Term) -> bool:
        if value in exact:
            return True
        return bool(forms) and isinstance(value, Literal) and value.datatype in datatypes and normalize(value) in forms

    return contains


def compare(one: Literal, other: Literal) -> int | None:
    """Compare as pyshacl does: -1 if `one` is less than `other`, 0, 1, or None if incomparable."""
    left, right = _normal(one), _normal(other)
    if isinstance(left.value, str) != isinstance(right.value, str):
        return None
    try:
        if left.eq(right):
            return 0
        if type(left.value) in (datetime, time):
            return 1 if left.value > right.value else -1
        return 1 if left > right else -1
    except (TypeError, NotImplementedError, ArithmeticError):
        return None


def is_ordered(one: Term, other: Term, compare: Callable[[object, object], bool]) -> bool:
    """Whether `compare` holds of two terms as pyshacl compares the values of two properties: IRIs and texts as such."""
    if isinstance(one, BlankNode | Triple) or isinstance(other, BlankNode | Triple):
        return False
    if any(isinstance(each, Literal) and isnan(number(each) or 0) for each in (one, other)):
        return False
    (left, is_text), (right, is_other_text) = _comparable(one), _comparable(other)
    try:
        return is_text == is_other_text and compare(left, right)
    except (TypeError, NotImplementedError, ArithmeticError):
        return False


def _comparable(term: NamedNode | Literal) -> tuple[object, bool]:
    """Return what to compare, and whether that is text (as a literal of rdflib is one to Python, too)."""
    if isinstance(term, NamedNode):
        return term.value, True
    normal = _normal(term)
    return (normal.value, True) if isinstance(normal.value, str) else (normal, False)


class View(Protocol):
    """The part of a data graph that a shape can see."""

    def objects(self, node: Term, predicate: NamedNode) -> Sequence[Term]:
        """Return the value nodes of a predicate (SHACL 2.3.1), each once."""
        ...

    def properties(self, node: Term) -> Mapping[NamedNode, Sequence[Term]]:
        """Return the objects of all predicates of a node."""
        ...

    def subjects(self, predicate: NamedNode, node: Term) -> Sequence[Term]:
        """Return the nodes that a predicate leads from."""
        ...


class TripleView:
    """The view of triples."""

    def __init__(self, triples: Iterable[Triple]) -> None:
        self._properties: dict[Term, dict[NamedNode, list[Term]]] = {}
        self._subjects: dict[tuple[NamedNode, Term | Node], list[Term]] | None = None
        for triple in triples:
            self._properties.setdefault(triple.subject, {}).setdefault(triple.predicate, []).append(triple.object)

    def objects(self, node: Term, predicate: NamedNode) -> Sequence[Term]:
        """Return the value nodes of a predicate."""
        found = self.properties(node).get(predicate)
        return () if found is None else distinct(found)

    def properties(self, node: Term) -> Mapping[NamedNode, Sequence[Term]]:
        """Return the objects of all predicates."""
        return self._properties.get(node, {})

    def subjects(self, predicate: NamedNode, node: Term) -> Sequence[Term]:
        """Return the nodes that a predicate leads from."""
        if self._subjects is None:
            self._subjects = {}
            for subject, properties in self._properties.items():
                for each, terms in properties.items():
                    for term in distinct(terms):
                        self._subjects.setdefault((each, _key(term)), []).append(subject)
        return self._subjects.get((predicate, _key(node)), ())
