r"""Constraint components of SHACL Core (section 4) as tests on value nodes, each with a sentence for people.

Patterns of clients are matched by RE2, in linear time. RE2 has no back-references and no lookaround, as XPath has no
lookaround (SHACL 4.4.3, SPARQL 17.4.3.14). `\d`, `\s` and `\w` are ASCII, as in Java and JavaScript, and `$` is the end
of the text.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Sequence
from math import isnan

import re2
from msgspec import Struct
from pyoxigraph import Literal, NamedNode

from rosld.ontology.body import Term
from rosld.ontology.literals import quote
from rosld.ontology.vocab import rdf, rdfs, sh, xsd
from rosld.shapes.compiled_shape import SetConstraint, SetTest, Shape, ValueConstraint, ValueTest
from rosld.shapes.terms import Number, View, compare, is_numeric, is_plain, normalize, number

_STEPS = 30_000_000
"""The size of a pattern times the bytes of a text, up to which it is tried: a third of a second at worst."""
_MAX_PATTERN = 2000
_MAX_MEMORY = 1 << 20
"""Bytes for a pattern: some 40,000 steps of it, which texts of 700 bytes may be tried with."""
_FLAGS = "ims"


class SafePattern(Struct, frozen=True):
    """A pattern that may be searched for in texts of up to `max_length` bytes of UTF-8."""

    text: str
    search: Callable[[bytes], object | None]
    max_length: int

    def is_found_in(self, text: str) -> bool:
        """Whether it matches somewhere in a text; a text that is too long to try counts as none."""
        octets = text.encode("utf-8", "surrogatepass")
        return len(octets) <= self.max_length and self.search(octets) is not None


def compile_pattern(text: str, flags: str = "") -> SafePattern:
    """Compile a pattern with SHACL's flags (4.4.3). Raises ValueError for an unsupported one."""
    if len(text) > _MAX_PATTERN:
        raise ValueError(f"the pattern {text[:40]!r}... is longer than {_MAX_PATTERN} characters")
    flags = flags.lower()
    if strange := set(flags) - set(_FLAGS):
        raise ValueError(f"the flag {min(strange)!r} of the pattern {text!r} is not known here: use i, m or s")
    options = re2.Options()
    options.max_mem = _MAX_MEMORY
    options.log_errors = False
    try:
        regex = re2.compile((f"(?{flags})" if flags else "").encode() + text.encode("utf-8", "surrogatepass"), options)
    except re2.error as error:
        words = error.args[0].decode("utf-8", "replace") if isinstance(error.args[0], bytes) else str(error)
        raise ValueError(f"the pattern {text[:200]!r} is no regular expression of RE2: {words}") from error
    return SafePattern(text, regex.search, _STEPS // max(1, regex.programsize))


_DATATYPE = NamedNode(rdfs.iri + "Datatype")
_ANY_LITERAL = NamedNode(rdfs.iri + "Literal")

_KINDS = {
    sh.IRI: (True, False, False),
    sh.BlankNode: (False, True, False),
    sh.Literal: (False, False, True),
    sh.BlankNodeOrIRI: (True, True, False),
    sh.BlankNodeOrLiteral: (False, True, True),
    sh.IRIOrLiteral: (True, False, True),
}
_KIND_WORDS = {
    sh.IRI: "must be an IRI",
    sh.BlankNode: "must be a blank node",
    sh.Literal: "must be a literal",
    sh.BlankNodeOrIRI: "must be no literal",
    sh.BlankNodeOrLiteral: "must be no IRI",
    sh.IRIOrLiteral: "must be no blank node",
}
_Compare = Callable[[Number, Number], bool]
_ORDERS: dict[NamedNode, tuple[_Compare, Callable[[int], bool], str]] = {
    sh.minInclusive: (operator.ge, lambda order: order >= 0, "must be at least {}"),
    sh.maxInclusive: (operator.le, lambda order: order <= 0, "must be at most {}"),
    sh.minExclusive: (operator.gt, lambda order: order > 0, "must be more than {}"),
    sh.maxExclusive: (operator.lt, lambda order: order < 0, "must be less than {}"),
}
RANGES = tuple(_ORDERS)
NODE_KINDS = tuple(_KINDS)


def component(parameter: NamedNode) -> NamedNode:
    """Return the constraint component of a parameter: `sh:minInclusive` is of `sh:MinInclusiveConstraintComponent`."""
    name = parameter.value[len(sh.iri) :]
    return NamedNode(f"{sh.iri}{name[0].upper()}{name[1:]}ConstraintComponent")


def phrase(term: Term) -> str:
    """Return a term within a sentence."""
    if isinstance(term, NamedNode):
        return f"<{term.value}>"
    if not isinstance(term, Literal):
        return "a blank node"
    return quote(term.value) if is_plain(term) else term.value


def list_terms(terms: Iterable[Term], limit: int = 12) -> str:
    """Several terms within a sentence."""
    phrases = [phrase(term) for term in terms]
    more = [f"{len(phrases) - limit} more"] if len(phrases) > limit else []
    return ", ".join([*phrases[:limit], *more])


# Value type (4.1)


def class_(iri: NamedNode) -> ValueConstraint:
    """sh:class: an instance of the class, or of one that the data says is below it."""

    def test(value: Term, view: View) -> bool:
        if isinstance(value, Literal):
            return False
        waiting = list(view.objects(value, rdf.type))
        seen = set(waiting)
        while waiting:
            kind = waiting.pop()
            if kind == iri:
                return True
            more = [each for each in view.objects(kind, rdfs.subClassOf) if each not in seen]
            seen.update(more)
            waiting += more
        return False

    return ValueConstraint(component(sh.class_), test, f"must be a <{iri.value}>")


def datatype(iri: NamedNode) -> ValueConstraint:
    """sh:datatype: a literal of exactly this datatype that is no ill-typed one."""
    test: ValueTest
    if iri == _ANY_LITERAL:
        test = lambda value, _: isinstance(value, Literal)  # noqa: E731
    elif iri == _DATATYPE:
        test = lambda value, _: not is_plain(value)  # noqa: E731
    elif iri in (xsd.string, rdf.langString):
        test = lambda value, _: isinstance(value, Literal) and value.datatype == iri  # noqa: E731
    elif is_numeric(iri):
        test = lambda value, _: (  # noqa: E731
            isinstance(value, Literal) and value.datatype == iri and number(value) is not None
        )
    else:
        test = lambda value, _: (  # noqa: E731
            isinstance(value, Literal) and value.datatype == iri and not getattr(normalize(value), "ill_typed", False)
        )
    name = f"xsd:{iri.value[len(xsd.iri) :]}" if iri.value.startswith(xsd.iri) else f"literal of <{iri.value}>"
    article = "an" if name[0] in "x" else "a"
    return ValueConstraint(component(sh.datatype), test, f"must be {article} {name}")


def node_kind(kind: NamedNode) -> ValueConstraint:
    """sh:nodeKind."""
    iri, blank, literal = _KINDS[kind]

    def test(value: Term, view: View) -> bool:
        return literal if isinstance(value, Literal) else iri if isinstance(value, NamedNode) else blank

    return ValueConstraint(component(sh.nodeKind), test, _KIND_WORDS[kind])


# Cardinality (4.2)


def min_count(least: int) -> SetConstraint:
    """sh:minCount."""
    words = "is missing" if least == 1 else f"must be there at least {least} times"
    return SetConstraint(component(sh.minCount), lambda values: len(values) >= least, words)


def max_count(limit: int) -> SetConstraint:
    """sh:maxCount."""
    words = (
        "must not be there"
        if limit == 0
        else "must be there once only"
        if limit == 1
        else f"is there over {limit} times"
    )
    return SetConstraint(component(sh.maxCount), lambda values: len(values) <= limit, words)


# Value range (4.3)


def value_range(parameter: NamedNode, bound: Literal) -> ValueConstraint:
    """sh:minInclusive, sh:maxInclusive, sh:minExclusive, sh:maxExclusive: numbers by value, whatever their datatypes.

    Raises ValueError for a bound that is NaN.
    """
    limit = number(bound)
    if limit is not None and isnan(limit):
        raise ValueError(f"sh:{parameter.value[len(sh.iri) :]} is NaN, with which nothing compares")
    is_within, accepts, words = _ORDERS[parameter]

    def test(value: Term, view: View) -> bool:
        if not isinstance(value, Literal):
            return False
        if limit is not None:
            found = number(value)
            if found is not None:
                return not (isinstance(found, float) and isnan(found)) and is_within(found, limit)
        order = compare(value, bound)
        return order is not None and accepts(order)

    return ValueConstraint(component(parameter), test, words.format(phrase(bound)))


# Strings (4.4)


def str_of(value: Term) -> str | None:
    """Return STR() of SPARQL of a value; None for a blank node."""
    if isinstance(value, NamedNode) or (isinstance(value, Literal) and is_plain(value)):
        return value.value
    return str(normalize(value)) if isinstance(value, Literal) else None


def length(parameter: NamedNode, length: int) -> ValueConstraint:
    """sh:minLength and sh:maxLength, in characters."""
    unit = "character" if length == 1 else "characters"
    if parameter == sh.minLength:

        def test(value: Term, view: View) -> bool:
            text = str_of(value)
            return length == 0 or (text is not None and len(text) >= length)

        return ValueConstraint(component(parameter), test, f"must be at least {length} {unit} long")

    def test_most(value: Term, view: View) -> bool:
        text = str_of(value)
        return text is not None and len(text) <= length

    return ValueConstraint(component(parameter), test_most, f"must be at most {length} {unit} long")


def pattern_(pattern: SafePattern) -> ValueConstraint:
    """sh:pattern."""

    def test(value: Term, view: View) -> bool:
        text = str_of(value)
        return text is not None and pattern.is_found_in(text)

    return ValueConstraint(component(sh.pattern), test, f"must match the pattern {pattern.text}")


# Logic and shapes (4.6 and 4.7)


def not_(shape: Shape) -> ValueConstraint:
    """sh:not."""
    return ValueConstraint(
        component(sh.not_), lambda value, view: not shape.conforms(value, view), "must not be like this"
    )


def and_(shapes: Sequence[Shape]) -> ValueConstraint:
    """sh:and."""
    return ValueConstraint(
        component(sh.and_),
        lambda value, view: all(shape.conforms(value, view) for shape in shapes),
        f"must conform to all of {len(shapes)} shapes",
    )


def or_(shapes: Sequence[Shape]) -> ValueConstraint:
    """sh:or."""
    return ValueConstraint(
        component(sh.or_),
        lambda value, view: any(shape.conforms(value, view) for shape in shapes),
        f"must conform to one of {len(shapes)} shapes at least",
    )


def xone(shapes: Sequence[Shape]) -> ValueConstraint:
    """sh:xone."""
    return ValueConstraint(
        component(sh.xone),
        lambda value, view: sum(shape.conforms(value, view) for shape in shapes) == 1,
        f"must conform to exactly one of {len(shapes)} shapes",
    )


def node(shape: Shape) -> ValueConstraint:
    """sh:node."""
    named = f" <{shape.node.value}>" if isinstance(shape.node, NamedNode) else ""
    return ValueConstraint(component(sh.node), shape.conforms, f"must conform to the shape{named}")


# Other (4.8)


def in_(terms: Sequence[Term]) -> ValueConstraint:
    """sh:in: the same term, which of literals means: the same normal form."""
    contains = _membership(terms)
    return ValueConstraint(
        component(sh.in_), lambda value, view: contains(value), f"must be one of {list_terms(terms)}"
    )


def has_value(term: Term) -> SetConstraint:
    """sh:hasValue."""
    contains = _membership((term,))
    test: SetTest = lambda values: any(map(contains, values))  # noqa: E731
    return SetConstraint(component(sh.hasValue), test, f"must be {phrase(term)}")


def _membership(terms: Iterable[Term]) -> Callable[[Term], bool]:
    # A blank node of the shapes graph is none of the data graph, whatever its label.
    exact = frozenset(term for term in terms if isinstance(term, NamedNode | Literal))
    others = [term for term in exact if isinstance(term, Literal) and not is_plain(term)]
    forms, datatypes = frozenset(map(normalize, others)), frozenset(term.datatype for term in others)

    def contains(value: Term) -> bool:
        if value in exact:
            return True
        return bool(forms) and isinstance(value, Literal) and value.datatype in datatypes and normalize(value) in forms

    return contains
