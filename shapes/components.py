r"""Constraints of SHACL Core (section 4): how each parameter is read, tested, and described.

Patterns of clients are matched by RE2, in linear time. RE2 has no back-references and no lookaround, as XPath has no
lookaround (SHACL 4.4.3, SPARQL 17.4.3.14). `\d`, `\s` and `\w` are ASCII, as in Java and JavaScript, and `$` is the end
of the text.
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import isnan
from typing import Any, NamedTuple, TypeAlias

import re2
from msgspec import Struct
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.literals import quote
from rosld.ontology.vocab import rdf, rdfs, sh, xsd
from rosld.shapes.compiled_shape import Constraint, Offenders, Shape, ValueTest
from rosld.shapes.terms import Number, View, compare, is_numeric, is_ordered, is_plain, membership, normalize, number
from rosld.shapes.value import UNBOUNDED, Bounds

_STEPS = 30_000_000
"""Maximum product of the size of a pattern and the bytes of a text, which takes at most a third of a second."""
_MAX_PATTERN = 2000
_MAX_MEMORY = 1 << 20
"""Memory in bytes for a pattern: some 40,000 instructions, which can be matched against texts of 700 bytes."""
_FLAGS = "ims"


class SafePattern(Struct, frozen=True):
    """A pattern that can be searched safely in texts of up to `max_length` bytes of UTF-8."""

    text: str
    search: Callable[[bytes], object | None]
    max_length: int

    def is_found_in(self, text: str) -> bool:
        """Whether it matches somewhere in a text; a text that is too long never matches."""
        octets = text.encode("utf-8", "surrogatepass")
        return len(octets) <= self.max_length and self.search(octets) is not None


def compile_pattern(text: str, flags: str = "") -> SafePattern:
    """Compile a pattern with SHACL's flags (4.4.3). Raises ValueError for an unsupported one."""
    if len(text) > _MAX_PATTERN:
        raise ValueError(f"the pattern {text[:40]!r}... is longer than {_MAX_PATTERN} characters")
    flags = flags.lower()
    if strange := set(flags) - set(_FLAGS):
        raise ValueError(f"the flag {min(strange)!r} of the pattern {text!r} is not supported: use i, m or s")
    options = re2.Options()
    options.max_mem = _MAX_MEMORY
    options.log_errors = False
    try:
        regex = re2.compile((f"(?{flags})" if flags else "").encode() + text.encode("utf-8", "surrogatepass"), options)
    except re2.error as error:
        words = error.args[0].decode("utf-8", "replace") if isinstance(error.args[0], bytes) else str(error)
        raise ValueError(f"the pattern {text[:200]!r} is not a regular expression of RE2: {words}") from error
    return SafePattern(text, regex.search, _STEPS // max(1, regex.programsize))


_DATATYPE = NamedNode(rdfs.iri + "Datatype")
_ANY_LITERAL = NamedNode(rdfs.iri + "Literal")
_RESOURCE = NamedNode(rdfs.iri + "Resource")


def term(name: str) -> NamedNode:
    """Return a term of SHACL."""
    return NamedNode(sh.iri + name)


_QUALIFIED = term("qualifiedValueShape")
_QUALIFIED_MIN, _QUALIFIED_MAX = term("qualifiedMinCount"), term("qualifiedMaxCount")
_QUALIFIED_DISJOINT = term("qualifiedValueShapesDisjoint")
PAIRS = frozenset(map(term, ("equals", "disjoint", "lessThan", "lessThanOrEquals")))
"""Parameters whose values are predicates with which the values of the path are compared."""
_XML = frozenset(NamedNode(rdf.iri + name) for name in ("XMLLiteral", "HTML"))
_CARDINAL = (xsd.integer, xsd.nonNegativeInteger, NamedNode(xsd.iri + "positiveInteger"))
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


class ParameterFault(ValueError):
    """An invalid value of a parameter; the message continues the parameter's name."""


def checked_iri(value: Term) -> NamedNode:
    """Return the value, which must be an IRI. Raises ParameterFault."""
    if not isinstance(value, NamedNode):
        raise ParameterFault(f"is {value}, where an IRI is needed")
    return value


def checked_text(value: Term) -> str:
    """Return the text of the value, which must be an xsd:string. Raises ParameterFault."""
    if not isinstance(value, Literal) or value.datatype != xsd.string:
        raise ParameterFault(f"is {value}, where a string is needed")
    return value.value


def checked_truth(value: Term) -> bool:
    """Return the value of an xsd:boolean. Raises ParameterFault."""
    if not isinstance(value, Literal) or value.datatype != xsd.boolean or value.value not in _TRUTH:
        raise ParameterFault(f"is {value}, where true or false is needed")
    return _TRUTH[value.value]


def checked_cardinal(value: Term) -> int:
    """Return the value as a number, which must be a non-negative integer. Raises ParameterFault."""
    if isinstance(value, Literal) and value.datatype in _CARDINAL:
        found = number(value)
        if isinstance(found, int) and found >= 0:
            return found
    raise ParameterFault(f"is {value}, where an integer from 0 is needed")


def checked_term(value: Term) -> Term:
    """Return the value, which must be a comparable term.

    Raises ParameterFault for triple terms, for markup, and for ill-typed numbers.
    """
    if isinstance(value, Triple):
        raise ParameterFault("is a triple term, which SHACL does not support")
    if isinstance(value, Literal):
        if value.datatype in _XML:
            raise ParameterFault("is XML or HTML, which cannot be compared")
        if is_numeric(value.datatype) and number(value) is None:
            raise ParameterFault(f"is {value}, which is not a number")
    return value


class ShapeSource(NamedTuple):
    """Source of the constraints of a shape: its statements, the shapes it references, lists, and siblings (4.7.3)."""

    statements: Mapping[NamedNode, Sequence[Term]]
    shape: Callable[[Term], Shape]
    members: Callable[[Term], Sequence[Term]]
    siblings: Callable[[Term], Sequence[Shape]]


_BLANK = (BlankNode, Triple)
"""A triple term is a blank node, as in `terms.normalize`."""
_KINDS: Mapping[NamedNode, tuple[type, ...]] = {
    sh.IRI: (NamedNode,),
    sh.BlankNode: _BLANK,
    sh.Literal: (Literal,),
    sh.BlankNodeOrIRI: (NamedNode, *_BLANK),
    sh.BlankNodeOrLiteral: (Literal, *_BLANK),
    sh.IRIOrLiteral: (NamedNode, Literal),
}
_KIND_WORDS = {
    sh.IRI: "must be an IRI",
    sh.BlankNode: "must be a blank node",
    sh.Literal: "must be a literal",
    sh.BlankNodeOrIRI: "must not be a literal",
    sh.BlankNodeOrLiteral: "must not be an IRI",
    sh.IRIOrLiteral: "must not be a blank node",
}
_RANGES: dict[NamedNode, tuple[Callable[[Number, Number], bool], Callable[[Literal], Bounds], str]] = {
    sh.minInclusive: (operator.ge, lambda value: Bounds(minimum=value), "must be at least {}"),
    sh.maxInclusive: (operator.le, lambda value: Bounds(maximum=value), "must be at most {}"),
    sh.minExclusive: (operator.gt, lambda value: Bounds(exclusive_minimum=value), "must be more than {}"),
    sh.maxExclusive: (operator.lt, lambda value: Bounds(exclusive_maximum=value), "must be less than {}"),
}


def phrase(term: Term) -> str:
    """Return a term as a phrase of a sentence."""
    if isinstance(term, NamedNode):
        return f"<{term.value}>"
    if not isinstance(term, Literal):
        return "a blank node"
    return quote(term.value) if is_plain(term) else term.value


def list_terms(terms: Iterable[Term], limit: int = 12) -> str:
    """Return several terms as a phrase of a sentence."""
    phrases = [phrase(term) for term in terms]
    more = [f"{len(phrases) - limit} more"] if len(phrases) > limit else []
    return ", ".join([*phrases[:limit], *more])


# Value type (4.1)


def _class(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint to instances of a class, or of one of its subclasses in the data."""
    iri = checked_iri(value)

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

    return Constraint(parameter, value, f"must be a <{iri.value}>", test)


def _datatype(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint to well-typed literals of exactly this datatype."""
    iri = checked_iri(value)

    def test(value: Term, view: View) -> bool:
        if not isinstance(value, Literal) or iri == _ANY_LITERAL:
            return isinstance(value, Literal)
        if iri == _DATATYPE:
            return not is_plain(value)
        if value.datatype != iri or iri in (xsd.string, rdf.langString):
            return value.datatype == iri
        return number(value) is not None if is_numeric(iri) else not getattr(normalize(value), "ill_typed", False)

    is_xsd = iri.value.startswith(xsd.iri)
    words = f"must be an xsd:{iri.value[len(xsd.iri) :]}" if is_xsd else f"must be a literal of <{iri.value}>"
    return Constraint(parameter, value, words, test)


def _node_kind(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    if value not in _KINDS or not isinstance(value, NamedNode):
        raise ParameterFault(f"is {value}, which is not a node kind: sh:IRI, sh:Literal, sh:BlankNode, ...")
    kinds = _KINDS[value]
    return Constraint(parameter, value, _KIND_WORDS[value], lambda value, _: isinstance(value, kinds))


# Cardinality (4.2)


def _require_path(source: ShapeSource) -> None:
    if sh.path not in source.statements:
        raise ParameterFault("is for property shapes only: this shape has no sh:path")


def _count(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    _require_path(source)
    if not isinstance(value, Literal) or value.datatype != xsd.integer:
        raise ParameterFault(f"is {value}, where an xsd:integer is needed")
    count = checked_cardinal(value)
    if parameter == sh.minCount:
        words = "is missing" if count == 1 else f"must occur at least {count} times"
        return Constraint(
            parameter, value, words, offenders=lambda _, values, view: () if len(values) >= count else (None,)
        )
    words = {0: "must be absent", 1: "must occur only once"}.get(count, f"occurs more than {count} times")
    return Constraint(
        parameter, value, words, offenders=lambda _, values, view: () if len(values) <= count else (None,)
    )


# Value range (4.3)


def _range(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint on the range of numbers, compared by value across datatypes."""
    if not isinstance(value, Literal):
        raise ParameterFault(f"is {value}, where a literal is needed")
    if value.language is None and value.datatype != xsd.string:
        checked_term(value)
    bound, limit = value, number(value)
    if limit is not None and isnan(limit):
        raise ParameterFault("is NaN, which cannot be compared")
    is_within, bounds, words = _RANGES[parameter]

    def test(value: Term, view: View) -> bool:
        if not isinstance(value, Literal):
            return False
        if limit is not None:
            found = number(value)
            if found is not None:
                return not (isinstance(found, float) and isnan(found)) and is_within(found, limit)
        order = compare(value, bound)
        return order is not None and is_within(order, 0)

    return Constraint(parameter, value, words.format(phrase(value)), test, bounds=bounds(value))


# Strings (4.4)


def str_of(value: Term) -> str | None:
    """Return the value of SPARQL's STR(); None for a blank node."""
    if isinstance(value, NamedNode) or (isinstance(value, Literal) and is_plain(value)):
        return value.value
    return str(normalize(value)) if isinstance(value, Literal) else None


def _length(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint on the length in characters."""
    length = checked_cardinal(value)
    is_least = parameter == sh.minLength

    def test(value: Term, view: View) -> bool:
        text = str_of(value)
        if text is None:
            return is_least and length == 0
        return len(text) >= length if is_least else len(text) <= length

    words = f"must be at {'least' if is_least else 'most'} {length} character{'' if length == 1 else 's'} long"
    bounds = Bounds(min_length=length) if is_least else Bounds(max_length=length)
    return Constraint(parameter, value, words, test, bounds=bounds)


def _pattern(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    text, flags = checked_text(value), "".join(map(checked_text, source.statements.get(sh.flags, ())))
    try:
        pattern = compile_pattern(text, flags)
    except ValueError as error:
        raise ParameterFault(f"cannot be used: {error}") from error

    def test(value: Term, view: View) -> bool:
        text = str_of(value)
        return text is not None and pattern.is_found_in(text)

    words, bounds = f"must match the pattern {text}", UNBOUNDED if flags else Bounds(pattern=text)
    return Constraint(parameter, value, words, test, bounds=bounds)


# Logic and shapes (4.6 and 4.7)


def _logic(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint of sh:and, sh:or or sh:xone, whose values are lists of shapes."""
    shapes = tuple(map(source.shape, source.members(value)))
    if not shapes:
        raise ParameterFault("is an empty list")
    words, least, most = {
        sh.and_: ("must conform to all of {} shapes", len(shapes), len(shapes)),
        sh.or_: ("must conform to one of {} shapes at least", 1, len(shapes)),
        sh.xone: ("must conform to exactly one of {} shapes", 1, 1),
    }[parameter]

    def test(value: Term, view: View) -> bool:
        return least <= sum(shape.conforms(value, view) for shape in shapes) <= most

    return Constraint(parameter, value, words.format(len(shapes)), test, shapes=shapes)


def _not(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    shape = source.shape(value)
    test: ValueTest = lambda value, view: not shape.conforms(value, view)  # noqa: E731
    return Constraint(parameter, value, "must not conform to the excluded shape", test, shapes=(shape,))


def _node(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    shape = source.shape(value)
    if shape.is_property:
        raise ParameterFault("leads to a property shape: it must be a node shape")
    named = f" <{value.value}>" if isinstance(value, NamedNode) else ""
    return Constraint(parameter, value, f"must conform to the shape{named}", shape.conforms, shapes=(shape,))


def _property(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    shape = source.shape(value)
    if not shape.is_property:
        raise ParameterFault("leads to a shape without a sh:path")
    return Constraint(parameter, value, test=shape.conforms, shapes=(shape,))


# Qualified shapes (4.7.3)


def _qualified(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    shape = source.shape(value)
    if not source.statements.keys() & {_QUALIFIED_MIN, _QUALIFIED_MAX}:
        raise ParameterFault("needs sh:qualifiedMinCount or sh:qualifiedMaxCount beside it")
    return Constraint(parameter, value, shapes=(shape,))


def _qualified_count(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    count = checked_cardinal(value)
    nodes = source.statements.get(_QUALIFIED, ()) if sh.path in source.statements else ()
    is_disjoint = any(map(checked_truth, source.statements.get(_QUALIFIED_DISJOINT, ())))

    def offenders(focus: Term, values: Sequence[Term], view: View) -> Sequence[None]:
        return [None for node in nodes if not is_enough(number_of(node, values, view))]

    def number_of(node: Term, values: Sequence[Term], view: View) -> int:
        shape, siblings = source.shape(node), source.siblings(node) if is_disjoint else ()
        fitting = (value for value in values if shape.conforms(value, view))
        return sum(not any(each.conforms(value, view) for each in siblings) for value in fitting)

    def is_enough(found: int) -> bool:
        return found >= count if parameter == _QUALIFIED_MIN else found <= count

    words = f"must have at {'least' if parameter == _QUALIFIED_MIN else 'most'} {count} values of a certain shape"
    return Constraint(parameter, value, words, offenders=offenders)


# Languages (4.4.4 and 4.4.5)


def _language_in(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    languages = {checked_text(each).lower() for each in source.members(value)}

    def test(value: Term, view: View) -> bool:
        language = value.language if isinstance(value, Literal) else None
        return language is not None and not languages.isdisjoint(
            {"*", language.lower(), language.lower().partition("-")[0]}
        )

    return Constraint(parameter, value, f"must be in one of the languages {', '.join(sorted(languages))}", test)


def _unique_language(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    is_unique = checked_truth(value)
    _require_path(source)

    def offenders(focus: Term, values: Sequence[Term], view: View) -> Sequence[None]:
        languages = (each.language for each in values if isinstance(each, Literal) and each.language)
        counts = Counter(map(str.lower, languages))
        return [None for count in counts.values() if count > 1 and is_unique]

    return Constraint(parameter, value, "must occur only once per language", offenders=offenders)


# Pairs of properties (4.5)


def _equals(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    other = checked_iri(value)

    def offenders(focus: Term, values: Sequence[Term], view: View) -> Sequence[Term]:
        others = view.objects(focus, other)
        is_value, is_other = membership(values), membership(others)
        return [*(each for each in values if not is_other(each)), *(each for each in others if not is_value(each))]

    return Constraint(parameter, value, f"must have the same values as {phrase(value)}", offenders=offenders)


def _disjoint(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    other = checked_iri(value)
    offenders: Offenders = lambda focus, values, view: [  # noqa: E731
        *filter(membership(view.objects(focus, other)), values)
    ]
    return Constraint(parameter, value, f"must not be one of {phrase(value)}", offenders=offenders)


def _less(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    other = checked_iri(value)
    _require_path(source)
    order: Callable[[Any, Any], bool] = operator.lt if parameter == sh.lessThan else operator.le
    words = "less than" if parameter == sh.lessThan else "at most"

    def offenders(focus: Term, values: Sequence[Term], view: View) -> Sequence[Term]:
        others = view.objects(focus, other)
        return [
            each
            for each in values
            if isinstance(each, BlankNode | Triple) or not all(is_ordered(each, one, order) for one in others)
        ]

    return Constraint(parameter, value, f"must be {words} that of {phrase(value)}", offenders=offenders)


# Other (4.8)


def _data_terms(terms: Iterable[Term]) -> list[Term]:
    """Leave out blank nodes: one of the shapes graph is none of the data graph, whatever its label."""
    return [each for each in terms if not isinstance(each, BlankNode)]


def _in(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint to the terms of a list; literals are equal if their normal forms are."""
    terms = [checked_term(each) for each in source.members(value)]
    contains = membership(_data_terms(terms))
    bounds = Bounds(choices=tuple(each for each in terms if isinstance(each, Literal)))
    words = f"must be one of {list_terms(terms)}"
    return Constraint(parameter, value, words, lambda value, _: contains(value), bounds=bounds)


def _has_value(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    contains = membership(_data_terms([checked_term(value)]))
    bounds = Bounds(choices=(value,)) if isinstance(value, Literal) else UNBOUNDED
    offenders: Offenders = lambda _, values, view: () if any(map(contains, values)) else (None,)  # noqa: E731
    return Constraint(parameter, value, f"must be {phrase(value)}", offenders=offenders, bounds=bounds)


def _closed(parameter: NamedNode, value: Term, source: ShapeSource) -> Constraint:
    """Return the constraint to the properties of the shape's property shapes and the ignored ones."""
    is_closed = checked_truth(value)
    allowed: set[Term | None] = {source.shape(each).path for each in source.statements.get(sh.property, ())}
    for head in source.statements.get(sh.ignoredProperties, ()):
        allowed |= set(map(checked_iri, source.members(head)))

    def strangers(value: Term, view: View) -> Iterator[tuple[NamedNode, Term]]:
        for predicate, terms in view.properties(value).items() if is_closed else ():
            if predicate not in allowed:
                yield from ((predicate, each) for each in terms if (predicate, each) != (rdf.type, _RESOURCE))

    def test(value: Term, view: View) -> bool:
        return next(strangers(value, view), None) is None

    return Constraint(parameter, value, "is not allowed here", test, strangers=strangers)


Build: TypeAlias = Callable[[NamedNode, Term, ShapeSource], Constraint]
CONSTRAINTS: Mapping[NamedNode, Build] = {
    sh.class_: _class,
    sh.datatype: _datatype,
    sh.nodeKind: _node_kind,
    sh.minCount: _count,
    sh.maxCount: _count,
    **dict.fromkeys(_RANGES, _range),
    sh.minLength: _length,
    sh.maxLength: _length,
    sh.pattern: _pattern,
    sh.not_: _not,
    sh.and_: _logic,
    sh.or_: _logic,
    sh.xone: _logic,
    sh.node: _node,
    sh.property: _property,
    sh.in_: _in,
    sh.hasValue: _has_value,
    _QUALIFIED: _qualified,
    _QUALIFIED_MIN: _qualified_count,
    _QUALIFIED_MAX: _qualified_count,
    term("languageIn"): _language_in,
    term("uniqueLang"): _unique_language,
    sh.closed: _closed,
    term("equals"): _equals,
    term("disjoint"): _disjoint,
    sh.lessThan: _less,
    sh.lessThanOrEquals: _less,
}
"""Functions that read the values of the parameters of SHACL Core."""
