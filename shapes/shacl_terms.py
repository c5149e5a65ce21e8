"""The terms of SHACL Core by what becomes of them here: compiled, left to pyshacl, said about a shape."""

from __future__ import annotations

from pyoxigraph import NamedNode

from rosld.ontology.vocab import sh


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
    """A term of SHACL as people write it, such as `sh:path`."""
    return f"sh:{term.value[len(sh.iri) :]}"
