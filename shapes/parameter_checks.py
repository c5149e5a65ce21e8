"""Parameters of SHACL Core: the terms by their treatment here, and checks of their values."""

from __future__ import annotations

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.vocab import rdf, sh, xsd
from rosld.shapes.terms import is_numeric, number


def _terms(names: str) -> frozenset[NamedNode]:
    return frozenset(NamedNode(sh.iri + name) for name in names.split())


COMPILED = _terms(
    "class datatype nodeKind minCount maxCount minInclusive maxInclusive minExclusive maxExclusive minLength maxLength "
    "pattern flags and or not xone node property in hasValue"
)
LEFT_TO_PYSHACL = _terms(
    "languageIn uniqueLang equals disjoint lessThan lessThanOrEquals closed ignoredProperties qualifiedValueShape "
    "qualifiedMinCount qualifiedMaxCount qualifiedValueShapesDisjoint"
)
PAIRS = _terms("equals disjoint lessThan lessThanOrEquals")
"""Those whose values are predicates that the values of the path are compared with."""
TARGETS = _terms("targetNode targetClass targetSubjectsOf targetObjectsOf")
ABOUT = _terms("path message severity deactivated name description order group defaultValue")
REPEATABLE = _terms(
    "class minInclusive maxInclusive minExclusive maxExclusive pattern and or not xone node property hasValue equals "
    "disjoint lessThan lessThanOrEquals qualifiedValueShape message name description targetNode targetClass "
    "targetSubjectsOf targetObjectsOf"
)
"""Those that a shape may have more than once."""
BEYOND_CORE = _terms("sparql js rule expression target values entailment shapesGraph")
BOUNDS = _terms("minInclusive maxInclusive minExclusive maxExclusive minLength maxLength pattern in")
"""Those that only narrow what a single value may be."""


def prefixed(term: NamedNode) -> str:
    """Return a term of SHACL as people write it, such as `sh:path`."""
    return f"sh:{term.value[len(sh.iri) :]}"


_XML = frozenset(NamedNode(rdf.iri + name) for name in ("XMLLiteral", "HTML"))
_CARDINAL = (xsd.integer, xsd.nonNegativeInteger, NamedNode(xsd.iri + "positiveInteger"))
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


class ParameterFault(ValueError):
    """The value of a parameter is invalid; the words follow its name."""


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
    """Return the number of the value, which must be an integer from 0. Raises ParameterFault."""
    if isinstance(value, Literal) and value.datatype in _CARDINAL:
        found = number(value)
        if isinstance(found, int) and found >= 0:
            return found
    raise ParameterFault(f"is {value}, where an integer from 0 is needed")


def checked_term(value: Term) -> Term:
    """Return the value, which must be a term that can be compared with.

    Raises ParameterFault for triple terms, for markup, and for ill-typed numbers.
    """
    if isinstance(value, Triple):
        raise ParameterFault("is a triple term, which SHACL does not know")
    if isinstance(value, Literal):
        if value.datatype in _XML:
            raise ParameterFault("is XML or HTML, which is not compared here")
        if is_numeric(value.datatype) and number(value) is None:
            raise ParameterFault(f"is {value}, which is no number")
    return value
