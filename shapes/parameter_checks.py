"""Values of SHACL's parameters, checked: a fault in words for one that is of another kind than it must be."""

from __future__ import annotations

from pyoxigraph import Literal, NamedNode, Triple

from rosld.ontology.body import Term
from rosld.ontology.vocab import rdf, xsd
from rosld.shapes.terms import is_numeric, number

_XML = frozenset(NamedNode(rdf.iri + name) for name in ("XMLLiteral", "HTML"))
_CARDINAL = (xsd.integer, xsd.nonNegativeInteger, NamedNode(xsd.iri + "positiveInteger"))
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


class ParameterFault(ValueError):
    """What is wrong with the value of a parameter, in words that follow its name."""


def checked_iri(value: Term) -> NamedNode:
    """The value, which must be an IRI. Raises ParameterFault."""
    if not isinstance(value, NamedNode):
        raise ParameterFault(f"is {value}, where an IRI is needed")
    return value


def checked_text(value: Term) -> str:
    """The text of the value, which must be an xsd:string. Raises ParameterFault."""
    if not isinstance(value, Literal) or value.datatype != xsd.string:
        raise ParameterFault(f"is {value}, where a string is needed")
    return value.value


def checked_truth(value: Term) -> bool:
    """What the value says, which must be an xsd:boolean. Raises ParameterFault."""
    if not isinstance(value, Literal) or value.datatype != xsd.boolean or value.value not in _TRUTH:
        raise ParameterFault(f"is {value}, where true or false is needed")
    return _TRUTH[value.value]


def checked_cardinal(value: Term) -> int:
    """The number of the value, which must be an integer from 0. Raises ParameterFault."""
    if isinstance(value, Literal) and value.datatype in _CARDINAL:
        found = number(value)
        if isinstance(found, int) and found >= 0:
            return found
    raise ParameterFault(f"is {value}, where an integer from 0 is needed")


def checked_term(value: Term) -> Term:
    """The value, which must be a term that can be compared with.

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
